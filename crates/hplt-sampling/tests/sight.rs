//! Which places a function has a say at.
mod common;

use std::sync::atomic::{AtomicUsize, Ordering};

use common::{Shapes, two_rooms};
use glam::{DVec3, Vec3};
use hplt_geom::{Bvh, Extent, Hit, NoProgress, OrientedPoint, Ray, RayCaster, RegionId, Scene};
use hplt_sampling::{HierarchyOptions, Radius, free_height, is_in_sight, poisson_hierarchy};

/// Counts the rays that go through it.
struct Counting<'a>(&'a Bvh, AtomicUsize);

impl RayCaster for Counting<'_> {
    fn trace_nearest(&self, rays: &[Ray], hits: &mut [Hit]) {
        self.1.fetch_add(rays.len(), Ordering::Relaxed);
        self.0.trace_nearest(rays, hits);
    }

    fn trace_occluded(&self, rays: &[Ray], occluded: &mut [bool]) {
        self.1.fetch_add(rays.len(), Ordering::Relaxed);
        self.0.trace_occluded(rays, occluded);
    }
}

/// A floor, and over its half at x > 0 a plate, 12 mm above it, with a rim at x = 0 when it is `closed`.
fn plate(closed: bool) -> (Scene, Bvh) {
    let mut s = Shapes::new();
    let white = s.white;
    s.quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], white);
    s.quad([0.0, 0.012, -1.0], [0.0, 0.0, 2.0], [1.0, 0.0, 0.0], white);
    if closed {
        s.quad([0.0, 0.0, -1.0], [0.0, 0.012, 0.0], [0.0, 0.0, 2.0], white);
    }
    s.build()
}

fn facing_up(scene: &Scene, bvh: &Bvh, at: [f64; 3]) -> OrientedPoint {
    let position = scene.frame().scene_from_world_point(DVec3::from(at));
    let extent = Extent::of_query(free_height(bvh, position, Vec3::Y));
    OrientedPoint { extent, ..OrientedPoint::new(position, Vec3::Y, RegionId(0)) }
}

#[test]
fn what_lies_under_a_plate_is_out_of_sight_of_functions_on_it() {
    for closed in [true, false] {
        let (scene, bvh) = plate(closed);
        let at = |p| facing_up(&scene, &bvh, p);
        let support = scene.frame().scene_from_world_length(0.2);
        let on_plate = at([0.05, 0.012, 0.0]);
        let sees = |query: [f64; 3]| is_in_sight(&bvh, &on_plate, &at(query), support);
        assert!(!sees([0.1, 0.0, 0.03]), "under the plate");
        assert!(sees([0.1, 0.012, 0.03]), "beside it on the plate");
        // Over the edge, 12 mm down: the lines run as high as 10 mm above both.
        assert!(sees([-0.1, 0.0, 0.0]), "on the floor before the plate");
        // Under the plate what the open floor sees depends on the rim alone.
        let on_floor = at([-0.02, 0.0, 0.0]);
        let inverse_depths = [1.0 / scene.frame().scene_from_world_length(0.02); 8];
        let on_floor = OrientedPoint { extent: Extent { inverse_depths, ..on_floor.extent }, ..on_floor };
        assert_eq!(is_in_sight(&bvh, &on_floor, &at([0.03, 0.0, 0.0]), support * 0.2), !closed);
    }
}

#[test]
fn flat_surface_with_nothing_near_costs_no_ray() {
    let (scene, bvh) = plate(true);
    let counting = Counting(&bvh, AtomicUsize::new(0));
    let [a, b] = [[-0.5, 0.0, 0.0], [-0.4, 0.0, 0.05]].map(|p| facing_up(&scene, &bvh, p));
    let support = scene.frame().scene_from_world_length(0.2);
    assert!(is_in_sight(&counting, &a, &b, support));
    assert_eq!(counting.1.load(Ordering::Relaxed), 0);
    let near_something = OrientedPoint { extent: Extent { inverse_depths: [100.0; 8], ..a.extent }, ..a };
    assert!(is_in_sight(&counting, &near_something, &b, support));
    assert_eq!(counting.1.load(Ordering::Relaxed), 1);
}

/// The functions of one level, of world radius `radius`.
fn functions(scene: &Scene, bvh: &Bvh, radius: f64) -> Vec<OrientedPoint> {
    let options =
        HierarchyOptions { n_levels: 1, coarsest_radius: Radius::World(radius), ..HierarchyOptions::slides() };
    poisson_hierarchy(scene, bvh, &options, &NoProgress).unwrap().points.levels.swap_remove(0).points
}

/// Half a cylinder of radius 1 about the x axis, from x = -2 to 2, open below, in facets of 11.25 degrees, in a room with a lamp.
fn vault() -> (Scene, Bvh) {
    let mut s = Shapes::new();
    let white = s.white;
    let edge = |k: u32| (f64::from(k) * std::f64::consts::PI / 16.0).sin_cos();
    for k in 0..16 {
        let ((y, z), (y1, z1)) = (edge(k), edge(k + 1));
        s.quad([-2.0, y, z], [4.0, 0.0, 0.0], [0.0, y1 - y, z1 - z], white);
    }
    s.cuboid([-4.0, -2.0, -3.0], [4.0, 3.0, 3.0], true, white).lamp_at([0.0, 0.0, 0.0], 0.5);
    s.build()
}

#[test]
fn functions_in_a_vault_go_on_along_it_until_it_has_turned_by_sixty_degrees() {
    let (scene, bvh) = vault();
    let frame = scene.frame();
    let points = functions(&scene, &bvh, 0.4);
    let mut checked = 0;
    for point in &points {
        let at = frame.world_from_scene_point(point.position);
        let is_inside = f64::from(point.normal.y) * at.y + f64::from(point.normal.z) * at.z < 0.0;
        let angle = at.z.atan2(at.y).to_degrees();
        if !is_inside || at.y > 1.1 || angle.abs() > 14.0 || at.x.abs() > 1.9 {
            continue;
        }
        for turn in [-75.0_f64, -45.0, -20.0, 20.0, 45.0, 75.0] {
            let (z, y) = (angle + turn).to_radians().sin_cos();
            let other = frame.scene_from_world_point(DVec3::new(at.x, y, z));
            let goes_on = point.extent.contains(other - point.position, point.normal);
            assert_eq!(goes_on, turn.abs() < 60.0, "from {angle:.1} by {turn} degrees");
            checked += 1;
        }
    }
    assert!(checked >= 24, "{checked}");
}

#[test]
fn a_wall_ends_the_floor() {
    let (scene, bvh) = two_rooms(0.0).build();
    let frame = scene.frame();
    let mut checked = 0;
    for point in functions(&scene, &bvh, 0.2) {
        let at = frame.world_from_scene_point(point.position);
        if point.normal.y < 0.9 || !(0.7..0.999).contains(&at.x) {
            continue;
        }
        let contains = |x: f64| {
            let other = frame.scene_from_world_point(DVec3::new(x, at.y, at.z));
            point.extent.contains(other - point.position, point.normal)
        };
        assert!(contains(at.x + 0.9 * (1.0 - at.x)) && !contains(1.05), "{at}");
        checked += 1;
    }
    assert!(checked >= 3, "{checked}");
}
