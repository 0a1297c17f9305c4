//! The path tracer against closed forms that its own unit tests do not cover: discs, strips, pinholes, a manufactured cube.

use std::f64::consts::TAU;

use hplt_geom::glam::{DVec3, Vec3};
use hplt_geom::{Environment, Material, NoProgress, Rgb, Scene, SceneBuilder};
use hplt_reference::closed_forms;
use hplt_reference::path_tracer::{Emission, IrradianceEstimate, IrradianceOptions, PathTracer};
use hplt_reference::scenes::{self, Shape};
use hplt_reference::statistics::{MeanEstimate, Outcome, equivalence};

fn at(scene: &Scene, points: &[(DVec3, DVec3)], options: &IrradianceOptions) -> Vec<IrradianceEstimate> {
    let place = |&(p, n): &(DVec3, DVec3)| (scene.frame().scene_from_world_point(p), n.as_vec3());
    let points: Vec<(Vec3, Vec3)> = points.iter().map(place).collect();
    PathTracer::new(scene).irradiance(&points, options, &NoProgress).unwrap()
}

fn options(samples: u32, emission: Emission) -> IrradianceOptions {
    IrradianceOptions { seed: 17, samples_per_replicate: samples, emission, ..IrradianceOptions::preview() }
}

/// Equivalence at 99.9 %, and a reference that is wrong by twice the margin does not pass.
#[track_caller]
fn assert_equivalent(what: &str, value: f64, standard_error: f64, exact: f64, margin: f64) {
    let estimate = MeanEstimate { mean: value, standard_error, degrees_of_freedom: 15.0 };
    let verdict = equivalence(&estimate, exact, margin, 1e-3);
    assert_eq!(verdict.outcome, Outcome::Pass, "{what}: {value} for {exact}: {verdict:?}");
    assert_ne!(equivalence(&estimate, exact * (1.0 + 2.01 * margin), margin, 1e-3).outcome, Outcome::Pass, "{what}");
}

#[test]
fn a_disc_on_its_axis() {
    let (radius, distance) = (0.5, 1.0);
    let step = TAU / 256.0;
    // Of the same area as the disc.
    let r = radius * (step / step.sin()).sqrt();
    let rim = |i: u32| DVec3::new(r * (step * f64::from(i)).cos(), distance, r * (step * f64::from(i)).sin());
    let mut lamp = Shape::new();
    (0..256).for_each(|i| {
        lamp.triangle([DVec3::Y * distance, rim(i), rim(i + 1)]);
    });
    let mut builder = SceneBuilder::new();
    let id = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::ONE));
    lamp.push_into(&mut builder, "lamp", id);
    let e = at(&scenes::build(builder), &[(DVec3::ZERO, DVec3::Y)], &options(2048, Emission::NextEvent))[0];
    let exact = closed_forms::disc_on_axis_irradiance(1.0 / std::f64::consts::PI, radius, distance);
    assert_equivalent("disc", e.direct.x, e.direct_standard_error.x, exact, 0.01);
}

#[test]
fn a_hole_to_the_sky_in_a_sphere() {
    let full = scenes::geodesic_sphere(1.0, 20_480);
    let mut open = full.mapped(|p| p);
    open.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    let middle = |t: &[u32; 3]| t.iter().map(|&v| full.positions[v as usize]).sum::<DVec3>().normalize();
    open.triangles.retain(|t| middle(t).y <= 0.8);
    let fraction = 1.0 - open.area() / full.area();
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(Material::diffuse("wall", Rgb::splat(0.8)));
    open.push_into(&mut builder, "sphere", wall);
    builder.set_environment(Environment::constant(Rgb::ONE).unwrap());
    let e = at(&scenes::build(builder), &[(-DVec3::Y, DVec3::Y)], &options(8192, Emission::NextEvent))[0];
    let exact = closed_forms::cap_cavity_irradiance(fraction, 0.8, 1.0);
    assert_equivalent("hole", e.total().x, e.total_standard_error.x, exact, 0.03);
}

/// Radiosities constant on the faces of a cube: each face emits what makes it so, in cells.
#[test]
fn a_manufactured_cube() {
    const CELLS: u32 = 24;
    let (radiosity, albedo) = ([2.0, 2.5, 4.0, 2.2, 3.0, 2.4], 0.5);
    let mut room = Shape::new();
    room.room(DVec3::ZERO, DVec3::ONE);
    let faces: Vec<&[DVec3]> = room.positions.chunks(4).collect();
    let normal = |on: usize| (faces[on][1] - faces[on][0]).cross(faces[on][2] - faces[on][0]).normalize();
    let irradiance = |on: usize, x: DVec3| -> f64 {
        let corners = |j: usize| faces[j].iter().map(|p| *p - x).collect::<Vec<_>>();
        let others = (0..6).filter(|&j| j != on);
        others.map(|j| closed_forms::point_to_polygon(normal(on), &corners(j)) * radiosity[j]).sum()
    };
    let mut builder = SceneBuilder::new();
    for (on, face) in faces.iter().enumerate() {
        let place = |i: u32, j: u32| {
            face[0] + ((face[1] - face[0]) * f64::from(i) + (face[3] - face[0]) * f64::from(j)) / f64::from(CELLS)
        };
        for (i, j) in (0..CELLS * CELLS).map(|k| (k % CELLS, k / CELLS)) {
            let middle = place(i, j).midpoint(place(i + 1, j + 1));
            let exitance = Rgb::splat((radiosity[on] - albedo * irradiance(on, middle)) as f32);
            let id = builder.push_material(Material::emitter("cell", Rgb::splat(albedo as f32), exitance));
            let corners = [place(i, j), place(i + 1, j), place(i + 1, j + 1), place(i, j + 1)];
            Shape::new().quad(corners).push_into(&mut builder, "cell", id);
        }
    }
    let scene = scenes::build(builder);
    let places: Vec<(usize, DVec3)> = (0..6).map(|on| (on, faces[on][0].lerp(faces[on][2], 0.37))).collect();
    let points: Vec<_> = places.iter().map(|&(on, p)| (p, normal(on))).collect();
    for (e, &(on, p)) in at(&scene, &points, &options(2048, Emission::Hit)).iter().zip(&places) {
        let exact = irradiance(on, p);
        assert_equivalent(&format!("face {on}"), e.total().x, e.total_standard_error.x, exact, 0.02);
    }
}
