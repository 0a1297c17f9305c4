//! Relations between solutions that need no reference: scaling, superposition, cutting, turning, reciprocity.

use hplt::basis::{Coefficients, Delta, absolute_from_delta, delta_from_absolute};
use hplt::geom::glam::{DMat3, DVec3, Vec3};
use hplt::geom::{Material, OrientedPoint, RayCaster, Rgb, Scene, SceneBuilder};
use hplt::reference::scenes::{self, Shape};
use hplt::reference::statistics::{MeanEstimate, mean_of_replicates, sidak_z, welch_t};
use hplt::sampling::random_surface_points;
use hplt::transport::{DirectEstimator, DirectOptions, Threshold, TransportOptions};
use hplt_tests::{Bare, Prepared, Setup, assert_equivalent, mean_luminance, replicated};

/// How [`room`] is varied.
#[derive(Clone, Copy)]
struct Variant {
    /// World from local.
    turn: DMat3,
    offset: DVec3,
    scale: f64,
    /// Factors of the exitances of two lamps.
    power: [f32; 2],
    /// Every triangle cut in four, so many times.
    cuts: usize,
    /// Meshes pushed in reverse order, each with a material of its own.
    reversed: bool,
}

const PLAIN: Variant =
    Variant { turn: DMat3::IDENTITY, offset: DVec3::ZERO, scale: 1.0, power: [1.0, 1.0], cuts: 0, reversed: false };

/// A closed room with a block and two lamps.
fn room(v: Variant) -> Scene {
    let white = Material::diffuse("white", Rgb::new(0.7, 0.6, 0.5));
    let lamp = |name: &str, i: usize, rgb: Rgb| Material::emitter(name, Rgb::ZERO, rgb * v.power[i]);
    let quad = |y: f64, x: f64, z: f64| {
        [(0.0, 0.0), (0.2, 0.0), (0.2, 0.2), (0.0, 0.2)].map(|(a, b)| DVec3::new(x + a, y, z + b))
    };
    let mut parts = vec![
        (Shape::new().room(DVec3::new(0.1, -0.3, 0.7), DVec3::new(1.4, 0.8, 1.9)).clone(), white.clone()),
        (Shape::new().cuboid(DVec3::new(0.5, -0.2, 1.0), DVec3::new(0.9, 0.1, 1.3)).clone(), white),
        (Shape::new().quad(quad(0.75, 0.3, 0.9)).clone(), lamp("one", 0, Rgb::new(30.0, 50.0, 70.0))),
        (Shape::new().quad(quad(0.7, 1.0, 1.5)).clone(), lamp("two", 1, Rgb::new(60.0, 40.0, 20.0))),
    ];
    if v.reversed {
        parts.reverse();
    }
    let mut builder = SceneBuilder::new();
    for (shape, material) in parts {
        let mut placed = shape.mapped(|p| v.turn * p * v.scale + v.offset);
        (0..v.cuts).for_each(|_| placed = in_four(&placed));
        let id = builder.push_material(material);
        placed.push_into(&mut builder, "part", id);
    }
    scenes::build(builder)
}

fn in_four(shape: &Shape) -> Shape {
    let mut cut = Shape::new();
    for t in &shape.triangles {
        let [a, b, c] = t.map(|v| shape.positions[v as usize]);
        let (ab, bc, ca) = (a.midpoint(b), b.midpoint(c), c.midpoint(a));
        for corners in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
            cut.triangle(corners);
        }
    }
    cut
}

fn quick() -> Setup {
    Setup {
        n_levels: 3,
        transport: TransportOptions { n_rays: 64, ..TransportOptions::production() },
        ..Setup::default()
    }
}

/// Every function gathered, whatever its values: the operator does not depend on the light.
fn linear() -> Setup {
    let threshold = Threshold { absolute: 0.0, relative: 0.0, noise: 0.0 };
    let transport = TransportOptions {
        n_rays: 64,
        threshold,
        shaped_push_down: false,
        tolerance: 0.0,
        max_bounces: 6,
        ..TransportOptions::production()
    };
    Setup { n_levels: 2, transport, ..Setup::default() }
}

fn finest(v: Variant, setup: Setup) -> Vec<Rgb> {
    Prepared::new(room(v), setup).solve().unwrap().finest()
}

/// B1, B2: powers of two, up to 2^±40 in space and in emission.
#[test]
fn b1_b2_powers_of_two_up_to_40_move_only_exponents() {
    let plain = finest(PLAIN, quick());
    for k in [-40, 40] {
        let scaled = finest(Variant { scale: 2f64.powi(k), ..PLAIN }, quick());
        assert!(scaled == plain, "coordinates times 2^{k}");
        let power = 2f32.powi(k);
        let brighter = finest(Variant { power: [power; 2], ..PLAIN }, quick());
        let expected: Vec<Rgb> = plain.iter().map(|e| *e * power).collect();
        assert!(brighter == expected, "emission times 2^{k}");
    }
    assert!(finest(Variant { power: [1.1; 2], ..PLAIN }, quick()) != plain, "passes anything");
}

/// B4: light is additive, with the same rays to rounding: twice the first lamp and twice the second are thrice both.
#[test]
fn b4_light_is_additive() {
    let both: Vec<Rgb> = finest(PLAIN, linear()).iter().map(|e| *e * 3.0).collect();
    let one = finest(Variant { power: [2.0, 1.0], ..PLAIN }, linear());
    let two = finest(Variant { power: [1.0, 2.0], ..PLAIN }, linear());
    assert_eq!(one.len(), both.len());
    let worst = |two: &[Rgb]| {
        let deviation = |i: usize| ((one[i] + two[i] - both[i]) / both[i].max(Rgb::splat(1e-6))).abs().max_element();
        (0..both.len()).map(deviation).fold(0.0, f32::max)
    };
    println!("additive to {:e}", worst(&two));
    assert!(worst(&two) <= 8.0 * f32::EPSILON / (1.0 - 0.7), "{:e}", worst(&two));
    // Negative control.
    let wrong: Vec<Rgb> = two.iter().map(|e| *e * (1.0 + 1e-4)).collect();
    assert!(worst(&wrong) > 8.0 * f32::EPSILON / (1.0 - 0.7));
}

/// Places of the plain room where variants of it are compared.
const PLACES: usize = 1000;
/// The mean irradiance of a variant of the room at places given in the plain one, with functions as large as there, which its bounding
/// box need not be: from `n` solutions with other points and other rays.
fn mean_at(v: Variant, places: &[(DVec3, DVec3)], n: u64) -> MeanEstimate {
    let diagonal = |scene: &Scene| f64::from(scene.diagonal()) * scene.frame().scale();
    let (plain, scene) = (room(PLAIN), room(v));
    let places: Vec<(DVec3, Vec3)> =
        places.iter().map(|&(p, n)| (v.turn * p * v.scale + v.offset, (v.turn * n).as_vec3())).collect();
    replicated(n, |seed| {
        let mut setup = quick();
        setup.radius *= v.scale * diagonal(&plain) / diagonal(&scene);
        setup.transport.n_rays = 128;
        (setup.points_seed, setup.direct.seed, setup.transport.seed) = (seed, seed, seed);
        let prepared = Prepared::new(scene.clone(), setup);
        let solved = prepared.solve().unwrap();
        mean_luminance(&prepared.interpolated_at(&solved, &prepared.locate_world(&places)))
    })
}

/// Asserts that two means are the same to within `margin`, at 99.9 %, and that twice that would not be.
fn assert_same(what: &str, a: &MeanEstimate, b: &MeanEstimate, margin: f64) {
    let standard_error = a.standard_error.hypot(b.standard_error);
    let difference =
        MeanEstimate { mean: a.mean, standard_error, degrees_of_freedom: welch_t(a, b).degrees_of_freedom };
    assert_equivalent(what, &difference, b.mean, margin);
}

/// Points of the surface of the plain room.
fn places_of_the_room() -> Vec<(DVec3, DVec3)> {
    let prepared = Prepared::new(room(PLAIN), Setup { n_levels: 1, ..quick() });
    let points = random_surface_points(&prepared.scene, &prepared.bvh.bvh, &prepared.regions, PLACES, 8);
    let frame = prepared.scene.frame();
    let place = |p: &OrientedPoint| (frame.world_from_scene_point(p.position), p.normal.as_dvec3());
    points.iter().map(place).collect()
}

fn turned() -> Variant {
    Variant { turn: DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.7), ..PLAIN }
}

/// B5, B7, B8, D19: other triangles, another order, another pose, far from the origin: the same light. The same places are read in all:
/// means over functions would differ by where these happen to be.
#[test]
fn b5_b7_b8_other_descriptions_of_a_room_have_the_same_light() {
    let quarter = DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X);
    let places = places_of_the_room();
    let plain = mean_at(PLAIN, &places, 8);
    for (what, v, margin) in [
        ("reordered", Variant { reversed: true, ..PLAIN }, 0.005),
        ("cut in 16", Variant { cuts: 2, ..PLAIN }, 0.01),
        ("axes permuted", Variant { turn: quarter, ..PLAIN }, 0.005),
        ("turned", turned(), 0.01),
        ("1000 km away", Variant { offset: DVec3::new(1e6, -1e6, 1e6), ..PLAIN }, 0.01),
    ] {
        assert_same(what, &mean_at(v, &places, 8), &plain, margin);
    }
}

/// B8 to its margin: a turned room, to half a per cent.
#[test]
#[ignore = "slow: 64 solutions"]
fn b8_a_turned_room_has_the_same_light_to_half_a_per_cent() {
    let places = places_of_the_room();
    assert_same("turned", &mean_at(turned(), &places, 32), &mean_at(PLAIN, &places, 32), 0.005);
}

/// D20, D21: offsets and scales that are composed in f64 leave the furnace exact.
#[test]
fn d20_d21_offsets_and_scales_leave_the_furnace_exact() {
    for (offset, scale) in [(1e6, 1.0), (1e9, 1.0), (0.0, 1e-6), (0.0, 1e3), (0.0, 1e8), (-3e5, 17.3)] {
        let mut builder = SceneBuilder::new();
        let wall = builder.push_material(Material::emitter("wall", Rgb::splat(0.9), Rgb::ONE));
        let min = DVec3::new(offset, -offset, offset);
        Shape::new().room(min, min + scale).push_into(&mut builder, "room", wall);
        let prepared = Prepared::new(scenes::build(builder), hplt_tests::checks::hemisphere(2, 16, 1e-6));
        let solved = prepared.solve().unwrap();
        assert_eq!(solved.report.n_escaped(), 0, "{offset} {scale}");
        let error = hplt_tests::checks::worst(&solved.finest(), Rgb::splat(10.0));
        assert!(error <= 2e-5, "{offset} {scale}: {error:e}");
    }
}

/// B9: `A_i F_ij = A_j F_ji` for pairs of patches, both sides estimated, jointly by Šidák.
#[test]
fn b9_reciprocity_of_pairs_of_patches() {
    assert_reciprocal(6, 10);
}

/// B9 at its full size: 210 pairs of 21 patches.
#[test]
#[ignore = "slow: 210 pairs"]
fn b9_reciprocity_of_two_hundred_pairs() {
    assert_reciprocal(21, 150);
}

/// Both exchanges of all pairs of so many patches, jointly; of at least `least` pairs the noise must be below a quarter.
fn assert_reciprocal(n_patches: u32, least: usize) {
    let patches: Vec<(DVec3, DVec3, DVec3)> = (0..n_patches)
        .map(|i| {
            let t = f64::from(i);
            let corner = DVec3::new(0.3 * t, 0.2 * (t * 1.7).sin(), 0.4 * (t * 2.3).cos());
            let u = DVec3::new((t * 1.1).cos(), (t * 0.7).sin(), 0.3).normalize() * (0.2 + 0.05 * t.min(6.0));
            let v = u.cross(DVec3::new(0.3, (t * 1.9).cos(), 0.8)).normalize() * 0.3;
            (corner, u, v)
        })
        .collect();
    let scene_lit_by = |lit: usize| {
        let mut builder = SceneBuilder::new();
        for (i, &(corner, u, v)) in patches.iter().enumerate() {
            let exitance = if i == lit { Rgb::ONE } else { Rgb::ZERO };
            let id = builder.push_material(Material {
                emits: hplt::geom::Sides::Both,
                ..Material::emitter("patch", Rgb::ZERO, exitance)
            });
            Shape::new().quad([corner, corner + u, corner + u + v, corner + v]).push_into(&mut builder, "patch", id);
        }
        Bare::new(scenes::build(builder))
    };
    let lit: Vec<Bare> = (0..patches.len()).map(scene_lit_by).collect();
    // What arrives on both sides of patch `to` from patch `from`: A_to·F_to,from.
    let exchange = |from: usize, to: usize| {
        let (corner, u, v) = patches[to];
        let normal = u.cross(v).normalize().as_vec3();
        let values: Vec<f64> = (0..16)
            .map(|seed| {
                let stream = hplt::sampling::random::Stream::new(seed, hplt::sampling::random::Stage::Error);
                let unit = hplt::sampling::random::unit_f32;
                let points: Vec<(DVec3, Vec3)> = (0..512)
                    .flat_map(|i| {
                        let [a, b, ..] = stream.words(i, to as u32, 0);
                        let p = corner + u * f64::from(unit(a)) + v * f64::from(unit(b));
                        [(p, normal), (p, -normal)]
                    })
                    .collect();
                let options = DirectOptions { seed, estimator: DirectEstimator::Lights, ..DirectOptions::projection() };
                let sum: f64 = lit[from].direct_at(&points, options).iter().map(|e| f64::from(e.x)).sum();
                sum / 512.0 * u.cross(v).length()
            })
            .collect();
        mean_of_replicates(&values).unwrap()
    };
    let pairs: Vec<(usize, usize)> = (0..patches.len()).flat_map(|i| (0..i).map(move |j| (i, j))).collect();
    let z = sidak_z(1e-4, pairs.len());
    let mut seen = 0;
    for (i, j) in pairs {
        let (a, b) = (exchange(i, j), exchange(j, i));
        if a.mean == 0.0 && b.mean == 0.0 {
            continue;
        }
        // Sixteen replicates: Student's tails are wider than the normal ones by less than half here.
        let allowed = 1.5 * z * a.standard_error.hypot(b.standard_error);
        assert!((a.mean - b.mean).abs() <= allowed, "patches {i} and {j}: {} and {} ± {allowed}", a.mean, b.mean);
        // Pairs that hardly see each other are too noisy to tell and do not count.
        seen += usize::from(allowed < 0.25 * a.mean);
    }
    println!("{seen} pairs tell");
    assert!(seen >= least, "{seen} pairs tell");
}

/// B14: a field whose detail is 1e-7 of its mean survives the delta encoding.
#[test]
fn b14_delta_encoding_returns_the_values() {
    let prepared = Prepared::new(room(PLAIN), quick());
    let top = prepared.basis.n_levels() - 1;
    for (base, detail) in [(0.0f32, 1.0f32), (1.0, 1e-7), (1e12, 1.0), (1e-12, 1e-14)] {
        let values = |p: &OrientedPoint| Rgb::splat(base + detail * (9.0 * p.position.x).sin().abs());
        let finest = prepared.basis.points(top).iter().map(values).collect();
        let field = hplt::basis::restrict(&prepared.basis, finest);
        let delta: Coefficients<Delta> = delta_from_absolute(&prepared.basis, &field);
        let back = absolute_from_delta(&prepared.basis, &delta);
        let scale = base.max(detail);
        for level in 0..=top {
            for (a, b) in field.level(level).iter().zip(back.level(level)) {
                assert!((*a - *b).abs().max_element() <= 1e-6 * scale, "{a} {b}");
            }
        }
    }
}

/// B6: the same bits while the pool is busy with other work.
#[test]
fn b6_a_busy_pool_gives_the_same_bits() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    let quiet = pool.install(|| finest(PLAIN, quick()));
    let stop = std::sync::atomic::AtomicBool::new(false);
    let busy = pool.scope(|scope| {
        for worker in 0..2u64 {
            let stop = &stop;
            scope.spawn(move |scope| spin(worker, stop, scope));
        }
        let busy = finest(PLAIN, quick());
        stop.store(true, std::sync::atomic::Ordering::Relaxed);
        busy
    });
    assert!(busy == quiet);
}

/// Keeps a worker of the pool busy in short pieces, so that pieces of other work come in between.
fn spin<'s>(worker: u64, stop: &'s std::sync::atomic::AtomicBool, scope: &rayon::Scope<'s>) {
    let mut x = worker | 1;
    for _ in 0..20_000 {
        x = x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    }
    if !stop.load(std::sync::atomic::Ordering::Relaxed) {
        scope.spawn(move |scope| spin(std::hint::black_box(x), stop, scope));
    }
}

/// D25: a ray that leaves a surface point never meets its own triangle again.
#[test]
fn d25_a_ray_never_meets_the_surface_that_it_leaves() {
    let prepared = Prepared::new(room(PLAIN), Setup { n_levels: 2, ..quick() });
    let directions = hplt_tests::checks::spread_directions(500);
    for point in prepared.basis.points(1) {
        let origin = hplt::geom::offset_origin(point.position, point.normal);
        for d in directions.iter().map(|d| d.as_vec3()).filter(|d| d.dot(point.normal) > 1e-4) {
            let hit = prepared.bvh.nearest(hplt::geom::Ray::new(origin, d));
            assert!(!hit.is_miss() && hit.t > 1e-6, "{point:?} {d} {hit:?}");
        }
    }
}
