//! The bounding volume hierarchy behind [`RayCaster`].
//!
//! A binary tree (PLOC and reinsertion, from obvhs; or a top-down sweep of our own where PLOC would degenerate) is
//! collapsed into nodes of eight children and leaves of up to eight triangles by dynamic programming over the surface area
//! heuristic (Ylitie, Karras & Laine, HPG 2017, section 3). Traversal and intersection are ours, because they must be
//! watertight: see `triangle.rs` and `traverse.rs`.

mod alpha;
mod batch;
mod binary;
mod build;
mod dispatch;
mod shaft;
mod top_down;
mod traverse;
mod triangle;
mod wide;

#[cfg(test)]
pub(crate) mod test_scenes;
#[cfg(test)]
mod tests;

use std::ops::ControlFlow;

use crate::{Blocker, Hit, Mesh, Ray, RayCaster, Scene, Shaft};
use alpha::Cutouts;
use dispatch::Query;
use traverse::Target;
use wide::WideTree;

/// How much work goes into the tree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BvhOptions {
    /// Whether PLOC looks far for the best neighbour to merge with (14 nodes each way instead of 1): a better tree for
    /// about twice the time of that stage.
    pub search_far: bool,
    /// Whether large triangles that fill their box badly count as several smaller boxes: better for architecture at a few
    /// per cent more memory.
    pub split_large: bool,
    /// The share of nodes that are taken out and put back in a better place, in each of 16 shrinking rounds; 0 switches
    /// that off.
    pub reinsertion: f32,
}

impl BvhOptions {
    /// The fastest build: for previews and for scenes that are traced with few rays.
    pub fn fast() -> Self {
        Self { search_far: false, split_large: false, reinsertion: 0.0 }
    }

    /// The best tree for its build time when there are many rays per triangle.
    pub fn production() -> Self {
        Self { search_far: true, split_large: true, reinsertion: 0.15 }
    }
}

impl Default for BvhOptions {
    fn default() -> Self {
        Self::production()
    }
}

/// What [`Bvh::build`] made.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BvhReport {
    /// Bytes that the hierarchy takes.
    pub memory: usize,
    /// Levels of eight-wide nodes from the root to the deepest leaf.
    pub depth: usize,
    /// Levels of the binary tree that it was made from; at most `64 + 2·log2(n)`.
    pub binary_depth: usize,
    /// Eight-wide nodes.
    pub n_nodes: usize,
    /// Packets of eight triangles, one per leaf.
    pub n_packets: usize,
    /// Triangles that can block a ray.
    pub n_triangles: usize,
    /// Boxes that the builder was given: one per triangle, more where large ones are split.
    pub n_boxes: usize,
    /// Triangles that an alpha mask may cut.
    pub n_masked: usize,
    /// Triangles left out because their alpha mask cuts them away entirely.
    pub n_invisible: usize,
    /// Whether the tree was built top-down, because too many triangles share a place for PLOC, or there are few of them.
    pub is_top_down: bool,
    /// Expected cost of a random ray that hits the scene's box, in units of one node visit (surface area heuristic).
    pub expected_cost: f32,
}

/// A watertight bounding volume hierarchy over the triangles of a [`Scene`]. Immutable; shared freely between threads.
#[derive(Debug, Clone)]
pub struct Bvh {
    tree: WideTree,
    cutouts: Cutouts,
}

impl Bvh {
    /// The hierarchy over all triangles of `scene`, and what it took. The result is a pure function of the arguments.
    pub fn build(scene: &Scene, options: BvhOptions) -> (Self, BvhReport) {
        let cutouts = Cutouts::new(scene);
        let (tree, mut report) = build_tree(scene.mesh(), &cutouts, options);
        report.memory += cutouts.memory();
        (Self { tree, cutouts }, report)
    }

    fn target(&self) -> Target<'_> {
        Target { tree: &self.tree, cutouts: &self.cutouts }
    }
}

fn build_tree(mesh: &Mesh, cutouts: &Cutouts, options: BvhOptions) -> (WideTree, BvhReport) {
    let primitives = build::primitives(mesh, options.split_large, |triangle| !cutouts.is_invisible(triangle));
    let n_triangles = mesh.n_triangles() - cutouts.n_invisible();
    let (binary, is_top_down) = build::binary_tree(&primitives, options);
    let binary_depth = binary.depth();
    let (tree, expected_cost) = wide::collapse(&binary, mesh, |triangle| cutouts.is_masked(triangle));
    let report = BvhReport {
        memory: tree.memory(),
        depth: tree.depth(),
        binary_depth,
        n_nodes: tree.nodes.len(),
        n_packets: tree.packets.len(),
        n_triangles,
        n_boxes: primitives.len(),
        n_masked: cutouts.n_masked(),
        n_invisible: cutouts.n_invisible(),
        is_top_down,
        expected_cost,
    };
    (tree, report)
}

impl RayCaster for Bvh {
    fn trace_nearest(&self, rays: &[Ray], hits: &mut [Hit]) {
        assert_eq!(rays.len(), hits.len(), "one hit per ray");
        dispatch::run(self.target(), Query::Nearest(rays, hits));
    }

    fn trace_occluded(&self, rays: &[Ray], occluded: &mut [bool]) {
        assert_eq!(rays.len(), occluded.len(), "one answer per ray");
        dispatch::run(self.target(), Query::Occluded(rays, occluded));
    }

    fn visit_blockers(&self, shaft: &Shaft, visit: &mut dyn FnMut(&Blocker) -> ControlFlow<()>) -> bool {
        shaft::visit(&self.tree, shaft, visit);
        true
    }
}
