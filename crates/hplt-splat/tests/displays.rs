//! How closely the three displays agree.

mod common;

use common::{
    absolute, adaptive_delta, hierarchy, max_difference, max_value, rms_difference, room, room_basis, room_gbuffer,
    smooth, spotted,
};
use hplt_basis::{
    Absolute, ApproximateNearest, BasisOptions, Coefficients, Coverage, Delta, ExactShepard, ShepardBasis,
};
use hplt_geom::{NoProgress, OrientedPoint, RegionId, Rgb};
use hplt_splat::{
    Flattened, GBuffer, Splatted, evaluate, flatten_absolute, flatten_delta, splat_absolute, splat_delta,
    splat_flattened,
};

/// Rounding of sums of some tens of positive terms in another order, relative to the largest value.
const ROUNDING: f32 = 1e-5;

fn evaluated<E: Sync>(basis: &ShepardBasis, field: &Coefficients<E>, gbuffer: &GBuffer) -> (Vec<Rgb>, Coverage)
where
    ExactShepard: hplt_basis::Reconstruction<E>,
{
    evaluate(basis, field, &ExactShepard, gbuffer, &NoProgress).unwrap()
}

fn splatted_delta(basis: &ShepardBasis, field: &Coefficients<Delta>, gbuffer: &GBuffer) -> Splatted {
    splat_delta(basis, field, gbuffer, &NoProgress).unwrap()
}

fn splatted_flat(basis: &ShepardBasis, field: &Flattened, gbuffer: &GBuffer) -> Splatted {
    splat_flattened(basis, field, gbuffer, &NoProgress).unwrap()
}

/// Whether two displays agree up to rounding.
fn same(a: &[Rgb], b: &[Rgb]) -> bool {
    max_difference(a, b) <= ROUNDING * max_value(a)
}

#[test]
fn splatting_equals_evaluation_up_to_rounding_in_delta_encoding() {
    let (basis, gbuffer) = (room_basis(4, 4), room_gbuffer(120, 90));
    let field = adaptive_delta(&basis, spotted, 0.02);
    let (a, coverage) = evaluated(&basis, &field, &gbuffer);
    let b = splatted_delta(&basis, &field, &gbuffer);
    assert!(same(&a, &b.irradiance), "{}", max_difference(&a, &b.irradiance));
    assert_eq!(coverage, b.report.coverage);
    assert!(max_value(&a) > 2.0);
    // A tenth of a per cent in a single coefficient of the coarsest level is seen.
    let mut wrong = field.clone();
    let function = basis.nearest(0, &gbuffer.query(60 * 120 + 20)).unwrap() as usize;
    wrong.level_mut(0)[function] *= 1.001;
    assert!(!same(&a, &splatted_delta(&basis, &wrong, &gbuffer).irradiance));
}

#[test]
fn splatting_equals_evaluation_up_to_rounding_in_absolute_encoding() {
    let (basis, gbuffer) = (room_basis(4, 4), room_gbuffer(120, 90));
    let field = absolute(&basis, spotted);
    let (a, coverage) = evaluated(&basis, &field, &gbuffer);
    let b = splat_absolute(&basis, &field, &gbuffer, &NoProgress).unwrap();
    assert!(same(&a, &b.irradiance), "{}", max_difference(&a, &b.irradiance));
    assert_eq!(coverage, b.report.coverage);
    let mut wrong = field.clone();
    let function = basis.nearest(3, &gbuffer.query(60 * 120 + 20)).unwrap() as usize;
    wrong.level_mut(3)[function] *= 1.001;
    let wrong = splat_absolute(&basis, &wrong, &gbuffer, &NoProgress).unwrap();
    assert!(!same(&a, &wrong.irradiance));
}

/// A room whose fine levels lack a patch each, whose left half lacks all of them, and whose block has no function at all.
fn with_holes() -> ShepardBasis {
    let mut points = hierarchy(&room(), 4, 3);
    for (l, level) in points.levels.iter_mut().enumerate() {
        let block = |p: &OrientedPoint| {
            let x = p.position;
            (-0.01..0.31).contains(&x.x) && x.y < -0.09 && (-0.21..0.11).contains(&x.z) && x.y > -0.499
        };
        level.points.retain(|p| !block(p) && (l == 0 || p.position.y < 0.3) && (l == 1 || p.position.x > -0.3));
    }
    ShepardBasis::build(points, BasisOptions::default())
}

#[test]
fn samples_that_nothing_covers_are_answered_alike_and_counted() {
    let (basis, gbuffer) = (with_holes(), room_gbuffer(120, 90));
    let field = absolute(&basis, smooth);
    let (a, coverage) = evaluated(&basis, &field, &gbuffer);
    let b = splat_absolute(&basis, &field, &gbuffer, &NoProgress).unwrap();
    assert!(same(&a, &b.irradiance) && coverage == b.report.coverage, "{coverage:?} {:?}", b.report.coverage);
    assert!(coverage.coarser > 100 && coverage.nearest > 0, "{coverage:?}");

    let field = hplt_basis::delta_from_absolute(&basis, &field);
    let (a, coverage) = evaluated(&basis, &field, &gbuffer);
    let b = splatted_delta(&basis, &field, &gbuffer);
    assert!(same(&a, &b.irradiance) && coverage == b.report.coverage, "{coverage:?} {:?}", b.report.coverage);
    assert!(coverage.coarser > 100 && coverage.nearest > 0, "{coverage:?}");
}

#[test]
fn other_regions_are_dark_in_every_display() {
    let basis = room_basis(4, 3);
    let mut gbuffer = room_gbuffer(60, 45);
    let region = |x: f32| RegionId(u32::from(x > 0.0));
    gbuffer.set_regions(gbuffer.surface_points().iter().map(|(p, _)| region(p.x)).collect());
    let field = adaptive_delta(&basis, smooth, 0.02);
    let a = evaluated(&basis, &field, &gbuffer).0;
    let b = splatted_delta(&basis, &field, &gbuffer).irradiance;
    let c = splatted_flat(&basis, &flatten_delta(&basis, &field, 0.0), &gbuffer).irradiance;
    for (i, query) in gbuffer.queries().iter().enumerate() {
        for display in [&a, &b, &c] {
            assert_eq!(display[i] == Rgb::ZERO, query.region != RegionId(0), "sample {i}");
        }
    }
}

#[test]
fn a_camera_among_the_functions_sees_the_same_in_both_displays() {
    use glam::DVec3;
    let basis = room_basis(4, 4);
    let field = adaptive_delta(&basis, spotted, 0.02);
    let scene = common::scene_of(&room());
    // Millimetres off the floor, in the middle of supports of every level, looking along it.
    let eye = DVec3::new(-0.2, -0.497, 0.2);
    let camera = hplt_geom::Camera::look_at(eye, DVec3::new(-0.1, -0.45, -0.5), DVec3::Y, 1.9).unwrap();
    let options = hplt_splat::GBufferOptions::preview(97, 61);
    let gbuffer = common::gbuffer_of(&scene, &camera, options);
    let a = evaluated(&basis, &field, &gbuffer).0;
    assert!(same(&a, &splatted_delta(&basis, &field, &gbuffer).irradiance));
}

#[test]
fn leaf_weights_are_a_partition_of_unity_across_the_cut() {
    let (basis, gbuffer) = (room_basis(4, 4), room_gbuffer(120, 90));
    let field = adaptive_delta(&basis, spotted, 0.05);
    // A constant on top of the base level changes no detail, so the cut is the same.
    let mut raised = field.clone();
    raised.level_mut(0).iter_mut().for_each(|c| *c += 1.0);
    let (low, high) = (flatten_delta(&basis, &field, 0.0), flatten_delta(&basis, &raised, 0.0));
    assert_eq!(low.report(), high.report());
    let leaves = &low.report().leaves;
    assert!(leaves.iter().filter(|&&n| n > 0).count() >= 3, "a cut across levels: {leaves:?}");
    let (a, b) = (splatted_flat(&basis, &low, &gbuffer), splatted_flat(&basis, &high, &gbuffer));
    for i in (0..gbuffer.n_samples()).filter(|&i| !gbuffer.is_background(i)) {
        let weight = b.irradiance[i] - a.irradiance[i];
        assert!((weight - 1.0).abs().max_element() < 1e-5, "sample {i}: {weight}");
    }
    assert_eq!(a.report.coverage.coarser + a.report.coverage.nearest, 0);
}

#[test]
fn flattening_a_field_without_detail_changes_nothing_and_draws_the_base_level_only() {
    let (basis, gbuffer) = (room_basis(4, 4), room_gbuffer(120, 90));
    let mut field = Coefficients::<Delta>::zeros(&basis);
    *field.level_mut(0) = basis.points(0).iter().map(smooth).collect();
    let flat = flatten_delta(&basis, &field, 0.0);
    assert_eq!(flat.report().n_drawn(), basis.n_functions(0) as u64);
    let (a, c) = (evaluated(&basis, &field, &gbuffer).0, splatted_flat(&basis, &flat, &gbuffer));
    assert!(same(&a, &c.irradiance));
}

#[test]
fn a_flattened_delta_field_comes_closer_as_the_threshold_shrinks_with_less_overdraw() {
    let (basis, gbuffer) = (room_basis(4, 5), room_gbuffer(120, 90));
    let field = adaptive_delta(&basis, spotted, 0.02);
    let a = evaluated(&basis, &field, &gbuffer).0;
    let b = splatted_delta(&basis, &field, &gbuffer);
    // Values are 0.4 to 4. Measured: RMS 0.0108, 0.0062, 0.0027, 0.0014; maxima 0.14, 0.050, 0.031, 0.031, at the spot.
    let cases = [(0.5, 0.015, 0.2), (0.1, 0.009, 0.07), (0.03, 0.004, 0.045), (0.0, 0.002, 0.045)];
    let mut errors = Vec::new();
    for (threshold, rms_limit, max_limit) in cases {
        let c = splatted_flat(&basis, &flatten_delta(&basis, &field, threshold), &gbuffer);
        let (rms, max) = (rms_difference(&gbuffer, &a, &c.irradiance), max_difference(&a, &c.irradiance));
        assert!(rms < rms_limit && max < max_limit, "threshold {threshold}: {rms} {max}");
        // Measured: 18 to 23 blends per sample instead of 53.
        assert!(c.report.overdraw() < 0.5 * b.report.overdraw(), "{:?}", c.report);
        assert!(c.report.weights_per_sample() < 0.6 * b.report.weights_per_sample(), "{:?}", c.report);
        errors.push(rms);
    }
    assert!(errors.is_sorted_by(|a, b| a > b), "{errors:?}");
    // The comparison tells thresholds apart: the coarsest cut would not pass for the finest.
    assert!(errors[0] > cases[3].1);
}

#[test]
fn a_flattened_absolute_field_comes_closer_as_the_threshold_shrinks() {
    let (basis, gbuffer) = (room_basis(4, 5), room_gbuffer(120, 90));
    let field: Coefficients<Absolute> = absolute(&basis, spotted);
    let a = evaluated(&basis, &field, &gbuffer).0;
    // Measured: RMS 0.0190, 0.0115, 0.0039.
    let mut errors = Vec::new();
    for (threshold, limit) in [(0.5, 0.025), (0.1, 0.015), (0.03, 0.006)] {
        let c = splatted_flat(&basis, &flatten_absolute(&basis, &field, threshold), &gbuffer);
        let rms = rms_difference(&gbuffer, &a, &c.irradiance);
        assert!(rms < limit, "threshold {threshold}: {rms}");
        errors.push(rms);
    }
    assert!(errors.is_sorted_by(|a, b| a > b), "{errors:?}");
    // With detail everywhere the cut is the finest level.
    let c = splatted_flat(&basis, &flatten_absolute(&basis, &field, 0.0), &gbuffer);
    assert!(same(&a, &c.irradiance));
}

#[test]
fn absolute_functions_below_push_down_are_not_drawn() {
    let (basis, gbuffer) = (room_basis(4, 4), room_gbuffer(120, 90));
    let mut field = Coefficients::<Absolute>::zeros(&basis);
    *field.level_mut(0) = basis.points(0).iter().map(smooth).collect();
    for level in 1..4 {
        *field.level_mut(level) = basis.parents(level).push_down(field.level(level - 1));
    }
    let flat = flatten_absolute(&basis, &field, 0.0);
    assert_eq!(flat.report().leaves, [basis.n_functions(0) as u64, 0, 0, 0]);
    // Level 0 alone, exactly: no push-down has smoothed it.
    let mut base = Coefficients::<Delta>::zeros(&basis);
    *base.level_mut(0) = field.level(0).to_vec();
    let a = evaluated(&basis, &base, &gbuffer).0;
    assert!(same(&a, &splatted_flat(&basis, &flat, &gbuffer).irradiance));
}

#[test]
fn splatting_a_flattened_field_equals_evaluating_it_point_by_point() {
    let gbuffer = room_gbuffer(120, 90);
    for basis in [room_basis(4, 4), with_holes()] {
        let field = adaptive_delta(&basis, spotted, 0.02);
        let mut flat = flatten_delta(&basis, &field, 0.05);
        let a = flat.evaluate(&basis, &gbuffer.queries());
        assert!(same(&a, &splatted_flat(&basis, &flat, &gbuffer).irradiance));
        // The comparison sees a slightly different cut.
        flat = flatten_delta(&basis, &field, 0.1);
        assert!(!same(&a, &splatted_flat(&basis, &flat, &gbuffer).irradiance));
    }
}

/// The nearest function of a level is off by at most the distances to it and to the functions that Shepard averages, times
/// the gradient of the field: absolute fields on the scale of the finest level, delta fields on that of the coarsest, because
/// their base level carries most of the value.
#[test]
fn approximate_nearest_differs_from_shepard_by_the_scale_of_the_level_it_reads() {
    let (basis, gbuffer) = (room_basis(4, 4), room_gbuffer(120, 90));
    let nearest_rms_and_max = |a: &[Rgb], n: &[Rgb]| (rms_difference(&gbuffer, a, n), max_difference(a, n));
    // The largest gradient of `smooth` in any channel: (2 z, x/2, y/2) at z = 0.5.
    const GRADIENT: f32 = 1.1;
    let field = absolute(&basis, smooth);
    let a = evaluated(&basis, &field, &gbuffer).0;
    let n = evaluate(&basis, &field, &ApproximateNearest, &gbuffer, &NoProgress).unwrap().0;
    let (rms, max) = nearest_rms_and_max(&a, &n);
    // Measured: RMS 0.0053, largest 0.032, at b = 0.0625.
    assert!(max < 2.0 * GRADIENT * basis.support(3), "{max}");
    assert!(rms < f64::from(0.2 * GRADIENT * basis.support(3)), "{rms}");
    assert!(!same(&a, &n));

    let field = hplt_basis::delta_from_absolute(&basis, &field);
    let a = evaluated(&basis, &field, &gbuffer).0;
    let n = evaluate(&basis, &field, &ApproximateNearest, &gbuffer, &NoProgress).unwrap().0;
    let (delta_rms, delta_max) = nearest_rms_and_max(&a, &n);
    // Measured: RMS 0.042, largest 0.15, at b = 0.5.
    assert!(delta_max < GRADIENT * basis.support(0), "{delta_max}");
    assert!(delta_rms < f64::from(0.2 * GRADIENT * basis.support(0)), "{delta_rms}");
    assert!(delta_rms > rms, "details do not repair a base level that is read without blending");
}

#[cfg(feature = "rayon")]
#[test]
fn thread_counts_do_not_change_a_bit() {
    let run = |n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| {
            let (basis, gbuffer) = (room_basis(4, 3), room_gbuffer(50, 40));
            let field = adaptive_delta(&basis, spotted, 0.02);
            let a = evaluated(&basis, &field, &gbuffer);
            let b = splatted_delta(&basis, &field, &gbuffer);
            let flat = flatten_delta(&basis, &field, 0.05);
            let c = splatted_flat(&basis, &flat, &gbuffer);
            (gbuffer, a, b, flat, c)
        })
    };
    let one = run(1);
    assert!(max_value(&one.2.irradiance) > 1.0);
    for n_threads in [2, 3, 7] {
        let other = run(n_threads);
        assert!(other == one, "{n_threads} threads");
    }
}
