use glam::Vec3;

use crate::Rgb;

/// A light without a surface, in scene space. Emissive surfaces are materials, not lights.
#[derive(Debug, Clone, PartialEq)]
pub struct Light {
    /// Name in the scene file; empty when it has none.
    pub name: String,
    /// What it is.
    pub shape: LightShape,
}

/// The punctual and distant lights.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum LightShape {
    /// Radiates equally in all directions: `E = I cosθ / d²`.
    Point {
        /// Position.
        position: Vec3,
        /// Radiant intensity, W/sr in scene units.
        intensity: Rgb,
    },
    /// A point that radiates within a cone, smoothly fading between the two angles (`KHR_lights_punctual`).
    Spot {
        /// Position.
        position: Vec3,
        /// Unit vector along the axis of the cone.
        direction: Vec3,
        /// Radiant intensity on the axis, W/sr in scene units.
        intensity: Rgb,
        /// Cosine of the angle up to which the intensity is full.
        cos_inner: f32,
        /// Cosine of the angle from which it is zero.
        cos_outer: f32,
    },
    /// Light from a cone of directions around one direction; a sun when the angle is not zero.
    Directional {
        /// Unit vector from the scene towards the light.
        direction_to_light: Vec3,
        /// Irradiance on a surface that faces the light, W/m².
        irradiance: Rgb,
        /// Half-angle of the cone in radians; 0 for a parallel light. The radiance is uniform over the disc.
        angular_radius: f32,
    },
}

impl LightShape {
    /// The factor in `[0, 1]` by which a spot light fades towards `direction` (unit, from the light outwards):
    /// the square of the clamped linear ramp in the cosine (`KHR_lights_punctual`).
    pub fn spot_falloff(cos_inner: f32, cos_outer: f32, cos_angle: f32) -> f32 {
        let ramp = ((cos_angle - cos_outer) / (cos_inner - cos_outer).max(1e-4)).clamp(0.0, 1.0);
        ramp * ramp
    }
}
