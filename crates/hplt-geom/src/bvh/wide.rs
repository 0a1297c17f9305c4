use super::binary::{BinaryKind, BinaryTree, Bounds};
use super::triangle::Packet;
use crate::{Mesh, TriangleId};

/// Children of a node.
pub(super) const WIDTH: usize = 8;
/// Triangles that one leaf may hold.
const MAX_LEAF: u32 = 8;
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

/// A node index, or a range of packets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Child(u32);

impl Child {
    const LEAF: u32 = 1 << 31;
    const COUNT_SHIFT: u32 = 28;
    /// Packets or nodes beyond this cannot be addressed; it follows that scenes of 200 million triangles can.
    const MAX_INDEX: u32 = (1 << Self::COUNT_SHIFT) - 1;
    pub(super) const NONE: Self = Self(u32::MAX);
    pub(super) const ROOT: Self = Self(0);

    fn node(index: usize) -> Self {
        assert!(index <= Self::MAX_INDEX as usize, "too many nodes");
        Self(index as u32)
    }

    fn leaf(first_packet: usize, n_packets: usize) -> Self {
        assert!((1..=8).contains(&n_packets) && first_packet <= Self::MAX_INDEX as usize, "too many packets");
        Self(Self::LEAF | ((n_packets as u32 - 1) << Self::COUNT_SHIFT) | first_packet as u32)
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
    pub(super) fn packets(self) -> std::ops::Range<usize> {
        let first = (self.0 & Self::MAX_INDEX) as usize;
        first..first + ((self.0 >> Self::COUNT_SHIFT) & 7) as usize + 1
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

    /// Entries that a traversal may have to keep.
    pub(super) fn stack_size(&self) -> usize {
        (WIDTH - 1) * self.depth + 1
    }
}

/// The wide tree of least expected cost that keeps the grouping of `binary`, and that cost relative to the root's area.
pub(super) fn collapse(binary: &BinaryTree, mesh: &Mesh, is_masked: impl Fn(TriangleId) -> bool) -> (WideTree, f32) {
    if binary.nodes.is_empty() {
        return (WideTree::default(), 0.0);
    }
    let plan = Plan::new(binary);
    let mut tree = WideTree::default();
    tree.nodes.push(EMPTY_NODE);
    let mut pending = vec![(0u32, 0usize, 1usize)];
    let mut members = Vec::with_capacity(MAX_LEAF as usize);
    while let Some((root, index, depth)) = pending.pop() {
        tree.depth = tree.depth.max(depth);
        for (lane, child) in plan.children(root).into_iter().flatten().enumerate() {
            let node = if plan.is_leaf[child as usize] {
                members.clear();
                binary_members(binary, child, &mut members);
                push_leaf(&mut tree, mesh, &members, &is_masked)
            } else {
                tree.nodes.push(EMPTY_NODE);
                pending.push((child, tree.nodes.len() - 1, depth + 1));
                Child::node(tree.nodes.len() - 1)
            };
            tree.nodes[index].set(lane, binary.nodes[child as usize].bounds, node);
        }
    }
    let root_area = binary.nodes[0].bounds.half_area();
    (tree, if root_area > 0.0 { plan.cost[0][0] / root_area } else { 1.0 })
}

fn push_leaf(tree: &mut WideTree, mesh: &Mesh, members: &[u32], is_masked: impl Fn(TriangleId) -> bool) -> Child {
    let first = tree.packets.len();
    for group in members.chunks(Packet::LANES) {
        let mut packet = Packet::EMPTY;
        for (lane, &id) in group.iter().enumerate() {
            let id = TriangleId(id);
            packet.set(lane, id, mesh.corners(id), is_masked(id));
        }
        tree.packets.push(packet);
    }
    Child::leaf(first, tree.packets.len() - first)
}

/// The distinct triangles below a binary node, in ascending order.
fn binary_members(binary: &BinaryTree, node: u32, members: &mut Vec<u32>) {
    let mut pending = vec![node];
    while let Some(node) = pending.pop() {
        match binary.nodes[node as usize].kind {
            BinaryKind::Leaf(triangle) => members.push(triangle),
            BinaryKind::Inner(first) => pending.extend([first, first + 1]),
        }
    }
    members.sort_unstable();
    members.dedup();
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
        for &node in binary.parents_first().iter().rev() {
            let index = node as usize;
            let area = binary.nodes[index].bounds.half_area();
            let leaf_cost = |n: u32| area * PACKET_COST * n.div_ceil(Packet::LANES as u32) as f32;
            match binary.nodes[index].kind {
                BinaryKind::Leaf(_) => {
                    count[index] = 1;
                    plan.cost[index] = [leaf_cost(1); WIDTH];
                    plan.is_leaf[index] = true;
                }
                BinaryKind::Inner(first) => {
                    count[index] = count[first as usize] + count[first as usize + 1];
                    let n = count[index];
                    plan.set_inner(index, first, area, if n <= MAX_LEAF { leaf_cost(n) } else { f32::INFINITY });
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
