//! A21: a cube made so that its answer is known everywhere, and the order in which the error falls.

use hplt::geom::glam::DVec3;
use hplt::geom::{Material, Rgb, Scene, SceneBuilder};
use hplt::reference::closed_forms::point_to_polygon;
use hplt::reference::scenes::{self, Shape};
use hplt::transport::{Threshold, TransportOptions};
use hplt_tests::checks::hemisphere;
use hplt_tests::{Prepared, Setup};

/// Radiosities of the faces, constant on each.
const RADIOSITY: [f64; 6] = [2.0, 2.5, 4.0, 2.2, 3.0, 2.4];
const ALBEDO: f64 = 0.5;
/// Cells of constant exitance across a face.
const CELLS: u32 = 16;

fn faces() -> Vec<[DVec3; 4]> {
    let mut room = Shape::new();
    room.room(DVec3::ZERO, DVec3::ONE);
    room.positions.chunks(4).map(|c| [c[0], c[1], c[2], c[3]]).collect()
}

/// The irradiance at a point of face `on`: `Σ F(x→j) B_j`, with the exact factor from a point to a polygon.
fn irradiance(faces: &[[DVec3; 4]], on: usize, x: DVec3) -> f64 {
    let [a, b, c, _] = faces[on];
    let normal = (b - a).cross(c - a).normalize();
    let factor = |j: usize| point_to_polygon(normal, &faces[j].map(|p| p - x));
    (0..6).filter(|&j| j != on).map(|j| factor(j) * RADIOSITY[j]).sum()
}

/// The cube with exitances `M = B - ρH`, constant on cells.
fn manufactured() -> Scene {
    let faces = faces();
    let mut builder = SceneBuilder::new();
    for (on, &[a, b, _, d]) in faces.iter().enumerate() {
        let at = |i: u32, j: u32| {
            a + (b - a) * (f64::from(i) / f64::from(CELLS)) + (d - a) * (f64::from(j) / f64::from(CELLS))
        };
        for (i, j) in (0..CELLS * CELLS).map(|k| (k % CELLS, k / CELLS)) {
            let middle = at(i, j).midpoint(at(i + 1, j + 1));
            let exitance = RADIOSITY[on] - ALBEDO * irradiance(&faces, on, middle);
            assert!(exitance > 0.0);
            let material = Material::emitter("cell", Rgb::splat(ALBEDO as f32), Rgb::splat(exitance as f32));
            let id = builder.push_material(material);
            let corners = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            Shape::new().quad(corners).push_into(&mut builder, "cell", id);
        }
    }
    scenes::build(builder)
}

/// The slope of `ln y` over `ln x`, least squares.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let logs: Vec<(f64, f64)> = points.iter().map(|&(x, y)| (x.ln(), y.ln())).collect();
    let (mx, my) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    logs.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>() / logs.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>()
}

/// Mean relative error of interpolated irradiance over a grid on all faces, at radii that halve twice. Rays enough for their
/// noise, 0.1 %, to stay below the error of the functions.
#[test]
fn a21_the_error_falls_with_the_first_power_of_the_radius() {
    let (scene, faces) = (manufactured(), faces());
    let mut errors = Vec::new();
    for radius in [0.24, 0.17, 0.12, 0.085] {
        let mut setup = Setup { radius, ..hemisphere(1, 4096, 1e-3) };
        let threshold = Threshold { absolute: 0.0, relative: 0.0, noise: 0.0 };
        setup.transport = TransportOptions { threshold, shaped_push_down: false, max_bounces: 8, ..setup.transport };
        let prepared = Prepared::new(scene.clone(), setup);
        let solved = prepared.solve().unwrap();
        let (mut sum, mut n) = (0.0, 0.0);
        for (on, &[a, b, c, d]) in faces.iter().enumerate() {
            let normal = (b - a).cross(c - a).normalize().as_vec3();
            let places: Vec<DVec3> = hplt_tests::checks::cells(8).map(|(u, v)| a + (b - a) * u + (d - a) * v).collect();
            let points = prepared.locate_world(&places.iter().map(|&p| (p, normal)).collect::<Vec<_>>());
            // Total irradiance, direct light interpolated too: it is the reconstruction that is measured.
            let total = solved.direct.plus(&solved.indirect);
            let (values, _) = prepared.interpolate(&total, &points);
            for (value, &place) in values.iter().zip(&places) {
                let exact = irradiance(&faces, on, place);
                sum += (f64::from(value.x) / exact - 1.0).abs();
                n += 1.0;
            }
        }
        let radius = prepared.placed.radii[0];
        println!("radius {radius:.4}: mean error {:.3} %", 100.0 * sum / n);
        errors.push((radius, sum / n));
    }
    let order = slope(&errors);
    println!("order {order:.2}");
    assert!(order >= 0.9, "order {order}: {errors:?}");
    assert!(errors[3].1 < 0.01, "{errors:?}");
}
