//! Samples of a pixel that see one surface, taken together.

#[allow(dead_code, reason = "other tests use the rest")]
mod common;

use common::{camera, gbuffer_of, room, scene_of};
use hplt_geom::RegionId;
use hplt_geom::glam::Vec3;
use hplt_splat::{GBufferOptions, Patches};

/// Nearly all pixels see one surface; a patch is in the middle of its samples and on their surface.
#[test]
fn patches_stand_for_the_samples_of_a_pixel_that_see_one_surface() {
    let options = GBufferOptions { width: 80, height: 60, samples_per_axis: 4, seed: 1 };
    let gbuffer = gbuffer_of(&scene_of(&room()), &camera(), options);
    let patches = Patches::of(&gbuffer);
    let points = patches.surface_points();
    let sees_surface = |pixel: &usize| (16 * pixel..16 * (pixel + 1)).any(|i| !gbuffer.is_background(i));
    let n_pixels = (0..80 * 60).filter(sees_surface).count();
    assert!(n_pixels < points.len() && points.len() < n_pixels * 5 / 4, "{} patches", points.len());
    let positions: Vec<Vec3> = points.iter().map(|(position, _)| *position).collect();
    let spread = patches.spread(&positions, Vec3::INFINITY);
    let mut sum = Vec3::ZERO;
    for i in (0..gbuffer.n_samples()).filter(|&i| !gbuffer.is_background(i)) {
        let offset = spread[i] - gbuffer.positions()[i];
        assert!(offset.dot(gbuffer.normals()[i]).abs() < 1e-5 && offset.length() < 0.3, "{offset}");
        sum += offset;
    }
    assert!(sum.length() < 1e-4 * gbuffer.n_samples() as f32, "{sum}");
    let queries = patches.queries(&vec![RegionId(3); points.len()]);
    assert!(queries.iter().all(|q| q.region == RegionId(3) && (q.normal.length() - 1.0).abs() < 1e-5));
}

#[test]
fn background_has_no_patch() {
    let floor = [common::Rectangle::new([0.0; 3], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])];
    let options = GBufferOptions { width: 40, height: 30, samples_per_axis: 2, seed: 1 };
    let gbuffer = gbuffer_of(&scene_of(&floor), &camera(), options);
    let patches = Patches::of(&gbuffer);
    let is_seen = patches.spread(&vec![true; patches.surface_points().len()], false);
    assert!(is_seen.iter().any(|&seen| !seen));
    assert!((0..gbuffer.n_samples()).all(|i| is_seen[i] != gbuffer.is_background(i)));
}
