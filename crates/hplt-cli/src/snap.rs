//! Sensor points put onto the surface that they mean.

use hplt_geom::glam::Vec3;
use hplt_geom::{Hit, Ray, RayCaster, Scene, offset_origin, parallel};
use hplt_io::SensorPoint;

/// The least cosine between the normal of a sensor and that of its surface: 25 degrees.
const MIN_COSINE: f32 = 0.906_307_8;
/// Surfaces that are passed on the way to the right one.
const MAX_LAYERS: usize = 16;

/// A sensor in scene space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placed {
    /// Position.
    pub position: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Whether it is on a surface; else it is in the air.
    pub is_on_surface: bool,
}

/// Puts every sensor that is within `reach` (scene units, along its normal) of a surface whose side agrees with its normal
/// onto the nearest such surface, with that side's normal. The others stay where they are. In order.
pub fn place(scene: &Scene, caster: &dyn RayCaster, sensors: &[SensorPoint], reach: f32) -> Vec<Placed> {
    parallel::map(
        sensors.len(),
        || (),
        |(), i| {
            let position = scene.frame().scene_from_world_point(sensors[i].position);
            let normal = sensors[i].normal.as_vec3().normalize();
            place_one(scene, caster, position, normal, reach)
        },
    )
}

fn place_one(scene: &Scene, caster: &dyn RayCaster, position: Vec3, normal: Vec3, reach: f32) -> Placed {
    let mut best = Placed { position, normal, is_on_surface: false };
    let mut best_distance = f32::INFINITY;
    // Down through everything between `reach` above and `reach` below.
    let mut origin = position + normal * reach;
    let end = position - normal * reach;
    for _ in 0..MAX_LAYERS {
        let hit = caster.nearest(Ray::segment(origin, end));
        if hit.is_miss() {
            break;
        }
        let surface = scene.surface_at(&hit);
        let distance = (surface.position - position).length();
        if surface.normal.dot(normal) >= MIN_COSINE && distance < best_distance {
            best_distance = distance;
            best = Placed { position: surface.position, normal: surface.normal, is_on_surface: true };
        }
        origin = behind(&hit, scene);
        if (origin - end).dot(normal) <= 0.0 {
            break;
        }
    }
    best
}

/// Just behind the surface that a ray met.
fn behind(hit: &Hit, scene: &Scene) -> Vec3 {
    let surface = scene.surface_at(hit);
    offset_origin(surface.position, -surface.normal)
}

#[cfg(test)]
mod tests {
    use hplt_geom::glam::DVec3;
    use hplt_geom::{Bvh, BvhOptions};
    use hplt_reference::scenes;

    use super::*;

    fn placed(x: f64, y: f64, z: f64, normal: DVec3) -> (DVec3, Vec3, bool) {
        let scene = scenes::build(scenes::two_rooms(0.001));
        let (bvh, _) = Bvh::build(&scene, BvhOptions::fast());
        let sensor = SensorPoint { position: DVec3::new(x, y, z), normal };
        let placed = place(&scene, &bvh, &[sensor], 1e-3 * scene.diagonal())[0];
        (scene.frame().world_from_scene_point(placed.position), placed.normal, placed.is_on_surface)
    }

    #[test]
    fn points_above_below_and_on_a_floor_are_put_onto_it() {
        for y in [0.0, 1e-3, -1e-3, 1e-7, -1e-7] {
            let (position, normal, is_on_surface) = placed(-0.5, y, 0.5, DVec3::Y);
            assert!(is_on_surface && position.y.abs() < 1e-6 && normal == Vec3::Y, "{y}: {position}");
        }
    }

    #[test]
    fn a_tilted_normal_is_replaced_by_that_of_the_surface_when_it_agrees() {
        let tilted = DVec3::new(0.3, 1.0, 0.0).normalize();
        assert_eq!(placed(-0.5, 1e-4, 0.5, tilted).1, Vec3::Y);
        let (_, normal, is_on_surface) = placed(-0.5, 1e-4, 0.5, DVec3::new(1.0, 1.0, 0.0).normalize());
        assert!(!is_on_surface && normal.x > 0.5);
    }

    #[test]
    fn a_point_in_the_air_stays() {
        let (position, _, is_on_surface) = placed(-0.5, 0.3, 0.5, DVec3::Y);
        assert!(!is_on_surface && (position.y - 0.3).abs() < 1e-6);
    }

    #[test]
    fn a_sensor_in_a_thin_wall_is_put_onto_the_nearest_side_that_faces_its_way() {
        // The wall's two sheets are at x = 0 and x = 0.001, both within reach.
        let (left, ..) = placed(0.0003, 0.5, 0.5, -DVec3::X);
        let (right, ..) = placed(0.0008, 0.5, 0.5, DVec3::X);
        assert!(left.x.abs() < 1e-6 && (right.x - 0.001).abs() < 1e-6, "{left} {right}");
    }
}
