//! Which triangle does a ray meet, and where? Builds a unit floor, casts one ray at it and one past it.

use hplt_geom::glam::{DVec3, Vec3};
use hplt_geom::{BuildPolicy, Bvh, BvhOptions, Error, Material, MeshInput, Ray, RayCaster, Rgb, SceneBuilder};

fn main() -> Result<(), Error> {
    let mut builder = SceneBuilder::new();
    let material = builder.push_material(Material::diffuse("floor", Rgb::splat(0.8)));
    let positions = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, 0.0]].map(DVec3::from);
    let triangles = &[[0, 1, 2], [0, 2, 3]];
    builder.push_mesh(MeshInput {
        name: "floor",
        positions: &positions,
        normals: &[],
        uvs: &[],
        triangles,
        material,
    })?;
    let (scene, _) = builder.build(BuildPolicy::default())?;

    let (bvh, report) = Bvh::build(&scene, BvhOptions::production());
    println!("{} triangles, {} bytes, {} levels", report.n_triangles, report.memory, report.depth);

    // Rays live in scene space: ask the frame.
    let origin = scene.frame().scene_from_world_point(DVec3::new(0.25, 2.0, 0.5));
    let hit = bvh.nearest(Ray::new(origin, Vec3::NEG_Y));
    let point = scene.surface_at(&hit);
    let world = scene.frame().world_from_scene_point(point.position);
    println!("triangle {} at {world}, normal {}", hit.triangle.0, point.normal);
    assert!((world - DVec3::new(0.25, 0.0, 0.5)).length() < 1e-6);
    assert!(!bvh.is_occluded(point.ray(Vec3::new(0.3, 1.0, 0.2))), "nothing stands on the floor");
    Ok(())
}
