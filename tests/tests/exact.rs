//! Exact answers: closed and open furnaces, spheres.

use hplt::geom::glam::DVec3;
use hplt::geom::{Material, NoProgress, Rgb, Scene, SceneBuilder, Sides};
use hplt::reference::scenes::{self, Shape};
use hplt::transport::{DirectEstimator, DirectOptions, Error, LinkOptions, StopReason, TransportOptions};
use hplt_tests::{Prepared, Setup, area_mean};

/// Every surface emits: lights are found by the rays that gather.
fn furnace_setup() -> Setup {
    Setup {
        n_levels: 2,
        direct: DirectOptions { estimator: DirectEstimator::Hemisphere, ..DirectOptions::projection() },
        transport: TransportOptions { n_rays: 16, tolerance: 1e-7, ..TransportOptions::production() },
        ..Setup::default()
    }
}

fn furnace(albedo: f32) -> Scene {
    scenes::build(scenes::furnace_box(Rgb::splat(albedo), Rgb::ONE))
}

/// Largest relative deviation of the irradiance at the functions and at random points from `expected`.
fn worst(prepared: &Prepared, solved: &hplt_tests::Solved, expected: f32) -> f32 {
    let points = hplt::sampling::random_surface_points(&prepared.scene, &prepared.bvh, &prepared.regions, 200, 5);
    let direct = prepared.direct_at(&points);
    let (indirect, coverage) = prepared.interpolate(&solved.indirect, &points);
    assert_eq!(coverage.uncovered, 0);
    let at_points = direct.iter().zip(&indirect).map(|(d, i)| *d + *i);
    solved
        .finest()
        .into_iter()
        .chain(at_points)
        .map(|e| (e / expected - Rgb::ONE).abs().max_element())
        .fold(0.0, f32::max)
}

/// A1: B = M/(1-ρ) in a closed cube, every ray accounted for.
#[test]
fn a1_closed_furnace() {
    for albedo in [0.0, 0.5, 0.9, 0.99] {
        let prepared = Prepared::new(furnace(albedo), furnace_setup());
        let solved = prepared.solve().unwrap();
        // E = B here, since B = M + ρE = 1 + ρ/(1-ρ) = 1/(1-ρ).
        let expected = 1.0 / (1.0 - albedo);
        let error = worst(&prepared, &solved, expected);
        assert_eq!(solved.report.n_escaped(), 0);
        assert!(error <= 2e-6 * expected, "albedo {albedo}: {error:e}");
        assert!(error <= solved.report.truncation_bound.max(2e-6 * expected));
        let delta = prepared.solve_delta().unwrap();
        let error = worst(&prepared, &delta, expected);
        assert!(error <= 4e-6 * expected, "delta, albedo {albedo}: {error:e}");
    }
}

/// A2: after k bounces B_k = M(1-ρ^(k+1))/(1-ρ).
#[test]
fn a2_furnace_after_k_bounces() {
    let albedo = 0.7f32;
    for k in [1, 2, 5, 12] {
        let mut setup = furnace_setup();
        setup.transport.max_bounces = k;
        setup.transport.tolerance = 0.0;
        let prepared = Prepared::new(furnace(albedo), setup);
        let solved = prepared.solve().unwrap();
        assert_eq!((solved.report.bounces.len(), solved.report.stop), (k, StopReason::MaxBounces));
        // Irradiance counts M arriving directly as well: E_k = Σ_{j=0..k} ρ^j.
        let expected = (1.0 - albedo.powi(k as i32 + 1)) / (1.0 - albedo);
        let error = worst(&prepared, &solved, expected);
        assert!(error <= 1e-6, "{k} bounces: {error:e}");
        // Negative control: one bounce more or less is far outside.
        assert!(worst(&prepared, &solved, (1.0 - albedo.powi(k as i32)) / (1.0 - albedo)) > 1e-3);
    }
}

/// A3: M = (1-ρ)·B0 with any albedo in any closed geometry gives B = B0.
#[test]
fn a3_generalised_furnace() {
    let scenes = [
        ("clutter", scenes::build(scenes::cluttered_room(3, 12, 1.0))),
        ("torus", scenes::build(scenes::torus(48, 24, 1.0))),
        ("boxes through each other", scenes::build(scenes::cluttered_room(4, 60, 1.0))),
    ];
    for (name, scene) in scenes {
        assert_uniform(name, scene);
    }
}

/// Solves a generalised furnace of unit radiosity and asserts that it is one: the mean to half a per cent, every function to its noise.
fn assert_uniform(name: &str, scene: Scene) {
    let mut setup = furnace_setup();
    setup.n_levels = 1;
    setup.direct.sky_samples = 256;
    setup.transport = TransportOptions { n_rays: 128, tolerance: 1e-3, ..setup.transport };
    let prepared = Prepared::new(scene, setup);
    let solved = prepared.solve().unwrap();
    assert_eq!(solved.report.n_escaped(), 0, "{name}");
    // Where boxes cut each other into slivers, the coarsest level has no function on some of their sides.
    let coverage = solved.report.coverage();
    assert!(coverage.uncovered <= coverage.queries / 1000, "{name}: {coverage:?}");
    // B = 1 makes E = 1, but emission and reflection are gathered by different rays: what is left is their noise.
    let points = hplt::sampling::random_surface_points(&prepared.scene, &prepared.bvh, &prepared.regions, 200, 5);
    let gathered = prepared.gather(&solved, &points, 256);
    let at_points = prepared.direct_at(&points).into_iter().zip(&gathered).map(|(d, g)| d + g.irradiance);
    let finest = solved.finest();
    let deviations = finest.iter().copied().chain(at_points).map(|e| (e - Rgb::ONE).abs().max_element());
    let error = deviations.fold(0.0, f32::max);
    println!("{name}: {error:e}, {} bounces", solved.report.bounces.len());
    // The largest of a thousand values whose noise is 0.8 %.
    assert!(error <= 0.08, "{name}: {error:e}");
    let mean = finest.iter().sum::<Rgb>() / finest.len() as f32;
    println!("{name}: mean {mean}");
    assert!((mean - Rgb::ONE).abs().max_element() <= 5e-3, "{name}: mean {mean}");
}

/// A3 as the catalogue has it: 500 boxes through each other, albedos up to 0.99. Between them lie thousands of hollows of their own;
/// in those that are nearly white, what one function a wall cannot tell of is multiplied by up to `1/(1-ρ)`, so that single functions
/// may be far off. It is not noise: with 64 times the rays and other seeds the same functions are off by the same. Hence small functions;
/// the hollows that are smaller still are the few that are beyond the bound. Direct light, which nothing multiplies, needs few samples.
#[test]
#[ignore = "slow: 500 boxes, 48,000 functions"]
fn a3_five_hundred_boxes_through_each_other() {
    let mut setup = Setup { n_levels: 1, radius: 0.06, ..furnace_setup() };
    setup.direct.sky_samples = 256;
    let prepared = Prepared::new(scenes::build(scenes::random_boxes_furnace(4)), setup);
    let linked = prepared.link(&LinkOptions { n_levels: 1, n_rays: 512, ..LinkOptions::production() });
    assert_eq!(linked.report.escaped, 0);
    let coverage = linked.report.coverage;
    assert!(coverage.uncovered <= coverage.queries / 10_000, "{coverage:?}");
    let total = linked.direct.plus(&linked.indirect);
    let mut deviations: Vec<f32> = total.level(0).iter().map(|e| (*e - Rgb::ONE).abs().max_element()).collect();
    deviations.sort_by(f32::total_cmp);
    let n = deviations.len();
    let [median, most, worst] = [n / 2, n - n / 1000, n - 1].map(|i| deviations[i]);
    let mean = area_mean(prepared.basis.points(0), total.level(0)) - 1.0;
    println!(
        "{n} functions, {} regions: median {median:.4}, 999 of 1000 within {most:.4}, worst {worst:.4}, mean {mean:+.5}",
        prepared.regions.n_regions()
    );
    assert!(median <= 0.03 && most <= 0.3 && mean.abs() <= 2e-3, "{median} {most} {mean}");
}

/// A4: open geometry in a uniform sky of radiance L with M = (1-ρ)πL looks like the sky.
#[test]
fn a4_open_geometry_in_a_uniform_sky() {
    let sky = Rgb::new(0.5, 1.0, 2.0);
    let mut builder = SceneBuilder::new();
    let exitance = |albedo: f32| sky * (std::f32::consts::PI * (1.0 - albedo));
    let mut push = |shape: &mut Shape, albedo: f32| {
        let material = Material { emits: Sides::Both, ..Material::emitter("m", Rgb::splat(albedo), exitance(albedo)) };
        let id = builder.push_material(material);
        shape.push_into(&mut builder, "m", id);
    };
    push(Shape::new().quad([DVec3::ZERO, DVec3::Z * 2.0, DVec3::new(2.0, 0.0, 2.0), DVec3::X * 2.0]), 0.3);
    push(Shape::new().cuboid(DVec3::new(0.5, 0.0, 0.5), DVec3::new(1.0, 0.7, 1.0)), 0.8);
    push(Shape::new().cuboid(DVec3::new(1.2, 0.1, 0.9), DVec3::new(1.6, 0.5, 1.8)), 0.6);
    builder.set_environment(hplt::geom::Environment::constant(sky).unwrap());
    let mut setup = furnace_setup();
    setup.direct.sky_samples = 1024;
    setup.transport = TransportOptions { n_rays: 1024, tolerance: 1e-5, ..setup.transport };
    let prepared = Prepared::new(scenes::build(builder), setup);
    let solved = prepared.solve().unwrap();
    let expected = sky * std::f32::consts::PI;
    let ratios: Vec<Rgb> = solved.finest().iter().map(|e| *e / expected).collect();
    let worst = ratios.iter().map(|r| (*r - Rgb::ONE).abs().max_element()).fold(0.0, f32::max);
    println!("worst function {worst}");
    // The largest of some thousand functions, each with the noise of 1024 rays twice.
    assert!(worst < 0.05, "{worst}");
    // Equivalence of the mean within 0.2 %.
    let n = ratios.len() as f32;
    let mean = ratios.iter().sum::<Rgb>() / n;
    let variance = ratios.iter().map(|r| (*r - mean) * (*r - mean)).sum::<Rgb>() / (n - 1.0);
    let half_width = 4.0 * (variance.max_element() / n).sqrt();
    assert!((mean - Rgb::ONE).abs().max_element() + half_width <= 2e-3, "mean {mean}, half width {half_width}");
}

/// A5: albedo 1 in a closed room that emits has no finite solution, and says so.
#[test]
fn a5_closed_room_of_albedo_one_is_refused() {
    let error = Prepared::new(furnace(1.0), furnace_setup()).solve().err();
    assert!(matches!(error, Some(Error::NoFiniteSolution { region: 0 })), "{error:?}");
}

/// A7: albedo 1 in the open is legal and converges at once.
#[test]
fn a7_albedo_one_in_the_open_is_legal() {
    let sky = Rgb::splat(1.0);
    let prepared = Prepared::new(scenes::build(scenes::plane_under_sky(1.0, Rgb::ONE, sky)), Setup::default());
    let solved = prepared.solve().unwrap();
    assert_eq!(solved.report.bounces.len(), 1);
    for e in solved.finest() {
        assert!((e / std::f32::consts::PI - Rgb::ONE).abs().max_element() < 2e-3, "{e}");
    }
}

/// A10: in a sphere H = <M>/(1-<ρ>) everywhere, whatever M and ρ are.
#[test]
fn a10_sphere_with_arbitrary_emission_and_albedo() {
    let bands = 8;
    let materials: Vec<Material> = (0..bands)
        .map(|i| {
            let t = i as f32 / bands as f32;
            let albedo = Rgb::new(0.2 + 0.6 * t, 0.8 - 0.5 * t, 0.5);
            let exitance = if i == 2 { Rgb::new(4.0, 1.0, 2.0) } else { Rgb::new(0.3 * t, 0.2, 0.4 * (1.0 - t)) };
            Material::emitter(format!("band {i}"), albedo, exitance)
        })
        .collect();
    let choose = |p: DVec3| (((p.y + 1.0) * 0.5 * bands as f64) as usize).min(bands - 1);
    let scene = scenes::build(scenes::sphere(1.0, 20_480, &materials, choose));
    let (mut area, mut exitance, mut albedo) = (0.0, DVec3::ZERO, DVec3::ZERO);
    for t in 0..scene.mesh().n_triangles() as u32 {
        let id = hplt::geom::TriangleId(t);
        let a = scene.mesh().area(id);
        area += a;
        exitance += scene.material(id).exitance.as_dvec3() * a;
        albedo += scene.material(id).albedo.as_dvec3() * a;
    }
    let expected = (exitance / area) / (DVec3::ONE - albedo / area);
    let mut setup = furnace_setup();
    setup.n_levels = 3;
    setup.direct.sky_samples = 4096;
    setup.transport = TransportOptions { n_rays: 1024, tolerance: 1e-4, ..TransportOptions::production() };
    let prepared = Prepared::new(scene, setup);
    let solved = prepared.solve().unwrap();
    assert_eq!(solved.report.n_escaped(), 0);
    // Equivalence on 64 patches within 1 %, of the whole within 0.5 %.
    let points = prepared.basis.points(2);
    let values = solved.finest();
    let mut patches = vec![Vec::new(); 64];
    for (p, e) in points.iter().zip(&values) {
        let d = p.position.normalize();
        let column = ((d.z.atan2(d.x) / std::f32::consts::TAU + 0.5) * 8.0) as usize % 8;
        let row = ((d.y * 0.5 + 0.5) * 8.0) as usize;
        patches[row.min(7) * 8 + column].push((e.as_dvec3() / expected).to_array());
    }
    for patch in patches.iter().filter(|p| p.len() >= 4) {
        for c in 0..3 {
            let n = patch.len() as f64;
            let mean = patch.iter().map(|v| v[c]).sum::<f64>() / n;
            let variance = patch.iter().map(|v| (v[c] - mean).powi(2)).sum::<f64>() / (n - 1.0);
            let half_width = 4.0 * (variance / n).sqrt();
            assert!((mean - 1.0).abs() + half_width <= 0.01, "mean {mean}, half width {half_width}");
        }
    }
    let mean = values.iter().map(|e| e.as_dvec3()).sum::<DVec3>() / values.len() as f64 / expected;
    assert!((mean - DVec3::ONE).abs().max_element() <= 0.005, "{mean}");
}

/// The progress callback is asked and obeyed: an interrupted transport keeps what it has and says so.
#[test]
fn interruption_keeps_finished_bounces() {
    struct StopAfter(std::sync::atomic::AtomicU64);
    impl hplt::geom::Progress for StopAfter {
        fn advance(&self, stage: &'static str, done: u64, _total: u64) {
            if stage == "bounce" && done == 0 {
                self.0.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            }
        }
        fn is_cancelled(&self) -> bool {
            // Two levels a bounce: in the middle of the fourth bounce.
            self.0.load(std::sync::atomic::Ordering::Relaxed) > 7
        }
    }
    let prepared = Prepared::new(furnace(0.9), furnace_setup());
    let direct = prepared.project();
    let options = &prepared.setup.transport;
    let run = |progress: &dyn hplt::geom::Progress| {
        hplt::transport::transport_absolute(
            &prepared.model(),
            &direct,
            &hplt::basis::ApproximateNearest,
            &options.threshold,
            options,
            progress,
        )
        .unwrap()
    };
    let partial = run(&StopAfter(0.into()));
    assert_eq!(partial.report.stop, StopReason::Interrupted);
    let n = partial.report.bounces.len();
    assert!((1..10).contains(&n), "{n}");
    // The finished bounces are those of an undisturbed run, bit for bit.
    let mut shorter = options.clone();
    shorter.max_bounces = n;
    shorter.tolerance = 0.0;
    let full = hplt::transport::transport_absolute(
        &prepared.model(),
        &direct,
        &hplt::basis::ApproximateNearest,
        &shorter.threshold,
        &shorter,
        &NoProgress,
    )
    .unwrap();
    assert_eq!(partial.indirect, full.indirect);
}
