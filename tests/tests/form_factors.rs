//! Form factors with closed forms, through direct light and through the gather.

use std::f64::consts::{PI, TAU};

use hplt::geom::glam::{DVec3, Vec3};
use hplt::geom::{Material, Rgb, SceneBuilder};
use hplt::reference::closed_forms;
use hplt::reference::scenes::{self, Shape};
use hplt::sampling::random::{Stage, Stream, unit_f64};
use hplt::transport::{DirectEstimator, DirectOptions, TransportOptions};
use hplt_tests::checks::{BOTH, cells};
use hplt_tests::{Bare, Prepared, Setup, assert_equivalent, mean_luminance, replicated};

/// A point in each of `n × n` cells of the unit square, jittered by the replicate.
fn jittered(n: usize, replicate: u64) -> Vec<(f64, f64)> {
    let stream = Stream::new(replicate, Stage::Error);
    let cell = 1.0 / n as f64;
    let place = |(i, (x, y)): (usize, (f64, f64))| {
        let [a, b, c, d] = stream.words(i as u32, 0, 0);
        (x + cell * (unit_f64(a, b) - 0.5), y + cell * (unit_f64(c, d) - 0.5))
    };
    cells(n).enumerate().map(place).collect()
}

fn options(estimator: DirectEstimator, seed: u64, light_samples: u32, sky_samples: u32) -> DirectOptions {
    DirectOptions { seed, light_samples, sky_samples, estimator, ..DirectOptions::measurement() }
}

/// A14: parallel unit squares, all gaps by shadow rays, and down to the size of the gap where blind rays still meet the plate.
#[test]
fn a14_parallel_squares_at_all_gaps() {
    for (gap, factor) in closed_forms::PARALLEL_SQUARES {
        let bare = Bare::new(scenes::build(scenes::parallel_plates(gap)));
        for estimator in BOTH {
            let margin = match (estimator, gap <= 1.0, gap <= 10.0) {
                (_, true, _) => 0.005,
                (DirectEstimator::Lights, ..) => 0.001,
                (_, false, true) => 0.02,
                // 9e8 blind rays for 5 %.
                _ => continue,
            };
            let (n, n_rays) = if gap > 1.0 { (8, 4096) } else { (16, 256) };
            let mean = replicated(16, |seed| {
                let place = |(x, z): (f64, f64)| (DVec3::new(x, gap, z), Vec3::NEG_Y);
                let points: Vec<_> = jittered(n, seed).into_iter().map(place).collect();
                mean_luminance(&bare.direct_at(&points, options(estimator, seed, 16, n_rays)))
            });
            assert_equivalent(&format!("gap {gap}, {estimator:?}"), &mean, factor, margin);
        }
    }
}

/// A15: perpendicular rectangles with a common edge, where sampling areas has infinite variance; points denser near the edge.
#[test]
fn a15_perpendicular_rectangles() {
    for (w, h, factor) in closed_forms::PERPENDICULAR_RECTANGLES {
        // The factor from the receiver (w wide) to the emitter (h wide) is the receiver's mean irradiance.
        let bare = Bare::new(scenes::build(scenes::perpendicular_plates(h, w)));
        for estimator in BOTH {
            let mean = replicated(16, |seed| {
                let parts = jittered(24, seed);
                let points: Vec<_> = parts.iter().map(|&(x, y)| (DVec3::new(x, w * y * y * y, 0.0), Vec3::Z)).collect();
                let values = bare.direct_at(&points, options(estimator, seed, 16, 1024));
                let weighted = values.iter().zip(&parts).map(|(v, (_, y))| f64::from(v.x) * 3.0 * y * y);
                weighted.sum::<f64>() / parts.len() as f64
            });
            // Blind rays start up to 2^-16 of the scene above their surface: a limit where plates are 1e-4 of it wide.
            let is_tiny = w < 5e-4 && h < 5e-4 && estimator == DirectEstimator::Hemisphere;
            let margin = if is_tiny { 0.12 } else { 0.01 };
            assert_equivalent(&format!("perpendicular {w} {h}, {estimator:?}"), &mean, factor, margin);
        }
    }
}

/// A16: the six faces of a cube are all that a point inside it sees.
#[test]
fn a16_a_closed_cube_is_seen_whole() {
    let mut sum = 0.0;
    for lit in 0..6 {
        let exitance = |face: usize| if face == lit { Rgb::ONE } else { Rgb::ZERO };
        let faces = std::array::from_fn(|face| Material::emitter("face", Rgb::ZERO, exitance(face)));
        let bare = Bare::new(scenes::build(scenes::cube(faces)));
        let point = [(DVec3::new(0.3, 0.0, 0.2), Vec3::Y)];
        sum += f64::from(bare.direct_at(&point, options(DirectEstimator::Hemisphere, 0, 1, 4096))[0].x);
    }
    assert!((sum - 1.0).abs() <= 4.0 * f64::from(f32::EPSILON), "{sum}");
}

/// A17: a point and a square: under its centre, under a corner, and with half of it below the horizon.
#[test]
fn a17_a_point_and_a_square() {
    let corner = closed_forms::point_to_parallel_rectangle(1.0, 1.0);
    let upright = closed_forms::point_to_perpendicular_rectangle(1.0, 1.0);
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let cases = [
        ("centre", [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(x, z)| at(x, 1.0, z)), 0.239456470460774),
        ("corner", [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(x, z)| at(x, 1.0, z)), corner),
        ("upright", [(-1.0, 0.0), (1.0, 0.0), (1.0, 1.0), (-1.0, 1.0)].map(|(y, z)| at(1.0, y, z)), upright),
    ];
    for (name, square, factor) in cases {
        let mut builder = SceneBuilder::new();
        let lamp = builder.push_material(Material {
            emits: hplt::geom::Sides::Both,
            ..Material::emitter("lamp", Rgb::ZERO, Rgb::ONE)
        });
        Shape::new().quad(square).push_into(&mut builder, "lamp", lamp);
        let bare = Bare::new(scenes::build(builder));
        for estimator in BOTH {
            let mean = replicated(16, |seed| {
                f64::from(bare.direct_at(&[(DVec3::ZERO, Vec3::Y)], options(estimator, seed, 64, 65_536))[0].x)
            });
            assert_equivalent(&format!("{name}, {estimator:?}"), &mean, factor, 0.003);
        }
    }
}

/// A fan of `n` triangles of the area of a disc.
fn disc(y: f64, radius: f64, n: u32, up: bool) -> Shape {
    let step = TAU / f64::from(n);
    let radius = radius * (step / step.sin()).sqrt();
    let rim = |i: u32| DVec3::new(radius * (step * f64::from(i)).cos(), y, radius * (step * f64::from(i)).sin());
    let mut shape = Shape::new();
    for i in 0..n {
        let (a, b) = if up { (rim(i + 1), rim(i)) } else { (rim(i), rim(i + 1)) };
        shape.triangle([DVec3::Y * y, a, b]);
    }
    shape
}

/// A18: coaxial discs, and strips so long that their ends do not count.
#[test]
fn a18_coaxial_discs_and_long_strips() {
    for (r1, r2, distance) in [(1.0, 1.0, 1.0), (0.5, 1.0, 1.0), (1.0, 2.0, 3.0)] {
        let mut builder = SceneBuilder::new();
        let black = builder.push_material(Material::diffuse("black", Rgb::ZERO));
        let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::ONE));
        disc(0.0, r1, 256, true).push_into(&mut builder, "receiver", black);
        disc(distance, r2, 256, false).push_into(&mut builder, "lamp", lamp);
        let bare = Bare::new(scenes::build(builder));
        let mean = replicated(16, |seed| {
            let place =
                |(u, v): (f64, f64)| (DVec3::new((TAU * v).cos(), 0.0, (TAU * v).sin()) * (r1 * u.sqrt()), Vec3::Y);
            let points: Vec<_> = jittered(16, seed).into_iter().map(place).collect();
            mean_luminance(&bare.direct_at(&points, options(DirectEstimator::Hemisphere, seed, 16, 1024)))
        });
        let factor = closed_forms::coaxial_discs(r1, r2, distance);
        assert_equivalent(&format!("discs {r1} {r2} {distance}"), &mean, factor, 0.005);
    }
    for gap in [0.1, 1.0, 3.0] {
        let mut builder = SceneBuilder::new();
        let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::ONE));
        let strip = [(0.0, -2e3), (1.0, -2e3), (1.0, 2e3), (0.0, 2e3)].map(|(x, z)| DVec3::new(x, gap, z));
        Shape::new().quad(strip).push_into(&mut builder, "lamp", lamp);
        let bare = Bare::new(scenes::build(builder));
        let mean = replicated(16, |seed| {
            let points: Vec<_> = jittered(16, seed).iter().map(|&(x, _)| (DVec3::X * x, Vec3::Y)).collect();
            mean_luminance(&bare.direct_at(&points, options(DirectEstimator::Lights, seed, 16, 16)))
        });
        assert_equivalent(&format!("strips {gap}"), &mean, closed_forms::opposite_strips(gap), 0.005);
    }
}

/// CIE 171:2006 5.6: what a uniformly lit diffuse floor throws onto points of a black wall is `ρE` times the configuration
/// factor; here it is the gather that must find it.
#[test]
fn cie_171_5_6_a_lit_floor_lights_a_wall() {
    let mut builder = SceneBuilder::new();
    let floor = builder.push_material(Material::diffuse("floor", Rgb::splat(0.6)));
    let wall = builder.push_material(Material::diffuse("wall", Rgb::ZERO));
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    Shape::new().quad([at(-2.0, 0.0, 0.0), at(-2.0, 0.0, 3.0), at(2.0, 0.0, 3.0), at(2.0, 0.0, 0.0)]).push_into(
        &mut builder,
        "floor",
        floor,
    );
    Shape::new().quad([at(-2.0, 0.0, 0.0), at(2.0, 0.0, 0.0), at(2.0, 3.0, 0.0), at(-2.0, 3.0, 0.0)]).push_into(
        &mut builder,
        "wall",
        wall,
    );
    builder.push_directional_light("sun", Vec3::Y, Rgb::splat(10.0), 0.0);
    let transport = TransportOptions { n_rays: 256, tolerance: 1e-3, ..TransportOptions::production() };
    let prepared = Prepared::new(scenes::build(builder), Setup { n_levels: 3, transport, ..Setup::default() });
    let solved = prepared.solve().unwrap();
    for height in [0.5, 1.0, 2.5] {
        let points = prepared.locate_world(&[(at(0.0, height, 0.0), Vec3::Z)]);
        let gathered = prepared.gather(&solved, &points, 1 << 16)[0].irradiance;
        // Two rectangles 2 m wide and 3 m deep, a corner of each at the foot of the point.
        let factor = 2.0 * closed_forms::point_to_perpendicular_rectangle(3.0 / 2.0, height / 2.0);
        let expected = 0.6 * 10.0 * factor;
        println!("height {height}: {} for {expected}", gathered.x);
        assert!((f64::from(gathered.x) / expected - 1.0).abs() < 5e-3, "height {height}: {gathered} for {expected}");
    }
    // A disc of sun would do the same: π is in no factor.
    assert!((closed_forms::disc_on_axis_irradiance(1.0, 1.0, 1.0) - 0.5 * PI).abs() < 1e-15);
}

/// CIE 171:2006 5.7 with values of our own (its table 19 is wrong): as 5.6, and an upright plate hides a strip of the floor. The sun
/// sees the plate edge-on, so that the floor stays evenly lit.
#[test]
fn cie_171_5_7_a_plate_hides_part_of_the_floor() {
    let mut builder = SceneBuilder::new();
    let floor = builder.push_material(Material::diffuse("floor", Rgb::splat(0.6)));
    let black = builder.push_material(Material::diffuse("black", Rgb::ZERO));
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let (near, top) = (1.0, 0.6);
    let ground = [at(-2.0, 0.0, 0.0), at(-2.0, 0.0, 3.0), at(2.0, 0.0, 3.0), at(2.0, 0.0, 0.0)];
    Shape::new().quad(ground).push_into(&mut builder, "floor", floor);
    let wall = [at(-2.0, 0.0, 0.0), at(2.0, 0.0, 0.0), at(2.0, 3.0, 0.0), at(-2.0, 3.0, 0.0)];
    let plate = [at(-2.0, 0.0, near), at(2.0, 0.0, near), at(2.0, top, near), at(-2.0, top, near)];
    Shape::new().quad(wall).quad(plate).push_into(&mut builder, "wall and plate", black);
    builder.push_directional_light("sun", Vec3::Y, Rgb::splat(10.0), 0.0);
    let transport = TransportOptions { n_rays: 256, tolerance: 1e-3, ..TransportOptions::production() };
    let prepared = Prepared::new(scenes::build(builder), Setup { n_levels: 3, transport, ..Setup::default() });
    let solved = prepared.solve().unwrap();
    for height in [1.0, 2.0, 2.5] {
        // The line of sight over the top of the plate comes down at `far`.
        let far = near / (1.0 - top / height);
        let to = |depth: f64| 2.0 * closed_forms::point_to_perpendicular_rectangle(depth / 2.0, height / 2.0);
        let (whole, visible) = (to(3.0), to(near) + to(3.0) - to(far.min(3.0)));
        let points = prepared.locate_world(&[(at(0.0, height, 0.0), Vec3::Z)]);
        let gathered = f64::from(prepared.gather(&solved, &points, 1 << 16)[0].irradiance.x);
        println!("height {height}: {gathered} for {}, {} without the plate", 6.0 * visible, 6.0 * whole);
        assert!((gathered / (6.0 * visible) - 1.0).abs() < 5e-3, "height {height}");
        assert!(visible < 0.97 * whole, "the plate hides too little for a test");
    }
}
