//! Every way to read a basis against its definition, which looks at all functions, one by one, in double precision.

mod common;

use common::{Noise, plane};
use glam::{DVec3, Vec3};
use hplt_basis::{
    Absolute, ApproximateNearest, BasisOptions, Coefficients, Coverage, Delta, ExactShepard, Layered, LayeredNearest,
    LayeredScratch, MIN_WEIGHT_SUM, Reconstruction, ShepardBasis, delta_from_absolute, restrict,
};
use hplt_geom::{Extent, N_SECTORS, OrientedPoint, PointHierarchy, PointLevel, RegionId, Rgb};

const N_LEVELS: usize = 3;
/// The region of some queries that no function is in.
const EMPTY: RegionId = RegionId(2);

/// Along an axis, or across them.
fn normal(noise: &mut Noise, may_be_across: bool) -> Vec3 {
    match noise.next() {
        x if x < 0.6 || !may_be_across => [Vec3::Y, Vec3::NEG_X][usize::from(x > 0.4)],
        _ => (Vec3::new(noise.next(), noise.next(), noise.next()) - 0.5).normalize(),
    }
}

/// Functions strewn over a slab, facing along the axes and in one of two regions across them, in thin layers, with walls nearby. Finer
/// levels exist where x is below `refined_below` of the level before.
fn strewn(refined_below: [f32; N_LEVELS - 1]) -> PointHierarchy {
    let mut noise = Noise::new(1);
    let mut levels: Vec<PointLevel> = Vec::new();
    for l in 0..N_LEVELS {
        let radius = 0.2 / (1 << l) as f32;
        let mut function = |_| {
            let position = Vec3::new(noise.next(), 0.2 * noise.next(), noise.next()) - 0.5;
            let region = RegionId(u32::from(noise.next() < 0.3));
            let normal = normal(&mut noise, region == RegionId(0));
            let mut extent =
                Extent { below: 0.02 + 0.2 * noise.next(), above: 0.02 + 0.2 * noise.next(), ..Extent::OPEN };
            if noise.next() < 0.5 {
                extent.inverse_depths = [(); N_SECTORS].map(|()| (3.0 * noise.next() - 1.0).max(0.0) / radius);
                extent.sight_height = 0.02 * noise.next();
            }
            OrientedPoint { extent, ..OrientedPoint::new(position, normal, region).with_area(noise.next()) }
        };
        let exists = |p: &OrientedPoint| refined_below[..l].iter().all(|&bound| p.position.x < bound);
        levels.push(PointLevel::new(radius, (0..40 << (2 * l)).map(&mut function).filter(exists).collect()));
    }
    for (level, bound) in levels.iter_mut().zip(refined_below) {
        level.is_refined = level.points.iter().map(|p| p.position.x < bound).collect();
    }
    PointHierarchy { levels, n_regions: 2 }
}

/// Levels that thin out from the first on.
const THIN: [f32; 2] = [0.2, -0.1];
/// A level that is refined everywhere before one that is not.
const WHOLE_THEN_THIN: [f32; 2] = [1.0, 0.0];

fn strewn_basis(refined_below: [f32; N_LEVELS - 1]) -> ShepardBasis {
    ShepardBasis::build(strewn(refined_below), BasisOptions::default())
}

fn coefficients<E>(basis: &ShepardBasis) -> Coefficients<E> {
    let mut noise = Noise::new(2);
    let mut level =
        |l| (0..basis.n_functions(l)).map(|_| Vec3::new(noise.next(), noise.next(), noise.next())).collect();
    Coefficients::from_levels((0..basis.n_levels()).map(&mut level).collect())
}

/// Queries like the functions of [`strewn`], and some far away, in a dark region or in one without functions; none where the weights of
/// a level sum to so little that rounding decides.
fn queries(basis: &ShepardBasis) -> Vec<OrientedPoint> {
    let mut noise = Noise::new(3);
    let mut query = |i: usize| {
        let far = if i.is_multiple_of(16) { 3.0 } else { 0.0 };
        let position = 1.1 * (Vec3::new(noise.next(), 0.2 * noise.next(), noise.next()) - 0.5) + far * Vec3::Z;
        let region = match noise.next() {
            x if x < 0.6 => RegionId(0),
            x if x < 0.9 => RegionId(1),
            x if x < 0.95 => EMPTY,
            _ => RegionId::DARK,
        };
        let extent = Extent::of_query(if i.is_multiple_of(2) { f32::INFINITY } else { 0.01 });
        OrientedPoint { extent, ..OrientedPoint::new(position, normal(&mut noise, true), region) }
    };
    let is_clear = |query: &OrientedPoint| {
        (0..basis.n_levels()).map(|level| sum_of_weights(basis, level, query)).all(|sum| sum == 0.0 || sum > 0.01)
    };
    let queries: Vec<OrientedPoint> = (0..500).map(&mut query).filter(is_clear).collect();
    assert!(queries.len() > 400, "{}", queries.len());
    queries
}

/// `w_i` of all functions of a level.
fn raw_weights(basis: &ShepardBasis, level: usize, query: &OrientedPoint) -> Vec<f64> {
    let support = 2.0 * f64::from(basis.hierarchy().levels[level].poisson_radius);
    let weight = |function: &OrientedPoint| {
        if !function.is_continued_at(query) {
            return 0.0;
        }
        let (offset, normal) = (query.position.as_dvec3() - function.position.as_dvec3(), function.normal.as_dvec3());
        let h = ((offset + 2.0 * offset.dot(normal) * normal).length() / support).min(1.0);
        (2.0 * h * h * h - 3.0 * h * h + 1.0) * query.normal.as_dvec3().dot(normal).powi(2)
    };
    basis.points(level).iter().map(weight).collect()
}

fn sum_of_weights(basis: &ShepardBasis, level: usize, query: &OrientedPoint) -> f64 {
    raw_weights(basis, level, query).iter().sum()
}

/// `B_i` of all functions of a level, where some cover the query.
fn basis_values(basis: &ShepardBasis, level: usize, query: &OrientedPoint) -> Option<Vec<f64>> {
    let weights = raw_weights(basis, level, query);
    let sum: f64 = weights.iter().sum();
    (sum >= f64::from(MIN_WEIGHT_SUM)).then(|| weights.iter().map(|w| w / sum).collect())
}

fn weighted_sum(weights: &[f64], coefficients: &[Rgb]) -> DVec3 {
    assert_eq!(weights.len(), coefficients.len());
    weights.iter().zip(coefficients).map(|(w, c)| *w * c.as_dvec3()).sum()
}

/// The nearest of the functions of a level that `accept` agrees to.
fn nearest_of(
    basis: &ShepardBasis,
    level: usize,
    query: &OrientedPoint,
    accept: impl Fn(&OrientedPoint) -> bool,
) -> Option<u32> {
    let distance = |i: &usize| basis.points(level)[*i].position.as_dvec3().distance(query.position.as_dvec3());
    let accepted = (0..basis.n_functions(level)).filter(|&i| accept(&basis.points(level)[i]));
    accepted.min_by(|a, b| distance(a).total_cmp(&distance(b))).map(|i| i as u32)
}

/// What the nearest function must be, the best first: in sight, else on the side of the query, else not behind it.
fn is_near_enough(function: &OrientedPoint, query: &OrientedPoint, choice: usize) -> bool {
    let cosine = function.normal.dot(query.normal);
    match choice {
        0 => function.is_continued_at(query),
        1 => function.region == query.region && cosine > 0.0,
        _ => function.region == query.region && cosine > -0.5,
    }
}

fn nearest(basis: &ShepardBasis, level: usize, query: &OrientedPoint) -> Option<u32> {
    (0..3).find_map(|choice| nearest_of(basis, level, query, |f| is_near_enough(f, query, choice)))
}

fn nearest_on_any_level(basis: &ShepardBasis, n_levels: usize, query: &OrientedPoint) -> Option<(usize, u32)> {
    (0..3).find_map(|choice| {
        (0..n_levels).rev().find_map(|level| {
            nearest_of(basis, level, query, |f| is_near_enough(f, query, choice)).map(|function| (level, function))
        })
    })
}

/// The value at one query, and how it came about.
type Answer = (DVec3, Coverage);

const ANSWERED: Coverage = Coverage { queries: 1, coarser: 0, nearest: 0, uncovered: 0 };

fn answer_of_nearest<E>(coefficients: &Coefficients<E>, found: Option<(usize, u32)>) -> Answer {
    match found {
        Some((level, i)) => (coefficients.level(level)[i as usize].as_dvec3(), Coverage { nearest: 1, ..ANSWERED }),
        None => (DVec3::ZERO, Coverage { uncovered: 1, ..ANSWERED }),
    }
}

/// Compares values, books and what is in sight with `expected`, which has the number of levels and a query, for many queries at once
/// and few. Returns the books.
fn check<E>(
    reconstruction: &impl Reconstruction<E>,
    basis: &ShepardBasis,
    coefficients: &Coefficients<E>,
    expected: impl Fn(usize, &OrientedPoint) -> Answer,
) -> Coverage {
    let queries = queries(basis);
    let mut books = Coverage::default();
    for n_levels in 1..=N_LEVELS {
        for chunk in [queries.len(), 11] {
            for queries in queries.chunks(chunk).take(20) {
                let mut out = vec![Rgb::ONE; queries.len()];
                let found = reconstruction.reconstruct(basis, coefficients, n_levels, queries, &mut out);
                let mut coverage = Coverage::default();
                for (query, value) in queries.iter().zip(&out) {
                    let answer = match query.region {
                        RegionId::DARK => (DVec3::ZERO, ANSWERED),
                        _ => expected(n_levels, query),
                    };
                    assert!(value.as_dvec3().abs_diff_eq(answer.0, 1e-4), "{value} for {} at {query:?}", answer.0);
                    coverage += answer.1;
                }
                assert_eq!(found, coverage, "{n_levels} levels, {} queries", queries.len());
                books += coverage;
            }
        }
    }
    books
}

/// The coefficients of a field of which a query reads the values `F_l` of its definition.
fn expansion(basis: &ShepardBasis, level: usize, query: &OrientedPoint, coefficients: &[Rgb]) -> Option<DVec3> {
    basis_values(basis, level, query).map(|weights| weighted_sum(&weights, coefficients))
}

#[test]
fn the_absolute_expansion_is_that_of_the_finest_level_that_covers_a_point() {
    let basis = strewn_basis(THIN);
    let field = coefficients::<Absolute>(&basis);
    let books = check(&ExactShepard, &basis, &field, |n_levels, query| {
        let found =
            (0..n_levels).rev().find_map(|level| Some((level, expansion(&basis, level, query, field.level(level))?)));
        match found {
            Some((level, value)) => (value, Coverage { coarser: u64::from(level + 1 < n_levels), ..ANSWERED }),
            None => answer_of_nearest(&field, nearest_on_any_level(&basis, n_levels, query)),
        }
    });
    assert!(books.coarser > 100 && books.nearest > 100 && books.uncovered > 100, "{books:?}");
}

/// `Σ F_l`, where level 0 is answered by its nearest function if none covers the point.
fn delta_answer(basis: &ShepardBasis, field: &Coefficients<Delta>, n_levels: usize, query: &OrientedPoint) -> Answer {
    let parts: Vec<Option<DVec3>> =
        (0..n_levels).map(|level| expansion(basis, level, query, field.level(level))).collect();
    let finest = parts.iter().rposition(Option::is_some);
    let (base, mut coverage) = match parts[0] {
        Some(_) => (DVec3::ZERO, ANSWERED),
        None => answer_of_nearest(field, nearest(basis, 0, query).map(|function| (0, function))),
    };
    coverage.coarser = u64::from(finest.is_some_and(|level| level + 1 < n_levels));
    (base + parts.iter().flatten().sum::<DVec3>(), coverage)
}

#[test]
fn the_delta_expansion_is_the_sum_over_levels() {
    let basis = strewn_basis(THIN);
    let field = coefficients::<Delta>(&basis);
    let books = check(&ExactShepard, &basis, &field, |n_levels, query| delta_answer(&basis, &field, n_levels, query));
    assert!(books.coarser > 100 && books.nearest > 100 && books.uncovered > 100, "{books:?}");
    let absolute = coefficients::<Absolute>(&basis);
    let delta = delta_from_absolute(&basis, &absolute);
    for level in 1..N_LEVELS {
        for (i, point) in basis.points(level).iter().enumerate().step_by(7) {
            if (0..level).map(|l| sum_of_weights(&basis, l, point)).any(|sum| sum > 0.0 && sum < 0.01) {
                continue;
            }
            let expected = absolute.level(level)[i].as_dvec3() - delta_answer(&basis, &delta, level, point).0;
            assert!(delta.level(level)[i].as_dvec3().abs_diff_eq(expected, 1e-4), "{expected}");
        }
    }
}

/// `W_level` as weights of the functions of all levels in turn; `None` where the level does not cover the query.
fn layered_weights(basis: &ShepardBasis, level: usize, n_levels: usize, query: &OrientedPoint) -> Option<Vec<f64>> {
    let here = basis_values(basis, level, query)?;
    let is_refined = &basis.hierarchy().levels[level].is_refined;
    let refined: f64 = here.iter().zip(is_refined).filter(|(_, is_refined)| **is_refined).map(|(b, _)| b).sum();
    let finer = (level + 1 < n_levels).then(|| layered_weights(basis, level + 1, n_levels, query)).flatten();
    let share =
        if finer.is_some() { refined * (sum_of_weights(basis, level + 1, query) / 0.125).min(1.0) } else { 0.0 };
    let before: usize = (0..level).map(|l| basis.n_functions(l)).sum();
    let mut all = vec![0.0; basis.hierarchy().n_points()];
    all.iter_mut().zip(finer.iter().flatten()).for_each(|(w, of_finer)| *w = share * of_finer);
    all[before..].iter_mut().zip(here).for_each(|(w, b)| *w += (1.0 - share) * b);
    Some(all)
}

fn layered(basis: &ShepardBasis, n_levels: usize, query: &OrientedPoint) -> Option<Vec<f64>> {
    (0..n_levels).find_map(|start| layered_weights(basis, start, n_levels, query))
}

#[test]
fn the_layered_expansion_goes_from_level_to_level_by_its_shares() {
    for refined_below in [THIN, WHOLE_THEN_THIN] {
        let basis = strewn_basis(refined_below);
        let field = coefficients::<Absolute>(&basis);
        let all: Vec<Rgb> = (0..N_LEVELS).flat_map(|level| field.level(level).to_vec()).collect();
        let answer = |n_levels, query: &OrientedPoint| match layered(&basis, n_levels, query) {
            Some(weights) => (weighted_sum(&weights, &all), ANSWERED),
            None => answer_of_nearest(&field, nearest_on_any_level(&basis, n_levels, query)),
        };
        let books = check(&Layered, &basis, &field, answer);
        assert!(books.nearest > 100 && books.uncovered > 100, "{books:?}");
        // The same weights, function by function, and the support of the functions around.
        let queries = queries(&basis);
        let mut expansions = Vec::new();
        basis.expand(N_LEVELS, &queries, &mut LayeredScratch::default(), |i, found, coverage| {
            assert_eq!(i, expansions.len());
            expansions.push((found.clone(), coverage));
        });
        let in_sight = Layered.in_sight(&basis, &field, N_LEVELS, &queries);
        let finest = basis.layered_nearest(N_LEVELS, &queries);
        assert_eq!((in_sight.len(), finest.len()), (queries.len(), queries.len()));
        let mut alone = LayeredScratch::default();
        for (((query, in_sight), finest), (found, coverage)) in queries.iter().zip(in_sight).zip(finest).zip(expansions)
        {
            basis.expand(N_LEVELS, std::slice::from_ref(query), &mut alone, |_, by_itself, _| {
                assert_eq!(*by_itself, found, "the same bits, whatever else is asked for");
            });
            let (value, expected_coverage) = answer(N_LEVELS, query);
            // Dark regions need no answer.
            let expected_coverage = if query.region == RegionId::DARK { ANSWERED } else { expected_coverage };
            assert_eq!(coverage, expected_coverage);
            let mut expected = layered(&basis, N_LEVELS, query).unwrap_or(vec![0.0; all.len()]);
            if let Some((level, function)) =
                nearest_on_any_level(&basis, N_LEVELS, query).filter(|_| coverage.nearest == 1)
            {
                expected[basis.flat_index(level, function) as usize] = 1.0;
            }
            assert!(found.iter().all(|w| w.weight > 0.0), "{found:?}");
            for w in &found {
                expected[w.function as usize] -= f64::from(w.weight);
            }
            assert!(expected.iter().all(|difference| difference.abs() < 1e-4));
            assert_eq!(in_sight.map(|found| found.1), finest.map(|(level, _)| basis.support(level)));
            assert!(in_sight.is_none_or(|found| found.0.as_dvec3().abs_diff_eq(value, 1e-4)), "{value}");
        }
    }
}

#[test]
fn the_nearest_function_is_the_nearest_of_the_best_kind_that_there_is() {
    let basis = strewn_basis(THIN);
    let mut n_found = [0; 3];
    for query in queries(&basis) {
        for level in 0..N_LEVELS {
            let of_kind = |kind| nearest_of(&basis, level, &query, |f| is_near_enough(f, &query, kind));
            let best = (0..3).find_map(|kind| Some((kind, of_kind(kind)?)));
            assert_eq!(basis.nearest(level, &query), best.map(|(_, function)| function), "{query:?}");
            n_found[best.map_or(0, |(kind, _)| kind)] += 1;
        }
    }
    assert!(n_found.iter().all(|&n| n > 20), "{n_found:?}");
}

/// Of the functions in sight, within a support and facing nearly the same way one is found if there is any, and mostly the nearest.
#[test]
fn the_approximately_nearest_function_is_one_that_may_answer() {
    let basis = strewn_basis(WHOLE_THEN_THIN);
    let (mut n_found, mut n_nearest) = (0, 0);
    for query in queries(&basis) {
        for level in 0..N_LEVELS {
            let may_answer = |f: &OrientedPoint| {
                let distance = f.position.distance(query.position);
                f.is_continued_at(&query) && f.normal.dot(query.normal) > 0.5 && distance <= basis.support(level)
            };
            let (found, nearest) =
                (basis.approximate_nearest(level, &query), nearest_of(&basis, level, &query, may_answer));
            assert_eq!(found.is_some(), nearest.is_some(), "{query:?}");
            assert!(found.is_none_or(|function| may_answer(&basis.points(level)[function as usize])));
            n_found += u32::from(found.is_some());
            n_nearest += u32::from(found.is_some() && found == nearest);
        }
    }
    assert!(n_found > 300 && n_nearest > n_found / 2 && n_nearest < n_found, "{n_nearest} of {n_found}");
}

#[test]
fn the_nearest_reconstruction_reads_what_is_found() {
    let basis = strewn_basis(THIN);
    let field = coefficients::<Absolute>(&basis);
    let books = check(&ApproximateNearest, &basis, &field, |n_levels, query| {
        let top = n_levels - 1;
        match basis.approximate_nearest(top, query) {
            Some(function) => (field.level(top)[function as usize].as_dvec3(), ANSWERED),
            None => answer_of_nearest(&field, nearest_on_any_level(&basis, n_levels, query)),
        }
    });
    assert!(books.nearest > 100 && books.uncovered > 100, "{books:?}");
    let field = coefficients::<Delta>(&basis);
    let books = check(&ApproximateNearest, &basis, &field, |n_levels, query| {
        let (mut value, mut coverage) = (DVec3::ZERO, ANSWERED);
        for level in 0..n_levels {
            let found = basis.approximate_nearest(level, query);
            let nearest = nearest(&basis, level, query).filter(|_| found.is_none());
            value += found.or(nearest).map_or(DVec3::ZERO, |i| field.level(level)[i as usize].as_dvec3());
            coverage.nearest += u64::from(nearest.is_some());
            coverage.uncovered += u64::from(found.or(nearest).is_none());
        }
        (value, coverage)
    });
    assert!(books.nearest > 100 && books.uncovered > 100, "{books:?}");
}

/// Level after level, as long as the function found is refined, and on coarser levels where these have nothing.
#[test]
fn the_layered_nearest_function_is_on_the_finest_level_around() {
    for (refined_below, coarsest) in [(THIN, 0), (WHOLE_THEN_THIN, 1)] {
        let basis = strewn_basis(refined_below);
        let field = coefficients::<Absolute>(&basis);
        let mut queries = queries(&basis);
        // Along the axes, where no rule but the cosine decides which functions face the same way.
        queries.retain(|query| query.normal.abs().max_element() == 1.0);
        for n_levels in 1..=N_LEVELS {
            let coarsest = coarsest.min(n_levels - 1);
            assert_eq!(basis.coarsest_read(n_levels), coarsest);
            let expected = |query: &OrientedPoint| {
                let nearest_in_reach = |level| {
                    let (points, reach) = (basis.points(level), basis.support(level));
                    let accept = |f: &OrientedPoint| f.is_continued_at(query) && f.normal.dot(query.normal) > 0.5;
                    let found = nearest_of(&basis, level, query, accept)?;
                    (points[found as usize].position.distance(query.position) < reach).then_some((level, found))
                };
                let mut found = None;
                for level in coarsest..n_levels {
                    match nearest_in_reach(level) {
                        Some(nearer) => found = Some(nearer),
                        None if found.is_none() => continue,
                        None => break,
                    }
                    if found.is_some_and(|(_, i)| !basis.hierarchy().levels[level].is_refined(i)) {
                        break;
                    }
                }
                found.or_else(|| (0..coarsest).rev().find_map(nearest_in_reach))
            };
            let expected: Vec<_> = queries.iter().map(expected).collect();
            for chunk in [queries.len(), 11] {
                let found: Vec<_> =
                    queries.chunks(chunk).flat_map(|few| basis.layered_nearest(n_levels, few)).collect();
                assert_eq!(found, expected);
            }
            let n_on = |level| expected.iter().flatten().filter(|found| found.0 == level).count();
            assert!((0..n_levels).all(|level| n_on(level) > 5), "{:?}", [n_on(0), n_on(1), n_on(2)]);
            // What is read there, and elsewhere the nearest of all, except where none can be in sight.
            let mut out = vec![Rgb::ONE; queries.len()];
            let coverage = LayeredNearest.reconstruct(&basis, &field, n_levels, &queries, &mut out);
            let in_sight = LayeredNearest.in_sight(&basis, &field, n_levels, &queries);
            let mut expected_coverage = Coverage::default();
            for (((query, found), value), in_sight) in queries.iter().zip(expected).zip(out).zip(in_sight) {
                let read = found.map(|(level, i)| (field.level(level)[i as usize], basis.support(level)));
                assert_eq!(in_sight, read);
                let (expected, coverage) = match read {
                    Some((value, _)) => (value.as_dvec3(), ANSWERED),
                    None if query.region == RegionId::DARK => (DVec3::ZERO, ANSWERED),
                    None => answer_of_nearest(&field, nearest_on_any_level(&basis, n_levels, query)),
                };
                assert_eq!(value.as_dvec3(), expected);
                expected_coverage += coverage;
            }
            assert_eq!(coverage, expected_coverage);
            assert!(coverage.nearest > 5 && coverage.uncovered > 5, "{coverage:?}");
        }
    }
}

/// On levels that are everywhere it is the approximately nearest of the finest that has one.
#[test]
fn the_layered_nearest_function_of_whole_levels_is_on_the_finest() {
    let mut hierarchy = strewn([1.0; 2]);
    hierarchy.levels.iter_mut().for_each(|level| level.is_refined.clear());
    let basis = ShepardBasis::build(hierarchy, BasisOptions::default());
    let queries = queries(&basis);
    for n_levels in 1..=N_LEVELS {
        assert_eq!(basis.coarsest_read(n_levels), n_levels - 1);
        for (query, found) in queries.iter().zip(basis.layered_nearest(n_levels, &queries)) {
            let of_level = |level| basis.approximate_nearest(level, query).map(|function| (level, function));
            assert_eq!(found, (0..n_levels).rev().find_map(of_level));
        }
    }
}

/// What is read without a guess: the value, and the support on the finest level.
#[test]
fn only_what_functions_in_sight_say_is_in_sight() {
    let basis = strewn_basis(THIN);
    let field = coefficients::<Absolute>(&basis);
    let queries: Vec<OrientedPoint> =
        queries(&basis).into_iter().filter(|query| query.region != RegionId::DARK).collect();
    let found = ExactShepard.in_sight(&basis, &field, 2, &queries);
    assert_eq!(found.len(), queries.len());
    let (mut n_fine, mut n_none) = (0, 0);
    for (query, found) in queries.iter().zip(found) {
        let [coarse, fine] = [0, 1].map(|level| expansion(&basis, level, query, field.level(level)));
        let expected = fine.or(coarse);
        assert_eq!(found.is_some(), expected.is_some(), "{query:?}");
        let is_right = |(found, expected): (DVec3, DVec3)| expected.abs_diff_eq(found, 1e-4);
        assert!(found.map(|(value, _)| value.as_dvec3()).zip(expected).is_none_or(is_right), "{query:?}");
        if fine.is_some() {
            assert_eq!(found.map(|(_, support)| support), Some(0.2));
        }
        n_fine += u32::from(fine.is_some());
        n_none += u32::from(found.is_none());
    }
    assert!(n_fine > 50 && n_none > 50, "{n_fine} {n_none}");
}

/// The functions that overlap a centre, with their basis values, or the nearest where none does; and what is inherited from them.
#[test]
fn parents_are_the_functions_that_overlap_a_centre() {
    let basis = strewn_basis(THIN);
    let field = coefficients::<Absolute>(&basis);
    let mut n_nearest = 0;
    for level in 1..N_LEVELS {
        let (parents, coarser) = (basis.parents(level), field.level(level - 1));
        let pushed = parents.push_down(coarser);
        assert_eq!(pushed.len(), basis.n_functions(level));
        for (i, point) in basis.points(level).iter().enumerate() {
            let sum = sum_of_weights(&basis, level - 1, point);
            if sum > 0.0 && sum < 0.01 {
                continue;
            }
            let mut expected = vec![0.0; basis.n_functions(level - 1)];
            match (basis_values(&basis, level - 1, point), nearest(&basis, level - 1, point)) {
                (Some(values), _) => expected = values,
                (None, Some(function)) => expected[function as usize] = 1.0,
                _ => {}
            }
            n_nearest += u32::from(sum == 0.0);
            assert!(pushed[i].as_dvec3().abs_diff_eq(weighted_sum(&expected, coarser), 1e-4));
            for parent in parents.of(i as u32) {
                expected[parent.function as usize] -= f64::from(parent.weight);
            }
            assert!(expected.iter().all(|difference| difference.abs() < 1e-4));
        }
    }
    assert!(n_nearest > 10, "{n_nearest}");
}

/// Averages by area and basis value; zero where a function has nothing finer under it.
#[test]
fn restriction_averages_over_children() {
    let basis = strewn_basis(THIN);
    let finest = coefficients::<Absolute>(&basis).level(N_LEVELS - 1).to_vec();
    let field = restrict(&basis, finest.clone());
    let mut area: Vec<f64> = basis.points(N_LEVELS - 1).iter().map(|p| p.area.into()).collect();
    let mut fine: Vec<DVec3> = finest.iter().map(|value| value.as_dvec3()).collect();
    let mut n_without = 0;
    for level in (0..N_LEVELS - 1).rev() {
        let mut sums = vec![(DVec3::ZERO, 0.0); basis.n_functions(level)];
        for child in 0..basis.n_functions(level + 1) {
            for parent in basis.parents(level + 1).of(child as u32) {
                let weight = area[child] * f64::from(parent.weight);
                let (value, total) = &mut sums[parent.function as usize];
                *value += weight * fine[child];
                *total += weight;
            }
        }
        n_without += sums.iter().filter(|(_, total)| *total == 0.0).count();
        fine = sums.iter().map(|(value, total)| *value / total.max(f64::MIN_POSITIVE)).collect();
        area = sums.iter().map(|(_, total)| *total).collect();
        for (value, expected) in field.level(level).iter().zip(&fine) {
            assert!(value.as_dvec3().abs_diff_eq(*expected, 1e-5), "{value} {expected}");
        }
    }
    assert!(n_without > 5, "{n_without}");
}

/// However its levels came together, a basis reads the same.
#[test]
fn levels_can_be_added_and_taken_away() {
    let assert_same = |found: &ShepardBasis, expected: &ShepardBasis| {
        let n_levels = expected.n_levels();
        assert_eq!(found.hierarchy(), expected.hierarchy());
        assert!((0..n_levels).all(|l| found.tree(l) == expected.tree(l)));
        assert!((1..n_levels).all(|l| found.parents(l) == expected.parents(l)));
        let queries = queries(expected);
        let field = coefficients::<Absolute>(expected);
        for n_levels in 1..=n_levels {
            assert_eq!(found.coarsest_read(n_levels), expected.coarsest_read(n_levels));
            let nearest = [found, expected].map(|basis| basis.layered_nearest(n_levels, &queries));
            assert_eq!(nearest[0], nearest[1]);
            let values = [found, expected].map(|basis| {
                let mut out = vec![Rgb::ZERO; queries.len()];
                ExactShepard.reconstruct(basis, &field, n_levels, &queries, &mut out);
                out
            });
            assert_eq!(values[0], values[1]);
        }
        assert_eq!(found.memory(), expected.memory());
    };
    for refined_below in [THIN, WHOLE_THEN_THIN] {
        let hierarchy = strewn(refined_below);
        let first = PointLevel { is_refined: Vec::new(), ..hierarchy.levels[0].clone() };
        let mut basis =
            ShepardBasis::build(PointHierarchy { levels: vec![first], n_regions: 2 }, BasisOptions::default());
        for level in 1..N_LEVELS {
            basis.push_level(hierarchy.levels[level].clone(), hierarchy.levels[level - 1].is_refined.clone());
            let last = basis.points(level).len();
            assert_eq!(basis.hierarchy().levels[level].points.len(), last);
        }
        let whole = strewn_basis(refined_below);
        let mut expected = hierarchy.clone();
        expected.levels[N_LEVELS - 1].is_refined = Vec::new();
        assert_same(&basis, &whole);
        for n_levels in [2, 1] {
            basis.truncate(n_levels);
            expected.levels.truncate(n_levels);
            let finest = &mut expected.levels[n_levels - 1];
            finest.is_refined = vec![false; finest.points.len()];
            assert_same(&basis, &ShepardBasis::build(expected.clone(), BasisOptions::default()));
        }
    }
}

#[test]
fn flat_indices_count_the_functions_of_all_levels() {
    let basis = strewn_basis(THIN);
    let mut flat = 0;
    for level in 0..N_LEVELS {
        for i in 0..basis.n_functions(level) as u32 {
            assert_eq!((basis.flat_index(level, i), basis.level_of(flat)), (flat, (level, i)));
            flat += 1;
        }
    }
    assert_eq!(flat as usize, basis.hierarchy().n_points());
}

#[test]
fn sums_of_fields_and_books_are_those_of_their_parts() {
    let field = |values: [f32; 3]| Coefficients::<Delta>::from_levels(vec![vec![], values.map(Rgb::splat).to_vec()]);
    let mut sum = field([1.0, -2.0, 4.0]);
    assert_eq!((sum.n_levels(), sum.max_abs(), sum.is_finite()), (2, 4.0, true));
    sum.add(&field([0.5, -3.0, -4.0]));
    assert_eq!(sum, field([1.5, -5.0, 0.0]));
    assert_eq!(sum.max_abs(), 5.0);
    assert_eq!(sum.plus(&sum), field([3.0, -10.0, 0.0]));
    for bad in [f32::NAN, f32::INFINITY] {
        assert!(!field([0.0, bad, 0.0]).is_finite());
    }
    let mut books = Coverage { queries: 100, coarser: 20, nearest: 3, uncovered: 4 };
    books += Coverage { queries: 7, coarser: 6, nearest: 5, uncovered: 1 };
    assert_eq!(books, Coverage { queries: 107, coarser: 26, nearest: 8, uncovered: 5 });
}

/// What is kept for every function, and little more.
#[test]
fn memory_is_that_of_the_contents() {
    let sum_over_levels = |basis: &ShepardBasis, of_level: &dyn Fn(usize) -> usize| -> usize {
        (0..basis.n_levels()).map(of_level).sum::<usize>() + basis.hierarchy().memory()
    };
    let everywhere = ShepardBasis::build(plane(6, N_LEVELS, Vec3::Y, 0), BasisOptions::default());
    let of_parents = |level: usize| {
        let n_links: usize =
            (0..everywhere.n_functions(level) as u32).map(|i| everywhere.parents(level).of(i).len()).sum();
        // A weight and a child for each, and where those of every function begin.
        12 * n_links + 4 * (everywhere.n_functions(level) + 1 + everywhere.n_functions(level - 1) + 1)
    };
    for level in 1..N_LEVELS {
        assert_eq!(everywhere.parents(level).memory(), of_parents(level));
    }
    let known = sum_over_levels(&everywhere, &|level| {
        everywhere.tree(level).memory() + if level > 0 { of_parents(level) } else { 0 }
    });
    assert_eq!(everywhere.memory(), known);
    // Reading lists the functions of a level by cells.
    let (field, queries) = (coefficients::<Absolute>(&everywhere), queries(&everywhere));
    ExactShepard.reconstruct(&everywhere, &field, 1, &queries, &mut vec![Rgb::ZERO; queries.len()]);
    let of_function = size_of::<OrientedPoint>();
    let of_cells = everywhere.memory() - known;
    assert!(
        (everywhere.n_functions(0) * of_function..everywhere.n_functions(0) * 20 * of_function).contains(&of_cells)
    );
    // Where levels are not everywhere, there is an index to the nearest function.
    let mut hierarchy = everywhere.hierarchy().clone();
    hierarchy.levels[0].is_refined = vec![true; hierarchy.levels[0].points.len()];
    let of_index = ShepardBasis::build(hierarchy, BasisOptions::default()).memory() - known;
    let n_points = everywhere.hierarchy().n_points();
    assert!((2 * n_points * of_function..20 * n_points * of_function).contains(&of_index), "{of_index}");
}
