//! Materials, lights and channels.

use hplt::geom::glam::{DVec3, Vec2, Vec3};
use hplt::geom::{BuildPolicy, Environment, Image, Material, NoProgress, Rgb, Scene, SceneBuilder};
use hplt::reference::path_tracer::{IrradianceOptions, PathTracer};
use hplt::reference::scenes::{self, Shape};
use hplt::transport::{DirectEstimator, DirectOptions, StopReason, Threshold, TransportOptions};
use hplt_tests::{Prepared, Setup};

fn furnace_setup(tolerance: f32) -> Setup {
    Setup {
        n_levels: 2,
        direct: DirectOptions { estimator: DirectEstimator::Hemisphere, ..DirectOptions::projection() },
        transport: TransportOptions { n_rays: 64, tolerance, ..TransportOptions::production() },
        ..Setup::default()
    }
}

/// C3: emission of surfaces, lamps and skies that is negative, infinite or no number is an error that names what it is of; surfaces are
/// clamped on request, and nothing that is no number comes out.
#[test]
fn c3_emission_that_is_no_light_is_refused() {
    for bad in [-5.0f32, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut builder = scenes::single_sheet(Rgb::splat(0.5));
        let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::new(1.0, bad, 1.0)));
        Shape::new().triangle([DVec3::Y, DVec3::X, DVec3::Z]).push_into(&mut builder, "lamp", lamp);
        let error = builder.clone().build(BuildPolicy::default()).unwrap_err().to_string();
        assert!(error.contains("material \"lamp\", emission, green"), "{bad}: {error}");
        let policy = BuildPolicy { clamp_materials: true, ..BuildPolicy::default() };
        let (scene, report) = builder.build(policy).unwrap();
        assert_eq!(report.clamped_materials, ["lamp"]);
        let solved = Prepared::new(scene, Setup { n_levels: 2, ..Setup::default() }).solve().unwrap();
        assert!(solved.finest().iter().all(|e| e.is_finite() && e.y == 0.0));
        let mut builder = scenes::single_sheet(Rgb::splat(0.5));
        builder.push_point_light("bulb", DVec3::Y, Rgb::splat(bad));
        let error = builder.build(BuildPolicy::default()).unwrap_err().to_string();
        assert!(error.contains("light 0 \"bulb\", intensity"), "{bad}: {error}");
        assert!(Environment::constant(Rgb::splat(bad)).is_err(), "{bad}");
    }
}

/// C4: in a room that only reflects and emits red, green and blue are exactly zero, and the stop rule still works.
#[test]
fn c4_dead_channels_stay_dead() {
    let scene = scenes::build(scenes::furnace_box(Rgb::new(0.9, 0.0, 0.0), Rgb::X));
    let solved = Prepared::new(scene, furnace_setup(1e-6)).solve().unwrap();
    assert_eq!(solved.report.stop, StopReason::Converged);
    for e in solved.finest() {
        assert_eq!((e.y, e.z), (0.0, 0.0));
        assert!((e.x / 10.0 - 1.0).abs() < 1e-4, "{e}");
    }
}

/// C5: without emitters everything is black, at no cost, and that is not an error.
#[test]
fn c5_no_light_is_black_and_free() {
    let scene = scenes::build(scenes::furnace_box(Rgb::splat(0.9), Rgb::ZERO));
    let prepared = Prepared::new(scene, Setup::default());
    let solved = prepared.solve().unwrap();
    assert_eq!((solved.report.stop, solved.report.n_rays()), (StopReason::NoLight, 0));
    assert!(solved.finest().iter().all(|e| *e == Rgb::ZERO));
}

/// C7: two closed rooms lit 24 orders of magnitude apart are each exact: nothing is relative to the brighter one.
#[test]
fn c7_dim_and_bright_rooms_are_each_exact() {
    let mut builder = SceneBuilder::new();
    for (i, exitance) in [1e-12f32, 1e12].into_iter().enumerate() {
        let wall = builder.push_material(Material::emitter(format!("room {i}"), Rgb::splat(0.9), Rgb::splat(exitance)));
        let min = DVec3::new(3.0 * i as f64, 0.0, 0.0);
        Shape::new().room(min, min + 1.0).push_into(&mut builder, "room", wall);
    }
    let prepared = Prepared::new(scenes::build(builder), furnace_setup(1e-6));
    let solved = prepared.solve().unwrap();
    assert_eq!(prepared.basis.hierarchy().n_regions, 2);
    for (point, e) in prepared.basis.points(1).iter().zip(solved.finest()) {
        let expected = if point.position.x < 0.0 { 1e-11 } else { 1e13 };
        assert!((e / expected - Rgb::ONE).abs().max_element() < 1e-5, "{e} {expected}");
    }
}

/// C10: open ground under a uniform sky receives πL.
#[test]
fn c10_ground_under_a_uniform_sky() {
    let sky = Rgb::new(1.0, 2.0, 3.0);
    let scene = scenes::build(scenes::plane_under_sky(10.0, Rgb::splat(0.5), sky));
    for estimator in [DirectEstimator::Lights, DirectEstimator::Hemisphere] {
        let direct = DirectOptions { estimator, ..DirectOptions::projection() };
        let prepared = Prepared::new(scene.clone(), Setup { direct, ..Setup::default() });
        let solved = prepared.solve().unwrap();
        for (point, e) in prepared.basis.points(3).iter().zip(solved.finest()) {
            if point.normal.y > 0.0 {
                assert!((e / (sky * std::f32::consts::PI) - Rgb::ONE).abs().max_element() < 2e-3, "{e}");
            }
        }
    }
}

/// C11: a sky with one texel a million times brighter than the rest: its light is found.
#[test]
fn c11_one_hot_sky_texel_is_found() {
    let mut map = Image::from_pixels(64, 32, vec![Rgb::splat(0.1); 64 * 32]);
    let (column, row) = (20, 6);
    map.pixels_mut()[row * 64 + column] = Rgb::splat(1e6);
    let environment = Environment::from_map(map).unwrap();
    let toward = environment.direction_in_texel(column, row, Vec2::splat(0.5));
    let expected = 1e6 * environment.texel_solid_angle(row) as f32 * toward.y + 0.1 * std::f32::consts::PI;
    let mut builder = scenes::single_sheet(Rgb::splat(0.5));
    builder.set_environment(environment);
    let prepared = Prepared::new(scenes::build(builder), Setup::default());
    let points = prepared.locate(&[(Vec3::ZERO, Vec3::Y)]);
    let direct = prepared.direct_at(&points)[0];
    assert!((direct.x / expected - 1.0).abs() < 0.01, "{direct} {expected}");
}

/// A cube of 10 m and albedo 2/3 around a point light of 50 000 cd.
fn khodulevs_cube() -> Scene {
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(Material::diffuse("wall", Rgb::splat(2.0 / 3.0)));
    Shape::new().room(DVec3::ZERO, DVec3::splat(10.0)).push_into(&mut builder, "cube", wall);
    builder.push_point_light("lamp", DVec3::splat(5.0), Rgb::splat(50_000.0));
    scenes::build(builder)
}

/// A19 in the corners of the same cube, where light changes fastest: within 3 % of the path tracer, both noises counted.
#[test]
fn a19_the_corners_of_the_cube() {
    let transport = TransportOptions { n_rays: 256, ..TransportOptions::production() };
    let prepared = Prepared::new(khodulevs_cube(), Setup { transport, ..Setup::default() });
    let solved = prepared.solve().unwrap();
    for distance in [0.02, 0.2, 0.5] {
        let [a, b] = [distance, 10.0 - distance];
        let corners = [(a, a), (a, b), (b, a), (b, b)];
        let places: Vec<_> = corners
            .iter()
            .flat_map(|&(x, y)| [(DVec3::new(x, 0.0, y), Vec3::Y), (DVec3::new(0.0, x, y), Vec3::X)])
            .collect();
        let points = prepared.locate_world(&places);
        let (direct, gathered) = (prepared.direct_at(&points), prepared.gather(&solved, &points, 1024));
        let in_scene: Vec<_> = points.iter().map(|p| (p.position, p.normal)).collect();
        let options = IrradianceOptions { seed: 0xa19, samples_per_replicate: 256, ..IrradianceOptions::preview() };
        let truth = PathTracer::new(&prepared.scene).irradiance(&in_scene, &options, &NoProgress).unwrap();
        let [mut sum, mut expected, mut variance] = [0.0; 3];
        for ((d, g), t) in direct.iter().zip(&gathered).zip(&truth) {
            sum += f64::from((*d + g.irradiance).x);
            expected += t.total().x;
            variance += f64::from(g.noise.x).powi(2) + t.total_standard_error.x.powi(2);
        }
        let (off, half_width) = (sum / expected - 1.0, 3.3 * variance.sqrt() / expected);
        println!("{distance} m from the corners: {:+.3} % ± {:.3} %", 100.0 * off, 100.0 * half_width);
        assert!(off.abs() + half_width <= 0.03, "{distance} m from the corners: {off} ± {half_width}");
        assert!((1.0603 * sum / expected - 1.0).abs() + half_width > 0.03, "passes anything");
    }
}

/// C14, A19: units. A point light of I W/sr at distance d gives I/d² on a facing surface, and the mean irradiance of a closed
/// room of albedo ρ is Φ/((1-ρ)A) (Khodulev's cube: 10 m, 50 000 cd, ρ = 2/3).
#[test]
fn a19_point_light_in_a_white_cube() {
    // Half a per cent asks for more refinement than the production preset has, and for the plain push-down: the shaped one keeps
    // contacts dark at the price of 0.6 % of the mean here.
    let threshold = Threshold { absolute: 0.0, relative: 0.02, noise: 1.0 };
    let transport =
        TransportOptions { n_rays: 512, threshold, shaped_push_down: false, ..TransportOptions::production() };
    let prepared = Prepared::new(khodulevs_cube(), Setup { transport, ..Setup::default() });
    let frame = prepared.scene.frame();
    let points = prepared.locate(&[(frame.scene_from_world_point(DVec3::new(5.0, 0.0, 5.0)), Vec3::Y)]);
    let direct = prepared.direct_at(&points)[0];
    assert!((direct.x / 2000.0 - 1.0).abs() < 1e-3, "{direct}");
    let solved = prepared.solve().unwrap();
    let flux = 4.0 * std::f64::consts::PI * 50_000.0;
    let expected = flux / ((1.0 - 2.0 / 3.0) * 600.0);
    let top = prepared.basis.n_levels() - 1;
    let (mut sum, mut area) = (0.0, 0.0);
    for (point, e) in prepared.basis.points(top).iter().zip(solved.finest()) {
        sum += f64::from(point.area) * f64::from(e.x);
        area += f64::from(point.area);
    }
    let mean = sum / area;
    assert!((mean / expected - 1.0).abs() < 5e-3, "mean {mean}, expected {expected}");
}

/// A sun of 0.27° half-angle gives E cosθ, and its radiance is spread, not lost.
#[test]
fn a_sun_gives_its_irradiance_times_the_cosine() {
    for angular_radius in [0.0, 0.004_7, 0.2] {
        let mut builder = scenes::single_sheet(Rgb::splat(0.5));
        builder.push_directional_light("sun", Vec3::new(0.6, 0.8, 0.0), Rgb::splat(10.0), angular_radius);
        let prepared = Prepared::new(scenes::build(builder), Setup::default());
        let points = prepared.locate(&[(Vec3::ZERO, Vec3::Y), (Vec3::ZERO, Vec3::NEG_Y)]);
        let direct = prepared.direct_at(&points);
        let expected = 8.0;
        assert!((direct[0].x / expected - 1.0).abs() < 2e-3, "{} {expected}", direct[0]);
        assert_eq!(direct[1], Rgb::ZERO);
    }
}
