//! The path tracer against closed forms, before it judges anything.

use std::f64::consts::PI;

use hplt_geom::glam::{DVec3, Vec3};
use hplt_geom::{
    AlphaMask, Camera, Environment, Image, Material, NoProgress, Rgb, Scene, SceneBuilder, Sides, TriangleId,
};

use super::{Emission, IrradianceEstimate, IrradianceOptions, PathTracer, RenderOptions};
use crate::closed_forms;
use crate::scenes::{self, Shape};
use crate::statistics::{Equivalence, MeanEstimate, Outcome, equivalence, mean_of_replicates};

/// Estimates at world-space points.
fn estimate(scene: &Scene, points: &[(DVec3, DVec3)], options: &IrradianceOptions) -> Vec<IrradianceEstimate> {
    let points: Vec<(Vec3, Vec3)> =
        points.iter().map(|&(p, n)| (scene.frame().scene_from_world_point(p), n.as_vec3())).collect();
    PathTracer::new(scene).irradiance(&points, options, &NoProgress).unwrap()
}

fn options(samples: u32) -> IrradianceOptions {
    IrradianceOptions { seed: 0x5eed, samples_per_replicate: samples, ..IrradianceOptions::preview() }
}

fn hit(samples: u32) -> IrradianceOptions {
    IrradianceOptions { emission: Emission::Hit, ..options(samples) }
}

/// The verdict on one number of `n` replicates; 99.9 % confidence.
fn verdict(value: f64, standard_error: f64, expected: f64, margin: f64) -> Equivalence {
    let estimate = MeanEstimate { mean: value, standard_error, degrees_of_freedom: 15.0 };
    equivalence(&estimate, expected, margin, 1e-3)
}

/// Asserts equivalence, and that a reference that is wrong by twice the margin does not pass.
#[track_caller]
fn assert_equivalent(what: &str, value: f64, standard_error: f64, expected: f64, margin: f64) {
    let result = verdict(value, standard_error, expected, margin);
    println!(
        "{what}: {value:.6} against {expected:.6}, off by {:+.3} %, half-width {:.3} % of margin {:.3} %",
        100.0 * result.difference / expected,
        100.0 * result.half_width / expected,
        100.0 * margin
    );
    assert_eq!(result.outcome, Outcome::Pass, "{what}: {result:?}");
    let wrong = expected * (1.0 + 2.01 * margin);
    assert_ne!(verdict(value, standard_error, wrong, margin).outcome, Outcome::Pass, "{what}: passes anything");
}

#[test]
fn closed_furnaces_give_the_geometric_series() {
    for (albedo, samples) in [(0.0, 16), (0.5, 8192), (0.9, 8192)] {
        let scene = scenes::build(scenes::furnace_box(Rgb::splat(albedo), Rgb::ONE));
        let points = [(DVec3::new(0.3, 0.0, 0.4), DVec3::Y), (DVec3::new(1.0, 0.999, 0.001), -DVec3::X)];
        for e in estimate(&scene, &points, &hit(samples)) {
            let expected = closed_forms::furnace_radiosity(1.0, albedo.into());
            assert_equivalent("furnace", e.total().x, e.total_standard_error.x, expected, 0.02);
            assert_eq!(e.direct, DVec3::ONE);
        }
    }
}

#[test]
fn a_furnace_cut_short_is_exact_to_rounding() {
    let scene = scenes::build(scenes::furnace_box(Rgb::splat(0.5), Rgb::ONE));
    for max in [0, 1, 2, 5] {
        let options = IrradianceOptions { min_bounces: 100, max_bounces: Some(max), ..hit(64) };
        let e = estimate(&scene, &[(DVec3::new(0.5, 0.0, 0.5), DVec3::Y)], &options)[0];
        let expected = closed_forms::furnace_radiosity_after(1.0, 0.5, max);
        assert!((e.total().x - expected).abs() < 1e-12, "{max}: {} {expected}", e.total().x);
    }
}

#[test]
fn a_generalised_furnace_is_uniform_among_random_boxes() {
    let scene = scenes::build(scenes::cluttered_room(3, 60, 1.0));
    let points = [(DVec3::new(1.3, 0.0, 1.1), DVec3::Y), (DVec3::new(0.0, 0.1, 0.1), DVec3::X)];
    for e in estimate(&scene, &points, &hit(2048)) {
        for channel in 0..3 {
            let (value, error) = (e.total()[channel], e.total_standard_error[channel]);
            assert_equivalent("clutter", value, error, 1.0, 0.02);
        }
    }
}

#[test]
fn a_generalised_furnace_is_uniform_in_a_torus() {
    let scene = scenes::build(scenes::torus(32, 16, 2.0));
    // Facet middles and facet normals: at a ridge, no single plane bounds what a point sees.
    let points = [100, 400, 900].map(|t| {
        let corners = scene.mesh().corners(TriangleId(t));
        let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
        (scene.frame().world_from_scene_point(middle), scene.mesh().face_normal(TriangleId(t)).as_dvec3())
    });
    for e in estimate(&scene, &points, &hit(4096)) {
        assert_equivalent("torus", e.total().x, e.total_standard_error.x, 2.0, 0.02);
    }
}

/// Exitance and albedo of a sphere that vary: a linear harmonic, and a step.
fn patterned_sphere() -> (Scene, f64) {
    let patterns: Vec<Material> = (0..16)
        .map(|i| {
            let height = (i % 8) as f32 / 7.0;
            let albedo = if i < 8 { 0.8 } else { 0.3 };
            Material::emitter("pattern", Rgb::splat(albedo), Rgb::splat(0.2 + height))
        })
        .collect();
    let choose = |d: DVec3| ((d.y * 0.5 + 0.5) * 7.999) as usize % 8 + if d.x > 0.2 { 8 } else { 0 };
    let scene = scenes::build(scenes::sphere(1.0, 20_000, &patterns, choose));
    // Area means over the facets themselves.
    let (mut area, mut exitance, mut albedo) = (0.0, 0.0, 0.0);
    for t in (0..scene.mesh().n_triangles() as u32).map(TriangleId) {
        let (a, material) = (scene.mesh().area(t), scene.material(t));
        area += a;
        exitance += a * f64::from(material.exitance.x);
        albedo += a * f64::from(material.albedo.x);
    }
    (scene, closed_forms::integrating_sphere_irradiance(exitance / area, albedo / area))
}

#[test]
fn a_sphere_with_a_pattern_has_the_same_irradiance_everywhere() {
    let (scene, expected) = patterned_sphere();
    let directions = [DVec3::Y, -DVec3::X, DVec3::new(0.5, -0.3, 0.8).normalize()];
    let points = directions.map(|d| (d, -d));
    for options in [hit(2048), options(1024)] {
        for e in estimate(&scene, &points, &options) {
            assert_equivalent("sphere", e.total().x, e.total_standard_error.x, expected, 0.03);
        }
    }
}

#[test]
fn an_integrating_sphere_with_a_lamp_and_a_port() {
    let wall = Material::diffuse("wall", Rgb::splat(0.9));
    let lamp = Material::emitter("lamp", Rgb::splat(0.9), Rgb::splat(10.0));
    let port = Material::diffuse("port", Rgb::ZERO);
    let choose = |d: DVec3| if d.y > 0.9 { 1 } else { 2 * usize::from(d.x > 0.8) };
    let scene = scenes::build(scenes::sphere(1.0, 20_000, &[wall, lamp, port], choose));
    let (mut total, mut lamp, mut port) = (0.0, 0.0, 0.0);
    for t in (0..scene.mesh().n_triangles() as u32).map(TriangleId) {
        let area = scene.mesh().area(t);
        total += area;
        lamp += if scene.material(t).is_emissive() { area } else { 0.0 };
        port += if scene.material(t).albedo.x == 0.0 { area } else { 0.0 };
    }
    let expected = closed_forms::integrating_sphere_irradiance(10.0 * lamp / total, 0.9 * (1.0 - port / total));
    let points = [(-DVec3::Y, DVec3::Y), (DVec3::new(-0.6, 0.8, 0.0), DVec3::new(0.6, -0.8, 0.0))];
    for e in estimate(&scene, &points, &options(2048)) {
        assert_equivalent("integrating sphere", e.total().x, e.total_standard_error.x, expected, 0.03);
    }
}

#[test]
fn concentric_spheres_shade_each_other() {
    let (albedo, radii) = ([0.5, 0.5], [1.0, 2.0]);
    let inner = Material::emitter("inner", Rgb::splat(0.5), Rgb::ONE);
    let outer = Material::diffuse("outer", Rgb::splat(0.5));
    let scene = scenes::build(scenes::concentric_spheres(radii[0], radii[1], 20_000, inner, outer));
    let [b1, b2] = closed_forms::concentric_spheres(radii, [1.0, 0.0], albedo);
    let d = DVec3::new(0.3, 0.5, -0.7).normalize();
    let e = estimate(&scene, &[(d * radii[0], d), (d * radii[1], -d)], &options(4096));
    assert_equivalent("inner", e[0].total().x, e[0].total_standard_error.x, (b1 - 1.0) / 0.5, 0.03);
    assert_equivalent("outer", e[1].total().x, e[1].total_standard_error.x, b2 / 0.5, 0.03);
}

/// Area mean over a receiver: mean and standard error over 16 sets of a jittered point per cell of an `n × n` grid.
/// `place` gives position, normal and the weight of its density.
fn mean_over(
    scene: &Scene,
    n: u32,
    place: impl Fn(f64, f64) -> (DVec3, DVec3, f64),
    options: &IrradianceOptions,
) -> (f64, f64) {
    let means: Vec<f64> = (0..16)
        .map(|replicate| {
            let mut random = super::rng::PathNumbers::new(99, replicate);
            let places: Vec<_> = (0..n * n)
                .map(|i| {
                    let (x, y) = (f64::from(i % n) + random.uniform(), f64::from(i / n) + random.uniform());
                    place(x / f64::from(n), y / f64::from(n))
                })
                .collect();
            let points: Vec<_> = places.iter().map(|p| (p.0, p.1)).collect();
            let options = IrradianceOptions { seed: replicate, replicates: 2, ..options.clone() };
            let estimates = estimate(scene, &points, &options);
            estimates.iter().zip(&places).map(|(e, p)| e.total().x * p.2).sum::<f64>() / estimates.len() as f64
        })
        .collect();
    let mean = mean_of_replicates(&means).unwrap();
    (mean.mean, mean.standard_error)
}

#[test]
fn parallel_plates_have_the_tabulated_form_factors() {
    for (gap, factor) in closed_forms::PARALLEL_SQUARES {
        let scene = scenes::build(scenes::parallel_plates(gap));
        let place = |x: f64, z: f64| (DVec3::new(x, gap, z), -DVec3::Y, 1.0);
        let (mean, error) = mean_over(&scene, 16, place, &options(8));
        assert_equivalent(&format!("gap {gap}"), mean, error, factor, 0.01);
    }
}

#[test]
fn perpendicular_plates_have_the_tabulated_form_factors() {
    for (w, h, factor) in closed_forms::PERPENDICULAR_RECTANGLES {
        // The mean irradiance of the receiver is the factor from the receiver to the emitter.
        let scene = scenes::build(scenes::perpendicular_plates(h, w));
        // More points near the common edge, where a wide receiver gets its light.
        let place = |x: f64, y: f64| (DVec3::new(x, w * y * y * y, 0.0), DVec3::Z, 3.0 * y * y);
        let (mean, error) = mean_over(&scene, 16, place, &options(32));
        assert_equivalent(&format!("perpendicular {w} {h}"), mean, error, factor, 0.01);
    }
}

#[test]
fn a_point_under_a_square_sees_the_exact_factor() {
    let scene = scenes::build(scenes::parallel_plates(1.0));
    let centre = (DVec3::new(0.5, 1.0, 0.5), -DVec3::Y);
    let e = estimate(&scene, &[centre], &options(1024))[0];
    assert_equivalent("centre", e.direct.x, e.direct_standard_error.x, closed_forms::POINT_UNDER_UNIT_SQUARE, 0.003);
    assert_eq!(e.indirect, DVec3::ZERO);
}

/// The irradiance integrated over both sides of all surface, scene units: mean and standard error over 16 sets of `n`
/// points by area. Sides that no light reaches add nothing.
fn integral_over_surface(scene: &Scene, n: u32, options: &IrradianceOptions) -> (f64, f64) {
    let mesh = scene.mesh();
    let triangles = || (0..mesh.n_triangles() as u32).map(TriangleId);
    let total: f64 = triangles().map(|t| mesh.area(t)).sum();
    let tracer = PathTracer::new(scene);
    let integrals: Vec<f64> = (0..16)
        .map(|replicate| {
            let mut random = super::rng::PathNumbers::new(5, replicate);
            let mut points = Vec::new();
            // Systematic sampling along the running area.
            let (mut area, mut next) = (0.0, random.uniform());
            for t in triangles() {
                area += mesh.area(t) / total * f64::from(n);
                while next < area {
                    next += 1.0;
                    let root = random.uniform().sqrt();
                    let (u, v) = (1.0 - root, random.uniform() * root);
                    let position = mesh.position_at(t, u as f32, v as f32);
                    points.extend([mesh.face_normal(t), -mesh.face_normal(t)].map(|normal| (position, normal)));
                }
            }
            let options = IrradianceOptions { seed: replicate, replicates: 2, ..options.clone() };
            let estimates = tracer.irradiance(&points, &options, &NoProgress).unwrap();
            estimates.iter().map(|e| e.total().x).sum::<f64>() * total / f64::from(n)
        })
        .collect();
    let mean = mean_of_replicates(&integrals).unwrap();
    (mean.mean, mean.standard_error)
}

#[test]
fn a_closed_cornell_box_absorbs_what_it_emits() {
    // Uniform albedo; the box's own shape, blocks and light.
    let mut builder = scenes::cornell_box_closed(scenes::Front::White);
    for material in builder.materials_mut() {
        material.albedo = Rgb::splat(0.6);
    }
    let scene = scenes::build(builder);
    let flux: f64 =
        scene.emissive_triangles().map(|t| scene.mesh().area(t) * f64::from(scene.material(t).exitance.x)).sum();
    let (integral, error) = integral_over_surface(&scene, 512, &options(16));
    assert_equivalent("closed Cornell box", integral, error, closed_forms::mean_irradiance(flux, 0.6, 1.0), 0.03);
}

/// A closed cube of `width` metres with a point light of `flux` at its centre.
fn lit_cube(width: f64, flux: f64, albedo: f32) -> Scene {
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(Material::diffuse("wall", Rgb::splat(albedo)));
    Shape::new().room(DVec3::ZERO, DVec3::splat(width)).push_into(&mut builder, "cube", wall);
    builder.push_point_light("lamp", DVec3::splat(0.5 * width), Rgb::splat((flux / (4.0 * PI)) as f32));
    scenes::build(builder)
}

#[test]
fn cie_171_case_5_8_has_the_published_mean() {
    let (albedo, published) = closed_forms::CIE_171_5_8[5];
    let scene = lit_cube(4.0, 10_000.0, albedo as f32);
    let (integral, error) = integral_over_surface(&scene, 512, &options(8));
    let scale = scene.frame().scale().powi(2) / 96.0;
    let direct = 10_000.0 / 96.0;
    assert_equivalent("CIE 171 5.8", integral * scale, error * scale, direct + published, 0.02);
}

#[test]
fn khodulevs_cube_is_lit_exactly_at_the_face_centres() {
    use closed_forms::khodulev_cube::{ALBEDO, DIRECT_AT_FACE_CENTRE, INTENSITY, WIDTH};
    let scene = lit_cube(WIDTH, 4.0 * PI * INTENSITY, ALBEDO as f32);
    let e = estimate(&scene, &[(DVec3::new(5.0, 0.0, 5.0), DVec3::Y)], &options(1))[0];
    assert!((e.direct.x / DIRECT_AT_FACE_CENTRE - 1.0).abs() < 1e-6, "{e:?}");
}

#[test]
fn a_plane_under_a_uniform_sky_and_a_white_one_have_irradiance_pi_l() {
    for albedo in [0.3, 1.0] {
        let scene = scenes::build(scenes::plane_under_sky(1.0, Rgb::splat(albedo), Rgb::splat(2.0)));
        let points = [(DVec3::ZERO, DVec3::Y), (DVec3::new(0.3, 0.0, 0.1), -DVec3::Y)];
        for e in estimate(&scene, &points, &options(64)) {
            assert!((e.total().x - 2.0 * PI).abs() < 1e-6 && e.indirect.x == 0.0, "{e:?}");
        }
    }
}

#[test]
fn an_open_furnace_under_the_sky_is_uniform() {
    // M = (1-ρ)πL on a box without lid: B = πL, whatever goes out is what comes in.
    let mut builder = SceneBuilder::new();
    for (i, albedo) in [0.2f32, 0.8, 0.5, 0.9, 0.0].into_iter().enumerate() {
        let wall = Material::emitter("wall", Rgb::splat(albedo), Rgb::splat((1.0 - albedo) * std::f32::consts::PI));
        let wall = builder.push_material(Material { emits: Sides::Both, ..wall });
        let mut room = Shape::new();
        room.room(DVec3::ZERO, DVec3::ONE);
        // Faces are x-, x+, y-, y+, z-, z+ and y+ stays open.
        let face = if i < 3 { i } else { i + 1 };
        room.triangles = room.triangles[2 * face..2 * face + 2].to_vec();
        room.push_into(&mut builder, "face", wall);
    }
    builder.set_environment(Environment::constant(Rgb::ONE).unwrap());
    let scene = scenes::build(builder);
    for e in
        estimate(&scene, &[(DVec3::new(0.2, 0.0, 0.3), DVec3::Y), (DVec3::new(0.0, 0.5, 0.9), DVec3::X)], &hit(4096))
    {
        assert_equivalent("open furnace", e.total().x, e.total_standard_error.x, PI, 0.01);
    }
}

#[test]
fn a_hemisphere_under_the_sky_is_a_uniform_cavity() {
    // Cut the sphere along facets and take the opening from the area that is left.
    let full = scenes::geodesic_sphere(1.0, 20_000);
    let mut bowl = Shape::new();
    for t in &full.triangles {
        let [a, b, c] = t.map(|v| full.positions[v as usize]);
        if (a + b + c).y < 0.0 {
            bowl.triangle([a, c, b]);
        }
    }
    let opening = 1.0 - bowl.area() / full.area();
    let mut builder = SceneBuilder::new();
    let material = builder.push_material(Material::diffuse("bowl", Rgb::splat(0.8)));
    bowl.push_into(&mut builder, "bowl", material);
    builder.set_environment(Environment::constant(Rgb::ONE).unwrap());
    let scene = scenes::build(builder);
    let expected = closed_forms::cap_cavity_irradiance(opening, 0.8, 1.0);
    let d = DVec3::new(0.6, -0.8, 0.0);
    for e in estimate(&scene, &[(-DVec3::Y, DVec3::Y), (d, -d)], &options(1024)) {
        assert_equivalent("bowl", e.total().x, e.total_standard_error.x, expected, 0.01);
    }
}

#[test]
fn one_bright_texel_of_a_sky_is_found() {
    let mut map = Image::from_pixels(64, 32, vec![Rgb::splat(0.1); 64 * 32]);
    map.pixels_mut()[5 * 64 + 40] = Rgb::splat(1e6);
    let sky = Environment::from_map(map).unwrap();
    // ∫ L cosθ dω by texels over the upper hemisphere; y is linear in solid angle within a row.
    let texel = |row: usize, radiance: f64| {
        let (top, bottom) = ((PI * row as f64 / 32.0).cos(), (PI * (row as f64 + 1.0) / 32.0).cos());
        radiance * 2.0 * PI / 64.0 * 0.5 * (top * top - bottom * bottom)
    };
    let expected = (0..16).map(|row| 64.0 * texel(row, 0.1)).sum::<f64>() + texel(5, 1e6 - 0.1);
    let mut builder = scenes::single_sheet(Rgb::splat(0.5));
    builder.set_environment(sky);
    let e = estimate(&scenes::build(builder), &[(DVec3::ZERO, DVec3::Y)], &options(256))[0];
    assert_equivalent("bright texel", e.direct.y, e.direct_standard_error.y, expected, 0.01);
}

#[test]
fn a_sun_gives_its_cosine_whatever_its_size() {
    for radius in [0.0, 0.00465, 0.3] {
        let mut builder = scenes::single_sheet(Rgb::splat(0.5));
        let towards = Vec3::new(0.6, 0.8, 0.0);
        builder.push_directional_light("sun", towards, Rgb::new(10.0, 5.0, 1.0), radius);
        let points = [(DVec3::ZERO, DVec3::Y), (DVec3::ZERO, -DVec3::Y)];
        let e = estimate(&scenes::build(builder), &points, &options(256));
        let expected = closed_forms::sun_irradiance(10.0, 0.8);
        assert_equivalent("sun", e[0].direct.x, e[0].direct_standard_error.x + 1e-9, expected, 0.002);
        assert_eq!(e[1].total(), DVec3::ZERO);
    }
}

#[test]
fn a_spot_light_fades_between_its_angles() {
    let mut builder = scenes::single_sheet(Rgb::splat(0.5));
    builder.push_spot_light("spot", DVec3::new(0.0, 0.5, 0.0), -Vec3::Y, Rgb::splat(3.0), 0.2, 0.6);
    let scene = scenes::build(builder);
    let at = |angle: f64| (DVec3::new(0.5 * angle.tan(), 0.0, 0.0), DVec3::Y);
    let e = estimate(&scene, &[at(0.0), at(0.15), at(0.4), at(0.65)], &options(1));
    let unfaded = |angle: f64| 3.0 / 0.25 * angle.cos().powi(3);
    let ramp = |angle: f64| ((angle.cos() - 0.6f64.cos()) / (0.2f64.cos() - 0.6f64.cos())).powi(2);
    for (e, expected) in e.iter().zip([unfaded(0.0), unfaded(0.15), unfaded(0.4) * ramp(0.4), 0.0]) {
        assert!((e.direct.x - expected).abs() < 1e-5 * 12.0, "{} {expected}", e.direct.x);
    }
}

#[test]
fn dark_rooms_stay_exactly_black() {
    for thickness in [0.0, 1e-4, 0.01, 0.1] {
        let scene = scenes::build(scenes::two_rooms(thickness));
        let points = [
            (DVec3::new(thickness, 0.5, 0.5), DVec3::X),
            (DVec3::new(thickness + 1e-4, 0.0, 0.5), DVec3::Y),
            (DVec3::new(thickness + 0.3, 0.0, 0.99), DVec3::Y),
            (DVec3::new(0.0, 0.5, 0.5), -DVec3::X),
        ];
        let e = estimate(&scene, &points, &options(256));
        assert!(e[..3].iter().all(|e| e.total() == DVec3::ZERO), "thickness {thickness}");
        assert!(e[3].total().x > 0.1, "the lit room is dark");
    }
    let inner =
        estimate(&scenes::build(scenes::nested_rooms()), &[(DVec3::new(0.1, -0.5, 0.2), DVec3::Y)], &options(64));
    assert_eq!(inner[0].total(), DVec3::ZERO);
    let under = [(DVec3::new(1.0, 0.0, 1.0), DVec3::Y), (DVec3::new(0.4, 0.0, 0.4), DVec3::Y)];
    let floor = estimate(&scenes::build(scenes::box_on_floor()), &under, &options(64));
    assert!(floor[0].total() == DVec3::ZERO && floor[1].total().x > 0.1);
}

#[test]
fn masks_cut_holes_and_single_sided_backs_are_black() {
    // A fully cut-out lid over a lit plane does not shade it; a solid one does.
    for (factor, expected) in [(0.0, 12.0), (1.0, 0.0)] {
        let mut builder = scenes::single_sheet(Rgb::splat(0.5));
        let alpha = Some(AlphaMask { factor, texture: None, cutoff: 0.5 });
        let lid = builder.push_material(Material { alpha, ..Material::diffuse("lid", Rgb::splat(0.5)) });
        Shape::new().cuboid(DVec3::new(-0.4, 0.2, -0.4), DVec3::new(0.4, 0.21, 0.4)).push_into(
            &mut builder,
            "lid",
            lid,
        );
        builder.push_point_light("lamp", DVec3::new(0.0, 0.5, 0.0), Rgb::splat(3.0));
        let e = estimate(&scenes::build(builder), &[(DVec3::ZERO, DVec3::Y)], &options(1))[0];
        assert!((e.direct.x - expected).abs() < 1e-5, "{e:?}");
    }
    let mut builder = scenes::furnace_box(Rgb::splat(0.5), Rgb::ONE);
    for material in builder.materials_mut() {
        (material.reflects, material.emits) = (Sides::Front, Sides::Front);
    }
    let inside = estimate(&scenes::build(builder), &[(DVec3::new(0.5, 0.0, 0.5), -DVec3::Y)], &options(16))[0];
    assert_eq!(inside.total(), DVec3::ZERO);
}

#[test]
fn light_sampling_and_blind_hits_agree() {
    let scene = scenes::build(scenes::box_on_floor());
    let points = [(DVec3::new(0.6, 0.0, 0.9), DVec3::Y), (DVec3::new(0.0, 1.9, 0.3), DVec3::X)];
    let sampled = estimate(&scene, &points, &options(2048));
    let blind = estimate(&scene, &points, &IrradianceOptions { seed: 77, ..hit(16384) });
    for (a, b) in sampled.iter().zip(&blind) {
        for channel in 0..3 {
            let error = a.total_standard_error[channel].hypot(b.total_standard_error[channel]);
            assert_equivalent("two ways", a.total()[channel], error, b.total()[channel], 0.05);
        }
    }
}

#[test]
fn no_ray_leaves_a_closed_box_aimed_at_corners_edges_or_anywhere() {
    let scene = scenes::build(scenes::cluttered_room(11, 40, 1.0));
    let tracer = PathTracer::new(&scene);
    let mut numbers = super::rng::PathNumbers::new(1, 2);
    let corners = scene.mesh().positions();
    let origin = scene.frame().scene_from_world_point(DVec3::new(0.02, 0.02, 0.02)).as_dvec3();
    let meets = |target: DVec3| tracer.tree.nearest(&scene, origin, target - origin, TriangleId::NONE).is_some();
    for t in scene.mesh().triangles() {
        let [a, b, c] = t.map(|v| corners[v as usize].as_dvec3());
        for target in [a, b, c, (a + b) * 0.5, (b + c) * 0.5, a * 0.3 + b * 0.7, (a + b + c) / 3.0] {
            assert!(meets(target));
        }
    }
    for _ in 0..200_000 {
        let target = DVec3::new(numbers.uniform(), numbers.uniform(), numbers.uniform()) - 0.5;
        assert!(meets(target));
    }
}

#[test]
fn the_tree_finds_what_brute_force_finds() {
    let scene = scenes::build(scenes::cluttered_room(5, 50, 1.0));
    let tracer = PathTracer::new(&scene);
    let mut numbers = super::rng::PathNumbers::new(3, 4);
    for _ in 0..5000 {
        let mut vector = || DVec3::new(numbers.uniform(), numbers.uniform(), numbers.uniform()) - 0.5;
        let (origin, direction) = (vector(), vector());
        let ray = super::triangle::ShearedRay::new(origin, direction);
        let all = (0..scene.mesh().n_triangles() as u32)
            .filter_map(|t| ray.cross(&scene.mesh().corners(TriangleId(t))).map(|c| c.t))
            .fold(f64::INFINITY, f64::min);
        let found = tracer.tree.nearest(&scene, origin, direction, TriangleId::NONE);
        assert_eq!(found.map_or(f64::INFINITY, |m| m.crossing.t), all);
        let none = [TriangleId::NONE; 2];
        assert_eq!(tracer.tree.is_occluded(&scene, origin, direction, 1.0, none), all < 1.0);
    }
}

#[test]
fn estimates_are_the_same_bits_at_any_thread_count_and_for_any_company() {
    let scene = scenes::build(scenes::cornell_box());
    let points: Vec<_> = (0..40).map(|i| (DVec3::new(0.01 * f64::from(i) + 0.05, 0.0, 0.05), DVec3::Y)).collect();
    let options = IrradianceOptions { target_relative_error: Some(0.03), ..options(16) };
    let all = estimate(&scene, &points, &options);
    assert_eq!(all, estimate(&scene, &points, &options));
    let steady = IrradianceOptions { target_relative_error: None, ..options };
    assert_eq!(estimate(&scene, &points, &steady)[..3], estimate(&scene, &points[..3], &steady)[..]);
}

#[test]
fn a_target_error_is_reached() {
    let scene = scenes::build(scenes::cornell_box());
    let points: Vec<_> = (0..20).map(|i| (DVec3::new(0.025 * f64::from(i) + 0.03, 0.0, 0.3), DVec3::Y)).collect();
    let options = IrradianceOptions { target_relative_error: Some(0.01), ..options(32) };
    for e in estimate(&scene, &points, &options) {
        let luminance = e.total().dot(DVec3::new(0.2126, 0.7152, 0.0722));
        // The two coplanar block bottoms hide some points: they are black and done at once.
        assert!(e.luminance_standard_error <= 0.01 * luminance || luminance < 0.2, "{e:?}");
    }
}

/// Paths that find light once in ten thousand: the first few hundred all find none, which is no proof that there is none.
#[test]
fn no_light_among_few_paths_is_not_taken_for_darkness() {
    let mut builder = SceneBuilder::new();
    let black = builder.push_material(Material::diffuse("black", Rgb::ZERO));
    let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::ONE));
    let corners = |h: f64, y: f64| [(-h, -h), (h, -h), (h, h), (-h, h)].map(|(x, z)| DVec3::new(x, y, z));
    Shape::new().quad(corners(0.009, 1.0)).push_into(&mut builder, "lamp", lamp);
    let mut floor = corners(1.0, 0.0);
    floor.reverse();
    Shape::new().quad(floor).push_into(&mut builder, "floor", black);
    let scene = scenes::build(builder);
    let points: Vec<_> = (0..12).map(|i| (DVec3::new(0.01 * f64::from(i), 0.0, 0.0), DVec3::Y)).collect();
    let options = IrradianceOptions { target_relative_error: Some(0.5), ..hit(16) };
    let found = estimate(&scene, &points, &options);
    assert!(found.iter().all(|e| e.n_samples >= 1 << 16), "{found:?}");
    let mean = found.iter().map(|e| e.total().x).sum::<f64>() / 12.0;
    let expected = 0.018 * 0.018 / PI;
    assert!((mean / expected - 1.0).abs() < 0.4, "{mean} against {expected}");
}

#[test]
fn pictures_of_a_furnace_are_uniform_and_their_variance_is_honest() {
    let scene = scenes::build(scenes::furnace_box(Rgb::splat(0.5), Rgb::ONE));
    let camera = Camera::look_at(DVec3::splat(0.5), DVec3::new(0.9, 0.2, 0.6), DVec3::Y, 1.2).unwrap();
    let options = RenderOptions { emission: Emission::Hit, replicates: 8, ..RenderOptions::preview() };
    let picture = PathTracer::new(&scene).render(&camera, 16, 16, &options, &NoProgress).unwrap();
    let scores: Vec<f64> = picture
        .mean
        .pixels()
        .iter()
        .zip(picture.variance_of_mean.pixels())
        .map(|(mean, variance)| (f64::from(mean.x) - 2.0 / PI) / f64::from(variance.x).sqrt())
        .collect();
    let mean = picture.mean.pixels().iter().map(|p| f64::from(p.x)).sum::<f64>() / 256.0;
    assert!((mean * PI / 2.0 - 1.0).abs() < 0.01, "{mean}");
    // Student's t with 7 degrees of freedom has variance 7/5.
    let spread = scores.iter().map(|s| s * s).sum::<f64>() / 256.0;
    assert!((0.9..2.2).contains(&spread), "{spread}");
}

#[test]
fn bad_options_are_refused() {
    let scene = scenes::build(scenes::cornell_box());
    let tracer = PathTracer::new(&scene);
    for bad in [
        IrradianceOptions { replicates: 1, ..options(16) },
        options(17),
        IrradianceOptions { target_relative_error: Some(f64::NAN), ..options(16) },
    ] {
        assert!(matches!(tracer.irradiance(&[], &bad, &NoProgress), Err(crate::Error::BadOption { .. })));
    }
}
