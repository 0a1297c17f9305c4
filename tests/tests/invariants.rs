//! Invariants: bits, scaling, row sums, coverage, agreement of the variants.

use hplt::basis::{
    Absolute, ApproximateNearest, Coefficients, Delta, ExactShepard, Reconstruction, absolute_from_delta,
    delta_from_absolute,
};
use hplt::geom::glam::DVec3;
use hplt::geom::{BuildPolicy, Material, MeshInput, NoProgress, Rgb, Scene, SceneBuilder};
use hplt::reference::scenes::{self, Shape};
use hplt::transport::{StopReason, Threshold, TransportOptions, transport_absolute, transport_delta};
use hplt_tests::{Prepared, Setup};

fn cornell() -> Scene {
    scenes::build(scenes::cornell_box())
}

fn quick() -> Setup {
    Setup {
        n_levels: 4,
        transport: TransportOptions { n_rays: 128, ..TransportOptions::production() },
        ..Setup::default()
    }
}

/// All bits of a solution.
fn bits(solved: &hplt_tests::Solved) -> Vec<u32> {
    let fields = [&solved.direct, &solved.indirect];
    fields
        .iter()
        .flat_map(|f| (0..f.n_levels()).flat_map(|l| f.level(l).iter().flat_map(|c| c.to_array())))
        .map(f32::to_bits)
        .collect()
}

/// B6: the same bits with 1, 2, 3 and 8 threads, hierarchy and all.
#[test]
fn b6_any_thread_count_gives_the_same_bits() {
    let solve = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let prepared = Prepared::new(cornell(), Setup { n_levels: 3, ..quick() });
            let solved = prepared.solve().unwrap();
            (prepared.basis.hierarchy().clone(), bits(&solved), bits(&prepared.solve_delta().unwrap()))
        })
    };
    let one = solve(1);
    for threads in [2, 3, 8] {
        assert!(solve(threads) == one, "{threads} threads");
    }
}

/// Negative control of B6: another seed gives other bits.
#[test]
fn another_seed_gives_other_bits() {
    let mut setup = Setup { n_levels: 2, ..quick() };
    let a = bits(&Prepared::new(cornell(), setup.clone()).solve().unwrap());
    setup.transport.seed = 1;
    let b = bits(&Prepared::new(cornell(), setup).solve().unwrap());
    assert!(a.len() == b.len() && a != b);
}

/// A room with a lamp, all coordinates times `scale`, all exitances times `power`.
fn scaled_room(scale: f64, power: f32) -> Scene {
    let mut builder = SceneBuilder::new();
    let white = builder.push_material(Material::diffuse("white", Rgb::new(0.7, 0.6, 0.5)));
    let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::new(3.0, 5.0, 7.0) * power));
    let mut push = |shape: &mut Shape, material| {
        let scaled = shape.mapped(|p| p * scale);
        let mesh = MeshInput {
            name: "scaled",
            positions: &scaled.positions,
            normals: &[],
            uvs: &[],
            triangles: &scaled.triangles,
            material,
        };
        builder.push_mesh(mesh).unwrap();
    };
    push(Shape::new().room(DVec3::new(0.1, -0.3, 0.7), DVec3::new(1.4, 0.8, 1.9)), white);
    push(Shape::new().cuboid(DVec3::new(0.5, -0.3, 1.0), DVec3::new(0.9, 0.1, 1.3)), white);
    let at = |x: f64, z: f64| DVec3::new(x, 0.75, z);
    push(Shape::new().quad([at(0.5, 1.0), at(0.9, 1.0), at(0.9, 1.4), at(0.5, 1.4)]), lamp);
    builder.build(BuildPolicy::default()).unwrap().0
}

/// B1, B2: coordinates or emission times a power of two leave every bit alone, or only the exponents.
#[test]
fn b1_b2_powers_of_two_move_only_exponents() {
    let setup = Setup { n_levels: 3, ..quick() };
    let plain = Prepared::new(scaled_room(1.0, 1.0), setup.clone()).solve().unwrap();
    assert!(plain.finest().iter().any(|e| e.max_element() > 0.0));
    for k in [-20, 20] {
        let scaled = Prepared::new(scaled_room(2f64.powi(k), 1.0), setup.clone()).solve().unwrap();
        assert!(bits(&scaled) == bits(&plain), "coordinates times 2^{k}");
        let power = 2f32.powi(k);
        let brighter = Prepared::new(scaled_room(1.0, power), setup.clone()).solve().unwrap();
        let expected: Vec<Rgb> = plain.finest().iter().map(|e| *e * power).collect();
        assert!(brighter.finest() == expected, "emission times 2^{k}");
    }
    // Negative control: a scale that is no power of two changes bits.
    let off = Prepared::new(scaled_room(1.1, 1.0), setup).solve().unwrap();
    assert!(bits(&off) != bits(&plain));
}

/// B10: row sums never exceed the largest albedo, and no ray is lost: in a closed room of one albedo they equal it.
#[test]
fn b10_row_sums_are_the_albedo() {
    for albedo in [0.3f32, 0.9] {
        let scene = scenes::build(scenes::furnace_box(Rgb::splat(albedo), Rgb::ONE));
        let solved = Prepared::new(scene, Setup { n_levels: 2, ..quick() }).solve().unwrap();
        let sum = solved.report.max_row_sum;
        assert!((sum / albedo - 1.0).abs() <= 4.0 * f32::EPSILON, "{sum} {albedo}");
    }
    let open = Prepared::new(cornell(), Setup { n_levels: 2, ..quick() }).solve().unwrap();
    assert!(open.report.max_row_sum <= 0.78 && open.report.max_row_sum > 0.5);
    assert!(open.report.n_escaped() > 0);
}

/// B13: with light that is nowhere negative, more bounces never darken.
#[test]
fn b13_more_bounces_never_darken() {
    let mut last: Option<Vec<Rgb>> = None;
    for bounces in 1..5 {
        let mut setup = Setup { n_levels: 3, ..quick() };
        setup.transport = TransportOptions { max_bounces: bounces, tolerance: 0.0, ..setup.transport };
        let finest = Prepared::new(cornell(), setup).solve().unwrap().finest();
        if let Some(last) = last {
            assert!(last.iter().zip(&finest).all(|(a, b)| a.cmple(*b).all()));
        }
        last = Some(finest);
    }
}

/// B15: in Cornell every hit of every gather ray is covered by the level that was asked for, but for a few.
#[test]
fn b15_hits_are_covered() {
    let prepared = Prepared::new(cornell(), quick());
    let coverage = prepared.solve_delta().unwrap().report.coverage();
    assert!(coverage.queries > 100_000);
    assert_eq!(coverage.uncovered, 0);
    assert!(coverage.nearest + coverage.coarser < coverage.queries / 500, "{coverage:?}");
}

/// V1 and V3 solve the same equation: fully refined, with the same rays, they differ by their reconstructions alone.
#[test]
fn delta_and_absolute_variants_agree() {
    let mut setup = quick();
    setup.n_levels = 3;
    setup.transport.threshold = Threshold { absolute: 0.0, relative: 0.0, noise: 0.0 };
    let prepared = Prepared::new(cornell(), setup);
    let absolute = prepared.solve().unwrap().finest();
    let delta = prepared.solve_delta().unwrap().finest();
    let mean = absolute.iter().sum::<Rgb>() / absolute.len() as f32;
    let difference = absolute.iter().zip(&delta).map(|(a, b)| (*a - *b).abs()).sum::<Rgb>() / absolute.len() as f32;
    let relative = (difference / mean).max_element();
    println!("mean difference of V1 and V3: {relative}");
    assert!(relative < 0.02, "{relative}");
}

/// Both variants run with both reconstructions, and what they find is near each other.
#[test]
fn both_variants_run_with_both_reconstructions() {
    let mut setup = Setup { n_levels: 3, ..quick() };
    setup.transport = TransportOptions { n_rays: 64, tolerance: 1e-2, ..setup.transport };
    let prepared = Prepared::new(cornell(), setup);
    let options = &prepared.setup.transport;
    let direct = prepared.project();
    let delta = delta_from_absolute(&prepared.basis, &direct);
    let mean = |field: &Coefficients<Absolute>| {
        let finest = field.level(2);
        finest.iter().sum::<Rgb>() / finest.len() as f32
    };
    let (model, oracle) = (prepared.model(), &options.threshold);
    // Differences of nearest values may add up to more than one, so that this combination need not converge: three bounces, as published.
    let published = TransportOptions { max_bounces: 3, tolerance: 0.0, ..options.clone() };
    let absolute = |r: &dyn Reconstruction<Absolute>, options: &TransportOptions| {
        mean(&transport_absolute(&model, &direct, r, oracle, options, &NoProgress).unwrap().indirect)
    };
    let delta = |r: &dyn Reconstruction<Delta>, options: &TransportOptions, stop: StopReason| {
        let solution = transport_delta(&model, &delta, r, oracle, options, &NoProgress).unwrap();
        assert_eq!(solution.report.stop, stop);
        mean(&absolute_from_delta(&prepared.basis, &solution.indirect))
    };
    let [exact, after_three] = [options, &published].map(|options| absolute(&ExactShepard, options));
    for (other, exact) in [
        (absolute(&ApproximateNearest, options), exact),
        (delta(&ExactShepard, options, StopReason::Converged), exact),
        (delta(&ApproximateNearest, &published, StopReason::MaxBounces), after_three),
    ] {
        let difference = ((other - exact) / exact).abs().max_element();
        println!("{difference}");
        assert!(difference < 0.1, "{other} {exact}");
    }
}
