//! Which places a function has a say at.
mod common;

use std::sync::atomic::{AtomicUsize, Ordering};

use common::Shapes;
use glam::{DVec3, Vec3};
use hplt_geom::{Bvh, Extent, Hit, OrientedPoint, Ray, RayCaster, RegionId, Scene};
use hplt_sampling::{free_height, is_in_sight};

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
