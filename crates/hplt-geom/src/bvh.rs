//! The bounding volume hierarchy behind [`RayCaster`].
use crate::{Hit, Ray, RayCaster, Scene};

/// How to build.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BvhOptions {}

/// What came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BvhReport {
    /// Bytes.
    pub memory: usize,
    /// Depth of the tree.
    pub depth: usize,
}

/// The caster.
#[derive(Debug)]
pub struct Bvh {}

impl Bvh {
    /// Builds over all triangles of `scene`.
    pub fn build(scene: &Scene, options: BvhOptions) -> (Self, BvhReport) {
        let _ = (scene, options);
        (Self {}, BvhReport::default())
    }
}

impl RayCaster for Bvh {
    fn trace_nearest(&self, _rays: &[Ray], _hits: &mut [Hit]) {}

    fn trace_occluded(&self, _rays: &[Ray], _occluded: &mut [bool]) {}
}
