//! Short visible paths between neighbouring points of a surface.

use glam::Vec3;
use hplt_geom::{Ray, RayCaster, offset_origin};

/// Twice the least distance, scene units, by which `offset_origin` lifts a point, and more: paths stay above that.
const CLEARANCE: f32 = 3.0 / 65_536.0;

/// A position and the unit normal of the side that is meant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Oriented {
    pub position: Vec3,
    pub normal: Vec3,
}

/// Whether light can go from just above `a` to just above `b` by way of a point above their middle, `slope` times their
/// distance high. True only when both legs are clear, so a chain of such paths never crosses a surface.
pub(crate) fn is_joined(caster: &dyn RayCaster, a: Oriented, b: Oriented, slope: f32) -> bool {
    let up = (a.normal + b.normal).normalize_or_zero();
    let height = slope * (a.position - b.position).length() + CLEARANCE;
    let apex = 0.5 * (a.position + b.position) + up * height;
    let is_clear = |from: Oriented| !caster.is_occluded(Ray::segment(offset_origin(from.position, from.normal), apex));
    is_clear(a) && is_clear(b)
}
