use glam::{Vec3, Vec3A};
use obvhs::Boundable;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

use obvhs::splits::split_aabbs_precise;
use obvhs::triangle::Triangle;

use super::BvhOptions;
use super::binary::{BinaryKind, BinaryNode, BinaryTree, Bounds, Primitive};
use super::top_down;
use crate::{Mesh, TriangleId, parallel};

/// Below this, the top-down builder is as fast, and PLOC has nothing to look for.
const FEW: usize = 4;
/// PLOC and reinsertion work on groups of at most so many boxes, which top-down splits make. Groups are built in parallel, and
/// what they need stays in the cache.
pub(super) const GROUP: usize = 1 << 17;
/// Levels below which top-down splits are at the median.
const MEDIAN_DEPTH: usize = 60;
/// A grid cell with more triangles than this that stick out of it is crowded.
const CROWDED: usize = 256;
/// Parts of large triangles that are always affordable.
const FREE_PARTS: usize = 1000;
/// Bits per axis of the grid for [`is_crowded`].
const GRID_BITS: u32 = 10;

/// The boxes of all triangles that are visible; `split` cuts large ones that fill their box badly into several.
pub(super) fn primitives(mesh: &Mesh, split: bool, is_visible: impl Fn(TriangleId) -> bool + Sync) -> Vec<Primitive> {
    const CHUNK: usize = 1 << 14;
    let n = mesh.n_triangles();
    let chunks = parallel::map(
        n.div_ceil(CHUNK),
        || (),
        |(), i| {
            let ids = (i * CHUNK..n.min((i + 1) * CHUNK)).map(|t| TriangleId(t as u32));
            let whole = |t: TriangleId| Primitive { bounds: bounds(mesh.corners(t)), triangle: t.0 };
            ids.filter(|&t| is_visible(t)).map(whole).collect::<Vec<_>>()
        },
    );
    let mut primitives = chunks.concat();
    if split {
        split_large(mesh, &mut primitives);
    }
    let chunks = parallel::map(
        primitives.len().div_ceil(CHUNK),
        || (),
        |(), i| {
            let chunk = &primitives[i * CHUNK..primitives.len().min((i + 1) * CHUNK)];
            let pad =
                |p: &Primitive| Primitive { bounds: padded(p.bounds, mesh.corners(TriangleId(p.triangle))), ..*p };
            chunk.iter().map(pad).collect::<Vec<_>>()
        },
    );
    chunks.concat()
}

fn bounds([a, b, c]: [Vec3; 3]) -> Bounds {
    Bounds { min: a.min(b).min(c), max: a.max(b).max(c) }
}

/// Cuts boxes much larger than the average in two, again and again, where that makes them smaller by enough, with the
/// thresholds of obvhs' own preset, but adding at most half as many boxes as there are triangles, or [`FREE_PARTS`].
fn split_large(mesh: &Mesh, primitives: &mut Vec<Primitive>) {
    let areas = || primitives.iter().map(|p| p.bounds.half_area());
    let average = (areas().map(f64::from).sum::<f64>() / primitives.len().max(1) as f64) as f32;
    let largest = areas().fold(0.0, f32::max);
    let large: Vec<usize> =
        (0..primitives.len()).filter(|&i| primitives[i].bounds.half_area() > 3.0 * average).collect();
    let budget = (primitives.len() / 2).max(FREE_PARTS);
    // Each round doubles the parts at most.
    let rounds = (1 + budget / large.len().max(1)).ilog2().min(12);
    if large.is_empty() || rounds == 0 {
        return;
    }
    let triangle = |&i: &usize| {
        let [v0, v1, v2] = mesh.corners(TriangleId(primitives[i].triangle)).map(Vec3A::from);
        Triangle { v0, v1, v2 }
    };
    let triangles: Vec<Triangle> = large.iter().map(triangle).collect();
    let mut boxes: Vec<Aabb> = large.iter().map(|&i| to_aabb(primitives[i].bounds)).collect();
    let mut indices: Vec<u32> = (0..boxes.len() as u32).collect();
    let upper = (4.0 * average).max(0.9 * average + 0.1 * largest);
    split_aabbs_precise(&mut boxes, &mut indices, &triangles, 3.0 * average, upper, 1.8, 1.6, rounds, 12);
    for (part, (b, &index)) in boxes.iter().zip(&indices).enumerate() {
        let bounds = Bounds { min: b.min.into(), max: b.max.into() };
        let whole = large[index as usize];
        if part < large.len() {
            primitives[whole].bounds = bounds;
        } else {
            primitives.push(Primitive { bounds, ..primitives[whole] });
        }
    }
}

/// The box of a triangle, or of a part of it, grown so that it contains every place where the triangle test can report a
/// hit. That test rounds the corners, relative to the ray, to about 4 units in the last place of their distance. The part of
/// this error that grows with the distance to the ray's origin is covered by the slab test; the part that grows with the
/// triangle's own size is covered here, 4 times over, and so is the rounding of cuts.
fn padded(part: Bounds, corners: [Vec3; 3]) -> Bounds {
    const OF_SIZE: f32 = 1.0 / (1 << 20) as f32;
    const OF_COORDINATES: f32 = 1.0 / (1 << 21) as f32;
    let whole = bounds(corners);
    let mut padding = OF_SIZE * (whole.max - whole.min).max_element();
    if part != whole {
        padding += OF_COORDINATES * whole.min.abs().max(whole.max.abs()).max_element();
    }
    let outward = |x: Vec3, sign: f32| (x + Vec3::splat(sign * padding)).to_array();
    Bounds {
        min: Vec3::from(outward(part.min, -1.0).map(f32::next_down)),
        max: Vec3::from(outward(part.max, 1.0).map(f32::next_up)),
    }
}

fn to_aabb(Bounds { min, max }: Bounds) -> Aabb {
    Aabb { min: min.into(), max: max.into() }
}

/// A binary tree over `primitives` with at most `64 + 2·log2(n)` levels, and whether it was built top-down.
pub(super) fn binary_tree(primitives: &[Primitive], options: BvhOptions) -> (BinaryTree, bool) {
    let limit = depth_limit(primitives.len());
    let groups = top_down::groups(primitives, GROUP, MEDIAN_DEPTH);
    let trees =
        parallel::map(groups.ranges.len(), || (), |(), i| group_tree(&groups.items[groups.ranges[i].clone()], options));
    let is_top_down = primitives.len() <= FEW || trees.iter().any(|(_, is_crowded)| *is_crowded);
    let trees: Vec<BinaryTree> = trees.into_iter().map(|(tree, _)| tree).collect();
    let tree = groups.tree.grafted(&trees);
    if tree.depth() <= limit {
        return (tree, is_top_down);
    }
    let tree = top_down::build(primitives, MEDIAN_DEPTH);
    assert!(tree.depth() <= limit, "median splits bound the depth");
    (tree, true)
}

/// The tree of one group, and whether too many boxes share a place in it for PLOC.
fn group_tree(primitives: &[Primitive], options: BvhOptions) -> (BinaryTree, bool) {
    let is_crowded = is_crowded(primitives);
    if primitives.len() > FEW && !is_crowded {
        (ploc(primitives, options), false)
    } else {
        (top_down::build(primitives, MEDIAN_DEPTH), is_crowded)
    }
}

/// The deepest binary tree that is accepted.
pub(super) fn depth_limit(n: usize) -> usize {
    64 + 2 * n.max(1).ilog2() as usize
}

struct Boxed(Aabb);

impl Boundable for Boxed {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

/// Parallel locally-ordered clustering (Meister & Bittner 2018), then reinsertion (Meister & Bittner 2018b).
fn ploc(primitives: &[Primitive], options: BvhOptions) -> BinaryTree {
    let boxes: Vec<Boxed> = primitives.iter().map(|p| Boxed(to_aabb(p.bounds))).collect();
    let indices = (0..boxes.len() as u32).collect();
    let (distance, near_rounds) =
        if options.search_far { (PlocSearchDistance::Medium, 2) } else { (PlocSearchDistance::Minimum, 0) };
    let mut tree =
        PlocBuilder::with_capacity(boxes.len()).build(distance, &boxes, indices, SortPrecision::U64, near_rounds);
    ReinsertionOptimizer::default().run(&mut tree, options.reinsertion, None);
    from_obvhs(&tree, primitives)
}

fn from_obvhs(tree: &Bvh2, primitives: &[Primitive]) -> BinaryTree {
    BinaryTree::from_unordered(tree.nodes.len(), |i| {
        let node = &tree.nodes[i as usize];
        let kind = if node.is_leaf() {
            let index = tree.primitive_indices[node.first_index as usize];
            BinaryKind::Leaf(primitives[index as usize].triangle)
        } else {
            BinaryKind::Inner(node.first_index)
        };
        let Aabb { min, max } = *node.aabb();
        BinaryNode { bounds: Bounds { min: min.into(), max: max.into() }, kind }
    })
}

/// Whether many triangles share a place while being larger than it. PLOC merges only mutual nearest neighbours, of which
/// there are few among nested boxes, so its time becomes quadratic.
fn is_crowded(primitives: &[Primitive]) -> bool {
    let all = primitives.iter().fold(Bounds::EMPTY, |b, p| b.union(p.bounds));
    let cells = (1u32 << GRID_BITS) as f32;
    let scale = Vec3::splat(cells) / (all.max - all.min).max(Vec3::splat(f32::MIN_POSITIVE));
    let mut keys: Vec<u32> = primitives
        .iter()
        .filter(|p| ((p.bounds.max - p.bounds.min) * scale).max_element() > 4.0)
        .map(|p| {
            let cell = (p.bounds.doubled_center() * 0.5 - all.min) * scale;
            let [x, y, z] = cell.to_array().map(|c| (c as u32).min((1 << GRID_BITS) - 1));
            (x << (2 * GRID_BITS)) | (y << GRID_BITS) | z
        })
        .collect();
    keys.sort_unstable();
    keys.chunk_by(|a, b| a == b).any(|cell| cell.len() > CROWDED)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn padded_boxes_contain_their_corners_strictly() {
        for scale in [1e-6, 1.0, 1e8] {
            let corners = [Vec3::ZERO, Vec3::X, Vec3::Y].map(|p| p * scale + Vec3::splat(0.3 * scale));
            let Bounds { min, max } = padded(bounds(corners), corners);
            assert!(corners.iter().all(|c| c.cmpgt(min).all() && c.cmplt(max).all()));
        }
    }
}
