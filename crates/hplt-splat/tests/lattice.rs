//! Where pixels differ from their neighbours, and light that is read there alone.

mod common;

use std::convert::Infallible;

use common::{Rectangle, camera, gbuffer_of, room, scene_of};
use hplt_geom::Rgb;
use hplt_splat::{Arriving, Edges, GBuffer, GBufferOptions, Patches, read_where_it_changes, uneven, widened};

const WIDTH: usize = 64;
const HEIGHT: usize = 50;

/// A wall that fills the picture.
fn wall() -> GBuffer {
    let wall = [Rectangle::new([-3.0, -3.0, 0.0], [6.0, 0.0, 0.0], [0.0, 6.0, 0.0])];
    gbuffer_of(&scene_of(&wall), &camera(), GBufferOptions::preview(WIDTH as u32, HEIGHT as u32))
}

/// Reads `light(x, y)`; what was found, and how many pixels were read.
fn read(gbuffer: &GBuffer, is_wanted: &[bool], light: impl Fn(f32, f32) -> f32) -> (Vec<Arriving>, usize) {
    let mut n_read = 0;
    let found = read_where_it_changes(gbuffer, is_wanted, |pixels| {
        assert!(pixels.is_sorted() && pixels.iter().all(|&pixel| is_wanted[pixel]));
        n_read += pixels.len();
        let at = |&pixel: &usize| light((pixel % gbuffer.width()) as f32, (pixel / gbuffer.width()) as f32);
        let arriving = |pixel| Arriving { direct: Rgb::ZERO, indirect: Rgb::new(1.0, 0.5, 0.1) * at(pixel) };
        Ok::<_, Infallible>(pixels.iter().map(arriving).collect())
    });
    (found.unwrap(), n_read)
}

fn worst(found: &[Arriving], light: impl Fn(f32, f32) -> f32) -> f32 {
    let error = |(pixel, found): (usize, &Arriving)| {
        let expected = light((pixel % WIDTH) as f32, (pixel / WIDTH) as f32);
        (found.total().x - expected).abs() / expected
    };
    found.iter().enumerate().map(error).fold(0.0, f32::max)
}

#[test]
fn smooth_light_is_read_at_an_eighth_of_the_pixels() {
    let gbuffer = wall();
    let smooth = |x: f32, y: f32| 10.0 + 0.05 * x + 0.02 * y + 1e-3 * x * x;
    let (found, n_read) = read(&gbuffer, &[true; WIDTH * HEIGHT], smooth);
    assert!(n_read < WIDTH * HEIGHT / 6, "{n_read}");
    assert!(worst(&found, smooth) < 2e-3, "{}", worst(&found, smooth));
}

/// One pixel wide and aslant, so that it misses most points of the lattice.
#[test]
fn a_narrow_shadow_is_followed() {
    let shadow = |x: f32, y: f32| if (x - 0.37 * y - 20.0).abs() < 0.5 { 1.0 } else { 2.0 };
    let (found, n_read) = read(&wall(), &[true; WIDTH * HEIGHT], shadow);
    assert_eq!(worst(&found, shadow), 0.0);
    assert!(n_read < WIDTH * HEIGHT / 2, "{n_read}");
}

#[test]
fn what_is_not_wanted_is_not_read_and_small_pictures_are_whole() {
    let gbuffer = wall();
    let is_wanted: Vec<bool> = (0..WIDTH * HEIGHT).map(|pixel| pixel % 5 != 3).collect();
    let (found, n_read) = read(&gbuffer, &is_wanted, |_, _| 1.0);
    assert_eq!(n_read, is_wanted.iter().filter(|wanted| **wanted).count());
    assert!(found.iter().zip(&is_wanted).all(|(found, &wanted)| (found.total().x == 1.0) == wanted));
    for (width, height) in [(1, 1), (2, 1), (1, 7), (5, 5), (6, 9)] {
        let options = GBufferOptions::preview(width, height);
        let wall = [Rectangle::new([-3.0, -3.0, 0.0], [6.0, 0.0, 0.0], [0.0, 6.0, 0.0])];
        let gbuffer = gbuffer_of(&scene_of(&wall), &camera(), options);
        let (found, _) = read(&gbuffer, &vec![true; gbuffer.n_pixels()], |x, y| 1.0 + x + y);
        assert!(found.iter().all(|found| found.total().x >= 1.0), "{width} {height}");
    }
}

/// Nearly every pixel in which samples see two surfaces is next to one whose middle sees another.
#[test]
fn edges_are_where_pixels_see_more_than_one_surface() {
    let (scene, camera, options) = (scene_of(&room()), camera(), GBufferOptions::preview(80, 60));
    let edges = Edges::of(&gbuffer_of(&scene, &camera, options));
    let fine = gbuffer_of(&scene, &camera, GBufferOptions { samples_per_axis: 4, ..options });
    let patches = Patches::of(&fine);
    let mut n_surfaces = vec![0; 80 * 60];
    (0..patches.len()).for_each(|i| n_surfaces[patches.pixel(i)] += 1);
    let mixed: Vec<usize> = (0..80 * 60).filter(|&pixel| n_surfaces[pixel] > 1).collect();
    let n_found = mixed.iter().filter(|&&pixel| edges.of_surface[pixel]).count();
    assert!(mixed.len() > 50 && n_found * 100 >= mixed.len() * 97, "{n_found} of {}", mixed.len());
    let n_edges = edges.of_surface.iter().filter(|edge| **edge).count();
    assert!(n_edges < 80 * 60 / 4, "{n_edges}");
    assert!(edges.of_colour.iter().zip(&edges.of_surface).all(|(colour, surface)| !colour || *surface));
}

#[test]
fn rims_are_where_light_jumps_on_one_surface() {
    let gbuffer = wall();
    let edges = Edges::of(&gbuffer);
    assert!(!edges.of_surface.iter().any(|edge| *edge));
    let lit = |pixel: usize| Arriving {
        direct: Rgb::splat(if pixel % WIDTH < 20 { 1.0 } else { 3.0 }),
        ..Arriving::default()
    };
    let light: Vec<Arriving> = (0..WIDTH * HEIGHT).map(lit).collect();
    let rims = uneven(&gbuffer, &edges, &light);
    assert!((0..WIDTH * HEIGHT).all(|pixel| rims[pixel] == (19..=20).contains(&(pixel % WIDTH))));
    let wide = widened(&gbuffer, &rims);
    assert!((0..WIDTH * HEIGHT).all(|pixel| wide[pixel] == (18..=21).contains(&(pixel % WIDTH))));
}
