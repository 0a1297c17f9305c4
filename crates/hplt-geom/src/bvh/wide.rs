use std::collections::VecDeque;

use super::binary::{BinaryKind, BinaryTree, Bounds};
use super::triangle::Packet;
use crate::{Mesh, TriangleId, parallel};

/// Children of a node.
pub(super) const WIDTH: usize = 8;
/// Boxes that one leaf may hold: one packet of triangles.
const MAX_LEAF: usize = Packet::LANES;
/// Parts that the tree is made of in parallel, at least, unless it is small.
const PARTS: usize = 64;
/// Cost of testing the eight boxes of a node.
const NODE_COST: f32 = 1.0;
/// Cost of testing a packet of triangles.
const PACKET_COST: f32 = 1.0;

/// A node: the boxes of its children, one row of eight per plane, and what they are.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// Rows: minimum x, y, z, maximum x, y, z. An absent child has an inverted infinite box, which no ray meets.
    pub(super) planes: [[f32; WIDTH]; 6],
    pub(super) children: [Child; WIDTH],
}

/// The index of a node or of a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Child(u32);

impl Child {
    const LEAF: u32 = 1 << 31;
    pub(super) const NONE: Self = Self(u32::MAX);
    pub(super) const ROOT: Self = Self(0);

    fn node(index: usize) -> Self {
        assert!(index < Self::LEAF as usize, "too many nodes");
        Self(index as u32)
    }

    fn leaf(packet: usize) -> Self {
        assert!(packet < Self::LEAF as usize - 1, "too many packets");
        Self(Self::LEAF | packet as u32)
    }

    #[inline(always)]
    pub(super) fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }

    #[inline(always)]
    pub(super) fn node_index(self) -> usize {
        self.0 as usize
    }

    #[inline(always)]
    pub(super) fn packet_index(self) -> usize {
        (self.0 & !Self::LEAF) as usize
    }
}

/// The tree that rays walk. Node 0 is the root; there is none when there is no triangle.
#[derive(Debug, Clone, Default)]
pub(super) struct WideTree {
    pub(super) nodes: Vec<Node>,
    pub(super) packets: Vec<Packet>,
    depth: usize,
}

impl WideTree {
    pub(super) fn depth(&self) -> usize {
        self.depth
    }

    pub(super) fn memory(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.packets[..])
    }

    /// Puts `part` in the place of node `place`.
    fn graft(&mut self, place: usize, part: &Self) {
        // The root takes that place; whatever comes after it moves.
        let (node_offset, packet_offset) = (self.nodes.len() - 1, self.packets.len());
        let moved = |node: &Node| node.moved(node_offset, packet_offset);
        self.nodes.extend(part.nodes[1..].iter().map(moved));
        self.nodes[place] = part.nodes[0].moved(node_offset, packet_offset);
        self.packets.extend_from_slice(&part.packets);
        self.depth = self.depth.max(part.depth);
    }

    /// Entries that a traversal may have to keep.
    pub(super) fn stack_size(&self) -> usize {
        (WIDTH - 1) * self.depth + 1
    }
}

/// The wide tree of least expected cost that keeps the grouping of `binary`, and that cost relative to the root's area.
pub(super) fn collapse(
    binary: &BinaryTree,
    mesh: &Mesh,
    is_masked: impl Fn(TriangleId) -> bool + Sync,
) -> (WideTree, f32) {
    if binary.nodes.is_empty() {
        return (WideTree::default(), 0.0);
    }
    let emitter = Emitter { plan: Plan::new(binary), mesh, is_masked };
    let mut tree = WideTree::default();
    tree.nodes.push(EMPTY_NODE);
    let mut pending = VecDeque::from([Pending { binary: 0, node: 0, depth: 1 }]);
    while pending.len() < PARTS
        && let Some(next) = pending.pop_front()
    {
        emitter.emit(next, &mut tree, |child| pending.push_back(child));
    }
    let parts = parallel::map(pending.len(), || (), |(), i| emitter.subtree(pending[i]));
    tree.nodes.reserve(parts.iter().map(|part| part.nodes.len()).sum());
    tree.packets.reserve(parts.iter().map(|part| part.packets.len()).sum());
    for (pending, part) in pending.iter().zip(&parts) {
        tree.graft(pending.node, part);
    }
    let (cost, root_area) = (emitter.plan.cost[0][0], binary.nodes[0].bounds.half_area());
    (tree, if root_area > 0.0 { cost / root_area } else { 1.0 })
}

/// A wide node that is still to be filled.
#[derive(Clone, Copy)]
struct Pending {
    binary: u32,
    node: usize,
    depth: usize,
}

struct Emitter<'a, F> {
    plan: Plan<'a>,
    mesh: &'a Mesh,
    is_masked: F,
}

impl<F: Fn(TriangleId) -> bool> Emitter<'_, F> {
    /// The part of the tree below a node, with that node first.
    fn subtree(&self, root: Pending) -> WideTree {
        let mut tree = WideTree::default();
        tree.nodes.push(EMPTY_NODE);
        let mut pending = vec![Pending { node: 0, ..root }];
        while let Some(next) = pending.pop() {
            self.emit(next, &mut tree, |child| pending.push(child));
        }
        tree
    }

    /// Fills a node, makes its leaves, and announces its inner children.
    fn emit(&self, Pending { binary, node, depth }: Pending, tree: &mut WideTree, mut announce: impl FnMut(Pending)) {
        tree.depth = tree.depth.max(depth);
        for (lane, child) in self.plan.children(binary).into_iter().flatten().enumerate() {
            let entry = if self.plan.is_leaf[child as usize] {
                self.push_leaf(tree, child)
            } else {
                tree.nodes.push(EMPTY_NODE);
                let node = tree.nodes.len() - 1;
                announce(Pending { binary: child, node, depth: depth + 1 });
                Child::node(node)
            };
            tree.nodes[node].set(lane, self.plan.binary.nodes[child as usize].bounds, entry);
        }
    }

    fn push_leaf(&self, tree: &mut WideTree, root: u32) -> Child {
        let (members, n) = members(self.plan.binary, root);
        let mut packet = Packet::EMPTY;
        for (lane, &id) in members[..n].iter().enumerate() {
            let id = TriangleId(id);
            packet.set(lane, id, self.mesh.corners(id), (self.is_masked)(id));
        }
        tree.packets.push(packet);
        Child::leaf(tree.packets.len() - 1)
    }
}

/// The distinct triangles below a binary node, in ascending order, and how many there are.
fn members(binary: &BinaryTree, root: u32) -> ([u32; MAX_LEAF], usize) {
    let (mut members, mut n) = ([0; MAX_LEAF], 0);
    let (mut pending, mut n_pending) = ([root; MAX_LEAF], 1);
    while n_pending > 0 {
        n_pending -= 1;
        match binary.nodes[pending[n_pending] as usize].kind {
            BinaryKind::Leaf(triangle) => {
                let at = members[..n].partition_point(|&other| other < triangle);
                if at == n || members[at] != triangle {
                    members[at..=n].rotate_right(1);
                    members[at] = triangle;
                    n += 1;
                }
            }
            BinaryKind::Inner(first) => {
                pending[n_pending..n_pending + 2].copy_from_slice(&[first, first + 1]);
                n_pending += 2;
            }
        }
    }
    (members, n)
}

const EMPTY_NODE: Node = Node {
    planes: [
        [f32::INFINITY; WIDTH],
        [f32::INFINITY; WIDTH],
        [f32::INFINITY; WIDTH],
        [f32::NEG_INFINITY; WIDTH],
        [f32::NEG_INFINITY; WIDTH],
        [f32::NEG_INFINITY; WIDTH],
    ],
    children: [Child::NONE; WIDTH],
};

impl Node {
    /// With its inner children and its packets that many places further on.
    fn moved(&self, node_offset: usize, packet_offset: usize) -> Self {
        let children = self.children.map(|child| match child {
            Child::NONE => child,
            leaf if leaf.is_leaf() => Child::leaf(leaf.packet_index() + packet_offset),
            inner => Child::node(inner.node_index() + node_offset),
        });
        Self { children, ..*self }
    }

    fn set(&mut self, lane: usize, Bounds { min, max }: Bounds, child: Child) {
        for axis in 0..3 {
            self.planes[axis][lane] = min[axis];
            self.planes[axis + 3][lane] = max[axis];
        }
        self.children[lane] = child;
    }
}

/// Which binary nodes become wide nodes and which become leaves.
struct Plan<'a> {
    binary: &'a BinaryTree,
    /// `cost[n][i]`: least cost of the subtree of `n` as at most `i + 1` children of one wide node.
    cost: Vec<[f32; WIDTH]>,
    is_leaf: Vec<bool>,
}

impl<'a> Plan<'a> {
    fn new(binary: &'a BinaryTree) -> Self {
        let n = binary.nodes.len();
        let mut plan = Self { binary, cost: vec![[0.0; WIDTH]; n], is_leaf: vec![false; n] };
        let mut count = vec![0u32; n];
        for index in (0..n).rev() {
            let area = binary.nodes[index].bounds.half_area();
            let leaf_cost = area * PACKET_COST;
            match binary.nodes[index].kind {
                BinaryKind::Leaf(_) => {
                    count[index] = 1;
                    plan.cost[index] = [leaf_cost; WIDTH];
                    plan.is_leaf[index] = true;
                }
                BinaryKind::Inner(first) => {
                    count[index] = count[first as usize] + count[first as usize + 1];
                    let n = count[index];
                    plan.set_inner(index, first, area, if n as usize <= MAX_LEAF { leaf_cost } else { f32::INFINITY });
                }
            }
        }
        plan
    }

    fn set_inner(&mut self, index: usize, first: u32, area: f32, leaf_cost: f32) {
        let inner_cost = area * NODE_COST + self.best_share(first, WIDTH).0;
        self.is_leaf[index] = leaf_cost <= inner_cost;
        let mut cost = [leaf_cost.min(inner_cost); WIDTH];
        for slots in 2..=WIDTH {
            cost[slots - 1] = self.best_share(first, slots).0.min(cost[slots - 2]);
        }
        self.cost[index] = cost;
    }

    /// The least cost of the two subtrees at `first` in `slots` slots, and how many of them the first one gets.
    fn best_share(&self, first: u32, slots: usize) -> (f32, usize) {
        let [left, right] = [first, first + 1].map(|n| &self.cost[n as usize]);
        let mut best = (f32::INFINITY, 1);
        for share in 1..slots {
            let cost = left[share - 1] + right[slots - share - 1];
            if cost < best.0 {
                best = (cost, share);
            }
        }
        best
    }

    /// The binary nodes that become the children of the wide node for `root`.
    fn children(&self, root: u32) -> [Option<u32>; WIDTH] {
        let mut children = [None; WIDTH];
        let mut n = 0;
        match self.binary.nodes[root as usize].kind {
            BinaryKind::Inner(first) if !self.is_leaf[root as usize] => {
                self.spread(first, WIDTH, &mut children, &mut n)
            }
            // The root of a tiny tree is a leaf: it becomes the only child.
            _ => children[0] = Some(root),
        }
        children
    }

    fn spread(&self, first: u32, slots: usize, children: &mut [Option<u32>; WIDTH], n: &mut usize) {
        let share = self.best_share(first, slots).1;
        for (node, slots) in [(first, share), (first + 1, slots - share)] {
            let cost = &self.cost[node as usize];
            let needed = (1..slots).find(|&i| cost[i - 1] <= cost[slots - 1]).unwrap_or(slots);
            match self.binary.nodes[node as usize].kind {
                BinaryKind::Inner(inner) if needed > 1 => self.spread(inner, needed, children, n),
                _ => {
                    children[*n] = Some(node);
                    *n += 1;
                }
            }
        }
    }
}
