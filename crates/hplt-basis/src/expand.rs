//! The layered expansion at many queries: those near each other share the search for functions, which are then evaluated for as many
//! queries at once as the processor's vectors have lanes.

use glam::Vec3;
use hplt_geom::{OrientedPoint, RegionId};

use crate::cells::MARGIN;
use crate::lanes::{Columns, list_weights};
use crate::{Coverage, MIN_WEIGHT_SUM, ShepardBasis, Weight};

/// Weights of a level this large, on and off its functions, are full coverage: what Poisson-disk sets guarantee.
const FULL_COVERAGE: f32 = 0.125;
/// Queries that share a search, at most: as many as two of the widest vectors hold,
const MAX_GROUP: usize = 32;
/// and how far from the middle between the first of them and the farthest others may be, in supports of the finest level.
const GROUP_REACH: f32 = 0.5;

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

/// Queries in a row, in one region, that are near each other.
struct Group {
    n_queries: usize,
    region: RegionId,
    min: Vec3,
    max: Vec3,
}

impl Group {
    fn of(query: &OrientedPoint) -> Self {
        Self { n_queries: 1, region: query.region, min: query.position, max: query.position }
    }

    /// Whether `query` joined it.
    fn takes(&mut self, query: &OrientedPoint, reach: f32) -> bool {
        let (min, max) = (self.min.min(query.position), self.max.max(query.position));
        let is_near = self.n_queries < MAX_GROUP && query.region == self.region && min.distance(max) <= 2.0 * reach;
        if is_near {
            (self.n_queries, self.min, self.max) = (self.n_queries + 1, min, max);
        }
        is_near
    }
}

/// Groups of consecutive queries, with at most `reach` from their middle to any of them.
fn groups_of(queries: &[OrientedPoint], reach: f32) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for query in queries {
        if !groups.last_mut().is_some_and(|group| group.takes(query, reach)) {
            groups.push(Group::of(query));
        }
    }
    groups
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
        let groups = groups_of(queries, GROUP_REACH * self.support(finest));
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
        groups: &[Group],
        LayeredScratch { partial, found, ids }: &mut LayeredScratch,
    ) {
        found.iter_mut().for_each(Vec::clear);
        ids.clear();
        let (points, footprint) = (self.points(level), self.footprint(level));
        let (mut ends, mut first) = (Vec::with_capacity(groups.len()), 0);
        for group in groups {
            let members = first..first + group.n_queries;
            let start = ids.len();
            if partial[members.clone()].iter().any(|p| p.share > 0.0) {
                let reach = footprint.support() * MARGIN + 0.5 * group.min.distance(group.max) * MARGIN;
                let faces = |point: &OrientedPoint| queries[members.clone()].iter().any(|q| q.normal.dot(point.normal) > 0.0);
                self.tree(level).within(0.5 * (group.min + group.max), reach, |id, _| {
                    let point = &points[id as usize];
                    if point.region == group.region && faces(point) {
                        ids.push(id);
                    }
                });
                ids[start..].sort_unstable();
            }
            ends.push(ids.len());
            first = members.end;
        }
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let with_ids = starts.zip(&ends).zip(groups).map(|((start, &end), group)| (&ids[start..end], group.n_queries));
        list_weights(self.functions(level), &footprint, columns, with_ids.collect(), found);
    }

    /// Moves what `level`, which has these weights, does not take over from the level before into the expansion, and all that is left
    /// where nothing is finer. `first_id` is the flat index of its first function.
    fn go_finer(&self, (level, is_finest): (usize, bool), first_id: u32, partial: &mut Partial, found: &mut Vec<Weight>) {
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
