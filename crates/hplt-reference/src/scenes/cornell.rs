use hplt_geom::glam::DVec3;
use hplt_geom::radiometry::exitance_from_radiance;
use hplt_geom::{Camera, Error, Material, MaterialId, MeshInput, Rgb, SceneBuilder};

use super::Shape;

const WHITE: Rgb = Rgb::new(0.725, 0.71, 0.68);
const RED: Rgb = Rgb::new(0.63, 0.065, 0.05);
const GREEN: Rgb = Rgb::new(0.14, 0.45, 0.091);
const LIGHT_ALBEDO: f32 = 0.78;
const LIGHT_RADIANCE: Rgb = Rgb::new(17.0, 12.0, 4.0);

/// What closes the open front of the Cornell box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Front {
    /// A wall that reflects nothing: the light inside is that of the open box.
    Black,
    /// A wall like the back wall.
    White,
}

/// The Cornell box: 36 triangles, metres, open front, one camera.
///
/// Geometry as measured by Cornell University's Program of Computer Graphics (Goral et al. 1984), with whole quads for
/// floor and ceiling, the light half a millimetre under the ceiling, and the blocks' bottoms in the floor plane. RGB
/// albedos 0.725 0.71 0.68 (white), 0.63 0.065 0.05 (red), 0.14 0.45 0.091 (green), light radiance 17 12 4.
pub fn cornell_box() -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    let white = walls_and_light(&mut builder);
    block("short block", 165.0, [[130.0, 65.0], [82.0, 225.0], [240.0, 272.0], [290.0, 114.0]], white, &mut builder);
    block("tall block", 330.0, [[423.0, 247.0], [265.0, 296.0], [314.0, 456.0], [472.0, 406.0]], white, &mut builder);
    builder.push_camera(camera());
    builder
}

/// The Cornell box with its front closed: 38 triangles. The camera stands outside and sees the closing wall.
pub fn cornell_box_closed(front: Front) -> SceneBuilder {
    let mut builder = cornell_box();
    close(front, &mut builder);
    builder
}

/// A given mesh in the closed Cornell box without its blocks, lit by the Cornell light.
///
/// `mesh` is in world space, already where it should stand (the room reaches from the origin to
/// (0.5528, 0.5488, 0.5592) m, its floor is y = 0); its material index is replaced by `material`. The front wall is
/// black on the outside, and inside white; the camera stands inside, at the front.
///
/// # Errors
/// When the mesh is invalid ([`SceneBuilder::push_mesh`]).
pub fn room_with(mesh: MeshInput<'_>, material: Material) -> Result<SceneBuilder, Error> {
    let mut builder = SceneBuilder::new();
    walls_and_light(&mut builder);
    close(Front::White, &mut builder);
    let material = builder.push_material(material);
    builder.push_mesh(MeshInput { material, ..mesh })?;
    let eye = DVec3::new(0.278, 0.25, 0.012);
    let target = DVec3::new(0.278, 0.15, 0.28);
    if let Ok(camera) = Camera::look_at(eye, target, DVec3::Y, 75f64.to_radians()) {
        builder.push_camera(Camera { name: "inside".into(), aspect: Some(1.0), ..camera });
    }
    Ok(builder)
}

/// Floor, ceiling, three walls and the light. Returns the white material.
fn walls_and_light(builder: &mut SceneBuilder) -> MaterialId {
    let white = builder.push_material(Material::diffuse("white", WHITE));
    let green = builder.push_material(Material::diffuse("green", GREEN));
    let red = builder.push_material(Material::diffuse("red", RED));
    let exitance = exitance_from_radiance(LIGHT_RADIANCE);
    let light = builder.push_material(Material::emitter("light", Rgb::splat(LIGHT_ALBEDO), exitance));
    let quads = [
        ("floor", white, [[552.8, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 559.2], [549.6, 0.0, 559.2]]),
        ("ceiling", white, [[556.0, 548.8, 0.0], [556.0, 548.8, 559.2], [0.0, 548.8, 559.2], [0.0, 548.8, 0.0]]),
        ("back wall", white, [[549.6, 0.0, 559.2], [0.0, 0.0, 559.2], [0.0, 548.8, 559.2], [556.0, 548.8, 559.2]]),
        ("right wall", green, [[0.0, 0.0, 559.2], [0.0, 0.0, 0.0], [0.0, 548.8, 0.0], [0.0, 548.8, 559.2]]),
        ("left wall", red, [[552.8, 0.0, 0.0], [549.6, 0.0, 559.2], [556.0, 548.8, 559.2], [556.0, 548.8, 0.0]]),
        ("light", light, [[343.0, 548.3, 227.0], [343.0, 548.3, 332.0], [213.0, 548.3, 332.0], [213.0, 548.3, 227.0]]),
    ];
    for (name, material, corners) in quads {
        Shape::new().quad(corners.map(metres)).push_into(builder, name, material);
    }
    white
}

fn close(front: Front, builder: &mut SceneBuilder) {
    let material = match front {
        Front::Black => Material::diffuse("front", Rgb::ZERO),
        Front::White => Material::diffuse("front", WHITE),
    };
    let material = builder.push_material(material);
    let corners = [[552.8, 0.0, 0.0], [556.0, 548.8, 0.0], [0.0, 548.8, 0.0], [0.0, 0.0, 0.0]];
    Shape::new().quad(corners.map(metres)).push_into(builder, "front", material);
}

/// A block on the floor: its top as (x, z), counter-clockwise from above, then sides and bottom.
fn block(name: &str, height: f64, top: [[f64; 2]; 4], material: MaterialId, builder: &mut SceneBuilder) {
    let at = |i: usize, y: f64| metres([top[i % 4][0], y, top[i % 4][1]]);
    let mut shape = Shape::new();
    shape.quad([0, 1, 2, 3].map(|i| at(i, height)));
    for i in 0..4 {
        shape.quad([at(i, height), at(i, 0.0), at(i + 1, 0.0), at(i + 1, height)]);
    }
    shape.quad([3, 2, 1, 0].map(|i| at(i, 0.0)));
    shape.push_into(builder, name, material);
}

fn metres(millimetres: [f64; 3]) -> DVec3 {
    DVec3::from(millimetres) / 1000.0
}

/// 35 mm lens on a film of 25 mm × 25 mm.
fn camera() -> Camera {
    Camera {
        name: "cornell".into(),
        eye: DVec3::new(0.278, 0.273, -0.8),
        forward: DVec3::Z,
        up: DVec3::Y,
        vertical_fov: 2.0 * (12.5f64 / 35.0).atan(),
        aspect: Some(1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::super::build;
    use super::*;
    use hplt_geom::{TriangleId, glam};

    #[test]
    fn the_cornell_box_has_36_triangles_that_face_the_room() {
        let scene = build(cornell_box());
        assert_eq!(scene.mesh().n_triangles(), 36);
        let middle = scene.frame().scene_from_world_point(DVec3::new(0.278, 0.274, 0.28));
        for t in (0..12).map(TriangleId) {
            let towards = middle - scene.mesh().corners(t)[0];
            assert!(scene.mesh().face_normal(t).dot(towards) > 0.0, "triangle {t:?}");
        }
        for block in [12..24, 24..36] {
            let corners = |t: u32| scene.mesh().corners(TriangleId(t));
            let centre = block.clone().flat_map(corners).map(|p| p / 36.0).sum::<glam::Vec3>();
            for t in block {
                let outwards = corners(t)[0] - centre;
                assert!(scene.mesh().face_normal(TriangleId(t)).dot(outwards) > 0.0, "triangle {t}");
            }
        }
    }

    #[test]
    fn areas_are_the_measured_ones() {
        let scene = build(cornell_box());
        let scale = scene.frame().scale() * scene.frame().scale();
        let area = |t: u32| scene.mesh().area(TriangleId(t)) * scale;
        let walls: f64 = (0..10).map(area).sum();
        assert!((walls - 1.5363).abs() < 5e-5, "{walls}");
        let light: f64 = scene.emissive_triangles().map(|t| area(t.0)).sum();
        assert!((light - 0.01365).abs() < 1e-8, "{light}");
    }

    #[test]
    fn the_closed_box_has_two_triangles_more() {
        assert_eq!(build(cornell_box_closed(Front::Black)).mesh().n_triangles(), 38);
    }
}
