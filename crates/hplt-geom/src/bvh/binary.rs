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

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum BinaryKind {
    /// The triangle's id.
    Leaf(u32),
    /// The index of the first child; the second one follows.
    Inner(u32),
}

/// A binary tree whose root is node 0; empty when there is no triangle.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct BinaryTree {
    pub(super) nodes: Vec<BinaryNode>,
}

impl BinaryTree {
    /// The nodes in an order in which every parent comes before its children.
    pub(super) fn parents_first(&self) -> Vec<u32> {
        let mut order: Vec<u32> = Vec::with_capacity(self.nodes.len());
        if !self.nodes.is_empty() {
            order.push(0);
        }
        let mut next = 0;
        while let Some(&node) = order.get(next) {
            if let BinaryKind::Inner(first) = self.nodes[node as usize].kind {
                order.extend([first, first + 1]);
            }
            next += 1;
        }
        order
    }

    /// Levels from the root to the deepest leaf, 1 for a lone leaf.
    pub(super) fn depth(&self) -> usize {
        let mut depth = vec![1usize; self.nodes.len()];
        let mut deepest = 0;
        for node in self.parents_first() {
            let here = depth[node as usize];
            deepest = deepest.max(here);
            if let BinaryKind::Inner(first) = self.nodes[node as usize].kind {
                depth[first as usize] = here + 1;
                depth[first as usize + 1] = here + 1;
            }
        }
        deepest
    }
}
