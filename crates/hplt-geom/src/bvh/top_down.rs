//! A top-down builder: binned surface area heuristic, with a median split where binning does not help. Its depth is
//! bounded and its time is O(n log n) for any input, which PLOC cannot promise.

use std::ops::Range;

use super::binary::{BinaryKind, BinaryNode, BinaryTree, Bounds, Primitive};

const N_BINS: usize = 16;

/// A tree whose leaves are groups of primitives.
pub(super) struct Groups {
    /// Leaves hold the index of a group.
    pub(super) tree: BinaryTree,
    /// The primitives, group by group.
    pub(super) items: Vec<Primitive>,
    /// Where each group is.
    pub(super) ranges: Vec<Range<usize>>,
}

/// Builds over `primitives`. Below `median_depth` levels every split is at the median, so that the depth is at most
/// `median_depth + log2(n) + 1`.
pub(super) fn build(primitives: &[Primitive], median_depth: usize) -> BinaryTree {
    let Groups { mut tree, items, ranges } = groups(primitives, 1, median_depth);
    for node in &mut tree.nodes {
        if let BinaryKind::Leaf(group) = &mut node.kind {
            *group = items[ranges[*group as usize].start].triangle;
        }
    }
    tree
}

/// The upper part of such a tree: splits until no group has more than `largest` primitives.
pub(super) fn groups(primitives: &[Primitive], largest: usize, median_depth: usize) -> Groups {
    let mut items = primitives.to_vec();
    let mut tree = BinaryTree { nodes: Vec::with_capacity(2 * items.len() / largest + 1) };
    let mut ranges = Vec::new();
    if items.is_empty() {
        return Groups { tree, items, ranges };
    }
    let placeholder = BinaryNode { bounds: Bounds::EMPTY, kind: BinaryKind::Leaf(0) };
    tree.nodes.push(placeholder);
    let mut pending = vec![(0usize, 0..items.len(), 0usize)];
    while let Some((node, range, depth)) = pending.pop() {
        let part = &mut items[range.clone()];
        let bounds = part.iter().fold(Bounds::EMPTY, |b, p| b.union(p.bounds));
        if part.len() <= largest {
            tree.nodes[node] = BinaryNode { bounds, kind: BinaryKind::Leaf(ranges.len() as u32) };
            ranges.push(range);
            continue;
        }
        let middle = range.start + split(part, depth < median_depth);
        let first = tree.nodes.len();
        tree.nodes[node] = BinaryNode { bounds, kind: BinaryKind::Inner(first as u32) };
        tree.nodes.extend([placeholder; 2]);
        pending.push((first, range.start..middle, depth + 1));
        pending.push((first + 1, middle..range.end, depth + 1));
    }
    Groups { tree, items, ranges }
}

/// Reorders `items` and returns how many go to the left: at least one, and not all.
fn split(items: &mut [Primitive], try_bins: bool) -> usize {
    let centers = items.iter().fold(Bounds::EMPTY, |b, p| {
        let c = p.bounds.doubled_center();
        b.union(Bounds { min: c, max: c })
    });
    if try_bins && let Some(plane) = best_plane(items, centers) {
        return partition(items, |p| plane.bin_of(p) <= plane.last_left);
    }
    let axis = (centers.max - centers.min).max_position();
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| {
        let key = |p: &Primitive| p.bounds.doubled_center()[axis];
        key(a).total_cmp(&key(b)).then_with(|| size_order(a, b))
    });
    middle
}

/// A total order for triangles with the same centre: by size, then by id.
fn size_order(a: &Primitive, b: &Primitive) -> std::cmp::Ordering {
    a.bounds.half_area().total_cmp(&b.bounds.half_area()).then(a.triangle.cmp(&b.triangle))
}

struct Plane {
    axis: usize,
    origin: f32,
    scale: f32,
    last_left: usize,
}

impl Plane {
    /// `None` when the centres do not differ along `axis`.
    fn new(axis: usize, centers: Bounds) -> Option<Self> {
        let extent = centers.max[axis] - centers.min[axis];
        let scale = N_BINS as f32 / extent;
        (extent > 0.0 && scale.is_finite()).then_some(Self { axis, origin: centers.min[axis], scale, last_left: 0 })
    }

    fn bin_of(&self, p: &Primitive) -> usize {
        let x = (p.bounds.doubled_center()[self.axis] - self.origin) * self.scale;
        (x as usize).min(N_BINS - 1)
    }
}

/// The cheapest of the binned planes on the three axes; `None` when all centres fall together.
fn best_plane(items: &[Primitive], centers: Bounds) -> Option<Plane> {
    let planes: Vec<Plane> = (0..3).filter_map(|axis| Plane::new(axis, centers)).collect();
    let mut bins = [[(0usize, Bounds::EMPTY); N_BINS]; 3];
    for p in items {
        for (plane, bins) in planes.iter().zip(&mut bins) {
            let bin = &mut bins[plane.bin_of(p)];
            *bin = (bin.0 + 1, bin.1.union(p.bounds));
        }
    }
    let mut best: Option<(f32, Plane)> = None;
    for (plane, bins) in planes.into_iter().zip(&bins) {
        if let Some((cost, last_left)) = cheapest_cut(bins)
            && best.as_ref().is_none_or(|(lowest, _)| cost < *lowest)
        {
            best = Some((cost, Plane { last_left, ..plane }));
        }
    }
    best.map(|(_, plane)| plane)
}

/// The cost of the best cut and the last bin on its left; `None` when all items are in one bin.
fn cheapest_cut(bins: &[(usize, Bounds); N_BINS]) -> Option<(f32, usize)> {
    let mut right_cost = [0.0f32; N_BINS];
    let mut right_count = [0usize; N_BINS];
    let mut right = (0, Bounds::EMPTY);
    for i in (1..N_BINS).rev() {
        right = (right.0 + bins[i].0, right.1.union(bins[i].1));
        right_cost[i] = right.0 as f32 * right.1.half_area();
        right_count[i] = right.0;
    }
    let mut left = (0, Bounds::EMPTY);
    let mut best: Option<(f32, usize)> = None;
    for i in 0..N_BINS - 1 {
        left = (left.0 + bins[i].0, left.1.union(bins[i].1));
        let cost = left.0 as f32 * left.1.half_area() + right_cost[i + 1];
        let splits = left.0 > 0 && right_count[i + 1] > 0;
        if splits && best.is_none_or(|(lowest, _)| cost < lowest) {
            best = Some((cost, i));
        }
    }
    best
}

/// Moves the items that satisfy `goes_left` to the front and returns how many there are.
fn partition(items: &mut [Primitive], goes_left: impl Fn(&Primitive) -> bool) -> usize {
    let mut n_left = 0;
    for i in 0..items.len() {
        if goes_left(&items[i]) {
            items.swap(i, n_left);
            n_left += 1;
        }
    }
    n_left
}
