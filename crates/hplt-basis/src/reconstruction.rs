use hplt_geom::{OrientedPoint, RegionId, Rgb};

use crate::{Absolute, Coefficients, Coverage, Delta, ShepardBasis, Weight};

/// Turns coefficients into values of the field.
pub trait Reconstruction<E>: Sync {
    /// Writes to `out[i]` the irradiance at `queries[i]`, W/m², reading the `n_levels` coarsest levels only. Where no
    /// function of the finest of them covers a point, coarser ones answer, then the nearest on the same side, then
    /// zero; the result counts how often. Zero in dark regions.
    ///
    /// # Panics
    /// When the slices differ in length or `n_levels` exceeds what there is.
    fn reconstruct(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<E>,
        n_levels: usize,
        queries: &[OrientedPoint],
        out: &mut [Rgb],
    ) -> Coverage;

    /// The irradiance at each query, W/m², reading the `n_levels` coarsest levels, and the support, scene units, of the finest
    /// functions read; `None` where no function is in sight, so that the answer would be a guess.
    fn in_sight(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<E>,
        n_levels: usize,
        queries: &[OrientedPoint],
    ) -> Vec<Option<(Rgb, f32)>> {
        let one = |query| {
            let mut value = [Rgb::ZERO];
            let coverage = self.reconstruct(basis, coefficients, n_levels, std::slice::from_ref(query), &mut value);
            (coverage.nearest + coverage.uncovered == 0).then(|| (value[0], basis.support(n_levels - 1)))
        };
        queries.iter().map(one).collect()
    }
}

/// The exact expansion: a range query per level (delta), or one on the finest level read (absolute).
#[derive(Debug, Clone, Copy, Default)]
pub struct ExactShepard;

/// The coefficient of the approximately nearest function on the same side: one descent of the kd-tree per level (delta)
/// or in all (absolute), and a search where that ends farther away than a support reaches. Its error averages out over
/// the many rays of a gather.
#[derive(Debug, Clone, Copy, Default)]
pub struct ApproximateNearest;

impl Reconstruction<Absolute> for ExactShepard {
    fn reconstruct(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Absolute>,
        n_levels: usize,
        queries: &[OrientedPoint],
        out: &mut [Rgb],
    ) -> Coverage {
        let mut coverage = begin(queries, out);
        let top = n_levels - 1;
        let values = basis.blend_many(top, queries, coefficients.level(top));
        let mut weights = Vec::new();
        for (i, query) in queries.iter().enumerate().filter(|(_, query)| query.region != RegionId::DARK) {
            let mut coarser = (0..top).rev();
            let mut coarser =
                || coarser.find_map(|level| basis.blend(level, query, coefficients.level(level), &mut weights));
            out[i] = values[i].unwrap_or_else(|| match coarser() {
                Some(value) => {
                    coverage.coarser += 1;
                    value
                }
                None => nearest_on_any_level(basis, coefficients, n_levels, query, &mut coverage),
            });
        }
        coverage
    }
}

impl Reconstruction<Delta> for ExactShepard {
    fn reconstruct(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Delta>,
        n_levels: usize,
        queries: &[OrientedPoint],
        out: &mut [Rgb],
    ) -> Coverage {
        let mut coverage = begin(queries, out);
        let mut finest = vec![None; queries.len()];
        for level in 0..n_levels {
            let values = basis.blend_many(level, queries, coefficients.level(level));
            for (i, query) in queries.iter().enumerate().filter(|(_, query)| query.region != RegionId::DARK) {
                if let Some(of_level) = values[i] {
                    out[i] += of_level;
                    finest[i] = Some(level);
                } else if level == 0 {
                    // The base level carries the mean of the field: details alone would be wrong everywhere.
                    out[i] += nearest_of(basis, coefficients.level(0), 0, query, &mut coverage);
                }
            }
        }
        coverage.coarser = finest.iter().flatten().filter(|&&level| level + 1 < n_levels).count() as u64;
        coverage
    }
}

impl Reconstruction<Absolute> for ApproximateNearest {
    fn reconstruct(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Absolute>,
        n_levels: usize,
        queries: &[OrientedPoint],
        out: &mut [Rgb],
    ) -> Coverage {
        for_each(queries, out, |query, coverage| {
            let top = n_levels - 1;
            match basis.approximate_nearest(top, query) {
                Some(function) => coefficients.level(top)[function as usize],
                None => nearest_on_any_level(basis, coefficients, n_levels, query, coverage),
            }
        })
    }
}

impl Reconstruction<Delta> for ApproximateNearest {
    fn reconstruct(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Delta>,
        n_levels: usize,
        queries: &[OrientedPoint],
        out: &mut [Rgb],
    ) -> Coverage {
        for_each(queries, out, |query, coverage| {
            (0..n_levels)
                .map(|level| match basis.approximate_nearest(level, query) {
                    Some(function) => coefficients.level(level)[function as usize],
                    None => nearest_of(basis, coefficients.level(level), level, query, coverage),
                })
                .sum()
        })
    }
}

/// Zeroes, and the books of that many queries.
pub(crate) fn begin(queries: &[OrientedPoint], out: &mut [Rgb]) -> Coverage {
    assert_eq!(queries.len(), out.len(), "queries and results");
    out.fill(Rgb::ZERO);
    Coverage { queries: queries.len() as u64, ..Coverage::default() }
}

pub(crate) fn for_each(
    queries: &[OrientedPoint],
    out: &mut [Rgb],
    mut evaluate: impl FnMut(&OrientedPoint, &mut Coverage) -> Rgb,
) -> Coverage {
    let mut coverage = begin(queries, out);
    visit_coherently(queries, |i| {
        let query = &queries[i];
        out[i] = if query.region == RegionId::DARK { Rgb::ZERO } else { evaluate(query, &mut coverage) };
    });
    coverage
}

/// Visits the index of every query once, in [an order](coherent_order) in which neighbours follow each other.
pub(crate) fn visit_coherently(queries: &[OrientedPoint], visit: impl FnMut(usize)) {
    coherent_order(queries).into_iter().map(|i| i as usize).for_each(visit);
}

/// Queries below this number are answered in the order given.
pub(crate) const FEW: usize = 64;

/// The queries cell by cell of a grid, so that what is read for one is in the nearest cache for the next.
pub(crate) fn coherent_order(queries: &[OrientedPoint]) -> Vec<u32> {
    const CELLS_PER_AXIS: f32 = 64.0;
    if queries.len() < FEW {
        return (0..queries.len() as u32).collect();
    }
    let key = |(i, query): (usize, &OrientedPoint)| {
        // Saturates for what is outside.
        let [x, y, z] = (0.5 * CELLS_PER_AXIS * (query.position + 1.0)).to_array().map(|c| c as u8);
        u64::from(u32::from_le_bytes([x, y, z, 0])) << 32 | i as u64
    };
    let mut keys: Vec<u64> = queries.iter().enumerate().map(key).collect();
    keys.sort_unstable();
    keys.into_iter().map(|key| key as u32).collect()
}

pub(crate) fn combine(weights: &[Weight], coefficients: &[Rgb]) -> Rgb {
    weights.iter().map(|w| coefficients[w.function as usize] * w.weight).sum()
}

fn nearest_of(
    basis: &ShepardBasis,
    coefficients: &[Rgb],
    level: usize,
    query: &OrientedPoint,
    coverage: &mut Coverage,
) -> Rgb {
    match basis.nearest(level, query) {
        Some(function) => {
            coverage.nearest += 1;
            coefficients[function as usize]
        }
        None => {
            coverage.uncovered += 1;
            Rgb::ZERO
        }
    }
}

pub(crate) fn nearest_on_any_level(
    basis: &ShepardBasis,
    coefficients: &Coefficients<Absolute>,
    n_levels: usize,
    query: &OrientedPoint,
    coverage: &mut Coverage,
) -> Rgb {
    match basis.nearest_on_any_level(n_levels, query) {
        Some((level, function)) => {
            coverage.nearest += 1;
            coefficients.level(level)[function as usize]
        }
        None => {
            coverage.uncovered += 1;
            Rgb::ZERO
        }
    }
}
