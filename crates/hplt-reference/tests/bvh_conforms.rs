//! The workspace's own ray caster against brute force.
use hplt_geom::{Bvh, BvhOptions, Scene};
use hplt_reference::{conformance, scenes};

fn assert_conforms(scene: &Scene, n_rays: usize) {
    let (bvh, _) = Bvh::build(scene, BvhOptions::default());
    let report = conformance::ray_caster(&bvh, scene, n_rays, 7);
    assert!(report.passed(), "{report}");
}

#[test]
fn the_bvh_conforms_on_the_cornell_box() {
    assert_conforms(&scenes::build(scenes::cornell_box()), 4000);
}

#[test]
fn the_bvh_conforms_among_boxes_and_on_curved_surfaces() {
    assert_conforms(&scenes::build(scenes::cluttered_room(9, 60, 1.0)), 2000);
    assert_conforms(&scenes::build(scenes::torus(32, 16, 1.0)), 2000);
    assert_conforms(&scenes::build(scenes::statue_room(2000)), 1000);
}

#[test]
fn the_bvh_conforms_on_coincident_walls() {
    assert_conforms(&scenes::build(scenes::two_rooms(0.0)), 2000);
}
