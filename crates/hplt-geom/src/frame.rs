use glam::{DVec3, Vec3};

/// The map between world space and scene space: `world = center + scene·2^exponent`.
///
/// Scaling the world by a power of two changes `exponent` alone, so everything computed in scene space keeps its bits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// The world-space point that is the origin of scene space.
    pub center: DVec3,
    /// The binary exponent of the scale: one scene unit is `2^exponent` world units.
    pub exponent: i32,
}

impl Frame {
    /// The frame that maps a world-space bounding box into `[-½, ½]³`, its longest side longer than ½.
    pub fn from_bounds(min: DVec3, max: DVec3) -> Self {
        let longest = (max - min).max_element();
        let exponent = if longest > 0.0 && longest.is_finite() { exponent_above(longest) } else { 0 };
        Self { center: min * 0.5 + max * 0.5, exponent }
    }

    /// World units per scene unit.
    pub fn scale(&self) -> f64 {
        2f64.powi(self.exponent)
    }

    /// A world-space position in scene space, rounded once.
    pub fn scene_from_world_point(&self, world: DVec3) -> Vec3 {
        ((world - self.center) / self.scale()).as_vec3()
    }

    /// A scene-space position in world space.
    pub fn world_from_scene_point(&self, scene: Vec3) -> DVec3 {
        self.center + scene.as_dvec3() * self.scale()
    }

    /// A world-space length in scene space.
    pub fn scene_from_world_length(&self, world: f64) -> f32 {
        (world / self.scale()) as f32
    }

    /// A scene-space length in world space.
    pub fn world_from_scene_length(&self, scene: f32) -> f64 {
        f64::from(scene) * self.scale()
    }

    /// A radiant intensity (W/sr) in scene units, so that `I/d²` gives the same irradiance in both spaces.
    pub fn scene_from_world_intensity(&self, world: Vec3) -> Vec3 {
        (world.as_dvec3() / (self.scale() * self.scale())).as_vec3()
    }
}

/// The smallest `e` with `x <= 2^e`, for finite positive `x`, exactly.
fn exponent_above(x: f64) -> i32 {
    let mut e = x.log2().round() as i32;
    while 2f64.powi(e) < x {
        e += 1;
    }
    while 2f64.powi(e - 1) >= x {
        e -= 1;
    }
    e
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_of_two_moves_only_the_exponent() {
        let (min, max) = (DVec3::new(-1.0, 3.0, 7.0), DVec3::new(2.0, 3.1, 7.7));
        let frame = Frame::from_bounds(min, max);
        for k in [-20, 20] {
            let s = 2f64.powi(k);
            let scaled = Frame::from_bounds(min * s, max * s);
            assert_eq!(scaled.exponent, frame.exponent + k);
            let p = DVec3::new(0.123, 3.05, 7.3);
            assert_eq!(scaled.scene_from_world_point(p * s), frame.scene_from_world_point(p));
        }
        let p = frame.scene_from_world_point(max);
        assert!(p.abs().max_element() <= 0.5 && p.abs().max_element() > 0.25);
    }
}
