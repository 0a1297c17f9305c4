//! The environment as a light source.

use glam::{Vec2, Vec3};
use hplt_geom::radiometry::{cosine_pdf_solid_angle, luminance};
use hplt_geom::{Environment, Rgb};

/// Chooses directions by the radiance of an environment map.
#[derive(Debug, Clone)]
pub(crate) struct SkySampler {
    /// Running share of the power over all texels, row by row, ending at 1.
    cumulative: Vec<f64>,
}

impl SkySampler {
    /// `None` where there is nothing to choose between: a constant sky, or a black one.
    pub fn new(environment: &Environment) -> Option<Self> {
        if environment.as_constant().is_some() {
            return None;
        }
        let map = environment.map();
        let mut sum = 0.0;
        let mut cumulative = Vec::with_capacity(map.pixels().len());
        for (i, radiance) in map.pixels().iter().enumerate() {
            sum += f64::from(luminance(*radiance)) * environment.texel_solid_angle(i / map.width());
            cumulative.push(sum);
        }
        (sum > 0.0).then(|| Self { cumulative: cumulative.into_iter().map(|c| c / sum).collect() })
    }

    /// A direction and its probability density per steradian.
    pub fn sample(&self, environment: &Environment, u: Vec2) -> (Vec3, f32) {
        let x = f64::from(u.x);
        let i = self.cumulative.partition_point(|&c| c <= x).min(self.cumulative.len() - 1);
        let below = if i == 0 { 0.0 } else { self.cumulative[i - 1] };
        let share = self.cumulative[i] - below;
        let again = ((x - below) / share).clamp(0.0, 1.0 - 1e-7) as f32;
        let width = environment.map().width();
        let direction = environment.direction_in_texel(i % width, i / width, Vec2::new(again, u.y));
        (direction, (share / environment.texel_solid_angle(i / width)) as f32)
    }

    /// The density with which [`sample`](Self::sample) chooses `direction`.
    pub fn pdf_solid_angle(&self, environment: &Environment, direction: Vec3) -> f32 {
        let (column, row) = environment.texel(direction);
        let i = row * environment.map().width() + column;
        let below = if i == 0 { 0.0 } else { self.cumulative[i - 1] };
        ((self.cumulative[i] - below) / environment.texel_solid_angle(row)) as f32
    }

    /// The contribution of one of `2n` samples, `n` from the map and `n` cosine-distributed, weighted by the balance
    /// heuristic (Veach & Guibas 1995, eq. 14): `L cosθ / (n (p_map + p_cos))`.
    pub fn weighted(&self, environment: &Environment, direction: Vec3, cos: f32, n: u32) -> Rgb {
        let density = self.pdf_solid_angle(environment, direction) + cosine_pdf_solid_angle(cos);
        environment.radiance(direction) * (cos.max(0.0) / (n as f32 * density))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hplt_geom::Image;

    #[test]
    fn one_hot_texel_is_always_found() {
        let mut map = Image::new(8, 4);
        map.pixels_mut()[13] = Rgb::splat(1e6);
        let environment = Environment::from_map(map).unwrap();
        let sampler = SkySampler::new(&environment).unwrap();
        for i in 0..100 {
            let u = Vec2::new(i as f32 / 100.0, 0.37);
            let (direction, pdf) = sampler.sample(&environment, u);
            assert_eq!(environment.radiance(direction), Rgb::splat(1e6));
            let expected = 1.0 / environment.texel_solid_angle(1) as f32;
            assert!((pdf / expected - 1.0).abs() < 1e-5);
            assert!((sampler.pdf_solid_angle(&environment, direction) / expected - 1.0).abs() < 1e-5);
        }
    }
}
