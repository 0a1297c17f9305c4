//! Direct light against closed forms.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::{DVec3, Vec2, Vec3};
use hplt_geom::{
    Blocker, Bvh, BvhOptions, Environment, Hit, Image, Material, NoProgress, OrientedPoint, Ray, RayCaster, RegionId,
    Rgb, Scene, SceneBuilder, Shaft,
};
use hplt_reference::scenes::{self, Shape};
use hplt_sampling::random::Stage;
use hplt_transport::{DirectEstimator, DirectLight, DirectOptions, direct_irradiance};

/// Point to the middle of a parallel unit square at height 1 (verification case A17).
const UNIT_SQUARE: f32 = 0.239_456_47;

fn at(scene: &Scene, position: [f64; 3], normal: Vec3) -> OrientedPoint {
    let position = scene.frame().scene_from_world_point(DVec3::from(position));
    OrientedPoint::new(position, normal, RegionId(0))
}

fn direct(scene: &Scene, points: &[OrientedPoint], options: DirectOptions) -> Vec<Rgb> {
    let (bvh, _) = Bvh::build(scene, BvhOptions::default());
    let light = DirectLight::new(scene, options);
    direct_irradiance(&light, &bvh, points, Stage::Direct, &NoProgress).unwrap()
}

/// A floor at y = 0 and a unit square of `n × n` quads at height 1 that emits 1 W/m² downwards.
fn floor_and_lamp(n: u32) -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    let floor = builder.push_material(Material::diffuse("floor", Rgb::splat(0.5)));
    let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::new(1.0, 2.0, 0.5)));
    let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    Shape::new()
        .quad([corner(-5.0, 0.0, -5.0), corner(-5.0, 0.0, 5.0), corner(5.0, 0.0, 5.0), corner(5.0, 0.0, -5.0)])
        .push_into(&mut builder, "floor", floor);
    let h = 0.5;
    Shape::new()
        .grid([corner(-h, 1.0, -h), corner(h, 1.0, -h), corner(h, 1.0, h), corner(-h, 1.0, h)], n, n)
        .push_into(&mut builder, "lamp", lamp);
    builder
}

#[test]
fn an_unoccluded_lamp_is_exact_whatever_the_samples() {
    let scene = scenes::build(floor_and_lamp(1));
    for light_samples in [1, 16] {
        let options =
            DirectOptions { light_samples, estimator: DirectEstimator::Lights, ..DirectOptions::projection() };
        let e = direct(&scene, &[at(&scene, [0.0; 3], Vec3::Y)], options)[0];
        assert!((e / Rgb::new(1.0, 2.0, 0.5) / UNIT_SQUARE - Rgb::ONE).abs().max_element() < 1e-5, "{e}");
    }
    // From behind, below the horizon, and on the back of the floor there is nothing.
    let dark = [at(&scene, [0.0, 1.5, 0.0], Vec3::NEG_Y), at(&scene, [0.0; 3], Vec3::NEG_Y)];
    assert_eq!(direct(&scene, &dark, DirectOptions::projection()), [Rgb::ZERO; 2]);
}

#[test]
fn many_emitters_the_hemisphere_and_one_emitter_agree() {
    let options = DirectOptions { estimator: DirectEstimator::Lights, ..DirectOptions::measurement() };
    let many = scenes::build(floor_and_lamp(16));
    // Squares of two triangles.
    assert_eq!(DirectLight::new(&many, options).n_emitters(), 16 * 16);
    let e = direct(&many, &[at(&many, [0.0; 3], Vec3::Y)], options)[0];
    assert!((e.x / UNIT_SQUARE - 1.0).abs() < 5e-3, "many: {e}");
    let hemisphere = DirectOptions { estimator: DirectEstimator::Hemisphere, ..options };
    let e = direct(&many, &[at(&many, [0.0; 3], Vec3::Y)], hemisphere)[0];
    assert!((e.x / UNIT_SQUARE - 1.0).abs() < 5e-3, "hemisphere: {e}");
}

/// With closed forms switched off, direct light is noisy and right on average, in the open and in the half-shadow of half a lamp.
#[test]
fn sampled_light_is_noisy_and_has_no_bias() {
    let mut builder = floor_and_lamp(1);
    let black = builder.push_material(Material::diffuse("black", Rgb::ZERO));
    let corner = |x: f64, z: f64| DVec3::new(x, 0.5, z);
    let corners = [corner(0.0, -2.0), corner(0.0, 2.0), corner(2.0, 2.0), corner(2.0, -2.0)];
    Shape::new().quad(corners).push_into(&mut builder, "blocker", black);
    let scene = scenes::build(builder);
    for (x, fraction) in [(0.0, 0.5), (-0.51, 1.0)] {
        // As many times the same point as there are samples of its own.
        let points = vec![at(&scene, [x, 0.0, 0.0], Vec3::Y); 1000];
        let e = |is_exact| direct(&scene, &points, DirectOptions { is_exact, ..DirectOptions::projection() });
        let (exact, sampled) = (e(true), e(false));
        let mean = sampled.iter().map(|e| f64::from(e.x)).sum::<f64>() / 1000.0;
        let variance = sampled.iter().map(|e| (f64::from(e.x) - mean).powi(2)).sum::<f64>() / 999.0;
        let noise = variance.sqrt();
        println!("{mean} of {}, noise {noise}", exact[0].x);
        assert!(exact.iter().all(|e| (e.x - exact[0].x).abs() < 1e-6));
        assert!(x < 0.0 || (exact[0].x / (fraction * UNIT_SQUARE) - 1.0).abs() < 1e-3);
        assert!(noise > 0.002 * mean && (mean - f64::from(exact[0].x)).abs() < 4.0 * noise / 1000f64.sqrt());
    }
}

/// A blocker that hides exactly half of the lamp by symmetry.
#[test]
fn half_a_lamp_gives_half_the_light() {
    let mut builder = floor_and_lamp(1);
    let black = builder.push_material(Material::diffuse("black", Rgb::ZERO));
    let corner = |x: f64, z: f64| DVec3::new(x, 0.5, z);
    Shape::new().quad([corner(0.0, -2.0), corner(0.0, 2.0), corner(2.0, 2.0), corner(2.0, -2.0)]).push_into(
        &mut builder,
        "blocker",
        black,
    );
    let scene = scenes::build(builder);
    let points = vec![at(&scene, [0.0; 3], Vec3::Y); 64];
    let lit = direct(&scene, &points, DirectOptions { light_samples: 64, ..DirectOptions::projection() });
    let mean = lit.iter().map(|e| e.x).sum::<f32>() / 64.0;
    assert!((mean / (0.5 * UNIT_SQUARE) - 1.0).abs() < 5e-3, "{mean}");
}

/// A map that is nearly constant must give what the constant gives, by the balance heuristic.
#[test]
fn a_sky_map_and_a_constant_sky_agree() {
    let mut map = Image::from_pixels(32, 16, vec![Rgb::splat(2.0); 512]);
    map.pixels_mut()[100] = Rgb::splat(2.000_001);
    for environment in [Environment::constant(Rgb::splat(2.0)).unwrap(), Environment::from_map(map).unwrap()] {
        let mut builder = scenes::single_sheet(Rgb::splat(0.5));
        builder.set_environment(environment);
        let scene = scenes::build(builder);
        let e = direct(&scene, &[at(&scene, [0.0; 3], Vec3::Y)], DirectOptions::measurement())[0];
        assert!((e.x / (2.0 * std::f32::consts::PI) - 1.0).abs() < 2e-3, "{e}");
    }
}

/// The half-bright sky: only directions with x > 0 shine, so an upward point receives half.
#[test]
fn half_a_sky_gives_half_the_light() {
    let pixels = (0..64 * 32).map(|i| if i % 64 >= 32 { Rgb::ONE } else { Rgb::ZERO }).collect();
    let mut builder = scenes::single_sheet(Rgb::splat(0.5));
    let environment = Environment::from_map(Image::from_pixels(64, 32, pixels)).unwrap();
    assert_eq!(environment.radiance(Vec3::X), Rgb::ONE);
    builder.set_environment(environment);
    let scene = scenes::build(builder);
    let e = direct(&scene, &[at(&scene, [0.0; 3], Vec3::Y)], DirectOptions::measurement())[0];
    assert!((e.x / (0.5 * std::f32::consts::PI) - 1.0).abs() < 3e-3, "{e}");
}

#[test]
fn point_and_spot_lights_fall_off_with_distance_and_cosine() {
    let mut builder = scenes::single_sheet(Rgb::splat(0.5));
    builder.push_point_light("point", DVec3::new(0.3, 0.4, 0.0), Rgb::splat(2.0));
    builder.push_spot_light("spot", DVec3::new(0.0, 0.5, 0.0), Vec3::NEG_Y, Rgb::splat(1.0), 0.2, 0.3);
    let scene = scenes::build(builder);
    let expected = 2.0 * 0.8 / 0.25 + 1.0 / 0.25;
    let e = direct(&scene, &[at(&scene, [0.0; 3], Vec3::Y)], DirectOptions::projection())[0];
    assert!((e.x / expected - 1.0).abs() < 1e-5, "{e} {expected}");
    // Outside the cone the spot gives nothing.
    let far = [at(&scene, [-0.4, 0.0, 0.0], Vec3::Y)];
    let to = Vec2::new(0.7, 0.4);
    let expected = 2.0 * (0.4 / to.length()) / to.length_squared();
    let e = direct(&scene, &far, DirectOptions::projection())[0];
    assert!((e.x / expected - 1.0).abs() < 1e-5, "{e} {expected}");
}

/// Over [`floor_and_lamp`], at half the height: sheets that leave a slit of the width `2 gap` along z open where `z < end`.
fn slit(builder: &mut SceneBuilder, gap: f64, end: f64) {
    let black = builder.push_material(Material::diffuse("black", Rgb::ZERO));
    let mut shape = Shape::new();
    let mut sheet = |x: [f64; 2], z: [f64; 2]| {
        let corner = |i: usize, k: usize| DVec3::new(x[i], 0.5, z[k]);
        shape.quad([corner(0, 0), corner(0, 1), corner(1, 1), corner(1, 0)]);
    };
    sheet([-4.0, -gap], [-4.0, 4.0]);
    sheet([gap, 4.0], [-4.0, 4.0]);
    if end < 4.0 {
        sheet([-gap, gap], [end, 4.0]);
    }
    shape.push_into(builder, "sheets", black);
}

/// Higher up a crowd of small triangles, more than are cut out of a lamp, which hides what is at `x > 0.1`, or `z > 0` if it is `across`.
fn crowd(builder: &mut SceneBuilder, across: bool) {
    let black = builder.push_material(Material::diffuse("crowd", Rgb::ZERO));
    let corner = |x: f64, z: f64| DVec3::new(x, 0.75, z);
    let from = if across { [-1.0, 0.0] } else { [0.1, -1.0] };
    Shape::new()
        .grid([corner(from[0], from[1]), corner(from[0], 1.0), corner(1.0, 1.0), corner(1.0, from[1])], 20, 20)
        .push_into(builder, "crowd", black);
}

fn through_slit(gap: f64, end: f64, crowded: Option<bool>, options: DirectOptions) -> Vec<f32> {
    let mut builder = floor_and_lamp(1);
    slit(&mut builder, gap, end);
    if let Some(across) = crowded {
        crowd(&mut builder, across);
    }
    let scene = scenes::build(builder);
    // Off the middle, to which the first ray goes.
    let points: Vec<_> = (0..8).map(|i| at(&scene, [0.003 + 0.001 * f64::from(i), 0.0, 0.0], Vec3::Y)).collect();
    direct(&scene, &points, options).into_iter().map(|e| e.x).collect()
}

/// A sliver of a lamp so thin that next to no shadow ray to the lamp would meet it, behind more blockers than can all be cut out: found
/// by cutting out those that rays meet.
#[test]
fn slivers_of_a_lamp_are_found_in_a_crowd() {
    for gap in [1e-3, 1e-4] {
        let exact = through_slit(gap, 4.0, None, DirectOptions::measurement());
        assert!(exact.iter().all(|&e| 0.0 < e && e < 5.0 * gap as f32), "{exact:?}");
        for options in [DirectOptions::measurement(), DirectOptions::projection()] {
            let found = through_slit(gap, 4.0, Some(false), options);
            for (found, exact) in found.iter().zip(&exact) {
                assert!((found / exact - 1.0).abs() < 1e-3, "gap {gap}: {found} {exact}");
            }
        }
    }
}

/// Half of what the cuts leave is hidden by small triangles: their share is sampled.
#[test]
fn what_is_left_of_a_lamp_is_sampled() {
    let exact = through_slit(1e-3, 0.0, None, DirectOptions::measurement());
    let found = through_slit(1e-3, 4.0, Some(true), DirectOptions::measurement());
    for (found, exact) in found.iter().zip(&exact) {
        assert!((found / exact - 1.0).abs() < 0.02, "{found} {exact}");
    }
}

/// Without a slit nothing is visible, and that is no matter of chance.
#[test]
fn a_hidden_lamp_gives_exactly_nothing() {
    for options in [DirectOptions::measurement(), DirectOptions::projection()] {
        assert_eq!(through_slit(0.0, 4.0, Some(false), options), [0.0; 8]);
    }
}

/// Shadow rays that get there are enough when there are sixteen of them.
const ROUGH: DirectOptions = DirectOptions {
    seed: 0,
    light_samples: 256,
    enough: 16,
    sky_samples: 1,
    estimator: DirectEstimator::Lights,
    is_exact: true,
};

/// Counts shadow rays.
struct Counting<'a>(&'a Bvh, AtomicUsize);

impl RayCaster for Counting<'_> {
    fn trace_nearest(&self, rays: &[Ray], hits: &mut [Hit]) {
        self.0.trace_nearest(rays, hits);
    }

    fn trace_occluded(&self, rays: &[Ray], occluded: &mut [bool]) {
        self.1.fetch_add(rays.len(), Ordering::Relaxed);
        self.0.trace_occluded(rays, occluded);
    }

    fn visit_blockers(&self, shaft: &Shaft, visit: &mut dyn FnMut(&Blocker) -> ControlFlow<()>) -> bool {
        self.0.visit_blockers(shaft, visit)
    }
}

/// What points on the floor receive through two crowds of small triangles that leave a slit of the width
/// `2 gap` open between them, and the shadow rays that it took.
fn through_crowds(gap: f64, options: DirectOptions) -> (Vec<f32>, usize) {
    let mut builder = floor_and_lamp(1);
    let black = builder.push_material(Material::diffuse("crowd", Rgb::ZERO));
    let corner = |x: f64, z: f64| DVec3::new(x, 0.75, z);
    for [low, high] in [[-3.0, -gap], [gap, 3.0]] {
        Shape::new()
            .grid([corner(low, -3.0), corner(low, 3.0), corner(high, 3.0), corner(high, -3.0)], 60, 120)
            .push_into(&mut builder, "crowd", black);
    }
    let scene = scenes::build(builder);
    let points: Vec<_> = (0..32).map(|i| at(&scene, [0.0, 0.0, 0.01 * f64::from(i)], Vec3::Y)).collect();
    let caster = Counting(&Bvh::build(&scene, BvhOptions::default()).0, AtomicUsize::new(0));
    let light = DirectLight::new(&scene, options);
    let found = direct_irradiance(&light, &caster, &points, Stage::Direct, &NoProgress).unwrap();
    (found.into_iter().map(|e| e.x).collect(), caster.1.into_inner())
}

#[test]
fn shadow_rays_end_when_enough_get_there() {
    let patient = DirectOptions { enough: u32::MAX, ..ROUGH };
    let ((found, few), (truth, many)) = (through_crowds(0.2, ROUGH), through_crowds(0.2, patient));
    assert!(4 * few <= many, "{few} {many}");
    for (found, truth) in found.iter().zip(&truth) {
        assert!((found / truth - 1.0).abs() < 0.2, "{found} {truth}");
    }
}
