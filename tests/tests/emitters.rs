//! Many emitters, emitters everywhere, and the units that they are given in.

use std::sync::{Mutex, PoisonError};

use hplt::geom::glam::{DVec3, Vec3};
use hplt::geom::radiometry::{exitance_from_radiance, power_of_point};
use hplt::geom::{Material, Rgb, Scene, SceneBuilder};
use hplt::reference::closed_forms;
use hplt::reference::scenes::{self, Shape};
use hplt::transport::{DirectEstimator, DirectOptions, TransportOptions};
use hplt_tests::{Bare, Prepared, Setup, area_mean, assert_equivalent, replicated};

/// One test at a time: one of them measures what the process costs.
static ALONE: Mutex<()> = Mutex::new(());

/// `n` small triangles below the ceiling of a closed room, `n_lit` of which emit, 1 W in all; everything reflects `albedo`.
fn many_lamps(n: u32, n_lit: u32, albedo: f32) -> (Scene, f64) {
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(Material::diffuse("wall", Rgb::splat(albedo)));
    let across = f64::from(n).sqrt().ceil();
    let size = 0.5 / across;
    let exitance = 1.0 / (f64::from(n_lit) * 0.5 * size * size);
    let lamp = builder.push_material(Material::emitter("lamp", Rgb::splat(albedo), Rgb::splat(exitance as f32)));
    Shape::new().room(DVec3::ZERO, DVec3::ONE).push_into(&mut builder, "room", wall);
    let (mut lamps, mut others) = (Shape::new(), Shape::new());
    for i in 0..n {
        let at = DVec3::new((f64::from(i) % across) / across, 0.9, (f64::from(i) / across).floor() / across);
        let at = at * DVec3::new(0.9, 1.0, 0.9) + DVec3::new(0.05, 0.0, 0.05);
        let shape = if i % (n / n_lit) == 0 { &mut lamps } else { &mut others };
        shape.triangle([at, at + DVec3::X * size, at + DVec3::Z * size]);
    }
    lamps.push_into(&mut builder, "lamps", lamp);
    others.push_into(&mut builder, "others", wall);
    (scenes::build(builder), 6.0 + 2.0 * (lamps.area() + others.area()))
}

/// Processor seconds of this process; those of the clock where they are not told.
fn processor_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // User and system time are fields 14 and 15, in hundredths of a second; the name, in brackets, may hold spaces.
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok());
    match (ticks(11), ticks(12)) {
        (Some(user), Some(system)) => 0.01 * (user + system),
        _ => std::time::SystemTime::UNIX_EPOCH.elapsed().map_or(0.0, |t| t.as_secs_f64()),
    }
}

/// What a room of so many lamps costs: scene, rays and points; light and bounces. Its mean must be within `margin` of the
/// exact one.
fn cost_of_many_lamps(n: u32, n_lit: u32, margin: f64) -> [f64; 2] {
    let albedo = 0.5;
    let start = processor_seconds();
    let (scene, area) = many_lamps(n, n_lit, albedo);
    let exact = closed_forms::mean_irradiance(1.0, albedo.into(), area);
    let transport = TransportOptions { n_rays: 64, ..TransportOptions::production() };
    let direct = DirectOptions { estimator: DirectEstimator::Lights, ..DirectOptions::projection() };
    let prepared = Prepared::new(scene, Setup { n_levels: 3, radius: 0.05, direct, transport, ..Setup::default() });
    let before = processor_seconds();
    let solved = prepared.solve().unwrap();
    let cost = [before - start, processor_seconds() - before];
    assert_eq!(solved.report.n_escaped(), 0);
    let mean = area_mean(prepared.basis.points(2), &solved.finest());
    let (off, n_functions) = (mean / exact - 1.0, prepared.basis.hierarchy().n_points());
    println!(
        "{n_lit} lamps among {n}: off by {:+.3} %, {n_functions} functions, {cost:.2?} processor seconds",
        100.0 * off
    );
    assert!(off.abs() < margin, "{n_lit} lamps among {n}: {mean} for {exact}");
    cost
}

/// C9: a thousand emitters; the mean of the room is what they emit over what is absorbed.
#[test]
fn c9_a_thousand_emitters() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    cost_of_many_lamps(1000, 1000, 0.01);
}

/// C9 at its full size: to light a room with a million lamps costs less than three times what it costs when all but a thousand of them are
/// out, everything included and the light alone. A room with a thousand small triangles is another scene, printed for comparison.
#[test]
#[ignore = "slow: a million emitters"]
fn c9_a_million_emitters() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let small = cost_of_many_lamps(1000, 1000, 0.01);
    let few = cost_of_many_lamps(1_000_000, 1000, 0.01);
    let many = cost_of_many_lamps(1_000_000, 1_000_000, 0.01);
    let whole = |cost: [f64; 2]| cost[0] + cost[1];
    let ratios = |other: [f64; 2]| [whole(many) / whole(other), many[1] / other[1]];
    println!(
        "times as much, whole and light alone: {:.2?} of few lit, {:.2?} of few at all",
        ratios(few),
        ratios(small)
    );
    assert!(ratios(few).iter().all(|ratio| *ratio < 3.0), "{many:?} {few:?}");
}

/// C6: where all walls emit, choosing among twelve hundred emitters finds them as well as looking around does.
#[test]
fn c6_everything_emits() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut room = Shape::new();
    for c in Shape::new().room(DVec3::ZERO, DVec3::ONE).positions.chunks(4) {
        room.grid([c[0], c[1], c[2], c[3]], 10, 10);
    }
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(Material::emitter("wall", Rgb::splat(0.5), Rgb::ONE));
    room.push_into(&mut builder, "room", wall);
    let bare = Bare::new(scenes::build(builder));
    let at: Vec<_> = (0..64)
        .map(|i| (DVec3::new(0.06 + 0.125 * f64::from(i % 8), 0.0, 0.06 + 0.125 * f64::from(i / 8)), Vec3::Y))
        .collect();
    let spread = |light_samples: u32, seed: u64| {
        let options =
            DirectOptions { seed, light_samples, estimator: DirectEstimator::Lights, ..DirectOptions::projection() };
        let values = bare.direct_at(&at, options);
        let mean = values.iter().map(|v| f64::from(v.x)).sum::<f64>() / 64.0;
        let variance = values.iter().map(|v| (f64::from(v.x) - mean).powi(2)).sum::<f64>() / 63.0;
        (mean, variance.sqrt())
    };
    assert_equivalent("all walls emit", &replicated(8, |seed| spread(1024, seed).0), 1.0, 0.005);
    let (few, many) = (spread(64, 1).1, spread(1024, 1).1);
    println!("standard deviation at a point: {few:.4} with 64 rays, {many:.4} with 1024");
    assert!(few < 0.1 && many < 0.5 * few, "{few} {many}");
}

/// C14: a lamp of exitance M and area A, a surface of radiance L, and a point of intensity I, all of the same power, light a closed
/// room the same on average: no π is lost or found.
#[test]
fn c14_lights_of_the_same_power_are_as_bright() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let power = 3.0f32;
    let side = 0.2f64;
    let area = (side * side) as f32;
    // L = Φ/(πA), I = Φ/(4π).
    let radiance = power / (std::f32::consts::PI * area);
    let intensity = power / (4.0 * std::f32::consts::PI);
    assert!((power_of_point(Rgb::splat(intensity)).x / power - 1.0).abs() < 1e-6);
    let room = |exitance: Option<Rgb>| {
        let mut builder = SceneBuilder::new();
        let wall = builder.push_material(Material::diffuse("wall", Rgb::splat(0.5)));
        Shape::new().room(DVec3::ZERO, DVec3::ONE).push_into(&mut builder, "room", wall);
        let lamp = builder.push_material(Material::emitter("lamp", Rgb::splat(0.5), exitance.unwrap_or(Rgb::ZERO)));
        let at = |x: f64, z: f64| DVec3::new(0.4 + side * x, 0.8, 0.4 + side * z);
        Shape::new().quad([at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)]).push_into(
            &mut builder,
            "lamp",
            lamp,
        );
        if exitance.is_none() {
            builder.push_point_light("bulb", DVec3::new(0.5, 0.6, 0.5), Rgb::splat(intensity));
        }
        scenes::build(builder)
    };
    let exact = closed_forms::mean_irradiance(power.into(), 0.5, 6.0 + 2.0 * f64::from(area));
    let cases = [
        ("exitance", Some(Rgb::splat(power / area))),
        ("radiance", Some(exitance_from_radiance(Rgb::splat(radiance)))),
        ("intensity", None),
    ];
    for (name, exitance) in cases {
        let scene = room(exitance);
        let mean = replicated(6, |seed| {
            let mut setup = Setup { n_levels: 3, radius: 0.06, ..Setup::default() };
            (setup.transport.seed, setup.direct.seed, setup.transport.n_rays) = (seed, seed, 64);
            let prepared = Prepared::new(scene.clone(), setup);
            let solved = prepared.solve().unwrap();
            area_mean(prepared.basis.points(2), &solved.finest())
        });
        assert_equivalent(name, &mean, exact, 0.01);
    }
}
