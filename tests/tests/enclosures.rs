//! Enclosures with closed forms: spheres, ports, pinholes, cubes, and the singular ones.

use std::f64::consts::PI;

use hplt::basis::{Layered, Reconstruction};
use hplt::geom::glam::{DVec3, Vec3};
use hplt::geom::{Bvh, BvhOptions, Environment, Material, NoProgress, Rgb, Scene, SceneBuilder, Sides, TriangleId};
use hplt::reference::closed_forms;
use hplt::reference::scenes::{self, Shape};
use hplt::transport::{DirectOptions, Error, LinkOptions, StopReason, Threshold, TransportOptions, sky_view};
use hplt_tests::checks::{cells, hemisphere, worst};
use hplt_tests::{Bare, Prepared, Setup, area_mean, assert_equivalent, mean_luminance, replicated, slope};

/// The area of the triangles that `select` takes, scene units.
fn area_of(scene: &Scene, select: impl Fn(&Material) -> bool) -> f64 {
    let triangles = (0..scene.mesh().n_triangles() as u32).map(TriangleId);
    triangles.filter(|&t| select(scene.material(t))).map(|t| scene.mesh().area(t)).sum()
}

/// A6: albedo 1, closed, nothing emits: the smallest solution is 0.
#[test]
fn a6_albedo_one_without_light_is_black() {
    let scene = scenes::build(scenes::furnace_box(Rgb::ONE, Rgb::ZERO));
    let solved = Prepared::new(scene, Setup::default()).solve().unwrap();
    assert_eq!(solved.report.stop, StopReason::NoLight);
    assert!(solved.finest().iter().all(|e| *e == Rgb::ZERO));
}

/// A8: albedo 1 - 1e-4 and 1 - 1e-6, closed: an answer within the bound that comes with it, or a refusal; never a wrong bound.
#[test]
fn a8_albedo_almost_one_never_claims_too_much() {
    for (albedo, max_bounces) in [(0.9999f32, 60_000), (0.9999, 1000), (0.999_999, 5000)] {
        let scene = scenes::build(scenes::furnace_box(Rgb::splat(albedo), Rgb::ONE));
        let mut setup = Setup { radius: 1.0, ..hemisphere(1, 8, 1e-2) };
        setup.transport.max_bounces = max_bounces;
        match Prepared::new(scene, setup).solve() {
            Ok(solved) => {
                let exact = (1.0 / (1.0 - f64::from(albedo))) as f32;
                let values = solved.finest();
                let error = worst(&values, Rgb::splat(exact));
                // The bound is relative to what was found.
                let claimed = solved.report.truncation_bound * values[0].x / exact;
                println!("{albedo}: off by {error:e}, claims {claimed:e}, {} bounces", solved.report.bounces.len());
                assert!(error <= 1.01 * claimed + 1e-4, "{albedo}: off by {error:e}, claims {claimed:e}");
                assert_eq!(solved.report.stop == StopReason::Converged, max_bounces == 60_000);
            }
            Err(error) => {
                println!("{albedo}: {error}");
                assert!(matches!(error, Error::NoFiniteSolution { .. }) && albedo > 0.9999, "{error}");
            }
        }
    }
}

/// An integrating sphere with a lamp and a black port in walls of that albedo, and its irradiance.
fn integrating_sphere(albedo: f32, facets: usize) -> (Scene, f64) {
    let wall = Material::diffuse("wall", Rgb::splat(albedo));
    let lamp = Material::emitter("lamp", Rgb::splat(albedo), Rgb::splat(10.0));
    let port = Material::diffuse("port", Rgb::ZERO);
    let choose = |d: DVec3| if d.y > 0.9 { 1 } else { 2 * usize::from(d.x > 0.9) };
    let scene = scenes::build(scenes::sphere(1.0, facets, &[wall, lamp, port], choose));
    let all = area_of(&scene, |_| true);
    let lit = area_of(&scene, Material::is_emissive) / all;
    let black = area_of(&scene, |m| m.albedo == Rgb::ZERO) / all;
    let exact = closed_forms::integrating_sphere_irradiance(10.0 * lit, f64::from(albedo) * (1.0 - black));
    (scene, exact)
}

/// A11: an integrating sphere with a lamp, a black port and walls of high albedo, by bounces on the fly.
#[test]
fn a11_integrating_sphere_with_a_lamp_and_a_port() {
    for (albedo, margin) in [(0.9f32, 0.035), (0.98, 0.07)] {
        let (scene, exact) = integrating_sphere(albedo, 5120);
        let mean = replicated(6, |seed| {
            let mut setup = hemisphere(1, 64, 1e-3);
            (setup.radius, setup.direct.seed, setup.transport.seed) = (0.12, seed, seed);
            setup.direct.sky_samples = 4096;
            let prepared = Prepared::new(scene.clone(), setup);
            let solved = prepared.solve().unwrap();
            assert_eq!(solved.report.n_escaped(), 0);
            area_mean(prepared.basis.points(0), &solved.finest())
        });
        assert_equivalent(&format!("integrating sphere, albedo {albedo}"), &mean, exact, margin);
    }
}

/// A11 to its margin, by links. What the rays make of the share of the port is multiplied by `1/(1-ρ)`: it takes millions of them.
#[test]
fn a11_integrating_sphere_by_links() {
    for albedo in [0.9f32, 0.98] {
        let (scene, exact) = integrating_sphere(albedo, 20_480);
        let mean = replicated(12, |seed| {
            let mut setup = Setup { radius: 0.06, points_seed: seed, ..hemisphere(1, 64, 1e-3) };
            (setup.direct.seed, setup.direct.sky_samples) = (seed, 2048);
            let prepared = Prepared::new(scene.clone(), setup);
            let mut options = LinkOptions { seed, n_levels: 1, n_rays: 4096, ..LinkOptions::production() };
            options.solve.tolerance = 1e-5;
            let linked = prepared.link(&options);
            assert_eq!(linked.report.escaped, 0);
            area_mean(linked.basis.points(0), linked.direct.plus(&linked.indirect).level(0))
        });
        assert_equivalent(&format!("integrating sphere by links, albedo {albedo}"), &mean, exact, 0.005);
    }
}

/// A sphere of albedo `albedo` whose cap `y > 1 - 2f` is open to a sky of radiance 1, and the fraction of area that is open.
fn pinhole(fraction: f64, facets: usize, albedo: f32) -> (Scene, f64) {
    pinhole_in(fraction, facets, wall(albedo))
}

fn wall(albedo: f32) -> Material {
    Material::diffuse("wall", Rgb::splat(albedo))
}

fn pinhole_in(fraction: f64, facets: usize, wall: Material) -> (Scene, f64) {
    let full = scenes::geodesic_sphere(1.0, facets);
    let mut builder = SceneBuilder::new();
    let id = builder.push_material(wall);
    let mut open = full.mapped(|p| p);
    open.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    let middle = |t: &[u32; 3]| t.iter().map(|&v| full.positions[v as usize]).sum::<DVec3>().normalize();
    open.triangles.retain(|t| middle(t).y <= 1.0 - 2.0 * fraction);
    open.push_into(&mut builder, "sphere", id);
    builder.set_environment(Environment::constant(Rgb::ONE).unwrap());
    (scenes::build(builder), 1.0 - open.area() / full.area())
}

/// The mean irradiance inside an open sphere, with so many rays to the sky at every function.
fn inside_of_sphere(scene: &Scene, seed: u64, sky_samples: u32) -> f64 {
    // Tolerances are relative to the mean of a region, and the outside, hundreds of times as bright, is in the same.
    let mut setup = hemisphere(1, 128, 1e-6);
    (setup.radius, setup.direct.seed, setup.transport.seed) = (0.05, seed, seed);
    setup.direct.sky_samples = sky_samples;
    let prepared = Prepared::new(scene.clone(), setup);
    let solved = prepared.solve().unwrap();
    // The outside sees the sky too; the inside is what the closed form speaks of.
    let top = prepared.basis.n_levels() - 1;
    let inside = prepared.basis.points(top).iter().zip(solved.finest());
    let (points, values): (Vec<_>, Vec<_>) =
        inside.filter(|(p, _)| p.position.dot(p.normal) < 0.0).map(|(p, e)| (*p, e)).unzip();
    area_mean(&points, &values)
}

/// A12: a sphere with a hole to the sky: `H = fπL/(1-ρ(1-f))`.
#[test]
fn a12_a_hole_to_the_sky() {
    for (fraction, albedo, margin) in [(0.5, 0.8, 0.01), (0.1, 0.5, 0.015), (1e-2, 0.8, 0.05)] {
        let (scene, open) = pinhole(fraction, 5120, albedo);
        let exact = closed_forms::cap_cavity_irradiance(open, albedo.into(), 1.0);
        let mean = replicated(6, |seed| inside_of_sphere(&scene, seed, 1024));
        assert_equivalent(&format!("hole of {open:.5}, albedo {albedo}"), &mean, exact, margin);
    }
}

/// A12, small holes: they are announced where some ray finds them, and bounded where none does.
#[test]
fn a12_a_hole_too_small_for_the_rays_is_announced() {
    let view = |fraction: f64, facets: usize| {
        let (scene, open) = pinhole(fraction, facets, 0.8);
        let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
        let view = sky_view(&scene, &bvh, 1, &NoProgress).unwrap().unwrap();
        assert!(open > 0.0);
        println!("hole of {open:.2e}: {view:?}, at most {:.2e}", view.most_seen_share());
        // The inside is half of all sides.
        assert!((view.enclosed_share - 0.5).abs() < 0.06, "{view:?}");
        assert!(view.most_seen_share() >= open && view.seen_share() <= 3.0 * open + 1e-9, "{view:?} {open}");
        view
    };
    assert!(!view(1e-2, 20_480).is_under_sampled());
    assert!(view(1e-3, 20_480).is_under_sampled());
    // A few facets of 327,680: no ray finds it. What is said is the most that can be there.
    let closed = view(1e-5, 327_680);
    assert_eq!(closed.seen, 0);
    assert!(closed.most_seen_share() < 1.2e-4, "{closed:?}");
}

/// No opening and nothing but openings: nothing to announce.
#[test]
fn a12_open_ground_and_closed_rooms_are_not_announced() {
    for scene in [
        scenes::build(scenes::plane_under_sky(10.0, Rgb::splat(0.5), Rgb::ONE)),
        scenes::build(scenes::furnace_box(Rgb::splat(0.5), Rgb::ONE)),
    ] {
        let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
        let view = sky_view(&scene, &bvh, 1, &NoProgress).unwrap();
        assert!(view.is_none_or(|v| !v.is_under_sampled()), "{view:?}");
    }
}

/// A13: concentric spheres from nearly touching to far apart; the inner one hides the other side of the outer one.
#[test]
fn a13_concentric_spheres_of_all_ratios() {
    for q in [0.9f64, 0.01] {
        let inner_radius = q.sqrt();
        let inner = Material::emitter("inner", Rgb::splat(0.5), Rgb::ONE);
        let outer = Material::emitter("outer", Rgb::splat(0.7), Rgb::splat(0.1));
        let scene = scenes::build(scenes::concentric_spheres(inner_radius, 1.0, 5120, inner, outer));
        let [b1, b2] = closed_forms::concentric_spheres([inner_radius, 1.0], [1.0, 0.1], [0.5, 0.7]);
        let middle = scene.frame().scene_from_world_length(0.5 * (inner_radius + 1.0));
        let solves: Vec<[f64; 2]> = (0..6)
            .map(|seed| {
                let mut setup = hemisphere(1, 128, 1e-3);
                (setup.radius, setup.direct.seed, setup.transport.seed) = (0.06, seed, seed);
                let prepared = Prepared::new(scene.clone(), setup);
                let values = prepared.solve().unwrap().finest();
                [true, false].map(|is_inner| {
                    let all = prepared.basis.points(0).iter().zip(&values);
                    let of_sphere = all.filter(|(p, _)| (p.position.length() < middle) == is_inner);
                    let (points, values): (Vec<_>, Vec<_>) = of_sphere.map(|(p, e)| (*p, *e)).unzip();
                    area_mean(&points, &values)
                })
            })
            .collect();
        let [first, second] = [0, 1].map(|i| replicated(6, |seed| solves[seed as usize][i]));
        assert_equivalent(&format!("inner sphere, q = {q}"), &first, (b1 - 1.0) / 0.5, 0.015);
        assert_equivalent(&format!("outer sphere, q = {q}"), &second, (b2 - 0.1) / 0.7, 0.015);
    }
}

/// A closed cube of `width` metres around a point light of `flux`.
fn lit_cube(width: f64, flux: f64, albedo: f32) -> Scene {
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(Material::diffuse("wall", Rgb::splat(albedo)));
    Shape::new().room(DVec3::ZERO, DVec3::splat(width)).push_into(&mut builder, "cube", wall);
    builder.push_point_light("lamp", DVec3::splat(0.5 * width), Rgb::splat((flux / (4.0 * PI)) as f32));
    scenes::build(builder)
}

/// Every function gathered, pushed down plainly: what is left is noise and the width of the functions.
fn fully_refined(n_rays: u32) -> TransportOptions {
    let threshold = Threshold { absolute: 0.0, relative: 0.0, noise: 0.0 };
    TransportOptions { n_rays, threshold, shaped_push_down: false, ..TransportOptions::production() }
}

/// CIE 171:2006 5.8: the mean indirect illuminance of a 4 m cube, 10 000 lm: `(Φ/S)ρ/(1-ρ)`, as an area mean.
#[test]
fn cie_171_5_8_mean_indirect_illuminance() {
    for (albedo, _) in closed_forms::CIE_171_5_8.into_iter().filter(|(a, _)| [0.05, 0.5, 0.8].contains(a)) {
        let exact = closed_forms::mean_indirect_irradiance(10_000.0, albedo, 96.0);
        let mean = replicated(6, |seed| {
            let transport = TransportOptions { seed, tolerance: 1e-4, ..fully_refined(32) };
            let setup = Setup { n_levels: 2, transport, ..Setup::default() };
            let prepared = Prepared::new(lit_cube(4.0, 10_000.0, albedo as f32), setup);
            let solved = prepared.solve().unwrap();
            area_mean(prepared.basis.points(1), solved.indirect.level(1))
        });
        assert_equivalent(&format!("CIE 171 5.8, albedo {albedo}"), &mean, exact, 0.02);
    }
}

/// Albedo of [`cluttered_closed_room`].
const CLUTTERED_ALBEDO: f32 = 0.6;

/// A closed room of one albedo in which blocks and a lamp hang, its rectangles, and its mean irradiance `Φ/((1-ρ)A)`.
fn cluttered_closed_room() -> (Scene, Shape, f64) {
    let albedo = CLUTTERED_ALBEDO;
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(Material::diffuse("wall", Rgb::splat(albedo)));
    let lamp = builder.push_material(Material::emitter("lamp", Rgb::splat(albedo), Rgb::splat(20.0)));
    let mut all = Shape::new();
    all.room(DVec3::ZERO, DVec3::new(3.0, 2.0, 2.5));
    all.cuboid(DVec3::new(0.5, 0.2, 0.4), DVec3::new(1.1, 1.0, 1.0));
    all.cuboid(DVec3::new(1.6, 0.5, 1.0), DVec3::new(2.2, 0.9, 2.0));
    all.push_into(&mut builder, "room", wall);
    let mut lamps = Shape::new();
    lamps.cuboid(DVec3::new(1.2, 1.6, 1.1), DVec3::new(1.6, 1.7, 1.5));
    lamps.push_into(&mut builder, "lamp", lamp);
    all.append(&lamps);
    let exact = closed_forms::mean_irradiance(20.0 * lamps.area(), albedo.into(), all.area());
    (scenes::build(builder), all, exact)
}

/// A20, B12: in a closed scene of one albedo the mean irradiance is `Φ/((1-ρ)A)`, whatever stands and shines in it: what is
/// emitted is absorbed.
#[test]
fn a20_what_is_emitted_is_absorbed() {
    let (scene, _, exact) = cluttered_closed_room();
    let mean = replicated(12, |seed| {
        let transport = TransportOptions { seed, n_rays: 128, ..TransportOptions::production() };
        let setup = Setup { n_levels: 3, points_seed: seed, transport, ..Setup::default() };
        let prepared = Prepared::new(scene.clone(), setup);
        let solved = prepared.solve().unwrap();
        assert_eq!(solved.report.n_escaped(), 0);
        let top = prepared.basis.n_levels() - 1;
        area_mean(prepared.basis.points(top), &solved.finest())
    });
    assert_equivalent("mean of a closed room", &mean, exact, 0.01);
}

/// Functions, and mean irradiance by links over all surface of [`cluttered_closed_room`], without what comes straight from the lamp:
/// read in the middles of `12 × 12` cells of each rectangle.
fn linked_mean((scene, all): (&Scene, &Shape), radius: f64, options: LinkOptions) -> (f64, f64) {
    let seed = options.seed;
    let direct = DirectOptions { seed, ..DirectOptions::projection() };
    let prepared =
        Prepared::new(scene.clone(), Setup { n_levels: 1, radius, points_seed: seed, direct, ..Setup::default() });
    let linked = prepared.link(&options);
    assert_eq!(linked.report.escaped, 0);
    let (mut sum, mut area) = (0.0, 0.0);
    for quad in all.positions.chunks(4) {
        let (u, v) = (quad[1] - quad[0], quad[3] - quad[0]);
        let normal = u.cross(v).normalize().as_vec3();
        let places: Vec<(DVec3, Vec3)> = cells(12).map(|(a, b)| (quad[0] + u * a + v * b, normal)).collect();
        let points = prepared.locate_world(&places);
        let mut values = vec![Rgb::ZERO; points.len()];
        Layered.reconstruct(&linked.basis, &linked.indirect, linked.basis.n_levels(), &points, &mut values);
        sum += u.cross(v).length() * mean_luminance(&values);
        area += u.cross(v).length();
    }
    let n_functions = (0..linked.basis.n_levels()).map(|level| linked.basis.n_functions(level)).sum::<usize>();
    (n_functions as f64, sum / area)
}

/// A20: the same by links at the settings of `production`, of what is reflected alone.
#[test]
fn a20_what_is_reflected_is_absorbed_at_production_settings() {
    let (scene, all, exact) = cluttered_closed_room();
    let mean = replicated(8, |seed| {
        linked_mean((&scene, &all), Setup::default().radius, LinkOptions { seed, ..LinkOptions::production() }).1
    });
    assert_equivalent("reflected light of a closed room", &mean, f64::from(CLUTTERED_ALBEDO) * exact, 0.01);
}

/// A20: the error of that mean falls to half or less with four times as many functions.
#[test]
fn a20_the_error_of_the_mean_falls_with_the_number_of_functions() {
    let (scene, all, exact) = cluttered_closed_room();
    let exact = f64::from(CLUTTERED_ALBEDO) * exact;
    let errors: Vec<(f64, f64)> = [0.17, 0.085, 0.0425]
        .into_iter()
        .map(|radius| {
            let runs = (0..4).map(|seed| {
                let options = LinkOptions { seed, n_levels: 1, ..LinkOptions::production() };
                linked_mean((&scene, &all), radius, options)
            });
            let (n, sum) = runs.fold((0.0, 0.0), |(n, sum), run| (n + 0.25 * run.0, sum + 0.25 * run.1));
            println!("{n} functions: off by {:+.3} %", 100.0 * (sum / exact - 1.0));
            (n, (sum / exact - 1.0).abs())
        })
        .collect();
    let order = -slope(&errors);
    println!("order {order:.2} in the number of functions");
    assert!(order >= 0.5, "order {order}: {errors:?}");
    // Negative control: a hundredth too much everywhere is an error that stays.
    let wrong: Vec<(f64, f64)> = errors.iter().map(|&(n, _)| (n, 0.01)).collect();
    assert!(-slope(&wrong) < 0.5);
}

/// A12 to its margin of 1 %, with the rays that this takes: the light inside, and for the smaller hole what comes straight from it.
#[test]
#[ignore = "slow: hundreds of millions of rays"]
fn a12_small_holes_with_many_rays() {
    for (fraction, sky_samples, margin) in [(1e-2, 4096, 0.01), (1e-3, 16_384, 0.1)] {
        let (scene, open) = pinhole(fraction, 20_480, 0.8);
        let exact = closed_forms::cap_cavity_irradiance(open, 0.8f32.into(), 1.0);
        let mean = replicated(12, |seed| inside_of_sphere(&scene, seed, sky_samples));
        assert_equivalent(&format!("hole of {open:.5}"), &mean, exact, margin);
    }
    let (scene, open) = pinhole(1e-3, 81_920, 0.8);
    let n = scene.mesh().n_triangles() as u32;
    let inside: Vec<(DVec3, Vec3)> = (0..n)
        .step_by(n as usize / 200)
        .map(|t| {
            let position = scene.mesh().position_at(TriangleId(t), 1.0 / 3.0, 1.0 / 3.0);
            (scene.frame().world_from_scene_point(position), -position.normalize())
        })
        .collect();
    let bare = Bare::new(scene);
    let mean = replicated(8, |seed| {
        let options = DirectOptions { seed, sky_samples: 1 << 16, ..DirectOptions::measurement() };
        mean_luminance(&bare.direct_at(&inside, options))
    });
    assert_equivalent(&format!("straight from a hole of {open:.5}"), &mean, open * PI, 0.01);
}

/// A12: a hole of a thousandth to 1 %. The outside, which no light of the inside comes from, reflects nothing.
#[test]
#[ignore = "slow: a hundred million rays"]
fn a12_a_hole_of_a_thousandth_with_many_rays() {
    let (scene, open) = pinhole_in(1e-3, 20_480, Material { reflects: Sides::Front, ..wall(0.8) });
    let exact = closed_forms::cap_cavity_irradiance(open, 0.8f32.into(), 1.0);
    let mean = replicated(16, |seed| {
        let mut setup = Setup { radius: 0.08, points_seed: seed, ..hemisphere(1, 128, 1e-4) };
        (setup.direct.seed, setup.transport.seed, setup.direct.sky_samples) = (seed, seed, 1 << 16);
        let prepared = Prepared::new(scene.clone(), setup);
        let solved = prepared.solve().unwrap();
        area_mean(prepared.basis.points(0), &solved.finest())
    });
    assert_equivalent(&format!("hole of {open:.5}, black outside"), &mean, exact, 0.01);
}
