use glam::Vec3;

use crate::{KdTree, LEAF_SIZE, Node};

/// Enough for `MAX_POINTS` in leaves of `LEAF_SIZE`: at most one entry per level.
const STACK_SIZE: usize = 32;

/// A subtree to look at later, and the vector from the query to the nearest point of its cell.
#[derive(Clone, Copy)]
struct Pending {
    node: u32,
    offset: Vec3,
}

impl KdTree {
    /// Calls `visit(id, distance²)` for every point within `radius` of `center`, the boundary included, in leaf order
    /// of a traversal that depends on nothing but the tree and the query. Nothing for a negative or NaN radius.
    pub fn within(&self, center: Vec3, radius: f32, mut visit: impl FnMut(u32, f32)) {
        if self.is_empty() || radius.is_nan() || radius < 0.0 {
            return;
        }
        let limit = radius * radius;
        let mut stack = [Pending { node: 0, offset: Vec3::ZERO }; STACK_SIZE];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let Pending { mut node, offset } = stack[top];
            let leaf = loop {
                let here = self.nodes[node as usize];
                if here.is_leaf() {
                    break here;
                }
                let (near, far, far_offset) = step(here, node, center, offset);
                if length_squared(far_offset) <= limit {
                    stack[top] = Pending { node: far, offset: far_offset };
                    top += 1;
                }
                node = near;
            };
            let range = leaf.range();
            for (point, &id) in self.points[range.clone()].iter().zip(&self.order[range]) {
                let distance_squared = length_squared(*point - center);
                if distance_squared <= limit {
                    visit(id, distance_squared);
                }
            }
        }
    }

    /// The nearest point within `max_radius` of `center` (the boundary included) whose id `accept` agrees to, with its
    /// distance²; of equally near ones the one with the lowest id. `accept` is asked only about points that would be
    /// the best so far.
    pub fn nearest(&self, center: Vec3, max_radius: f32, accept: impl FnMut(u32) -> bool) -> Option<(u32, f32)> {
        let ([nearest], n) = self.few_nearest(center, max_radius, accept);
        (n == 1).then_some(nearest)
    }

    /// The `N` nearest points within `max_radius` of `center` (the boundary included) whose ids `accept` agrees to, with
    /// their distances², nearest first, and how many there are; of equally near ones those with the lowest ids. `accept` is
    /// asked only about points that would be among the best so far. One traversal; for a small `N`.
    pub fn few_nearest<const N: usize>(
        &self,
        center: Vec3,
        max_radius: f32,
        mut accept: impl FnMut(u32) -> bool,
    ) -> ([(u32, f32); N], usize) {
        // An id that loses every tie, at the largest distance that still counts.
        let mut best = [(u32::MAX, max_radius * max_radius); N];
        if !(self.is_empty() || N == 0 || max_radius.is_nan() || max_radius < 0.0) {
            self.search(center, &mut best, &mut accept);
        }
        let n = best.iter().take_while(|b| b.0 != u32::MAX).count();
        (best, n)
    }

    fn search<const N: usize>(&self, center: Vec3, best: &mut [(u32, f32); N], accept: &mut impl FnMut(u32) -> bool) {
        let mut stack = [Pending { node: 0, offset: Vec3::ZERO }; STACK_SIZE];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let Pending { mut node, offset } = stack[top];
            if length_squared(offset) > best[N - 1].1 {
                continue;
            }
            let leaf = loop {
                let here = self.nodes[node as usize];
                if here.is_leaf() {
                    break here;
                }
                let (near, far, far_offset) = step(here, node, center, offset);
                if length_squared(far_offset) <= best[N - 1].1 {
                    stack[top] = Pending { node: far, offset: far_offset };
                    top += 1;
                }
                node = near;
            };
            self.improve(leaf, center, best, accept);
        }
    }

    /// The nearest accepted point of the one leaf that `center` falls into, with its distance²; `None` when that leaf
    /// has none. One descent, no backtracking: usually, not always, the nearest of all.
    pub fn approximate_nearest(&self, center: Vec3, mut accept: impl FnMut(u32) -> bool) -> Option<(u32, f32)> {
        let mut node = 0;
        let leaf = loop {
            let here = *self.nodes.get(node)?;
            if here.is_leaf() {
                break here;
            }
            node = if center[here.axis()] < here.split { node + 1 } else { here.right() };
        };
        let range = leaf.range();
        let ids = &self.order[range.clone()];
        let mut distances = [f32::NAN; LEAF_SIZE];
        distances.iter_mut().zip(&self.points[range]).for_each(|(d, point)| *d = length_squared(*point - center));
        // Asking costs more than measuring: the nearest is asked first. Ids ascend within a leaf, which settles ties.
        loop {
            let least = least(&distances);
            let at = distances.iter().position(|&d| d == least)?;
            if accept(ids[at]) {
                return Some((ids[at], least));
            }
            distances[at] = f32::NAN;
        }
    }

    /// Puts the points of a leaf that are among the `N` best into `best`, which stays in order.
    fn improve<const N: usize>(
        &self,
        leaf: Node,
        center: Vec3,
        best: &mut [(u32, f32); N],
        accept: &mut impl FnMut(u32) -> bool,
    ) {
        let range = leaf.range();
        for (point, &id) in self.points[range.clone()].iter().zip(&self.order[range]) {
            let distance_squared = length_squared(*point - center);
            let is_before = |b: &(u32, f32)| distance_squared < b.1 || (distance_squared == b.1 && id < b.0);
            if is_before(&best[N - 1]) && accept(id) {
                let mut i = N - 1;
                while i > 0 && is_before(&best[i - 1]) {
                    best[i] = best[i - 1];
                    i -= 1;
                }
                best[i] = (id, distance_squared);
            }
        }
    }
}

/// The least that is not NaN, in a form for vector instructions.
#[inline]
fn least(values: &[f32; LEAF_SIZE]) -> f32 {
    const LANES: usize = 8;
    let mut least = [f32::INFINITY; LANES];
    for chunk in values.chunks_exact(LANES) {
        for (least, &value) in least.iter_mut().zip(chunk) {
            *least = if value < *least { value } else { *least };
        }
    }
    least.into_iter().fold(f32::INFINITY, f32::min)
}

/// The child that `center` falls into, the other one, and the offset from `center` to the other one's cell.
#[inline]
fn step(here: Node, index: u32, center: Vec3, offset: Vec3) -> (u32, u32, Vec3) {
    let axis = here.axis();
    let to_plane = here.split - center[axis];
    let (left, right) = (index + 1, here.right() as u32);
    let mut far_offset = offset;
    far_offset[axis] = to_plane;
    if to_plane > 0.0 { (left, right, far_offset) } else { (right, left, far_offset) }
}

/// The same sum in the same order for points and for cells, so that a cell is never farther than its points.
#[inline]
fn length_squared(v: Vec3) -> f32 {
    (v.x * v.x + v.y * v.y) + v.z * v.z
}
