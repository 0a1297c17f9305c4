use std::ops::ControlFlow;

use glam::Vec3;

use crate::{Shaft, TriangleId};

/// A half-line, or a segment when `t_max` is finite. Scene space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where it starts.
    pub origin: Vec3,
    /// Where it goes. Need not be of unit length; distances are in its units.
    pub direction: Vec3,
    /// Hits at `0 <= t < t_max` count.
    pub t_max: f32,
}

impl Ray {
    /// The half-line from `origin` along `direction`.
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, t_max: f32::INFINITY }
    }

    /// The open segment from `origin` to `target`; both ends should already be offset from their surfaces.
    pub fn segment(origin: Vec3, target: Vec3) -> Self {
        Self { origin, direction: target - origin, t_max: 1.0 }
    }
}

/// Where a ray meets the scene, or [`Hit::MISS`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance in units of the ray's direction.
    pub t: f32,
    /// Barycentric weight of the triangle's second corner.
    pub u: f32,
    /// Barycentric weight of the triangle's third corner.
    pub v: f32,
    /// The triangle; [`TriangleId::NONE`] for a miss.
    pub triangle: TriangleId,
    /// Whether the ray arrives on the front (counter-clockwise) side.
    pub is_front: bool,
}

impl Hit {
    /// The ray meets nothing.
    pub const MISS: Self = Self { t: f32::INFINITY, u: 0.0, v: 0.0, triangle: TriangleId::NONE, is_front: false };

    /// Whether the ray meets nothing.
    pub fn is_miss(&self) -> bool {
        self.triangle == TriangleId::NONE
    }
}

/// A triangle that may be in the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blocker {
    /// Its corners, in some order.
    pub corners: [Vec3; 3],
    /// Whether an alpha mask may cut some of it away.
    pub is_masked: bool,
}

/// Casts rays in batches. A batch is one receiver's rays or one tile of pixels; callers run batches in parallel.
///
/// Contract: the result for a ray depends on that ray alone. A ray with a non-finite component or no direction is a
/// miss. Among hits at the same distance the front-facing one wins, then the triangle with the lowest id. Surfaces block on both
/// sides; texels that an alpha mask cuts away do not block.
pub trait RayCaster: Sync {
    /// Writes the nearest hit of `rays[i]` to `hits[i]`.
    ///
    /// # Panics
    /// When the slices differ in length.
    fn trace_nearest(&self, rays: &[Ray], hits: &mut [Hit]);

    /// Writes to `occluded[i]` whether anything blocks `rays[i]` before its `t_max`.
    ///
    /// # Panics
    /// When the slices differ in length.
    fn trace_occluded(&self, rays: &[Ray], occluded: &mut [bool]);

    /// The nearest hit of one ray.
    fn nearest(&self, ray: Ray) -> Hit {
        let mut hit = [Hit::MISS];
        self.trace_nearest(&[ray], &mut hit);
        hit[0]
    }

    /// Whether anything blocks one ray.
    fn is_occluded(&self, ray: Ray) -> bool {
        let mut occluded = [false];
        self.trace_occluded(&[ray], &mut occluded);
        occluded[0]
    }

    /// Visits every triangle that may reach into `shaft`, in some order, a few that do not and some more than once, until `visit` breaks.
    /// Returns `false`, and has visited nothing, where the caster does not know its triangles: then only rays can tell.
    fn visit_blockers(&self, _shaft: &Shaft, _visit: &mut dyn FnMut(&Blocker) -> ControlFlow<()>) -> bool {
        false
    }
}

/// `position`, moved off its surface along `normal` by a few units in the last place, so that a ray that starts there
/// does not meet the surface again (Wächter & Binder, "A Fast and Robust Method for Avoiding Self-Intersection", Ray
/// Tracing Gems 2019, listing 6-1). `position` must come from barycentric coordinates, not from `origin + t·direction`.
#[inline]
pub fn offset_origin(position: Vec3, normal: Vec3) -> Vec3 {
    Vec3::new(
        offset_coordinate(position.x, normal.x),
        offset_coordinate(position.y, normal.y),
        offset_coordinate(position.z, normal.z),
    )
}

fn offset_coordinate(p: f32, n: f32) -> f32 {
    const NEAR_ORIGIN: f32 = 1.0 / 32.0;
    const FLOAT_SCALE: f32 = 1.0 / 65536.0;
    const INT_SCALE: f32 = 256.0;
    if p.abs() < NEAR_ORIGIN {
        return p + FLOAT_SCALE * n;
    }
    let steps = (INT_SCALE * n) as i32;
    let bits = p.to_bits() as i32;
    f32::from_bits(bits.wrapping_add(if p < 0.0 { -steps } else { steps }) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_move_by_256_ulps_along_the_normal_on_both_sides_of_zero() {
        for p in [1.0f32, -1.0, 0.3, -0.3, 1e8, -1e8] {
            let up = offset_coordinate(p, 1.0);
            let down = offset_coordinate(p, -1.0);
            assert!(up > p && down < p, "{p}: {down} {up}");
            assert_eq!((up.to_bits() as i32 - p.to_bits() as i32).abs(), 256);
        }
        assert_eq!(offset_coordinate(0.0, 0.5), 0.5 / 65536.0);
        assert_eq!(offset_coordinate(0.7, 0.0), 0.7);
    }
}
