//! One maximal Poisson-disk level, by dart throwing in a fixed order.

use glam::{IVec3, Vec3};
use hplt_geom::{OrientedPoint, parallel};

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
/// infinite when the regions differ or the normals are more than 60° apart.
///
/// A candidate that is nearer than `r` has the weight `K(d/2r)·(n·nᵢ)² >= 0.125` in a basis of support `2r`, which is what
/// makes coverage a theorem: every candidate of a maximal set is either a point of it or that near to one.
pub fn rejection_distance_squared(point: &OrientedPoint, candidate: &OrientedPoint) -> f32 {
    let cos = point.normal.dot(candidate.normal);
    if point.region != candidate.region || cos < MIN_REJECTION_COSINE {
        return f32::INFINITY;
    }
    distance_squared(point, candidate.position) / (cos * cos)
}

/// A level while it grows: accepted points in a hash grid.
#[derive(Debug)]
pub(crate) struct Level {
    radius: f32,
    points: Vec<OrientedPoint>,
    /// The point that was put into the same cell before.
    previous: Vec<u32>,
    /// The last point put into each cell; a power of two of cells.
    last: Vec<u32>,
}

impl Level {
    /// An empty level that expects about `n` points.
    pub(crate) fn new(radius: f32, n: usize) -> Self {
        let last = vec![NONE; (2 * n).next_power_of_two().max(64)];
        Self { radius, points: Vec::new(), previous: Vec::new(), last }
    }

    pub(crate) fn len(&self) -> usize {
        self.points.len()
    }

    /// Accepts or rejects candidates, lower index first. `order` lists the indices of one batch, ascending or not; the
    /// nearer its neighbours are to each other, the faster.
    pub(crate) fn throw(&mut self, candidates: &[OrientedPoint], order: &[u32]) {
        // Most are rejected by what earlier batches left; what is not is settled in order.
        let open = parallel::map(
            order.len().div_ceil(CHUNK),
            || (),
            |(), chunk| {
                let chunk = &order[chunk * CHUNK..order.len().min((chunk + 1) * CHUNK)];
                chunk.iter().copied().filter(|&i| !self.rejects(&candidates[i as usize])).collect::<Vec<_>>()
            },
        );
        let mut open = open.concat();
        open.sort_unstable();
        for i in open {
            let candidate = &candidates[i as usize];
            if !self.rejects(candidate) {
                self.insert(candidate);
            }
        }
    }

    fn insert(&mut self, point: &OrientedPoint) {
        let slot = self.slot(self.cell(point.position));
        self.previous.push(std::mem::replace(&mut self.last[slot], self.points.len() as u32));
        self.points.push(OrientedPoint { area: 0.0, ..*point });
    }

    pub(crate) fn rejects(&self, candidate: &OrientedPoint) -> bool {
        let limit = self.radius * self.radius;
        self.any_near(candidate.position, self.radius, |i| {
            rejection_distance_squared(&self.points[i as usize], candidate) < limit
        })
    }

    /// Whether any function of support `2r` has a weight at `point`.
    pub(crate) fn covers(&self, point: &OrientedPoint) -> bool {
        let support = 2.0 * self.radius;
        self.rejects(point)
            || self.any_near(point.position, support, |i| {
                let function = &self.points[i as usize];
                function.region == point.region
                    && function.normal.dot(point.normal) > 0.0
                    && distance_squared(function, point.position) < support * support
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
        let (low, high) = (self.cell(position - reach), self.cell(position + reach));
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                for x in low.x..=high.x {
                    let mut i = self.last[self.slot(IVec3::new(x, y, z))];
                    while i != NONE {
                        if test(i) {
                            return true;
                        }
                        i = self.previous[i as usize];
                    }
                }
            }
        }
        false
    }

    /// Cells are two radii wide, so that a reach of one radius meets at most eight.
    fn cell(&self, position: Vec3) -> IVec3 {
        (position * (0.5 / self.radius)).floor().as_ivec3()
    }

    fn slot(&self, cell: IVec3) -> usize {
        let [x, y, z] = cell.to_array().map(|c| c as u32);
        let hash = (x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ z.wrapping_mul(83_492_791))
            .wrapping_mul(0x9E37_79B1);
        (hash >> (32 - self.last.len().trailing_zeros().min(31))) as usize & (self.last.len() - 1)
    }

    /// The points in the order they were accepted, areas still 0.
    pub(crate) fn into_points(self) -> Vec<OrientedPoint> {
        self.points
    }
}
