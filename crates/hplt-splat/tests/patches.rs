//! Samples of a pixel that see one surface, taken together.

mod common;

use common::{camera, gbuffer_of, room, scene_of};
use hplt_geom::glam::Vec3;
use hplt_geom::{RegionId, Rgb};
use hplt_splat::{GBuffer, GBufferOptions, Patches};

/// Nearly all pixels see one surface, and a patch is one of its samples: exactly on their surface, in their middle.
#[test]
fn patches_stand_for_the_samples_of_a_pixel_that_see_one_surface() {
    let options = GBufferOptions { width: 80, height: 60, samples_per_axis: 4, seed: 1 };
    let mut gbuffer = gbuffer_of(&scene_of(&room()), &camera(), options);
    let patches = Patches::of(&gbuffer);
    let points = patches.surface_points(&gbuffer);
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
    patches.set_regions(&mut gbuffer, &vec![RegionId(3); points.len()]);
    assert!(patches.queries(&gbuffer).iter().all(|q| q.region == RegionId(3)));
    assert!((0..gbuffer.n_samples()).all(|i| gbuffer.is_background(i) || gbuffer.regions()[i] == RegionId(3)));
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
    let points = Patches::of(&gbuffer).surface_points(&gbuffer);
    assert!(points.len() > 20, "{}", points.len());
    assert!(points.iter().all(|(position, _)| gbuffer.positions().contains(position)));
}

fn floor_in_the_open() -> GBuffer {
    let floor = [common::Rectangle::new([0.0; 3], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])];
    let options = GBufferOptions { width: 40, height: 30, samples_per_axis: 2, seed: 1 };
    gbuffer_of(&scene_of(&floor), &camera(), options)
}

/// Each sample counts once, and background not at all.
#[test]
fn means_are_taken_over_the_samples_of_a_patch() {
    let gbuffer = floor_in_the_open();
    let patches = Patches::of(&gbuffer);
    let n = patches.surface_points(&gbuffer).len();
    let numbers: Vec<usize> = (0..n).collect();
    let of_sample = patches.spread(&numbers, usize::MAX);
    let values: Vec<Rgb> = (0..gbuffer.n_samples()).map(|i| Rgb::splat((i % 7) as f32)).collect();
    let means = patches.means(&values);
    assert!(means.len() == n && n > 0);
    for (patch, mean) in means.iter().enumerate() {
        let members = of_sample.iter().zip(&values).filter(|(of, _)| **of == patch).map(|(_, value)| value.x);
        let (sum, count) = members.fold((0.0, 0), |(sum, count), x| (sum + x, count + 1));
        assert!((mean.x - sum / count as f32).abs() < 1e-6, "{mean} {sum} {count}");
    }
}

#[test]
fn background_has_no_patch() {
    let gbuffer = floor_in_the_open();
    let patches = Patches::of(&gbuffer);
    let is_seen = patches.spread(&vec![true; patches.surface_points(&gbuffer).len()], false);
    assert!(is_seen.iter().any(|&seen| !seen));
    assert!((0..gbuffer.n_samples()).all(|i| is_seen[i] != gbuffer.is_background(i)));
}
