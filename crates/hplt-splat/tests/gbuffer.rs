//! What a G-buffer holds, and the pictures made from it.

mod common;

use common::{Rectangle, camera, gbuffer_of, room, room_gbuffer, scene_of};
use glam::{DVec3, Vec3};
use hplt_geom::{
    BuildPolicy, Bvh, BvhOptions, Camera, Environment, Image, Interrupted, Material, NoProgress, Progress, RegionId,
    Rgb, Scene, SceneBuilder, TriangleId,
};
use hplt_splat::{Error, GBuffer, GBufferOptions, LayerValues, layers, radiance};

/// A unit square that emits π·(1, 2, 3) W/m² and reflects a half, seen face on from 1 m, with only its surroundings dark.
fn emitter(environment: Option<Environment>) -> Scene {
    let mut builder = SceneBuilder::new();
    let exitance = Rgb::new(1.0, 2.0, 3.0) * std::f32::consts::PI;
    let square = Rectangle::new([-0.5, -0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    square.push(&mut builder, Material::emitter("lamp", Rgb::splat(0.5), exitance));
    if let Some(environment) = environment {
        builder.set_environment(environment);
    }
    builder.build(BuildPolicy::default()).unwrap().0
}

fn from_in_front(target: [f64; 3]) -> Camera {
    let target = DVec3::from(target);
    Camera::look_at(target + DVec3::Z, target, DVec3::Y, std::f64::consts::FRAC_PI_2).unwrap()
}

#[test]
fn pixel_0_0_is_at_the_top_left() {
    // The axis of view goes through the lower right corner of the square: it fills the upper left quarter.
    let camera = from_in_front([0.5, -0.5, 0.0]);
    let gbuffer = gbuffer_of(&emitter(None), &camera, GBufferOptions::preview(20, 16));
    for y in 0..16 {
        for x in 0..20 {
            // At 1 m a field of view of 90° is 2 m high: the square reaches 8 pixels up and left.
            let inside = (2..10).contains(&x) && y < 8;
            assert_eq!(!gbuffer.is_background(y * 20 + x), inside, "column {x}, row {y}");
        }
    }
    let image = radiance(&gbuffer, &vec![Rgb::ZERO; 320], &vec![Rgb::ZERO; 320]);
    assert_eq!(image.pixels()[2].round(), Vec3::new(1.0, 2.0, 3.0));
    assert_eq!(image.pixels()[0], Rgb::ZERO);
}

#[test]
fn samples_lie_in_their_strata_in_the_documented_order() {
    let options = GBufferOptions { samples_per_axis: 3, ..GBufferOptions::preview(24, 18) };
    let gbuffer = gbuffer_of(&scene_of(&room()), &camera(), options);
    assert_eq!(gbuffer.n_samples(), 24 * 18 * 9);
    assert!(gbuffer.n_surface_samples() > 1000);
    let mut offsets = Vec::new();
    for i in (0..gbuffer.n_samples()).filter(|&i| !gbuffer.is_background(i)) {
        let (pixel, stratum) = (i / 9, i % 9);
        let at = gbuffer.projection().pixel(gbuffer.positions()[i]).unwrap();
        let x = at.x * 3.0 - ((pixel % 24) * 3 + stratum % 3) as f32;
        let y = at.y * 3.0 - ((pixel / 24) * 3 + stratum / 3) as f32;
        assert!((-1e-3..1.001).contains(&x) && (-1e-3..1.001).contains(&y), "sample {i} at {at}: {x} {y}");
        offsets.push(x);
    }
    let spread = offsets.iter().fold([1.0f32, 0.0], |[lo, hi], &x| [lo.min(x), hi.max(x)]);
    assert!(spread[0] < 0.1 && spread[1] > 0.9, "jitter fills its strata: {spread:?}");
    let other = gbuffer_of(&scene_of(&room()), &camera(), GBufferOptions { seed: 1, ..options });
    assert_ne!(other.positions(), gbuffer.positions(), "the seed moves the samples");
}

/// As if all pixels had as many samples in those that are chosen; untouched in the others.
#[test]
fn refining_changes_the_pixels_that_are_chosen() {
    let (scene, camera, options) = (scene_of(&room()), camera(), GBufferOptions::preview(24, 18));
    let (bvh, _) = Bvh::build(&scene, BvhOptions::fast());
    let coarse = gbuffer_of(&scene, &camera, options);
    let fine = gbuffer_of(&scene, &camera, GBufferOptions { samples_per_axis: 3, ..options });
    let is_chosen: Vec<bool> = (0..24 * 18).map(|pixel| pixel % 5 == 2).collect();
    let mixed = coarse.refined((&scene, &bvh, &camera), &is_chosen, 3, &NoProgress).unwrap();
    for (pixel, &is_chosen) in is_chosen.iter().enumerate() {
        let (from, n) = if is_chosen { (&fine, 9) } else { (&coarse, 1) };
        assert_eq!(mixed.samples_of(pixel).len(), n);
        let (here, there) = (mixed.samples_of(pixel), from.samples_of(pixel));
        assert_eq!(mixed.positions()[here.clone()], from.positions()[there.clone()]);
        assert_eq!(mixed.depths()[here.clone()], from.depths()[there.clone()]);
        assert_eq!(mixed.regions()[here], from.regions()[there]);
    }
    let none = vec![false; 24 * 18];
    assert_eq!(coarse.refined((&scene, &bvh, &camera), &none, 1, &NoProgress).unwrap(), coarse);
    assert!(coarse.refined((&scene, &bvh, &camera), &none, 0, &NoProgress).is_err());
}

#[test]
fn background_is_the_environment_and_everything_else_there_is_empty() {
    let gbuffer = room_gbuffer(32, 24);
    let zero = vec![Rgb::ZERO; gbuffer.n_samples()];
    let image = radiance(&gbuffer, &zero, &zero);
    let mut n_background = 0;
    for (i, query) in gbuffer.queries().iter().enumerate() {
        if gbuffer.is_background(i) {
            n_background += 1;
            assert_eq!(image.pixels()[i], Rgb::new(0.25, 0.5, 0.75));
            assert_eq!((gbuffer.depths()[i], gbuffer.regions()[i]), (f32::INFINITY, RegionId::DARK));
            assert_eq!((query.region, gbuffer.albedos()[i]), (RegionId::DARK, Rgb::ZERO));
            assert_eq!((gbuffer.triangles()[i], gbuffer.fronts()[i]), (TriangleId::NONE, false));
        } else {
            assert_eq!(image.pixels()[i], Rgb::ZERO);
            assert_eq!(gbuffer.albedos()[i], Rgb::splat(0.5));
        }
    }
    assert!((50..700).contains(&n_background), "{n_background}");
    assert_eq!(gbuffer.n_surface_samples(), gbuffer.n_samples() - n_background);
}

#[test]
fn an_environment_map_is_seen_the_right_way_up() {
    let (sky, ground) = (Rgb::new(0.0, 0.0, 1.0), Rgb::new(0.2, 0.1, 0.0));
    let environment = Environment::from_map(Image::from_pixels(1, 2, vec![sky, ground])).unwrap();
    let camera = Camera::look_at(DVec3::new(9.0, 0.0, 9.0), DVec3::new(9.0, 0.0, 0.0), DVec3::Y, 1.0).unwrap();
    let gbuffer = gbuffer_of(&emitter(Some(environment)), &camera, GBufferOptions::preview(6, 6));
    let image = radiance(&gbuffer, &[Rgb::ZERO; 36], &[Rgb::ZERO; 36]);
    assert!(image.pixels()[..18].iter().all(|p| *p == sky));
    assert!(image.pixels()[18..].iter().all(|p| *p == ground));
}

#[test]
fn radiance_is_emission_plus_reflection_over_pi_and_layers_add_up_to_it() {
    let environment = Environment::constant(Rgb::splat(0.125)).unwrap();
    let options = GBufferOptions { samples_per_axis: 2, ..GBufferOptions::preview(9, 7) };
    let gbuffer = gbuffer_of(&emitter(Some(environment)), &from_in_front([0.4, 0.0, 0.0]), options);
    let pi = std::f32::consts::PI;
    let direct = vec![Rgb::new(4.0, 0.0, 2.0) * pi; gbuffer.n_samples()];
    let indirect = vec![Rgb::new(0.0, 1.0, 2.0) * pi; gbuffer.n_samples()];
    let image = radiance(&gbuffer, &direct, &indirect);
    let expected = Rgb::new(1.0 + 2.0, 2.0 + 0.5, 3.0 + 2.0);
    let mut kinds = [0; 3];
    for (pixel, value) in image.pixels().iter().enumerate() {
        let covered = (0..4).filter(|s| !gbuffer.is_background(pixel * 4 + s)).count();
        let share = covered as f32 / 4.0;
        let mix = expected * share + 0.125 * (1.0 - share);
        assert!((*value - mix).abs().max_element() < 2e-6, "pixel {pixel}: {value} {mix}");
        kinds[usize::from(covered > 0) + usize::from(covered == 4)] += 1;
    }
    assert!(kinds.iter().all(|&k| k > 0), "empty, cut and full pixels: {kinds:?}");

    let layers = layers(&gbuffer, &direct, &indirect);
    let names: Vec<_> = layers.iter().map(|l| l.name).collect();
    assert_eq!(names, ["direct", "indirect", "emission", "irradiance", "albedo", "normal", "position", "depth"]);
    let color = |i: usize| match &layers[i].values {
        LayerValues::Color(image) => image.pixels().to_vec(),
        other => panic!("{other:?}"),
    };
    let (a, b, c) = (color(0), color(1), color(2));
    let sum: Vec<Rgb> = (0..63).map(|i| a[i] + b[i] + c[i]).collect();
    assert!(common::max_difference(&sum, image.pixels()) < 2e-6);
    // The comparison sees a layer that is missing.
    assert!(common::max_difference(&a, image.pixels()) > 0.1);
}

#[test]
fn geometric_layers_are_in_world_space() {
    let mut builder = SceneBuilder::new();
    let far = Rectangle::new([1000.0, 2000.0, 3000.0], [64.0, 0.0, 0.0], [0.0, 64.0, 0.0]);
    far.push(&mut builder, Material::diffuse("wall", Rgb::splat(0.5)));
    let scene = builder.build(BuildPolicy::default()).unwrap().0;
    let camera = from_in_front([1032.0, 2032.0, 3019.0]);
    let gbuffer = gbuffer_of(&scene, &camera, GBufferOptions::preview(5, 5));
    let layers = layers(&gbuffer, &[Rgb::ZERO; 25], &[Rgb::ZERO; 25]);
    let (LayerValues::Vector(normals), LayerValues::Vector(positions), LayerValues::Scalar(depths)) =
        (&layers[5].values, &layers[6].values, &layers[7].values)
    else {
        panic!("kinds of layers")
    };
    // 20 m in front of the wall, 90° over 5 pixels: 8 m per pixel, and the same depth everywhere.
    assert_eq!(normals[12], Vec3::Z);
    assert!((positions[12] - Vec3::new(1032.0, 2032.0, 3000.0)).length() < 1e-3, "{}", positions[12]);
    assert!((positions[6] - Vec3::new(1024.0, 2040.0, 3000.0)).length() < 1e-3, "{}", positions[6]);
    assert!(depths.iter().all(|d| (d - 20.0).abs() < 1e-4), "{depths:?}");
}

#[test]
fn regions_go_to_the_surface_samples_in_order() {
    let mut gbuffer = room_gbuffer(32, 24);
    let points = gbuffer.surface_points();
    let by_height = |p: Vec3| RegionId(u32::from(p.y > 0.0));
    gbuffer.set_regions(points.iter().map(|(position, _)| by_height(*position)).collect());
    for (i, query) in gbuffer.queries().iter().enumerate() {
        let expected = if gbuffer.is_background(i) { RegionId::DARK } else { by_height(gbuffer.positions()[i]) };
        assert_eq!(query.region, expected);
    }
    assert!(points.iter().any(|(p, _)| p.y > 0.0) && points.iter().any(|(p, _)| p.y < 0.0));
}

#[test]
fn queries_have_the_shading_normal_and_geometric_queries_the_other() {
    let mut builder = SceneBuilder::new();
    let material = builder.push_material(Material::diffuse("bent", Rgb::splat(0.5)));
    let tilted = [Vec3::new(0.6, 0.0, 0.8); 3];
    let positions = [DVec3::ZERO, DVec3::X, DVec3::Y];
    let triangles = [[0, 1, 2]];
    let input = hplt_geom::MeshInput {
        name: "t",
        positions: &positions,
        normals: &tilted,
        uvs: &[],
        triangles: &triangles,
        material,
    };
    builder.push_mesh(input).unwrap();
    let scene = builder.build(BuildPolicy::default()).unwrap().0;
    let gbuffer = gbuffer_of(&scene, &from_in_front([0.25, 0.25, 0.0]), GBufferOptions::preview(9, 9));
    assert!((gbuffer.queries()[40].normal - tilted[0]).length() < 1e-6);
    assert_eq!(gbuffer.geometric_queries()[40].normal, Vec3::Z);
    assert!(gbuffer.fronts()[40]);
}

#[test]
fn bad_options_and_interruption_are_errors() {
    struct Stop;
    impl Progress for Stop {
        fn advance(&self, _: &'static str, _: u64, _: u64) {}
        fn is_cancelled(&self) -> bool {
            true
        }
    }
    let scene = emitter(None);
    let bvh = Bvh::build(&scene, BvhOptions::fast()).0;
    let camera = from_in_front([0.0; 3]);
    let stopped = GBuffer::trace(&scene, &bvh, &camera, GBufferOptions::preview(8, 8), &Stop);
    assert_eq!(stopped.unwrap_err(), Error::Interrupted(Interrupted));
    let empty = GBuffer::trace(&scene, &bvh, &camera, GBufferOptions::preview(0, 8), &NoProgress);
    assert_eq!(empty.unwrap_err().to_string(), "width: 0 is out of range; expected 1 or more");
}
