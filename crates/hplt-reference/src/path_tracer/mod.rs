//! An unbiased path tracer of its own, for irradiance at points and for images.
//!
//! Diffuse transport on geometric normals. Light is sampled at every vertex and combined with the reflected ray by the
//! balance heuristic (Veach & Guibas 1995), so that emitters that touch a receiver stay bounded. The first two bounces
//! use Owen-scrambled Sobol points (`sobol_burley`), everything after them a counter-based generator. Every estimate is
//! made of independent *replicates*, each with its own scrambling, and its standard error comes from the spread of the
//! replicates: the i.i.d. formula would be wrong for such points.
//!
//! Rays start and meet triangles in `f64`, from the scene's `f32` corners, with an edge test that leaves no gap between
//! triangles that share corners. All results are functions of `(seed, point, replicate)`: the same bits at any thread count.

mod estimate;
mod light;
mod rng;
mod tree;
mod tree_build;
mod triangle;
mod vertex;
mod walk;

#[cfg(test)]
mod tests;

pub use estimate::{Emission, IrradianceEstimate, IrradianceOptions, RenderEstimate, RenderOptions};

pub(crate) use rng::PathNumbers;
pub(crate) use triangle::{Crossing, ShearedRay};

use hplt_geom::Scene;

use light::Lights;
use tree::Tree;

/// A scene made ready for tracing.
#[derive(Debug)]
pub struct PathTracer<'s> {
    scene: &'s Scene,
    tree: Tree,
    lights: Lights,
}

impl<'s> PathTracer<'s> {
    /// Builds the tracer's own acceleration structure and light tables: about a second per million triangles.
    pub fn new(scene: &'s Scene) -> Self {
        Self { scene, tree: Tree::build(scene), lights: Lights::new(scene) }
    }

    /// Bytes that the acceleration structure takes.
    pub fn memory(&self) -> usize {
        self.tree.memory()
    }
}
