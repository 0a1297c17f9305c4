use glam::Vec3;

/// An axis-aligned box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bounds {
    pub(super) min: Vec3,
    pub(super) max: Vec3,
}

impl Bounds {
    pub(super) const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    pub(super) fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Half the surface area; 0 for an empty box.
    pub(super) fn half_area(self) -> f32 {
        let d = (self.max - self.min).max(Vec3::ZERO);
        d.x * d.y + d.y * d.z + d.z * d.x
    }

    /// Twice the centre.
    pub(super) fn doubled_center(self) -> Vec3 {
        self.min + self.max
    }
}

/// A triangle, or a part of one, as builders see it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Primitive {
    pub(super) bounds: Bounds,
    pub(super) triangle: u32,
}

/// A node of a [`BinaryTree`]: a leaf of one triangle, or two children side by side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BinaryNode {
    pub(super) bounds: Bounds,
    pub(super) kind: BinaryKind,
}

impl BinaryNode {
    /// With its children, if it has any, `offset` places further on.
    fn moved(self, offset: u32) -> Self {
        match self.kind {
            BinaryKind::Inner(first) => Self { kind: BinaryKind::Inner(first + offset), ..self },
            BinaryKind::Leaf(_) => self,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum BinaryKind {
    /// The triangle's id.
    Leaf(u32),
    /// The index of the first child; the second one follows.
    Inner(u32),
}

/// A binary tree whose root is node 0 and whose nodes come after their parents; empty when there is no triangle.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct BinaryTree {
    pub(super) nodes: Vec<BinaryNode>,
}

impl BinaryTree {
    /// The tree below node 0 of `n` nodes in any order, which `node` gives.
    pub(super) fn from_unordered(n: usize, node: impl Fn(u32) -> BinaryNode) -> Self {
        let mut tree = Self { nodes: Vec::with_capacity(n) };
        if n > 0 {
            tree.nodes.push(node(0));
        }
        // Depth first, so that subtrees are close together.
        let mut pending = if n > 0 { vec![0] } else { Vec::new() };
        while let Some(parent) = pending.pop() {
            let first = tree.nodes.len();
            if let BinaryKind::Inner(children) = &mut tree.nodes[parent].kind {
                let from = std::mem::replace(children, first as u32);
                tree.nodes.extend([node(from), node(from + 1)]);
                pending.extend([first + 1, first]);
            }
        }
        tree
    }

    /// Puts `trees[i]` in the place of leaf `i`.
    pub(super) fn grafted(mut self, trees: &[Self]) -> Self {
        self.nodes.reserve(trees.iter().map(|tree| tree.nodes.len()).sum());
        for place in 0..self.nodes.len() {
            let BinaryKind::Leaf(leaf) = self.nodes[place].kind else { continue };
            // The root takes the place of the leaf; whatever comes after it moves.
            let nodes = &trees[leaf as usize].nodes;
            let offset = self.nodes.len() as u32 - 1;
            self.nodes[place] = nodes[0].moved(offset);
            self.nodes.extend(nodes[1..].iter().map(|node| node.moved(offset)));
        }
        self
    }

    /// Levels from the root to the deepest leaf, 1 for a lone leaf.
    pub(super) fn depth(&self) -> usize {
        let mut depth = vec![1u32; self.nodes.len()];
        let mut deepest = 0;
        for (node, i) in self.nodes.iter().zip(0..) {
            let here: u32 = depth[i];
            deepest = deepest.max(here);
            if let BinaryKind::Inner(first) = node.kind {
                depth[first as usize] = here + 1;
                depth[first as usize + 1] = here + 1;
            }
        }
        deepest as usize
    }
}
