//! What every Shepard basis must do, on jittered grids over a plane.

mod common;

use common::{Noise, plane, point};
use glam::Vec3;
use hplt_basis::{
    Absolute, ApproximateNearest, BasisOptions, Coefficients, Coverage, Delta, ExactShepard, LayeredScratch,
    Reconstruction, ShepardBasis, absolute_from_delta, delta_from_absolute, restrict,
};
use hplt_geom::{OrientedPoint, RegionId, Rgb};

fn queries(n: usize) -> Vec<OrientedPoint> {
    let mut noise = Noise::new(99);
    (0..n).map(|_| point(noise.next(), noise.next(), Vec3::Y, 0, 0.0)).collect()
}

fn smooth(p: Vec3) -> Rgb {
    Rgb::new(1.0 + 0.5 * p.x, 2.0 + p.z * p.z, 1.0 + p.x * p.z)
}

fn sampled(basis: &ShepardBasis) -> Coefficients<Absolute> {
    let values = |l| basis.points(l).iter().map(|p| smooth(p.position)).collect();
    Coefficients::from_levels((0..basis.n_levels()).map(values).collect())
}

#[test]
fn weights_are_a_partition_of_unity_on_every_level() {
    let basis = ShepardBasis::build(plane(6, 3, Vec3::Y, 0), BasisOptions::default());
    let mut weights = Vec::new();
    for query in queries(500) {
        for level in 0..3 {
            assert!(basis.raw_weights(level, &query, &mut weights) > 0.125);
            assert!(basis.weights(level, &query, &mut weights));
            let sum: f32 = weights.iter().map(|w| w.weight).sum();
            assert!((sum - 1.0).abs() <= 4.0 * f32::EPSILON * weights.len() as f32, "{sum}");
            assert!(weights.iter().all(|w| w.weight > 0.0));
        }
    }
}

#[test]
fn constants_are_reproduced_in_both_encodings_by_both_reconstructions() {
    let basis = ShepardBasis::build(plane(5, 4, Vec3::Y, 0), BasisOptions::default());
    let constant = Rgb::new(3.0, 0.5, 7.0);
    let absolute = restrict(&basis, vec![constant; basis.n_functions(3)]);
    let delta = delta_from_absolute(&basis, &absolute);
    let queries = queries(300);
    let check = |name: &str, out: &[Rgb]| {
        for value in out {
            assert!((*value - constant).abs().max_element() < 2e-5, "{name}: {value}");
        }
    };
    let mut out = vec![Rgb::ZERO; queries.len()];
    for n_levels in 1..=4 {
        ExactShepard.reconstruct(&basis, &absolute, n_levels, &queries, &mut out);
        check("shepard, absolute", &out);
        ApproximateNearest.reconstruct(&basis, &absolute, n_levels, &queries, &mut out);
        check("nearest, absolute", &out);
        ExactShepard.reconstruct(&basis, &delta, n_levels, &queries, &mut out);
        check("shepard, delta", &out);
        ApproximateNearest.reconstruct(&basis, &delta, n_levels, &queries, &mut out);
        check("nearest, delta", &out);
    }
}

#[test]
fn delta_and_absolute_encodings_hold_the_same_values() {
    let basis = ShepardBasis::build(plane(5, 4, Vec3::Y, 0), BasisOptions::default());
    let absolute = sampled(&basis);
    let delta: Coefficients<Delta> = delta_from_absolute(&basis, &absolute);
    let back = absolute_from_delta(&basis, &delta);
    for level in 0..4 {
        for (a, b) in absolute.level(level).iter().zip(back.level(level)) {
            assert!((*a - *b).abs().max_element() < 1e-5, "{a} {b}");
        }
    }
    // Details shrink from level to level: the point of the encoding.
    let largest = |l: usize| delta.level(l).iter().map(|c| c.abs().max_element()).fold(0.0, f32::max);
    assert!(largest(3) < 0.5 * largest(1) && largest(1) < largest(0), "{} {} {}", largest(0), largest(1), largest(3));
    // The delta field read on all levels is closer to the function than the absolute field of the finest level is:
    // each level corrects at its own points. Negative control: dropping the finest details is visibly worse.
    let queries = queries(400);
    let error = |out: &[Rgb]| {
        queries.iter().zip(out).map(|(q, v)| (*v - smooth(q.position)).abs().max_element()).sum::<f32>() / 400.0
    };
    let mut out = vec![Rgb::ZERO; queries.len()];
    ExactShepard.reconstruct(&basis, &delta, 4, &queries, &mut out);
    let all = error(&out);
    ExactShepard.reconstruct(&basis, &delta, 2, &queries, &mut out);
    let coarse = error(&out);
    assert!(all < 5e-3 && coarse > 2.0 * all, "{all} {coarse}");
}

#[test]
fn restriction_keeps_the_power_of_a_patch_smaller_than_a_coarse_function() {
    let basis = ShepardBasis::build(plane(4, 4, Vec3::Y, 0), BasisOptions::default());
    let mut finest = vec![Rgb::ZERO; basis.n_functions(3)];
    let hot = finest.len() / 2 + 16;
    finest[hot] = Rgb::ONE;
    let field = restrict(&basis, finest);
    let fine_power = basis.points(3)[hot].area;
    let coarse_power: f32 = basis.points(0).iter().zip(field.level(0)).map(|(p, c)| p.area * c.x).sum();
    // Coarse areas are those of the grid, not of the restriction: the powers agree to the irregularity of the grid.
    assert!((coarse_power / fine_power - 1.0).abs() < 0.5, "{coarse_power} {fine_power}");
    // Point sampling, the rejected alternative, would have lost it on every coarse level.
    let nearest = basis.points(0).iter().map(|p| (p.position - basis.points(3)[hot].position).length());
    assert!(nearest.fold(f32::INFINITY, f32::min) > 0.0);
}

#[test]
fn weights_do_not_cross_regions_or_sides() {
    let lit = plane(6, 2, Vec3::Y, 0);
    let mut both = lit.clone();
    for (level, other) in both.levels.iter_mut().zip(plane(6, 2, Vec3::Y, 1).levels) {
        level.points.extend(other.points);
    }
    both.n_regions = 2;
    let n: Vec<usize> = lit.levels.iter().map(|l| l.points.len()).collect();
    let basis = ShepardBasis::build(both, BasisOptions::default());
    // Region 0 shines, region 1 is dark.
    let levels = (0..2).map(|l| {
        let dark = basis.n_functions(l) - n[l];
        [vec![Rgb::ONE; n[l]], vec![Rgb::ZERO; dark]].concat()
    });
    let field = Coefficients::<Absolute>::from_levels(levels.collect());
    let mut queries = queries(200);
    let mut out = vec![Rgb::ZERO; queries.len()];
    let reconstructions: [&dyn Reconstruction<Absolute>; 2] = [&ExactShepard, &ApproximateNearest];
    for reconstruction in reconstructions {
        queries.iter_mut().for_each(|q| q.region = RegionId(1));
        reconstruction.reconstruct(&basis, &field, 2, &queries, &mut out);
        assert!(out.iter().all(|v| *v == Rgb::ZERO));
        queries.iter_mut().for_each(|q| q.region = RegionId::DARK);
        let coverage = reconstruction.reconstruct(&basis, &field, 2, &queries, &mut out);
        assert!(out.iter().all(|v| *v == Rgb::ZERO) && coverage.uncovered == 0);
        queries.iter_mut().for_each(|q| (q.region, q.normal) = (RegionId(0), Vec3::NEG_Y));
        let coverage = reconstruction.reconstruct(&basis, &field, 2, &queries, &mut out);
        assert!(out.iter().all(|v| *v == Rgb::ZERO) && coverage.uncovered == 200);
        queries.iter_mut().for_each(|q| q.normal = Vec3::Y);
    }
}

#[test]
fn a_point_off_every_support_is_answered_by_the_nearest_function_and_counted() {
    let basis = ShepardBasis::build(plane(6, 2, Vec3::Y, 0), BasisOptions::default());
    let field = sampled(&basis);
    let far = [point(3.0, 0.5, Vec3::Y, 0, 0.0)];
    let mut out = [Rgb::ZERO];
    let coverage = ExactShepard.reconstruct(&basis, &field, 2, &far, &mut out);
    assert_eq!((coverage.nearest, coverage.uncovered), (1, 0));
    assert!((out[0] - smooth(Vec3::new(1.0, 0.0, 0.5))).abs().max_element() < 0.1, "{}", out[0]);
}

#[test]
fn push_down_reproduces_constants_and_children_mirror_parents() {
    let basis = ShepardBasis::build(plane(6, 2, Vec3::Y, 0), BasisOptions::default());
    let parents = basis.parents(1);
    let pushed = parents.push_down(&vec![Rgb::splat(2.0); basis.n_functions(0)]);
    assert!(pushed.iter().all(|v| (*v - Rgb::splat(2.0)).abs().max_element() < 1e-6));
    for child in 0..basis.n_functions(1) as u32 {
        for parent in parents.of(child) {
            assert!(parents.children(parent.function).contains(&child));
        }
    }
    let n_links: usize = (0..basis.n_functions(0) as u32).map(|p| parents.children(p).len()).sum();
    assert_eq!(n_links, (0..basis.n_functions(1) as u32).map(|c| parents.of(c).len()).sum::<usize>());
}

/// The weight is the kernel of the elliptical distance times the squared cosine between the normals, and the tree of a level holds its
/// points.
#[test]
fn weights_are_those_of_their_definition() {
    let basis = ShepardBasis::build(plane(6, 2, Vec3::Y, 0), BasisOptions::default());
    let (footprint, centre) = (basis.footprint(1), basis.points(1)[40]);
    let support = footprint.support();
    assert_eq!(support, basis.support(1));
    assert_eq!(basis.tree(1).points().len(), basis.n_functions(1));
    for tilt in [0.0f32, 0.5, 1.0] {
        let normal = Vec3::new(tilt.sin(), tilt.cos(), 0.0);
        let offset = Vec3::new(0.3, 0.1, -0.2) * support;
        let query = OrientedPoint::new(centre.position + offset, normal, RegionId(0));
        // The height counts three times.
        let h = Vec3::new(0.3, 0.3, -0.2).length();
        let expected = (1.0 - h * h * (3.0 - 2.0 * h)) * tilt.cos() * tilt.cos();
        let weight = footprint.weight(&centre, &query);
        assert!((weight - expected).abs() < 1e-5, "tilt {tilt}: {weight} for {expected}");
    }
}

/// Where every function faces away a little, the nearest still answers; from behind a sheet none does.
#[test]
fn the_last_resort_may_face_away_but_not_be_behind() {
    let basis = ShepardBasis::build(plane(6, 1, Vec3::Y, 0), BasisOptions::default());
    let field = sampled(&basis);
    for (cosine, is_answered) in [(-0.3f32, true), (-0.7, false)] {
        let normal = Vec3::new((1.0 - cosine * cosine).sqrt(), cosine, 0.0);
        let mut out = [Rgb::ZERO];
        let coverage = ExactShepard.reconstruct(&basis, &field, 1, &[point(0.5, 0.5, normal, 0, 0.0)], &mut out);
        assert_eq!((coverage.nearest == 1, out[0] != Rgb::ZERO), (is_answered, is_answered), "{cosine}");
    }
}

/// Finer functions on the left half alone: well inside it they answer, on the right the coarse ones do, and the weights are a
/// partition of unity everywhere.
#[test]
fn a_layered_expansion_goes_as_deep_as_there_are_functions() {
    let mut hierarchy = plane(6, 2, Vec3::Y, 0);
    hierarchy.levels[0].is_refined = hierarchy.levels[0].points.iter().map(|p| p.position.x < 0.6).collect();
    hierarchy.levels[1].points.retain(|p| p.position.x < 0.5);
    let basis = ShepardBasis::build(hierarchy, BasisOptions::default());
    let n_coarse = basis.n_functions(0) as u32;
    let mut scratch = LayeredScratch::default();
    let mut finer_share = |query: &OrientedPoint, n_levels: usize| {
        let mut expansion = Vec::new();
        let mut coverage = Coverage::default();
        basis.expand(n_levels, std::slice::from_ref(query), &mut scratch, |_, found, how| {
            (expansion, coverage) = (found.clone(), how);
        });
        assert_eq!((coverage.queries, coverage.nearest, coverage.uncovered), (1, 0, 0));
        let sum: f32 = expansion.iter().map(|w| w.weight).sum();
        assert!((sum - 1.0).abs() < 1e-5, "{sum}");
        expansion.iter().filter(|w| w.function >= n_coarse).map(|w| w.weight).sum::<f32>()
    };
    for query in queries(500) {
        let share = finer_share(&query, 2);
        let x = query.position.x;
        assert!(x > 0.3 || share > 0.999, "{share} at {x}");
        assert!(x < 0.7 || share == 0.0, "{share} at {x}");
        assert_eq!(finer_share(&query, 1), 0.0);
    }
}
