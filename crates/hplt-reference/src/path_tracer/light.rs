//! Sampling of emitters, lights and the environment.

use std::f64::consts::PI;

use hplt_geom::glam::{DVec2, DVec3, Vec2};
use hplt_geom::{Environment, LightShape, Scene, TriangleId};

use super::vertex::unit_normal;

/// Up to this many lights without a surface are all sampled at every vertex; of more, one is picked.
const ALL_LIGHTS: usize = 4;

/// Tables to pick light from.
#[derive(Debug)]
pub(super) struct Lights {
    emitters: Vec<Emitter>,
    /// Running sums of the emitters' probabilities.
    emitter_sums: Vec<f64>,
    environment: Option<EnvironmentTable>,
}

#[derive(Debug)]
struct Emitter {
    triangle: TriangleId,
    probability: f64,
    area: f64,
}

/// A point on an emitting triangle.
#[derive(Debug, Clone, Copy)]
pub(super) struct EmitterSample {
    pub(super) triangle: TriangleId,
    pub(super) position: DVec3,
    /// Unit normal of the front.
    pub(super) normal: DVec3,
    pub(super) uv: Vec2,
    pub(super) pdf_area: f64,
}

/// Light that arrives from one direction, before visibility.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arrival {
    pub(super) direction: DVec3,
    /// Distance in units of `direction` up to which something can block.
    pub(super) t_max: f64,
    /// Irradiance on a surface that faces `direction`, over the probability of the sample.
    pub(super) irradiance: DVec3,
}

/// Per-texel probabilities of a map that is not constant.
#[derive(Debug)]
struct EnvironmentTable {
    row_sums: Vec<f64>,
    /// Per row, running sums over its columns, from 0 to 1.
    column_sums: Vec<Vec<f64>>,
}

impl Lights {
    pub(super) fn new(scene: &Scene) -> Self {
        let weight = |t: TriangleId| {
            let material = scene.material(t);
            scene.mesh().area(t) * f64::from(material.exitance.element_sum())
        };
        let triangles: Vec<TriangleId> = scene.emissive_triangles().collect();
        let total: f64 = triangles.iter().map(|&t| weight(t)).sum();
        let emitters: Vec<Emitter> = triangles
            .into_iter()
            .map(|triangle| Emitter {
                triangle,
                probability: weight(triangle) / total,
                area: scene.mesh().area(triangle),
            })
            .collect();
        let emitter_sums = running_sums(emitters.iter().map(|e| e.probability));
        Self { emitters, emitter_sums, environment: scene.environment().and_then(EnvironmentTable::new) }
    }

    /// A point on an emitter, emitters chosen by area times exitance.
    pub(super) fn sample_emitter(&self, scene: &Scene, pick: f64, numbers: DVec2) -> Option<EmitterSample> {
        let emitter = self.emitters.get(pick_index(&self.emitter_sums, pick))?;
        let root = numbers.x.sqrt();
        let (u, v) = (1.0 - root, numbers.y * root);
        let [a, b, c] = scene.mesh().corners(emitter.triangle).map(|p| p.as_dvec3());
        Some(EmitterSample {
            triangle: emitter.triangle,
            position: a + (b - a) * u + (c - a) * v,
            normal: unit_normal(scene, emitter.triangle),
            uv: scene.mesh().uv_at(emitter.triangle, u as f32, v as f32),
            pdf_area: emitter.probability / emitter.area,
        })
    }

    /// The density per area with which [`sample_emitter`](Self::sample_emitter) picks points of a triangle.
    pub(super) fn emitter_pdf_area(&self, triangle: TriangleId) -> f64 {
        let found = self.emitters.binary_search_by_key(&triangle, |e| e.triangle);
        found.map_or(0.0, |i| self.emitters[i].probability / self.emitters[i].area)
    }

    /// Light from the lights that have no surface, each arrival already divided by the probability of its choice.
    pub(super) fn punctual(&self, scene: &Scene, at: DVec3, pick: f64, numbers: DVec2, mut each: impl FnMut(Arrival)) {
        let lights = scene.lights();
        if lights.len() <= ALL_LIGHTS {
            for light in lights {
                each(arrival(&light.shape, at, numbers));
            }
            return;
        }
        let sums = running_sums(lights.iter().map(|light| {
            let shape = &light.shape;
            f64::from(power(shape)) / distance_squared(shape, at)
        }));
        let total = sums[sums.len() - 1];
        if total > 0.0 {
            let i = pick_index(&sums, pick);
            let probability = (sums[i] - if i > 0 { sums[i - 1] } else { 0.0 }) / total;
            let picked = arrival(&lights[i].shape, at, numbers);
            each(Arrival { irradiance: picked.irradiance / probability, ..picked });
        }
    }

    /// A direction towards the environment, its radiance and its density; `None` when rays that miss find it well enough.
    pub(super) fn sample_environment(&self, scene: &Scene, numbers: DVec2) -> Option<(DVec3, DVec3, f64)> {
        let (table, environment) = (self.environment.as_ref()?, scene.environment()?);
        let row = pick_index(&table.row_sums, numbers.y);
        let y = fraction(&table.row_sums, row, numbers.y);
        let columns = &table.column_sums[row];
        let column = pick_index(columns, numbers.x);
        let x = fraction(columns, column, numbers.x);
        let direction = environment.direction_in_texel(column, row, Vec2::new(x as f32, y as f32));
        let radiance = environment.map().pixels()[row * environment.map().width() + column].as_dvec3();
        Some((direction.as_dvec3().normalize(), radiance, table.pdf(environment, column, row)))
    }

    /// The density per solid angle of [`sample_environment`](Self::sample_environment) at a direction.
    pub(super) fn environment_pdf_solid_angle(&self, scene: &Scene, direction: DVec3) -> f64 {
        let (Some(table), Some(environment)) = (self.environment.as_ref(), scene.environment()) else { return 0.0 };
        let (column, row) = environment.texel(direction.as_vec3());
        table.pdf(environment, column, row)
    }
}

impl EnvironmentTable {
    fn new(environment: &Environment) -> Option<Self> {
        if environment.as_constant().is_some() {
            return None;
        }
        let map = environment.map();
        let weight = |row: usize, column: usize| {
            f64::from(map.pixels()[row * map.width() + column].element_sum()) * environment.texel_solid_angle(row)
        };
        let column_sums: Vec<Vec<f64>> =
            (0..map.height()).map(|row| running_sums((0..map.width()).map(|column| weight(row, column)))).collect();
        let row_sums = running_sums(column_sums.iter().map(|sums| sums[sums.len() - 1]));
        Some(Self { row_sums, column_sums })
    }

    fn pdf(&self, environment: &Environment, column: usize, row: usize) -> f64 {
        let weight = step(&self.column_sums[row], column);
        weight / self.row_sums[self.row_sums.len() - 1] / environment.texel_solid_angle(row)
    }
}

fn arrival(shape: &LightShape, at: DVec3, numbers: DVec2) -> Arrival {
    match shape {
        LightShape::Point { position, intensity } => {
            let direction = position.as_dvec3() - at;
            Arrival { direction, t_max: 1.0, irradiance: intensity.as_dvec3() / direction.length_squared() }
        }
        LightShape::Spot { position, direction: axis, intensity, cos_inner, cos_outer } => {
            let direction = position.as_dvec3() - at;
            let cos_angle = -axis.as_dvec3().dot(direction.normalize_or_zero());
            let (inner, outer) = (f64::from(*cos_inner), f64::from(*cos_outer));
            // KHR_lights_punctual: the squared linear ramp in the cosine.
            let ramp = ((cos_angle - outer) / (inner - outer).max(1e-4)).clamp(0.0, 1.0);
            let irradiance = intensity.as_dvec3() * (ramp * ramp / direction.length_squared());
            Arrival { direction, t_max: 1.0, irradiance }
        }
        LightShape::Directional { direction_to_light, irradiance, angular_radius } => {
            let axis = direction_to_light.as_dvec3().normalize();
            let irradiance = irradiance.as_dvec3();
            let angle = f64::from(*angular_radius);
            if angle == 0.0 {
                return Arrival { direction: axis, t_max: f64::INFINITY, irradiance };
            }
            // Uniform over the cone: the solid angle 2π(1-cos) over the projected one π sin².
            let drop = 2.0 * (0.5 * angle).sin().powi(2);
            let cos = 1.0 - numbers.x * drop;
            let sin = (1.0 - cos * cos).max(0.0).sqrt();
            let (tangent, bitangent) = axis.any_orthonormal_pair();
            let around = DVec2::from_angle(2.0 * PI * numbers.y) * sin;
            let direction = tangent * around.x + bitangent * around.y + axis * cos;
            let weight = 2.0 * drop / angle.sin().powi(2);
            Arrival { direction, t_max: f64::INFINITY, irradiance: irradiance * weight }
        }
        // A kind of light that this judge does not know must not pass as black.
        _ => unreachable!("unknown light shape"),
    }
}

fn power(shape: &LightShape) -> f32 {
    match shape {
        LightShape::Point { intensity, .. } | LightShape::Spot { intensity, .. } => intensity.element_sum(),
        LightShape::Directional { irradiance, .. } => irradiance.element_sum(),
        _ => 0.0,
    }
}

fn distance_squared(shape: &LightShape, at: DVec3) -> f64 {
    match shape {
        LightShape::Point { position, .. } | LightShape::Spot { position, .. } => {
            position.as_dvec3().distance_squared(at).max(1e-12)
        }
        _ => 1.0,
    }
}

fn running_sums(weights: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut sum = 0.0;
    weights
        .map(|weight| {
            sum += weight;
            sum
        })
        .collect()
}

/// The first index whose running sum exceeds the fraction `number` of the total; one of positive weight.
fn pick_index(sums: &[f64], number: f64) -> usize {
    let Some(&total) = sums.last() else { return 0 };
    let target = (number * total).min(total * (1.0 - f64::EPSILON));
    sums.partition_point(|&sum| sum <= target).min(sums.len() - 1)
}

fn step(sums: &[f64], i: usize) -> f64 {
    sums[i] - if i > 0 { sums[i - 1] } else { 0.0 }
}

/// Where in step `i` the fraction `number` of the total falls, in `[0, 1)`.
fn fraction(sums: &[f64], i: usize, number: f64) -> f64 {
    let total = sums[sums.len() - 1];
    let start = if i > 0 { sums[i - 1] } else { 0.0 };
    ((number * total - start) / step(sums, i)).clamp(0.0, 1.0 - f64::EPSILON)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn picks_follow_the_weights_and_never_hit_a_zero() {
        let sums = running_sums([0.0, 1.0, 0.0, 3.0, 0.0].into_iter());
        let picks: Vec<usize> = (0..8).map(|i| pick_index(&sums, f64::from(i) / 8.0)).collect();
        assert_eq!(picks, [1, 1, 3, 3, 3, 3, 3, 3]);
        assert_eq!(pick_index(&sums, 1.0 - 1e-17), 3);
        assert_eq!(fraction(&sums, 3, 0.625), 0.5);
    }
}
