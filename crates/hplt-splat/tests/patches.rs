//! Samples of a pixel that see one surface, taken together.

mod common;

use common::{camera, gbuffer_of, room, scene_of};
use hplt_geom::glam::Vec3;
use hplt_splat::{GBuffer, GBufferOptions, Patches};

/// Nearly all pixels see one surface, and a patch is one of its samples: exactly on their surface, in their middle.
#[test]
fn patches_stand_for_the_samples_of_a_pixel_that_see_one_surface() {
    let options = GBufferOptions { width: 80, height: 60, samples_per_axis: 4, seed: 1 };
    let gbuffer = gbuffer_of(&scene_of(&room()), &camera(), options);
    let patches = Patches::of(&gbuffer);
    let points = points_of(&patches, &gbuffer);
    let sees_surface = |pixel: &usize| (16 * pixel..16 * (pixel + 1)).any(|i| !gbuffer.is_background(i));
    let n_pixels = (0..80 * 60).filter(sees_surface).count();
    assert!(n_pixels < points.len() && points.len() < n_pixels * 5 / 4, "{} patches", points.len());
    let spread = patches.spread(&points, (Vec3::INFINITY, Vec3::ZERO));
    let mut sum = Vec3::ZERO;
    for i in (0..gbuffer.n_samples()).filter(|&i| !gbuffer.is_background(i)) {
        let (position, normal) = spread[i];
        let pixel = i / 16 * 16..(i / 16 + 1) * 16;
        assert!(pixel.clone().any(|k| gbuffer.positions()[k] == position && gbuffer.normals()[k] == normal));
        let offset = position - gbuffer.positions()[i];
        assert!(offset.dot(gbuffer.normals()[i]).abs() < 1e-5 && offset.length() < 0.3, "{offset}");
        sum += offset;
    }
    assert!(sum.length() < 2e-3 * gbuffer.n_samples() as f32, "{sum}");
    assert!((0..patches.len()).all(|i| gbuffer.samples_of(patches.pixel(i)).contains(&patches.middle(i))));
}

fn points_of(patches: &Patches, gbuffer: &GBuffer) -> Vec<(Vec3, Vec3)> {
    let middles = (0..patches.len()).map(|i| patches.middle(i));
    middles.map(|i| (gbuffer.positions()[i], gbuffer.normals()[i])).collect()
}

/// Surface that a coarser picture saw in the same pixel is known again, other surface is not.
#[test]
fn patches_continue_what_one_sample_saw() {
    let (scene, camera) = (scene_of(&room()), camera());
    let coarse = gbuffer_of(&scene, &camera, GBufferOptions::preview(40, 30));
    let options = GBufferOptions { samples_per_axis: 4, ..GBufferOptions::preview(40, 30) };
    let fine = gbuffer_of(&scene, &camera, options);
    let patches = Patches::of(&fine);
    let mut n_others = 0;
    for i in 0..patches.len() {
        let first = coarse.samples_of(patches.pixel(i)).start;
        let is_same = coarse.normals()[first].dot(fine.normals()[patches.middle(i)]) > 0.9;
        n_others += usize::from(!is_same);
        assert!(is_same || !patches.continues(i, &fine, &coarse));
    }
    let n_continued = (0..patches.len()).filter(|&i| patches.continues(i, &fine, &coarse)).count();
    assert!(n_others > 20 && n_continued > patches.len() / 2, "{n_others} {n_continued} {}", patches.len());
}

/// A wavy surface, no two samples of which are in one plane: patches do not leave it.
#[test]
fn patches_of_curved_surfaces_are_on_them() {
    let facet = |i: i32, k: i32| {
        let at = |i: i32, k: i32| [f64::from(i) * 0.05, 0.03 * f64::from((i * i + k * k) % 3), f64::from(k) * 0.05];
        let (corner, u, v) = (at(i, k), at(i, k + 1), at(i + 1, k));
        let edge = |to: [f64; 3]| std::array::from_fn(|axis| to[axis] - corner[axis]);
        common::Rectangle::new(corner, edge(u), edge(v))
    };
    let facets: Vec<_> = (-10..10).flat_map(|i| (-10..10).map(move |k| facet(i, k))).collect();
    let options = GBufferOptions { width: 20, height: 15, samples_per_axis: 4, seed: 1 };
    let gbuffer = gbuffer_of(&scene_of(&facets), &camera(), options);
    let points = points_of(&Patches::of(&gbuffer), &gbuffer);
    assert!(points.len() > 20, "{}", points.len());
    assert!(points.iter().all(|(position, _)| gbuffer.positions().contains(position)));
}

fn floor_in_the_open() -> GBuffer {
    let floor = [common::Rectangle::new([0.0; 3], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])];
    let options = GBufferOptions { width: 40, height: 30, samples_per_axis: 2, seed: 1 };
    gbuffer_of(&scene_of(&floor), &camera(), options)
}

#[test]
fn background_has_no_patch() {
    let gbuffer = floor_in_the_open();
    let patches = Patches::of(&gbuffer);
    let is_seen = patches.spread(&vec![true; patches.len()], false);
    assert!(is_seen.iter().any(|&seen| !seen));
    assert!((0..gbuffer.n_samples()).all(|i| is_seen[i] != gbuffer.is_background(i)));
}
