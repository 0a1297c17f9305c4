//! A median-split kd-tree over points: all within a radius, the nearest or the few nearest, and an approximate
//! nearest in one descent.
//!
//! The tree is two flat arrays of plain data, [`KdTree::nodes`] (8 bytes each, depth first) and the points in leaf
//! order with their ids ([`KdTree::points`], [`KdTree::order`]), so that it uploads to a GPU as it is. Every leaf is at
//! the same depth and leaves differ in size by at most one point: the shape depends on the number of points alone,
//! which makes the parallel build write straight into its final place, and the traversal stack small and fixed. A node
//! is split across the widest extent of its points.
//!
//! Rejected: an implicit layout without child links (saves little with leaves of this size, costs a second way to number
//! nodes on the GPU), and sliding-midpoint splits (unbounded depth on duplicates).
//!
//! All comparisons are on `f32` squared distances `(Δx² + Δy²) + Δz²`, and pruning uses lower bounds that are monotone
//! in the same arithmetic: the answers equal those of a linear search bit for bit. Squares overflow beyond coordinates
//! of about 1e19; everything that far away is then equally far.
#![forbid(unsafe_code)]

#[doc = include_str!("../README.md")]
#[cfg(doctest)]
struct Readme;

mod build;
mod query;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// Points per leaf, at most. Measured on 167k points: 8 and 16 are slower in every query.
pub const LEAF_SIZE: usize = 32;

/// More points than this are refused, so that every index fits the 30 bits that a [`Node`] has for it.
pub const MAX_POINTS: usize = 1 << 29;

/// One node: 8 bytes. An inner node splits space at a plane; a leaf holds a range of points.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Node {
    /// The coordinate of the splitting plane; in a leaf, the number of points (a small integer, exact in `f32`).
    pub split: f32,
    /// Bits 0-1: the axis, or 3 for a leaf. Bits 2-31: the index of the right child (the left one is the next node); in
    /// a leaf, the index of its first point.
    pub link: u32,
}

impl Node {
    const LEAF: u32 = 3;

    pub(crate) fn inner(split: f32, axis: usize, right: usize) -> Self {
        Self { split, link: (right as u32) << 2 | axis as u32 }
    }

    pub(crate) fn leaf(first: usize, count: usize) -> Self {
        Self { split: count as f32, link: (first as u32) << 2 | Self::LEAF }
    }

    /// Whether the node holds points.
    #[inline]
    pub fn is_leaf(self) -> bool {
        self.link & 3 == Self::LEAF
    }

    /// The axis that an inner node splits: 0, 1 or 2.
    #[inline]
    pub fn axis(self) -> usize {
        (self.link & 3) as usize
    }

    /// The index of the right child of an inner node.
    #[inline]
    pub fn right(self) -> usize {
        (self.link >> 2) as usize
    }

    /// The points of a leaf, as a range of positions in leaf order.
    #[inline]
    pub fn range(self) -> std::ops::Range<usize> {
        let first = (self.link >> 2) as usize;
        first..first + self.split as usize
    }
}

/// A kd-tree over points in space; see the crate documentation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct KdTree {
    nodes: Vec<Node>,
    points: Vec<Vec3>,
    order: Vec<u32>,
}

impl KdTree {
    /// The number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Bytes that the tree takes.
    pub fn memory(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.points[..]) + size_of_val(&self.order[..])
    }

    /// The nodes, depth first: the left child of an inner node is the next one. The first is the root.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The points in leaf order.
    pub fn points(&self) -> &[Vec3] {
        &self.points
    }

    /// For every position in leaf order the id of the point: its index in the input of [`KdTree::build`].
    pub fn order(&self) -> &[u32] {
        &self.order
    }
}
