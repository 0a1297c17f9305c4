use glam::{DVec3, Vec2, Vec3};

use crate::{Error, Frame, Ray};

/// A pinhole camera, in world space.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Name in the scene file; empty when it has none.
    pub name: String,
    /// Position of the eye.
    pub eye: DVec3,
    /// Unit vector along the view axis.
    pub forward: DVec3,
    /// Unit vector towards the top of the picture, perpendicular to `forward`.
    pub up: DVec3,
    /// Full vertical angle of view, radians.
    pub vertical_fov: f64,
    /// Width over height that the scene file asks for, if it does.
    pub aspect: Option<f64>,
}

impl Camera {
    /// A camera at `eye` that looks at `target`, with `up` made perpendicular to the view axis.
    ///
    /// # Errors
    /// When a value is not finite, when `eye` and `target` coincide, when `up` is parallel to the view axis, or when
    /// `vertical_fov` is outside (0, π).
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3, vertical_fov: f64) -> Result<Self, Error> {
        for (place, v) in [("camera eye", eye), ("camera target", target), ("camera up", up)] {
            if !v.is_finite() {
                return Err(Error::NotFinite { place: place.into(), value: v.x + v.y + v.z });
            }
        }
        if !(vertical_fov > 0.0 && vertical_fov < std::f64::consts::PI) {
            return Err(Error::OutOfRange {
                place: "camera field of view".into(),
                value: vertical_fov,
                expected: "an angle in (0, 180) degrees",
            });
        }
        let forward = (target - eye).try_normalize().ok_or_else(|| Error::OutOfRange {
            place: "camera target".into(),
            value: (target - eye).length(),
            expected: "a point away from the eye",
        })?;
        let right = forward.cross(up).try_normalize().ok_or_else(|| Error::OutOfRange {
            place: "camera up".into(),
            value: up.length(),
            expected: "a direction that is not parallel to the view axis",
        })?;
        Ok(Self { name: String::new(), eye, forward, up: right.cross(forward), vertical_fov, aspect: None })
    }

    /// The primary ray through `pixel` (in pixels, origin at the top left, centres at .5) of a `width` × `height`
    /// picture, in scene space, its direction of unit length.
    pub fn ray(&self, frame: &Frame, width: usize, height: usize, pixel: Vec2) -> Ray {
        let tan = (0.5 * self.vertical_fov).tan();
        let aspect = width as f64 / height as f64;
        let x = (2.0 * f64::from(pixel.x) / width as f64 - 1.0) * tan * aspect;
        let y = (1.0 - 2.0 * f64::from(pixel.y) / height as f64) * tan;
        let right = self.forward.cross(self.up);
        let direction = (self.forward + right * x + self.up * y).normalize();
        Ray::new(frame.scene_from_world_point(self.eye), direction.as_vec3())
    }

    /// The distance in scene units that one pixel covers at unit depth.
    pub fn pixel_footprint(&self, height: usize) -> f32 {
        (2.0 * (0.5 * self.vertical_fov).tan() / height as f64) as f32
    }

    /// The view axis as `f32`.
    pub fn forward_f32(&self) -> Vec3 {
        self.forward.as_vec3()
    }
}
