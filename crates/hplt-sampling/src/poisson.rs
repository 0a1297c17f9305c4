//! One maximal Poisson-disk level, by dart throwing in a fixed order.

use glam::{IVec3, Vec3};
use hplt_geom::{Extent, OrientedPoint, parallel};

/// The least cosine between the normals of a point and of one that rejects it.
pub const MIN_REJECTION_COSINE: f32 = 0.5;

/// Candidates checked by one task.
const CHUNK: usize = 1024;
const NONE: u32 = u32::MAX;

/// The square of the distance `|Δ + 2 (Δ·n) n|` from `center` (with unit normal `n`) to `position`: heights count three
/// times (Lehtinen et al. 2008).
pub fn distance_squared(center: &OrientedPoint, position: Vec3) -> f32 {
    let offset = position - center.position;
    let height = offset.dot(center.normal);
    offset.length_squared() + 8.0 * height * height
}

/// How near `candidate` is to `point` as far as rejection goes: the square of `dᵢ/(n·nᵢ)`, to be compared with `r²`;
/// infinite when the regions or layers differ or the normals are more than 60° apart.
///
/// A candidate that is nearer than `r` has the weight `K(d/2r)·(n·nᵢ)² >= 0.125` in a basis of support `2r`, which is what
/// makes coverage a theorem: every candidate of a maximal set is either a point of it or that near to one.
pub fn rejection_distance_squared(point: &OrientedPoint, candidate: &OrientedPoint) -> f32 {
    let cos = point.normal.dot(candidate.normal);
    if cos < MIN_REJECTION_COSINE || !point.is_continued_at(candidate) {
        return f32::INFINITY;
    }
    distance_squared(point, candidate.position) / (cos * cos)
}

/// A level while it grows: accepted points in a hash grid. Those of earlier batches lie cell by cell; those that have
/// come since hang in lists.
#[derive(Debug)]
pub(crate) struct Level {
    radius: f32,
    cells_per_unit: f32,
    points: Vec<OrientedPoint>,
    /// Points of slot `s` are `starts[s]..starts[s + 1]`, and those of its list.
    starts: Vec<u32>,
    /// The last of the newer points in each slot; a power of two of slots.
    last: Vec<u32>,
    /// For each newer point the one that was put into the same slot before.
    previous: Vec<u32>,
}

impl Level {
    /// An empty level that expects about `n` points.
    pub(crate) fn new(radius: f32, n: usize) -> Self {
        let n_slots = n.next_power_of_two().max(64);
        Self {
            radius,
            cells_per_unit: 0.5 / radius,
            points: Vec::new(),
            starts: vec![0; n_slots + 1],
            last: vec![NONE; n_slots],
            previous: Vec::new(),
        }
    }

    /// Puts all points into the order of their slots.
    pub(crate) fn settle(&mut self) {
        if self.previous.is_empty() {
            return;
        }
        let slots: Vec<u32> = self.points.iter().map(|p| self.slot(self.cell(p.position)) as u32).collect();
        let mut ends = vec![0u32; self.starts.len()];
        slots.iter().for_each(|&slot| ends[slot as usize + 1] += 1);
        for slot in 1..ends.len() {
            ends[slot] += ends[slot - 1];
        }
        self.starts.copy_from_slice(&ends);
        let mut order = vec![0u32; self.points.len()];
        for (i, &slot) in slots.iter().enumerate() {
            order[ends[slot as usize] as usize] = i as u32;
            ends[slot as usize] += 1;
        }
        self.points = order.iter().map(|&i| self.points[i as usize]).collect();
        self.previous.clear();
        self.last.fill(NONE);
    }

    /// The Poisson radius, scene units.
    pub(crate) fn radius(&self) -> f32 {
        self.radius
    }

    pub(crate) fn len(&self) -> usize {
        self.points.len()
    }

    /// Accepts or rejects candidates, lower index first. `order` lists the indices of one batch, ascending or not; the
    /// nearer its neighbours are to each other, the faster.
    ///
    /// `extent_of` measures the surroundings of a point that may be accepted.
    pub(crate) fn throw(
        &mut self,
        candidates: &[OrientedPoint],
        order: &[u32],
        extent_of: impl Fn(&OrientedPoint) -> Extent + Sync + Send,
    ) {
        self.settle();
        // Most are rejected by what earlier batches left; what is not is settled in order.
        let open = parallel::map(
            order.len().div_ceil(CHUNK),
            || (),
            |(), chunk| {
                let chunk = &order[chunk * CHUNK..order.len().min((chunk + 1) * CHUNK)];
                let mut guess = NONE;
                let is_open = |&i: &u32| !self.rejects_guessing(&candidates[i as usize], &mut guess);
                chunk.iter().copied().filter(is_open).collect::<Vec<_>>()
            },
        );
        let mut open = open.concat();
        open.sort_unstable();
        let extents = parallel::map(open.len(), || (), |(), k| extent_of(&candidates[open[k] as usize]));
        for (i, extent) in open.into_iter().zip(extents) {
            let candidate = &candidates[i as usize];
            if !self.rejects(candidate) {
                self.insert(&OrientedPoint { extent, ..*candidate });
            }
        }
    }

    fn insert(&mut self, point: &OrientedPoint) {
        let slot = self.slot(self.cell(point.position));
        debug_assert!(self.points.len() < NONE as usize);
        self.previous.push(std::mem::replace(&mut self.last[slot], self.points.len() as u32));
        self.points.push(OrientedPoint { area: 0.0, ..*point });
    }

    pub(crate) fn rejects(&self, candidate: &OrientedPoint) -> bool {
        self.rejects_guessing(candidate, &mut { NONE })
    }

    /// Whether any point rejects `candidate`; tries `guess` first and leaves there who did.
    fn rejects_guessing(&self, candidate: &OrientedPoint, guess: &mut u32) -> bool {
        let limit = self.radius * self.radius;
        let rejects = |point: &OrientedPoint| rejection_distance_squared(point, candidate) < limit;
        self.points.get(*guess as usize).is_some_and(rejects)
            || self.any_near(candidate.position, self.radius, |i| {
                let found = rejects(&self.points[i as usize]);
                if found {
                    *guess = i;
                }
                found
            })
    }

    /// Whether any function of support `2r` has a weight at `point`.
    pub(crate) fn covers(&self, point: &OrientedPoint) -> bool {
        let support = 2.0 * self.radius;
        self.rejects(point)
            || self.any_near(point.position, support, |i| {
                let function = &self.points[i as usize];
                function.is_continued_at(point) && distance_squared(function, point.position) < support * support
            })
    }

    /// The point that rejects `candidate` from nearest by; the lowest index among equals.
    pub(crate) fn nearest(&self, candidate: &OrientedPoint) -> Option<u32> {
        let mut best = (self.radius * self.radius, NONE);
        self.any_near(candidate.position, self.radius, |i| {
            let distance = rejection_distance_squared(&self.points[i as usize], candidate);
            if distance < best.0 || (distance == best.0 && i < best.1) {
                best = (distance, i);
            }
            false
        });
        (best.1 != NONE).then_some(best.1)
    }

    /// Whether `test` holds for any point whose cell is within `reach` of `position`. Stops at the first.
    fn any_near(&self, position: Vec3, reach: f32, mut test: impl FnMut(u32) -> bool) -> bool {
        let n_settled = self.points.len() - self.previous.len();
        let mut any_in = |cell| {
            let slot = self.slot(cell);
            if (self.starts[slot]..self.starts[slot + 1]).any(&mut test) {
                return true;
            }
            if n_settled == self.points.len() {
                return false;
            }
            let mut i = self.last[slot];
            while i != NONE {
                if test(i) {
                    return true;
                }
                i = self.previous[i as usize - n_settled];
            }
            false
        };
        // The cell of the position itself most often has the answer.
        let center = self.cell(position);
        if any_in(center) {
            return true;
        }
        let (low, high) = (self.cell(position - reach), self.cell(position + reach));
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                for x in low.x..=high.x {
                    let cell = IVec3::new(x, y, z);
                    if cell != center && any_in(cell) {
                        return true;
                    }
                }
            }
        }
        false
    }

    /// Cells are two radii wide, so that a reach of one radius meets at most eight.
    fn cell(&self, position: Vec3) -> IVec3 {
        let p = position * self.cells_per_unit;
        // floor(), without a call on processors that lack the instruction.
        let truncated = p.as_ivec3();
        truncated - IVec3::from(p.cmplt(truncated.as_vec3()))
    }

    fn slot(&self, cell: IVec3) -> usize {
        let [x, y, z] = cell.to_array().map(|c| c as u32);
        let mixed = x
            .wrapping_mul(0x9E37_79B1)
            .wrapping_add(y.wrapping_mul(0x85EB_CA77))
            .wrapping_add(z.wrapping_mul(0xC2B2_AE3D));
        let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x27D4_EB2F);
        ((mixed ^ (mixed >> 16)) as usize) & (self.last.len() - 1)
    }

    /// The points in the order they were accepted, areas still 0.
    pub(crate) fn into_points(self) -> Vec<OrientedPoint> {
        self.points
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Stage, Stream, unit_f32};
    use hplt_geom::RegionId;

    /// Candidates on two crossing sheets and a ball, in two regions, from both sides.
    fn candidates(n: u32) -> Vec<OrientedPoint> {
        let stream = Stream::new(4, Stage::Candidates);
        (0..n)
            .map(|i| {
                let words = stream.words(i, 0, 0);
                let (u, v) = (unit_f32(words[0]) - 0.5, unit_f32(words[1]) - 0.5);
                let side = if words[2] & 1 == 0 { 1.0 } else { -1.0 };
                let ball = crate::warp::uniform_cone(glam::Vec2::new(u + 0.5, v + 0.5), Vec3::Z, std::f32::consts::PI);
                let (position, normal) = match words[3] % 3 {
                    0 => (Vec3::new(u, v, 0.0), Vec3::Z),
                    1 => (Vec3::new(u, 0.0, v), Vec3::Y),
                    _ => (0.4 * ball, ball),
                };
                let region = RegionId(u32::from(position.x > 0.1));
                OrientedPoint::new(position, normal * side, region)
            })
            .collect()
    }

    /// One candidate after the other, against all accepted.
    fn greedy(candidates: &[OrientedPoint], radius: f32) -> Vec<OrientedPoint> {
        let mut accepted: Vec<OrientedPoint> = Vec::new();
        for candidate in candidates {
            if accepted.iter().all(|p| rejection_distance_squared(p, candidate) >= radius * radius) {
                accepted.push(*candidate);
            }
        }
        accepted
    }

    /// Batches in any order inside give what dart throwing one by one gives, and then every candidate is a point or has a
    /// weight of at least 0.125 in a basis of support `2r`.
    #[test]
    fn batches_equal_one_by_one_and_cover_every_candidate() {
        let candidates = candidates(20_000);
        for radius in [0.02f32, 0.07, 0.5] {
            let mut level = Level::new(radius, 100);
            for (start, end) in [(0, 700), (700, 5_000), (5_000, 20_000)] {
                level.throw(&candidates, &(start..end).rev().collect::<Vec<_>>(), |_| Extent::OPEN);
            }
            level.settle();
            let weight = |candidate: &OrientedPoint| {
                let function = &level.points[level.nearest(candidate).unwrap() as usize];
                let h = distance_squared(function, candidate.position).sqrt() / (2.0 * radius);
                let cos = function.normal.dot(candidate.normal);
                (1.0 - h * h * (3.0 - 2.0 * h)) * cos * cos
            };
            let least = candidates.iter().map(weight).fold(f32::INFINITY, f32::min);
            assert!(least >= 0.124_99, "{least}");
            assert!(candidates.iter().all(|c| level.rejects(c) && level.covers(c)));
            let key =
                |p: &OrientedPoint| (p.position.to_array().map(f32::to_bits), p.normal.to_array().map(f32::to_bits));
            let (mut ours, mut theirs) = (level.into_points(), greedy(&candidates, radius));
            ours.sort_by_key(key);
            theirs.sort_by_key(key);
            assert!(ours == theirs, "{} {}", ours.len(), theirs.len());
        }
    }

    /// The point that a candidate is counted for is the nearest, by linear search.
    #[test]
    fn the_nearest_is_the_nearest() {
        let candidates = candidates(3_000);
        let mut level = Level::new(0.1, 10);
        level.throw(&candidates, &(0..3_000).collect::<Vec<_>>(), |_| Extent::OPEN);
        for candidate in &candidates {
            let distances = level.points.iter().map(|p| rejection_distance_squared(p, candidate));
            let least = distances.fold(f32::INFINITY, f32::min);
            let found = level.nearest(candidate).map(|i| &level.points[i as usize]);
            assert_eq!(found.map(|p| rejection_distance_squared(p, candidate)), Some(least));
        }
        let far = OrientedPoint { position: Vec3::splat(0.9), ..candidates[0] };
        assert!(level.nearest(&far).is_none() && !level.rejects(&far) && !level.covers(&far));
        let elsewhere = OrientedPoint { region: RegionId(7), ..candidates[0] };
        assert!(!level.rejects(&elsewhere) && !level.covers(&elsewhere));
    }
}
