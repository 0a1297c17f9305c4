//! Short visible paths between neighbouring points of a surface.

use glam::Vec3;
use hplt_geom::{OrientedPoint, Ray, RayCaster, Slab, offset_origin};

/// Twice the least distance, scene units, by which `offset_origin` lifts a point, and more: paths stay above that.
const CLEARANCE: f32 = 3.0 / 65_536.0;

/// A position and the unit normal of the side that is meant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Oriented {
    pub position: Vec3,
    pub normal: Vec3,
}

/// The layer that a point belongs to: half-way to what is next above and below it along its normal. Two rays.
pub(crate) fn slab_of(caster: &dyn RayCaster, point: &OrientedPoint) -> Slab {
    let half_free = |direction: Vec3| {
        let t = caster.nearest(Ray::new(offset_origin(point.position, direction), direction)).t;
        (0.5 * t).max(CLEARANCE)
    };
    Slab { below: half_free(-point.normal), above: half_free(point.normal) }
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
