//! The groups of lights of a scene, with what each emits.

use hplt_geom::glam::DVec3;
use hplt_geom::radiometry::{irradiance_from_uniform_radiance, power_of_point, power_of_spot};
use hplt_geom::{Environment, LightGroups, LightShape, Rgb, Scene, TriangleId};
use hplt_sampling::{sobol, warp};
use serde::Serialize;

use crate::values::human_count;

/// Points at which the emission of a textured triangle is read, for its mean.
const TEXTURE_SAMPLES: u32 = 16;

/// One group of lights.
#[derive(Debug, Clone, PartialEq, Serialize, Default)]
pub struct LightRow {
    /// Its name.
    pub name: String,
    /// Emissive triangles.
    pub triangles: usize,
    /// Their area, m².
    pub area: f64,
    /// Lights without a surface.
    pub lights: usize,
    /// Whether the environment is in it.
    pub has_environment: bool,
    /// Power of surfaces, point and spot lights, W.
    pub power: [f64; 3],
    /// Irradiance on surfaces that face distant lights, or lie under all of a sky of the environment's mean radiance, W/m².
    pub irradiance: [f64; 3],
}

impl LightRow {
    /// What it holds, for people.
    pub fn in_words(&self) -> String {
        let mut parts = Vec::new();
        if self.triangles > 0 {
            parts.push(format!("{} triangles, {:.4} m2", human_count(self.triangles as u64), self.area));
        }
        if self.lights > 0 {
            parts.push(format!("{} lights", self.lights));
        }
        if self.has_environment {
            parts.push("environment".into());
        }
        for (values, unit) in [(self.power, "W"), (self.irradiance, "W/m2")] {
            if values != [0.0; 3] {
                let [r, g, b] = values;
                parts.push(format!("{r:.4} {g:.4} {b:.4} {unit}"));
            }
        }
        format!("\"{}\": {}", hplt_io::sanitized(&self.name), parts.join(", "))
    }
}

/// The groups of a scene, in their order.
pub fn light_table(scene: &Scene) -> Vec<LightRow> {
    let groups = LightGroups::of(scene);
    let name = |name: &String| LightRow { name: name.clone(), ..LightRow::default() };
    let mut rows: Vec<LightRow> = groups.names().iter().map(name).collect();
    let area_scale = scene.frame().scale() * scene.frame().scale();
    for triangle in scene.emissive_triangles() {
        if let Some(group) = groups.of_material(scene.mesh().material(triangle)) {
            let row = &mut rows[group.0 as usize];
            let area = scene.mesh().area(triangle) * area_scale;
            row.triangles += 1;
            row.area += area;
            add(&mut row.power, mean_exitance(scene, triangle) * area);
        }
    }
    for (i, light) in scene.lights().iter().enumerate() {
        let row = &mut rows[groups.of_light(i).0 as usize];
        row.lights += 1;
        match light.shape {
            LightShape::Point { intensity, .. } => {
                add(&mut row.power, power_of_point(intensity).as_dvec3() * area_scale);
            }
            LightShape::Spot { intensity, cos_inner, cos_outer, .. } => {
                add(&mut row.power, power_of_spot(intensity, cos_inner, cos_outer).as_dvec3() * area_scale);
            }
            LightShape::Directional { irradiance, .. } => add(&mut row.irradiance, irradiance.as_dvec3()),
            _ => {}
        }
    }
    if let (Some(environment), Some(group)) = (scene.environment(), groups.of_environment()) {
        let row = &mut rows[group.0 as usize];
        row.has_environment = true;
        add(&mut row.irradiance, irradiance_from_uniform_radiance(mean_radiance(environment)).as_dvec3());
    }
    rows
}

fn add(sum: &mut [f64; 3], value: DVec3) {
    sum.iter_mut().zip(value.to_array()).for_each(|(sum, x)| *sum += x);
}

/// Over both sides.
fn mean_exitance(scene: &Scene, triangle: TriangleId) -> DVec3 {
    let material = scene.material(triangle);
    let sides = [true, false].into_iter().filter(|&is_front| material.emits.includes(is_front));
    let n = if material.exitance_texture.is_some() { TEXTURE_SAMPLES } else { 1 };
    let at = |k: u32| warp::uniform_triangle(sobol::sobol_2d(k, triangle.0, 0));
    let of_side = |is_front: bool| {
        let uv = |k: u32| scene.mesh().uv_at(triangle, at(k).x, at(k).y);
        (0..n).map(|k| material.exitance_at(is_front, uv(k)).as_dvec3()).sum::<DVec3>() / f64::from(n)
    };
    sides.map(of_side).sum()
}

fn mean_radiance(environment: &Environment) -> Rgb {
    let map = environment.map();
    let (mut sum, mut total) = (DVec3::ZERO, 0.0);
    for (i, radiance) in map.pixels().iter().enumerate() {
        let solid_angle = environment.texel_solid_angle(i / map.width());
        sum += radiance.as_dvec3() * solid_angle;
        total += solid_angle;
    }
    (sum / total).as_vec3()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use hplt_geom::glam::Vec3;
    use hplt_geom::{BuildPolicy, Environment};

    use super::*;

    #[test]
    fn rows_hold_the_power_of_their_lights() {
        let mut builder = hplt_reference::scenes::cornell_box();
        builder.push_point_light("bulb", DVec3::splat(0.1), Rgb::new(1.0, 2.0, 0.0));
        builder.push_spot_light("bulb", DVec3::splat(0.1), Vec3::NEG_Y, Rgb::ONE, 0.0, PI as f32);
        builder.push_directional_light("sun", Vec3::Y, Rgb::splat(5.0), 0.0);
        builder.set_environment(Environment::constant(Rgb::splat(2.0)).unwrap());
        let (scene, _) = builder.build(BuildPolicy::default()).unwrap();
        let rows = light_table(&scene);
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-5;
        assert_eq!(rows.iter().map(|r| &r.name[..]).collect::<Vec<_>>(), ["light", "bulb", "sun", "sky"]);
        assert!((rows[0].triangles, rows[0].lights) == (2, 0) && near(rows[0].area, 0.13 * 0.105));
        assert!(near(rows[0].power[0], 17.0 * PI * 0.13 * 0.105), "{:?}", rows[0]);
        // The ramp from axis to antipode, squared: a third of a full sphere.
        assert!(rows[1].lights == 2 && near(rows[1].power[1], 4.0 * PI * (2.0 + 1.0 / 3.0)), "{:?}", rows[1]);
        assert!(rows[2].irradiance == [5.0; 3] && rows[2].power == [0.0; 3]);
        assert!(rows[3].has_environment && near(rows[3].irradiance[2], 2.0 * PI));
        assert!(rows[0].in_words().starts_with("\"light\": 2 triangles, 0.0136 m2, "), "{}", rows[0].in_words());
    }
}
