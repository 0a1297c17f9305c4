//! The layered expansion at many queries: those near each other share the search for functions, which are then evaluated for as many
//! queries at once as the processor's vectors have lanes.

use std::ops::Range;

use glam::Vec3;
use hplt_geom::{OrientedPoint, RegionId};

use crate::cells::MARGIN;
use crate::lanes::{Columns, list_weights};
use crate::{Coverage, MIN_WEIGHT_SUM, ShepardBasis, Weight};

/// Weights of a level this large, on and off its functions, are full coverage: what Poisson-disk sets guarantee.
const FULL_COVERAGE: f32 = 0.125;
/// Queries that share a search, at most: as many as two of the widest vectors hold,
const MAX_GROUP: usize = 32;
/// and the diagonal of the box that they are in, in supports of the finest level.
const GROUP_SIZE: f32 = 1.0;

/// Buffers of [`ShepardBasis::expand`].
#[derive(Debug, Default)]
pub struct LayeredScratch {
    partial: Vec<Partial>,
    /// The weights on the level that is looked at, by query.
    found: Vec<Vec<Weight>>,
    /// Functions of that level, group by group.
    ids: Vec<u32>,
}

/// An expansion as far as some level.
#[derive(Debug, Default)]
struct Partial {
    expansion: Vec<Weight>,
    /// Weights, summing to 1, on the finest level so far; empty where none has any.
    here: Vec<Weight>,
    /// The part of these on functions around which there are finer ones.
    refined: f32,
    /// What of the whole is not in `expansion` yet.
    share: f32,
}

impl ShepardBasis {
    /// Calls `visit` with the index of each of `queries`, in order, and with the weights of [`Layered`](crate::Layered) there on functions
    /// of the `n_levels` coarsest levels, with their [flat indices](Self::flat_index), coarse to fine and ascending, summing to 1;
    /// empty where no function is, and in dark regions.
    ///
    /// What is found at a query does not depend on the others. It is found faster where neighbours follow each other.
    pub fn expand(
        &self,
        n_levels: usize,
        queries: &[OrientedPoint],
        scratch: &mut LayeredScratch,
        mut visit: impl FnMut(usize, &mut Vec<Weight>, Coverage),
    ) {
        self.expand_by_level(n_levels, queries, scratch);
        for (i, (query, partial)) in queries.iter().zip(&mut scratch.partial).enumerate() {
            let mut coverage = Coverage { queries: 1, ..Coverage::default() };
            if partial.expansion.is_empty() && query.region != RegionId::DARK {
                match self.nearest_on_any_level(n_levels, query) {
                    Some((level, i)) => {
                        coverage.nearest = 1;
                        partial.expansion.push(Weight { function: self.flat_index(level, i), weight: 1.0 });
                    }
                    None => coverage.uncovered = 1,
                }
            }
            visit(i, &mut partial.expansion, coverage);
        }
    }

    /// Leaves the expansions in `scratch.partial`; those of queries that no function covers empty.
    fn expand_by_level(&self, n_levels: usize, queries: &[OrientedPoint], scratch: &mut LayeredScratch) {
        scratch.partial.resize_with(queries.len(), Partial::default);
        scratch.found.resize_with(queries.len(), Vec::new);
        for (partial, query) in scratch.partial.iter_mut().zip(queries) {
            partial.expansion.clear();
            partial.here.clear();
            partial.share = if query.region == RegionId::DARK { 0.0 } else { 1.0 };
        }
        let Some(finest) = n_levels.checked_sub(1) else { return };
        let columns = Columns::new(queries.iter());
        let groups = runs_of_neighbors(queries, MAX_GROUP, GROUP_SIZE * self.support(finest));
        let mut first_id = 0;
        for level in 0..n_levels {
            self.find_weights(level, (queries, &columns), &groups, scratch);
            for (partial, found) in scratch.partial.iter_mut().zip(&mut scratch.found) {
                if partial.share > 0.0 {
                    self.go_finer((level, level == finest), first_id, partial, found);
                }
            }
            first_id += self.n_functions(level) as u32;
        }
    }

    /// Leaves the unnormalised weights of the functions of `level` in `scratch.found`, ascending; nothing for groups of which
    /// everything is in the expansions already.
    fn find_weights(
        &self,
        level: usize,
        (queries, columns): (&[OrientedPoint], &Columns),
        groups: &[Range<usize>],
        LayeredScratch { partial, found, ids }: &mut LayeredScratch,
    ) {
        found.iter_mut().for_each(Vec::clear);
        ids.clear();
        let (points, footprint) = (self.points(level), self.footprint(level));
        let mut ends = Vec::with_capacity(groups.len());
        for group in groups {
            let start = ids.len();
            if partial[group.clone()].iter().any(|p| p.share > 0.0) {
                let members = &queries[group.clone()];
                let (center, radius) = ball_around(members);
                let may_answer = |point: &OrientedPoint| {
                    point.region == members[0].region && members.iter().any(|q| q.normal.dot(point.normal) > 0.0)
                };
                self.tree(level).within(center, MARGIN * (footprint.support() + radius), |id, _| {
                    ids.extend(may_answer(&points[id as usize]).then_some(id));
                });
                ids[start..].sort_unstable();
            }
            ends.push(ids.len());
        }
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let with_ids = starts.zip(&ends).zip(groups).map(|((start, &end), group)| (&ids[start..end], group.len()));
        list_weights(self.functions(level), &footprint, columns, with_ids.collect(), found);
    }

    /// Moves what `level`, which has these weights, does not take over from the level before into the expansion, and all that is left
    /// where nothing is finer. `first_id` is the flat index of its first function.
    fn go_finer(
        &self,
        (level, is_finest): (usize, bool),
        first_id: u32,
        partial: &mut Partial,
        found: &mut Vec<Weight>,
    ) {
        let sum: f32 = found.iter().map(|w| w.weight).sum();
        let is_covered = sum >= MIN_WEIGHT_SUM;
        if !partial.here.is_empty() {
            let finer_share = if is_covered { partial.refined * (sum / FULL_COVERAGE).min(1.0) } else { 0.0 };
            partial.put(1.0 - finer_share, first_id - self.n_functions(level - 1) as u32);
        }
        if !is_covered || partial.share == 0.0 {
            return;
        }
        found.iter_mut().for_each(|w| w.weight /= sum);
        std::mem::swap(&mut partial.here, found);
        let of_level = &self.hierarchy().levels[level];
        let refined = partial.here.iter().filter(|w| of_level.is_refined(w.function)).map(|w| w.weight);
        partial.refined = refined.sum::<f32>().min(1.0);
        if is_finest || partial.refined == 0.0 {
            partial.put(1.0, first_id);
        }
    }
}

/// Centre and radius of a ball around these points.
fn ball_around(points: &[OrientedPoint]) -> (Vec3, f32) {
    let first = points[0].position;
    let (min, max) = points.iter().fold((first, first), |(min, max), p| (min.min(p.position), max.max(p.position)));
    (0.5 * (min + max), 0.5 * min.distance(max))
}

impl Partial {
    /// Moves this part of what is left into the expansion, as it is spread over functions whose flat indices begin at `first_id`.
    fn put(&mut self, part: f32, first_id: u32) {
        let share = self.share * part;
        if share > 0.0 {
            let weight = |w: &Weight| Weight { function: first_id + w.function, weight: share * w.weight };
            self.expansion.extend(self.here.iter().map(weight));
        }
        self.share *= 1.0 - part;
    }
}

/// Cuts a list into runs of points that are in one region and in a box of this diagonal (scene space), of at most `most` points each.
fn runs_of_neighbors(points: &[OrientedPoint], most: usize, diagonal: f32) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    let (mut min, mut max) = (Vec3::ZERO, Vec3::ZERO);
    for (i, point) in points.iter().enumerate() {
        let (low, high) = (min.min(point.position), max.max(point.position));
        let is_near = |run: &&mut Range<usize>| {
            run.len() < most && points[run.start].region == point.region && low.distance(high) <= diagonal
        };
        match runs.last_mut().filter(is_near) {
            Some(run) => (run.end, min, max) = (i + 1, low, high),
            None => {
                runs.push(i..i + 1);
                (min, max) = (point.position, point.position);
            }
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_end_with_their_region_their_box_and_their_length() {
        let at = |(x, region): (f32, u32)| OrientedPoint::new(Vec3::new(x, 0.0, 0.0), Vec3::Z, RegionId(region));
        let points: Vec<OrientedPoint> =
            [(0.0, 0), (0.4, 0), (-0.5, 0), (-0.6, 0), (-0.6, 1), (-0.6, 1), (-0.6, 1), (-0.6, 1)].map(at).into();
        assert_eq!(runs_of_neighbors(&points, 3, 1.0), [0..3, 3..4, 4..7, 7..8]);
        assert!(runs_of_neighbors(&[], 3, 1.0).is_empty());
    }
}
