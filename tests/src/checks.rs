//! Members of the suite as functions of the pipeline under test, so that a planted fault can be seen to fail them.
//!
//! Each returns what is off, in words. Expected values are exact; margins are several times the noise of the fixed seeds.

use hplt::geom::glam::{DVec3, Vec2, Vec3};
use hplt::geom::{Environment, Material, MeshInput, OrientedPoint, Rgb, SceneBuilder, Texture, TextureSlot, Wrap};
use hplt::reference::closed_forms;
use hplt::reference::scenes::{self, Shape};
use hplt::sampling::poisson::rejection_distance_squared;
use hplt::transport::{DirectEstimator, DirectOptions, LinkOptions, StopReason, TransportOptions};

use crate::{Bare, Prepared, Setup, Solved, Stages};

/// `Ok`, or what is wrong.
pub type Verdict = Result<(), String>;

/// A member of the suite.
#[derive(Clone, Copy)]
pub struct Check {
    /// Its name in the catalogue.
    pub name: &'static str,
    /// What it does.
    pub run: fn(&Stages) -> Verdict,
}

/// All members that faults are held against.
pub const ALL: [Check; 15] = [
    Check { name: "A1 furnace", run: a1_furnace },
    Check { name: "A9 stop on a bound", run: a9_stop_on_a_bound },
    Check { name: "A13 concentric spheres", run: a13_concentric_spheres },
    Check { name: "A14 parallel plates", run: a14_parallel_plates },
    Check { name: "A17 blocked square", run: a17_blocked_square },
    Check { name: "B3 permuted channels", run: b3_permuted_channels },
    Check { name: "B6 threads", run: b6_threads },
    Check { name: "B11 areas", run: b11_areas },
    Check { name: "C4 dead channels", run: c4_dead_channels },
    Check { name: "C10 sky", run: c10_ground_under_a_sky },
    Check { name: "C12 encoded texture", run: c12_encoded_texture },
    Check { name: "D8 dark room", run: d8_dark_room },
    Check { name: "E8 distances", run: e8_distances },
    Check { name: "A1 by links", run: a1_by_links },
    Check { name: "A13 by links", run: a13_by_links },
];

/// The member of that name.
///
/// # Panics
/// When there is none.
pub fn named(name: &str) -> Check {
    *ALL.iter().find(|check| check.name == name).unwrap_or_else(|| panic!("no check is called {name}"))
}

/// Both ways to find direct light.
pub const BOTH: [DirectEstimator; 2] = [DirectEstimator::Lights, DirectEstimator::Hemisphere];

/// Every surface emits: lights are found by the rays that gather.
pub fn hemisphere(n_levels: usize, n_rays: u32, tolerance: f32) -> Setup {
    Setup {
        n_levels,
        direct: DirectOptions {
            estimator: DirectEstimator::Hemisphere,
            sky_samples: n_rays,
            ..DirectOptions::projection()
        },
        transport: TransportOptions { n_rays, tolerance, ..TransportOptions::production() },
        ..Setup::default()
    }
}

/// The largest relative deviation from `expected` in any channel.
pub fn worst(values: &[Rgb], expected: Rgb) -> f32 {
    // NaN must not pass: it is larger than any margin.
    let deviation = |v: &Rgb| (*v / expected - Rgb::ONE).abs().max_element();
    values.iter().map(deviation).fold(0.0, |a, b| if b.is_nan() { f32::INFINITY } else { a.max(b) })
}

/// `Err` with the text unless `holds`.
pub fn demand(holds: bool, otherwise: impl FnOnce() -> String) -> Verdict {
    if holds { Ok(()) } else { Err(otherwise()) }
}

fn solve(prepared: &Prepared) -> Result<Solved, String> {
    prepared.solve().map_err(|error| error.to_string())
}

/// A1: `B = M/(1-ρ)` in a closed cube, no ray lost.
fn a1_furnace(stages: &Stages) -> Verdict {
    for albedo in [0.5, 0.9] {
        let scene = stages.build(scenes::furnace_box(Rgb::splat(albedo), Rgb::ONE));
        let prepared = Prepared::of(stages, scene, hemisphere(2, 16, 1e-7));
        let solved = solve(&prepared)?;
        demand(solved.report.n_escaped() == 0, || format!("{} rays lost", solved.report.n_escaped()))?;
        let expected = 1.0 / (1.0 - albedo);
        let points =
            hplt::sampling::random_surface_points(&prepared.scene, &prepared.bvh.bvh, &prepared.regions, 50, 5);
        let values = [solved.finest(), prepared.interpolated_at(&solved, &points)].concat();
        let error = worst(&values, Rgb::splat(expected));
        demand(error <= 2e-6 * expected, || format!("albedo {albedo}: off by {error:e}"))?;
    }
    Ok(())
}

/// A9: at albedo 0.999 and a tolerance of 1e-4 the answer is within 1e-4, as it claims: a small step is no sign of the end.
fn a9_stop_on_a_bound(stages: &Stages) -> Verdict {
    let scene = stages.build(scenes::furnace_box(Rgb::splat(0.999), Rgb::ONE));
    let mut setup = Setup { radius: 1.0, ..hemisphere(1, 8, 1e-4) };
    setup.transport.max_bounces = 20_000;
    let prepared = Prepared::of(stages, scene, setup);
    let solved = solve(&prepared)?;
    demand(solved.report.stop == StopReason::Converged, || format!("{:?}", solved.report.stop))?;
    let expected = 1.0 / (1.0 - f64::from(0.999f32));
    let error = worst(&solved.finest(), Rgb::splat(expected as f32));
    demand(error <= 1e-4, || format!("off by {error:e}, {} bounces", solved.report.bounces.len()))
}

/// A13: an inner sphere that emits, an outer one that only reflects: `F12 = 1, F21 = q, F22 = 1 - q`.
fn a13_concentric_spheres(stages: &Stages) -> Verdict {
    let inner = Material::emitter("inner", Rgb::splat(0.5), Rgb::ONE);
    let outer = Material::diffuse("outer", Rgb::splat(0.5));
    let scene = stages.build(scenes::concentric_spheres(1.0, 2.0, 5120, inner, outer));
    let mut setup = hemisphere(2, 256, 1e-3);
    setup.radius = 0.1;
    let prepared = Prepared::of(stages, scene, setup);
    let solved = solve(&prepared)?;
    let points = hplt::sampling::random_surface_points(&prepared.scene, &prepared.bvh.bvh, &prepared.regions, 64, 5);
    let outer_radius = prepared.scene.frame().scene_from_world_length(2.0);
    let mean_of = |is_inner: bool| {
        let of_sphere = |p: &&OrientedPoint| (p.position.length() < 0.75 * outer_radius) == is_inner;
        let points: Vec<OrientedPoint> = points.iter().filter(of_sphere).copied().collect();
        let values = prepared.gathered_at(&solved, &points, 1024);
        f64::from(values.iter().sum::<Rgb>().x) / values.len() as f64
    };
    let [b1, b2] = closed_forms::concentric_spheres([1.0, 2.0], [1.0, 0.0], [0.5, 0.5]);
    for (name, value, expected) in [("inner", mean_of(true), (b1 - 1.0) / 0.5), ("outer", mean_of(false), b2 / 0.5)] {
        demand((value / expected - 1.0).abs() < 0.015, || format!("{name} sphere: {value} instead of {expected}"))?;
    }
    Ok(())
}

/// A1 by links: indirect light of `ρ/(1-ρ)`, no ray lost.
fn a1_by_links(stages: &Stages) -> Verdict {
    let albedo = 0.9f32;
    let scene = stages.build(scenes::furnace_box(Rgb::splat(albedo), Rgb::ONE));
    let prepared = Prepared::of(stages, scene, hemisphere(1, 64, 1e-5));
    let mut options = LinkOptions { n_levels: 2, n_rays: 64, ..LinkOptions::production() };
    options.solve.tolerance = 1e-6;
    let linked = prepared.link(&options);
    demand(linked.report.escaped == 0, || format!("{} rays lost", linked.report.escaped))?;
    let values: Vec<Rgb> = (0..linked.basis.n_levels()).flat_map(|l| linked.indirect.level(l)).copied().collect();
    let error = worst(&values, Rgb::splat(albedo / (1.0 - albedo)));
    demand(error <= 2e-5, || format!("off by {error:e}"))
}

/// A13 by links: what one sphere sends the other, with the inner one in the way.
fn a13_by_links(stages: &Stages) -> Verdict {
    let inner = Material::emitter("inner", Rgb::splat(0.5), Rgb::ONE);
    let outer = Material::diffuse("outer", Rgb::splat(0.5));
    let scene = stages.build(scenes::concentric_spheres(1.0, 2.0, 5120, inner, outer));
    let prepared = Prepared::of(stages, scene, Setup { radius: 0.1, ..hemisphere(1, 256, 1e-3) });
    let linked = prepared.link(&LinkOptions { n_levels: 1, n_rays: 256, ..LinkOptions::production() });
    let between = prepared.scene.frame().scene_from_world_length(1.5);
    let total = linked.direct.plus(&linked.indirect);
    let mean_of = |is_inner: bool| {
        let all = linked.basis.points(0).iter().zip(total.level(0));
        let of_sphere = all.filter(|(p, _)| (p.position.length() < between) == is_inner);
        let (points, values): (Vec<_>, Vec<_>) = of_sphere.map(|(p, e)| (*p, *e)).unzip();
        crate::area_mean(&points, &values)
    };
    let [b1, b2] = closed_forms::concentric_spheres([1.0, 2.0], [1.0, 0.0], [0.5, 0.5]);
    for (name, value, expected) in [("inner", mean_of(true), (b1 - 1.0) / 0.5), ("outer", mean_of(false), b2 / 0.5)] {
        demand((value / expected - 1.0).abs() < 0.015, || format!("{name} sphere: {value} instead of {expected}"))?;
    }
    Ok(())
}

/// `n` unit vectors spread evenly (a Fibonacci spiral).
pub fn spread_directions(n: usize) -> Vec<DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..n)
        .map(|i| {
            let y = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
            let (sin, cos) = (golden * i as f64).sin_cos();
            DVec3::new(cos, 0.0, sin) * (1.0 - y * y).sqrt() + DVec3::Y * y
        })
        .collect()
}

/// A14: the form factor of parallel unit squares, far and near, by shadow rays and by hemisphere.
fn a14_parallel_plates(stages: &Stages) -> Verdict {
    for (i, margin) in [(4, 0.01), (0, 2e-3)] {
        let (gap, factor) = closed_forms::PARALLEL_SQUARES[i];
        let bare = Bare::of(stages, stages.build(scenes::parallel_plates(gap)));
        let points: Vec<(DVec3, Vec3)> = cells(8).map(|(x, z)| (DVec3::new(x, gap, z), Vec3::NEG_Y)).collect();
        for estimator in BOTH {
            let values = bare.direct_at(&points, DirectOptions { estimator, ..DirectOptions::measurement() });
            let mean = f64::from(values.iter().sum::<Rgb>().x) / values.len() as f64;
            demand((mean / factor - 1.0).abs() <= margin, || {
                format!("gap {gap}, {estimator:?}: {mean} instead of {factor}")
            })?;
        }
    }
    Ok(())
}

/// The midpoints of `n × n` cells of the unit square.
pub fn cells(n: usize) -> impl Iterator<Item = (f64, f64)> {
    let at = move |i: usize| (i as f64 + 0.5) / n as f64;
    (0..n * n).map(move |i| (at(i % n), at(i / n)))
}

/// A17 and G18: a point under a unit square, and the same with a plate half-way that hides a quarter of it.
fn a17_blocked_square(stages: &Stages) -> Verdict {
    let visible = closed_forms::POINT_UNDER_UNIT_SQUARE;
    let hidden = 4.0 * closed_forms::point_to_parallel_rectangle(0.25, 0.25);
    for (blocker, expected) in [(None, visible), (Some(0.25), visible - hidden)] {
        let bare = Bare::of(stages, stages.build(square_above(blocker)));
        for estimator in BOTH {
            let options = DirectOptions { estimator, ..DirectOptions::measurement() };
            let value = f64::from(bare.direct_at(&[(DVec3::ZERO, Vec3::Y)], options)[0].x);
            demand((value / expected - 1.0).abs() < 0.01, || {
                format!("blocker {blocker:?}, {estimator:?}: {value} instead of {expected}")
            })?;
        }
    }
    Ok(())
}

/// A black floor, a unit square one metre above it that emits 1 W/m² downwards, and half-way a black plate of that width.
fn square_above(blocker: Option<f64>) -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::ONE));
    let black = builder.push_material(Material::diffuse("black", Rgb::ZERO));
    let square = |y: f64, half: f64| {
        [(-half, -half), (half, -half), (half, half), (-half, half)].map(|(x, z)| DVec3::new(x, y, z))
    };
    Shape::new().quad(square(0.0, 1.0)).push_into(&mut builder, "floor", black);
    Shape::new().quad(square(1.0, 0.5)).push_into(&mut builder, "lamp", lamp);
    if let Some(width) = blocker {
        Shape::new().quad(square(0.5, 0.5 * width)).push_into(&mut builder, "blocker", black);
    }
    builder
}

/// A small room with coloured walls and a coloured lamp, channels in the order given.
fn coloured_room(order: [usize; 3]) -> SceneBuilder {
    let colour = |rgb: [f32; 3]| Rgb::from_array(order.map(|c| rgb[c]));
    let mut builder = SceneBuilder::new();
    let walls = builder.push_material(Material::diffuse("walls", colour([0.7, 0.5, 0.2])));
    let block = builder.push_material(Material::diffuse("block", colour([0.1, 0.6, 0.8])));
    let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, colour([3.0, 5.0, 9.0])));
    Shape::new().room(DVec3::ZERO, DVec3::ONE).push_into(&mut builder, "room", walls);
    Shape::new().cuboid(DVec3::new(0.2, 0.0, 0.3), DVec3::new(0.5, 0.4, 0.6)).push_into(&mut builder, "block", block);
    let at = |x: f64, z: f64| DVec3::new(x, 0.98, z);
    Shape::new().quad([at(0.4, 0.4), at(0.6, 0.4), at(0.6, 0.6), at(0.4, 0.6)]).push_into(&mut builder, "lamp", lamp);
    builder
}

fn small_setup() -> Setup {
    Setup {
        n_levels: 3,
        transport: TransportOptions { n_rays: 64, tolerance: 1e-2, ..TransportOptions::production() },
        ..Setup::default()
    }
}

/// B3: permuted channels in, the same permutation out, bit for bit.
fn b3_permuted_channels(stages: &Stages) -> Verdict {
    let solve = |order| solve(&Prepared::of(stages, stages.build(coloured_room(order)), small_setup()));
    let plain = solve([0, 1, 2])?.finest();
    for order in [[1, 2, 0], [1, 0, 2]] {
        let permuted = solve(order)?.finest();
        let same = plain.iter().zip(&permuted).all(|(a, b)| order.map(|c| a[c]) == b.to_array());
        demand(plain.len() == permuted.len() && same, || format!("order {order:?} gives other values"))?;
    }
    Ok(())
}

/// B6: the same bits on 1, 2 and 3 threads.
fn b6_threads(stages: &Stages) -> Verdict {
    let on = |n: usize| -> Result<Vec<Rgb>, String> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().map_err(|e| e.to_string())?;
        pool.install(|| {
            let prepared = Prepared::of(stages, stages.build(coloured_room([0, 1, 2])), small_setup());
            Ok(solve(&prepared)?.finest())
        })
    };
    let one = on(1)?;
    for n in [2, 3] {
        demand(on(n)? == one, || format!("{n} threads give other bits than one"))?;
    }
    Ok(())
}

/// B11: on every level the areas add up to the surface that light reaches; in a closed cube those are the six faces, as far
/// as some ten thousand candidates can tell.
fn b11_areas(stages: &Stages) -> Verdict {
    let scene = stages.build(scenes::furnace_box(Rgb::splat(0.5), Rgb::ONE));
    let prepared = Prepared::of(stages, scene, Setup { n_levels: 3, ..hemisphere(3, 16, 1e-2) });
    let reachable = prepared.placed.reachable_area;
    demand((reachable / 6.0 - 1.0).abs() < 0.03, || format!("reachable area {reachable} instead of 6"))?;
    for level in 0..prepared.basis.n_levels() {
        let sum: f64 = prepared.basis.points(level).iter().map(|p| f64::from(p.area)).sum();
        demand((sum / reachable - 1.0).abs() < 1e-5, || format!("level {level}: areas {sum}, not {reachable}"))?;
    }
    Ok(())
}

/// E8: no two points of a level are nearer to each other than the Poisson radius.
fn e8_distances(stages: &Stages) -> Verdict {
    let scene = stages.build(coloured_room([0, 1, 2]));
    let prepared = Prepared::of(stages, scene, small_setup());
    for level in &prepared.basis.hierarchy().levels {
        let r2 = level.poisson_radius * level.poisson_radius * (1.0 - 1e-5);
        for (i, a) in level.points.iter().enumerate() {
            // The metric is that of the point that was there first, which is not known any more: one of the two.
            let apart = |b: &OrientedPoint| rejection_distance_squared(b, a).max(rejection_distance_squared(a, b));
            let near = level.points[..i].iter().any(|b| apart(b) < r2);
            demand(!near, || format!("point {i} of radius {} is too near to another", level.poisson_radius))?;
        }
    }
    Ok(())
}

/// C4: a room that only reflects and emits red stays exactly black in green and blue.
fn c4_dead_channels(stages: &Stages) -> Verdict {
    let scene = stages.build(scenes::furnace_box(Rgb::new(0.9, 0.0, 0.0), Rgb::X));
    let solved = solve(&Prepared::of(stages, scene, hemisphere(2, 64, 1e-6)))?;
    for e in solved.finest() {
        demand((e.y, e.z) == (0.0, 0.0) && (e.x / 10.0 - 1.0).abs() < 1e-4, || format!("{e}"))?;
    }
    Ok(())
}

/// C10: open ground under a sky of radiance 1 receives π, by either estimator.
fn c10_ground_under_a_sky(stages: &Stages) -> Verdict {
    let mut builder = scenes::single_sheet(Rgb::splat(0.5));
    builder.set_environment(Environment::constant(Rgb::ONE).map_err(|e| e.to_string())?);
    let bare = Bare::of(stages, stages.build(builder));
    for estimator in BOTH {
        let options = DirectOptions { estimator, ..DirectOptions::projection() };
        let value = bare.direct_at(&[(DVec3::ZERO, Vec3::Y)], options);
        let error = worst(&value, Rgb::splat(std::f32::consts::PI));
        demand(error < 2e-3, || format!("{estimator:?}: off by {error:e}"))?;
    }
    Ok(())
}

/// C12: a texel of sRGB code 188 is an albedo of 0.5029: in a furnace, 2.0115 times the exitance.
fn c12_encoded_texture(stages: &Stages) -> Verdict {
    let mut builder = SceneBuilder::new();
    let texture = Texture::from_rgba8(1, 1, vec![[188, 188, 188, 255]]).ok_or("no texture")?;
    let slot = TextureSlot { texture, transform: Default::default(), wrap: [Wrap::Repeat; 2] };
    let wall =
        builder.push_material(Material { albedo_texture: Some(slot), ..Material::emitter("wall", Rgb::ONE, Rgb::ONE) });
    let mut room = Shape::new();
    room.room(DVec3::ZERO, DVec3::ONE);
    let uvs = vec![Vec2::splat(0.5); room.positions.len()];
    let mesh = MeshInput {
        name: "room",
        positions: &room.positions,
        normals: &[],
        uvs: &uvs,
        triangles: &room.triangles,
        material: wall,
    };
    builder.push_mesh(mesh).map_err(|e| e.to_string())?;
    let solved = solve(&Prepared::of(stages, stages.build(builder), hemisphere(1, 16, 1e-6)))?;
    // IEC 61966-2-1: ((188/255 + 0.055)/1.055)^2.4 = 0.5028865.
    let error = worst(&solved.finest(), Rgb::splat(1.0 / (1.0 - 0.502_886_5)));
    demand(error < 1e-5, || format!("off by {error:e}"))
}

/// D8: two coincident walls of no thickness, back to back: the unlit room is exactly black, the lit one is not.
fn d8_dark_room(stages: &Stages) -> Verdict {
    let prepared = Prepared::of(stages, stages.build(scenes::two_rooms(0.0)), small_setup());
    let solved = solve(&prepared)?;
    let side = |normal: Vec3| {
        let points: Vec<(DVec3, Vec3)> = cells(8).map(|(y, z)| (DVec3::new(0.0, y, z), normal)).collect();
        let points = prepared.locate_world(&points);
        prepared.interpolated_at(&solved, &points)
    };
    let brightest = side(Vec3::X).into_iter().fold(Rgb::ZERO, Rgb::max);
    demand(brightest == Rgb::ZERO, || format!("the dark side receives {brightest}"))?;
    let darkest = side(Vec3::NEG_X).into_iter().fold(Rgb::INFINITY, Rgb::min);
    demand(darkest.min_element() > 0.0, || format!("the lit side receives {darkest}"))
}
