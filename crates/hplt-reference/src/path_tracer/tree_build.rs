//! A binary tree over triangle boxes by binned surface area heuristic (Wald 2007).

use hplt_geom::glam::Vec3;

const N_BINS: usize = 16;
const MAX_LEAF: usize = 4;
/// Cost of a node visit in units of a triangle test.
const NODE_COST: f32 = 0.8;
/// Below this many triangles a subtree is built on the spot.
#[cfg(feature = "rayon")]
const PARALLEL: usize = 8192;
/// Deeper than this, a subtree is split in the middle, which bounds the depth.
const MAX_SAH_DEPTH: usize = 48;

#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub(super) min: Vec3,
    pub(super) max: Vec3,
}

impl Bounds {
    pub(super) const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    pub(super) fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    pub(super) fn half_area(self) -> f32 {
        let d = self.max - self.min;
        if d.x < 0.0 { 0.0 } else { d.x * d.y + d.y * d.z + d.z * d.x }
    }
}

#[derive(Debug)]
pub(super) enum Binary {
    Leaf { bounds: Bounds, triangles: Vec<u32> },
    Inner { bounds: Bounds, children: Box<[Binary; 2]> },
}

impl Binary {
    pub(super) fn bounds(&self) -> Bounds {
        match self {
            Self::Leaf { bounds, .. } | Self::Inner { bounds, .. } => *bounds,
        }
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Item {
    pub(super) bounds: Bounds,
    pub(super) triangle: u32,
}

impl Item {
    /// Twice the centre: the factor does not matter.
    fn centre(&self) -> Vec3 {
        self.bounds.min + self.bounds.max
    }
}

/// The tree over `items`, which end up in another order.
pub(super) fn build(items: &mut [Item], depth: usize) -> Binary {
    let bounds = items.iter().fold(Bounds::EMPTY, |b, item| b.union(item.bounds));
    let split = if depth < MAX_SAH_DEPTH { best_split(items, bounds) } else { None };
    let middle = match split {
        Some((axis, plane, cost)) if items.len() > MAX_LEAF || cost < items.len() as f32 => {
            partition(items, |item| item.centre()[axis] < plane)
        }
        _ if items.len() <= MAX_LEAF => {
            let mut triangles: Vec<u32> = items.iter().map(|item| item.triangle).collect();
            triangles.sort_unstable();
            return Binary::Leaf { bounds, triangles };
        }
        _ => median(items, bounds),
    };
    let (left, right) = items.split_at_mut(middle);
    Binary::Inner { bounds, children: Box::new(both(left, right, depth + 1)) }
}

#[cfg(feature = "rayon")]
fn both(left: &mut [Item], right: &mut [Item], depth: usize) -> [Binary; 2] {
    if left.len() + right.len() < PARALLEL {
        return [build(left, depth), build(right, depth)];
    }
    let (left, right) = rayon::join(|| build(left, depth), || build(right, depth));
    [left, right]
}

#[cfg(not(feature = "rayon"))]
fn both(left: &mut [Item], right: &mut [Item], depth: usize) -> [Binary; 2] {
    [build(left, depth), build(right, depth)]
}

/// The cheapest plane between two bins: axis, position (in units of [`Item::centre`]) and cost.
fn best_split(items: &[Item], bounds: Bounds) -> Option<(usize, f32, f32)> {
    let centres = items.iter().fold(Bounds::EMPTY, |b, item| {
        let c = item.centre();
        Bounds { min: b.min.min(c), max: b.max.max(c) }
    });
    let extent = centres.max - centres.min;
    let mut best: Option<(usize, f32, f32)> = None;
    for axis in 0..3 {
        if extent[axis].is_nan() || extent[axis] <= 0.0 {
            continue;
        }
        let scale = N_BINS as f32 / extent[axis];
        let mut bins = [(Bounds::EMPTY, 0usize); N_BINS];
        for item in items {
            let bin = (((item.centre()[axis] - centres.min[axis]) * scale) as usize).min(N_BINS - 1);
            bins[bin].0 = bins[bin].0.union(item.bounds);
            bins[bin].1 += 1;
        }
        let mut right = [(0.0, 0usize); N_BINS];
        let mut sum = (Bounds::EMPTY, 0);
        for i in (1..N_BINS).rev() {
            sum = (sum.0.union(bins[i].0), sum.1 + bins[i].1);
            right[i] = (sum.0.half_area(), sum.1);
        }
        let mut sum = (Bounds::EMPTY, 0);
        for i in 1..N_BINS {
            sum = (sum.0.union(bins[i - 1].0), sum.1 + bins[i - 1].1);
            if sum.1 == 0 || right[i].1 == 0 {
                continue;
            }
            let area = sum.0.half_area() * sum.1 as f32 + right[i].0 * right[i].1 as f32;
            let cost = NODE_COST + area / bounds.half_area().max(f32::MIN_POSITIVE);
            if best.is_none_or(|b| cost < b.2) {
                best = Some((axis, centres.min[axis] + i as f32 / scale, cost));
            }
        }
    }
    best
}

/// Moves the items for which `left` holds to the front, and says how many; never none or all of them.
fn partition(items: &mut [Item], left: impl Fn(&Item) -> bool) -> usize {
    let mut n_left = 0;
    for i in 0..items.len() {
        if left(&items[i]) {
            items.swap(i, n_left);
            n_left += 1;
        }
    }
    // Rounding can put the plane a hair beside the bins.
    n_left.clamp(1, items.len() - 1)
}

/// Sorts along the longest axis and halves.
fn median(items: &mut [Item], bounds: Bounds) -> usize {
    let extent = bounds.max - bounds.min;
    let axis = (0..3).fold(0, |best, i| if extent[i] > extent[best] { i } else { best });
    let key = |item: &Item| item.centre()[axis];
    items.sort_unstable_by(|a, b| key(a).total_cmp(&key(b)).then(a.triangle.cmp(&b.triangle)));
    items.len() / 2
}
