use glam::Vec3;
use obvhs::Boundable;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

use super::BvhOptions;
use super::binary::{BinaryKind, BinaryNode, BinaryTree, Bounds, Primitive};
use super::top_down;
use crate::{Mesh, TriangleId};

/// Below this, the top-down builder is as fast, and PLOC has nothing to look for.
const FEW: usize = 4;
/// A grid cell with more triangles than this that stick out of it is crowded.
const CROWDED: usize = 256;
/// Bits per axis of the grid for [`is_crowded`].
const GRID_BITS: u32 = 10;

/// The padded box of every triangle that `is_visible`.
pub(super) fn primitives(mesh: &Mesh, is_visible: impl Fn(TriangleId) -> bool) -> Vec<Primitive> {
    (0..mesh.n_triangles() as u32)
        .filter(|&t| is_visible(TriangleId(t)))
        .map(|t| Primitive { bounds: padded_bounds(mesh.corners(TriangleId(t))), triangle: t })
        .collect()
}

/// A box that contains every place where the triangle test can report a hit. That test rounds the corners, relative to the
/// ray, to about 4 units in the last place of their distance. The part of it that grows with the distance to the ray's
/// origin is covered by the slab test; the part that grows with the triangle's own size is covered here, 4 times over.
fn padded_bounds([a, b, c]: [Vec3; 3]) -> Bounds {
    const PADDING: f32 = 1.0 / (1 << 20) as f32;
    let (min, max) = (a.min(b).min(c), a.max(b).max(c));
    let padding = PADDING * (max - min).max_element();
    let outward = |x: Vec3, sign: f32| (x + Vec3::splat(sign * padding)).to_array();
    Bounds {
        min: Vec3::from(outward(min, -1.0).map(f32::next_down)),
        max: Vec3::from(outward(max, 1.0).map(f32::next_up)),
    }
}

/// A binary tree over `primitives` with at most `64 + 2·log2(n)` levels, and whether it was built top-down.
pub(super) fn binary_tree(primitives: &[Primitive], options: BvhOptions) -> (BinaryTree, bool) {
    let limit = depth_limit(primitives.len());
    if primitives.len() > FEW && !is_crowded(primitives) {
        let tree = ploc(primitives, options);
        if tree.depth() <= limit {
            return (tree, false);
        }
    }
    let tree = top_down::build(primitives, 60);
    assert!(tree.depth() <= limit, "median splits bound the depth");
    (tree, true)
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
    let boxes: Vec<Boxed> =
        primitives.iter().map(|p| Boxed(Aabb { min: p.bounds.min.into(), max: p.bounds.max.into() })).collect();
    let indices = (0..boxes.len() as u32).collect();
    let (distance, near_rounds) =
        if options.search_far { (PlocSearchDistance::Medium, 2) } else { (PlocSearchDistance::Minimum, 0) };
    let mut tree =
        PlocBuilder::with_capacity(boxes.len()).build(distance, &boxes, indices, SortPrecision::U64, near_rounds);
    ReinsertionOptimizer::default().run(&mut tree, options.reinsertion, None);
    from_obvhs(&tree, primitives)
}

fn from_obvhs(tree: &Bvh2, primitives: &[Primitive]) -> BinaryTree {
    let nodes = tree.nodes.iter().map(|node| {
        let kind = if node.is_leaf() {
            let index = tree.primitive_indices[node.first_index as usize];
            BinaryKind::Leaf(primitives[index as usize].triangle)
        } else {
            BinaryKind::Inner(node.first_index)
        };
        let Aabb { min, max } = *node.aabb();
        BinaryNode { bounds: Bounds { min: min.into(), max: max.into() }, kind }
    });
    BinaryTree { nodes: nodes.collect() }
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
            let Bounds { min, max } = padded_bounds(corners);
            assert!(corners.iter().all(|c| c.cmpgt(min).all() && c.cmplt(max).all()));
        }
    }
}
