use hplt_geom::{OrientedPoint, RegionId, Rgb};

use crate::reconstruction::{begin, coherent_order, nearest_on_any_level};
use crate::{Absolute, Coefficients, Coverage, LayeredScratch, Reconstruction, ShepardBasis, Weight};

/// The continuous field of a hierarchy whose finer levels exist only where they are needed:
///
/// ```text
/// W_l(p) = (1 - s_l) F_l(p) + s_l W_{l+1}(p)      F_l: the Shepard expansion on level l
/// s_l(p) = β_l(p)·c_{l+1}(p)                      β_l = Σ_{i refined} B_i^l,  c = min(1, Σw / 0.125)
/// ```
///
/// `β` is a part of the partition of unity of level `l`, 1 where all around is refined and 0 where nothing is; `c` takes the finer
/// level back where it thins out. On a hierarchy that is refined everywhere this is the expansion on the finest level read.
#[derive(Debug, Clone, Copy, Default)]
pub struct Layered;

/// The coefficient of the approximately nearest function of the finest level around a point: one or a few descents of a
/// kd-tree. For the senders of a gather, where its error averages out over the rays.
#[derive(Debug, Clone, Copy, Default)]
pub struct LayeredNearest;

impl ShepardBasis {
    /// The coarsest of `n_levels` levels that has functions which nothing finer stands in for.
    pub fn coarsest_read(&self, n_levels: usize) -> usize {
        self.n_whole.min(n_levels.saturating_sub(1))
    }

    /// For each query the approximately nearest function on the finest level around it among the `n_levels` coarsest, as level and
    /// index there.
    pub fn layered_nearest(&self, n_levels: usize, queries: &[OrientedPoint]) -> Vec<Option<(usize, u32)>> {
        let mut found = vec![None; queries.len()];
        // Calls `visit` with each of the queries that it has not said no to, and the function of `level` nearest to it.
        let look = |level, pending: &mut Vec<u32>, visit: &mut dyn FnMut(usize, Option<u32>) -> bool| {
            let queries: Vec<OrientedPoint> = pending.iter().map(|&i| queries[i as usize]).collect();
            let mut nearest = self.nearest_many(level, &queries).into_iter();
            pending.retain(|&i| visit(i as usize, nearest.next().flatten()));
        };
        let coarsest = self.coarsest_read(n_levels);
        let mut pending: Vec<u32> = (0..queries.len() as u32).collect();
        for level in coarsest..n_levels {
            look(level, &mut pending, &mut |i, function| match function {
                Some(function) => {
                    found[i] = Some((level, function));
                    self.hierarchy().levels[level].is_refined(function)
                }
                None => found[i].is_none(),
            });
        }
        // A patch too small for a finer function has only its coarse one.
        pending.retain(|&i| found[i as usize].is_none());
        for level in (0..coarsest).rev() {
            look(level, &mut pending, &mut |i, function| {
                found[i] = function.map(|function| (level, function));
                function.is_none()
            });
        }
        found
    }
}

impl Reconstruction<Absolute> for Layered {
    fn reconstruct(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Absolute>,
        n_levels: usize,
        queries: &[OrientedPoint],
        out: &mut [Rgb],
    ) -> Coverage {
        let mut coverage = begin(queries, out);
        let order = coherent_order(queries);
        let in_order: Vec<OrientedPoint> = order.iter().map(|&i| queries[i as usize]).collect();
        basis.expand(n_levels, &in_order, &mut LayeredScratch::default(), |i, expansion, found| {
            let value = |w: &Weight| {
                let (level, function) = basis.level_of(w.function);
                coefficients.level(level)[function as usize] * w.weight
            };
            out[order[i] as usize] = expansion.iter().map(value).sum();
            coverage += Coverage { queries: 0, ..found };
        });
        coverage
    }

    fn in_sight(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Absolute>,
        n_levels: usize,
        queries: &[OrientedPoint],
    ) -> Vec<Option<(Rgb, f32)>> {
        let mut values = vec![Rgb::ZERO; queries.len()];
        self.reconstruct(basis, coefficients, n_levels, queries, &mut values);
        let found = basis.layered_nearest(n_levels, queries).into_iter().zip(values);
        found.map(|(function, value)| function.map(|(finest, _)| (value, basis.support(finest)))).collect()
    }
}

impl Reconstruction<Absolute> for LayeredNearest {
    fn reconstruct(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Absolute>,
        n_levels: usize,
        queries: &[OrientedPoint],
        out: &mut [Rgb],
    ) -> Coverage {
        let mut coverage = begin(queries, out);
        for ((query, out), found) in queries.iter().zip(out).zip(basis.layered_nearest(n_levels, queries)) {
            *out = match found {
                _ if query.region == RegionId::DARK => Rgb::ZERO,
                Some((level, function)) => coefficients.level(level)[function as usize],
                None => nearest_on_any_level(basis, coefficients, n_levels, query, &mut coverage),
            };
        }
        coverage
    }

    fn in_sight(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Absolute>,
        n_levels: usize,
        queries: &[OrientedPoint],
    ) -> Vec<Option<(Rgb, f32)>> {
        let read = |(level, i): (usize, u32)| (coefficients.level(level)[i as usize], basis.support(level));
        basis.layered_nearest(n_levels, queries).into_iter().map(|found| found.map(read)).collect()
    }
}
