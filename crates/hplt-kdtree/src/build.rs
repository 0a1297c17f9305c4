use glam::Vec3;

use crate::{KdTree, LEAF_SIZE, MAX_POINTS, Node};

/// Subtrees below this many points are built by one thread.
#[cfg(feature = "rayon")]
const SERIAL_BELOW: usize = 4096;

impl KdTree {
    /// The tree over finite `points`, which may repeat. The id of a point is its index. The same at any thread count.
    /// O(n log n).
    ///
    /// # Panics
    /// With more than [`MAX_POINTS`] points.
    pub fn build(points: &[Vec3]) -> Self {
        assert!(points.len() <= MAX_POINTS, "{} points exceed the limit of {MAX_POINTS}", points.len());
        debug_assert!(points.iter().all(|p| p.is_finite()));
        let mut items: Vec<Item> =
            points.iter().enumerate().map(|(i, &p)| Item { position: p, id: i as u32 }).collect();
        let depth = depth_of(points.len());
        let mut nodes = vec![Node::leaf(0, 0); (2 << depth) - 1];
        build_subtree(&mut items, &mut nodes, 0, 0);
        Self {
            nodes,
            points: items.iter().map(|item| item.position).collect(),
            order: items.iter().map(|item| item.id).collect(),
        }
    }
}

#[derive(Clone, Copy)]
struct Item {
    position: Vec3,
    id: u32,
}

/// The smallest depth at which `n` points, halved at every level, fit the leaves.
fn depth_of(n: usize) -> u32 {
    n.div_ceil(LEAF_SIZE).next_power_of_two().trailing_zeros()
}

/// Fills `nodes` (a perfect tree, depth first) and puts `items` into leaf order. The indices of the first node and the
/// first item in the whole tree are `first_node` and `first_item`.
fn build_subtree(items: &mut [Item], nodes: &mut [Node], first_node: usize, first_item: usize) {
    if nodes.len() == 1 {
        items.sort_unstable_by_key(|item| item.id);
        nodes[0] = Node::leaf(first_item, items.len());
        return;
    }
    let axis = widest_axis(items);
    let half = items.len() / 2;
    let by_coordinate = |a: &Item, b: &Item| {
        let (x, y) = (a.position[axis], b.position[axis]);
        x.total_cmp(&y).then(a.id.cmp(&b.id))
    };
    let split = items.select_nth_unstable_by(half, by_coordinate).1.position[axis];
    let children = nodes.len() / 2;
    nodes[0] = Node::inner(split, axis, first_node + 1 + children);
    let (left_nodes, right_nodes) = nodes[1..].split_at_mut(children);
    let (left_items, right_items) = items.split_at_mut(half);
    let mut left = || build_subtree(left_items, left_nodes, first_node + 1, first_item);
    let mut right = || build_subtree(right_items, right_nodes, first_node + 1 + children, first_item + half);
    #[cfg(feature = "rayon")]
    if half >= SERIAL_BELOW {
        rayon::join(left, right);
        return;
    }
    left();
    right();
}

fn widest_axis(items: &[Item]) -> usize {
    let first = items[0].position;
    let (min, max) = items.iter().fold((first, first), |(min, max), i| (min.min(i.position), max.max(i.position)));
    (max - min).max_position()
}
