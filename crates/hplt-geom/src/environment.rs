use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

use crate::{Error, Image, Rgb};

/// Light from far away in every direction: a constant, or an equirectangular map that is constant within each texel.
///
/// In a map, the centre column looks along -z, columns to the right turn towards +x, the top row is +y.
#[derive(Debug, Clone, PartialEq)]
pub struct Environment {
    map: Image,
    name: String,
}

impl Environment {
    /// The same radiance (W m⁻² sr⁻¹) from everywhere.
    ///
    /// # Errors
    /// When a component is negative or not finite.
    pub fn constant(radiance: Rgb) -> Result<Self, Error> {
        Self::from_map(Image::from_pixels(1, 1, vec![radiance]))
    }

    /// An equirectangular map of radiance.
    ///
    /// # Errors
    /// When the map is empty or a texel is negative or not finite.
    pub fn from_map(map: Image) -> Result<Self, Error> {
        if map.pixels().is_empty() {
            return Err(Error::LengthMismatch { place: "environment map".into(), found: 0, expected: 1 });
        }
        for (i, pixel) in map.pixels().iter().enumerate() {
            let place = || format!("environment map, column {}, row {}", i % map.width(), i / map.width());
            for value in pixel.to_array() {
                if !value.is_finite() {
                    return Err(Error::NotFinite { place: place(), value: value.into() });
                }
                if value < 0.0 {
                    return Err(Error::OutOfRange {
                        place: place(),
                        value: value.into(),
                        expected: "a radiance of 0 or more",
                    });
                }
            }
        }
        let name = if map.pixels().len() == 1 { "sky" } else { "environment" };
        Ok(Self { map, name: name.into() })
    }

    /// The same light under another name.
    pub fn named(self, name: impl Into<String>) -> Self {
        Self { name: name.into(), ..self }
    }

    /// The name, by which it is a group of lights: `sky` for a constant, `environment` for a map, unless it was given another.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The same sky with every radiance multiplied by `factor`.
    ///
    /// # Errors
    /// When a product is negative or not finite.
    pub fn scaled(&self, factor: Rgb) -> Result<Self, Error> {
        let pixels = self.map.pixels().iter().map(|p| *p * factor).collect();
        let map = Image::from_pixels(self.map.width(), self.map.height(), pixels);
        Ok(Self::from_map(map)?.named(self.name.clone()))
    }

    /// The radiance when it is the same everywhere.
    pub fn as_constant(&self) -> Option<Rgb> {
        let first = self.map.pixels()[0];
        self.map.pixels().iter().all(|p| *p == first).then_some(first)
    }

    /// The map; a single texel for a constant.
    pub fn map(&self) -> &Image {
        &self.map
    }

    /// The radiance that arrives along `-direction`, that is, seen when looking along `direction` (unit).
    pub fn radiance(&self, direction: Vec3) -> Rgb {
        let (width, height) = (self.map.width(), self.map.height());
        if width * height == 1 {
            return self.map.pixels()[0];
        }
        let (column, row) = self.texel(direction);
        self.map.pixels()[row * width + column]
    }

    /// The texel (column, row) that `direction` (unit) falls into.
    pub fn texel(&self, direction: Vec3) -> (usize, usize) {
        let (width, height) = (self.map.width(), self.map.height());
        let x = (0.5 + direction.x.atan2(-direction.z) / TAU) * width as f32;
        let y = direction.y.clamp(-1.0, 1.0).acos() / PI * height as f32;
        ((x as usize).min(width - 1), (y as usize).min(height - 1))
    }

    /// The solid angle of a texel of `row`, steradians.
    pub fn texel_solid_angle(&self, row: usize) -> f64 {
        let height = self.map.height() as f64;
        let cos = |r: f64| (std::f64::consts::PI * r / height).cos();
        let azimuth = std::f64::consts::TAU / self.map.width() as f64;
        azimuth * (cos(row as f64) - cos(row as f64 + 1.0))
    }

    /// The direction at `uv` in `[0, 1)²` of a texel, uniform in solid angle over it.
    pub fn direction_in_texel(&self, column: usize, row: usize, uv: Vec2) -> Vec3 {
        let (width, height) = (self.map.width() as f32, self.map.height() as f32);
        let azimuth = ((column as f32 + uv.x) / width - 0.5) * TAU;
        let (top, bottom) = ((PI * row as f32 / height).cos(), (PI * (row as f32 + 1.0) / height).cos());
        let y = top + (bottom - top) * uv.y;
        let radius = (1.0 - y * y).max(0.0).sqrt();
        let (sin, cos) = azimuth.sin_cos();
        Vec3::new(radius * sin, y, -radius * cos)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_in_a_texel_fall_into_that_texel_and_solid_angles_close() {
        let environment = Environment::from_map(Image::new(16, 8)).unwrap();
        let mut total = 0.0;
        for row in 0..8 {
            total += environment.texel_solid_angle(row) * 16.0;
            for column in 0..16 {
                for uv in [Vec2::splat(0.01), Vec2::splat(0.99), Vec2::new(0.3, 0.8)] {
                    let direction = environment.direction_in_texel(column, row, uv);
                    assert_eq!(environment.texel(direction), (column, row));
                }
            }
        }
        assert!((total - 2.0 * std::f64::consts::TAU).abs() < 1e-12);
    }

    #[test]
    fn negative_and_non_finite_radiance_is_refused() {
        assert!(Environment::constant(Rgb::new(0.0, -1.0, 0.0)).is_err());
        assert!(Environment::constant(Rgb::new(0.0, f32::NAN, 0.0)).is_err());
    }
}
