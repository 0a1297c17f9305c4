//! A21: a cube made so that its answer is known everywhere: radiosity is the same all over each face.

use hplt::geom::glam::DVec3;
use hplt::geom::{Material, Rgb, Scene, SceneBuilder};
use hplt::reference::closed_forms::point_to_polygon;
use hplt::reference::scenes::{self, Shape};

/// Radiosities of the faces, constant on each.
const RADIOSITY: [f64; 6] = [2.0, 2.5, 4.0, 2.2, 3.0, 2.4];
const ALBEDO: f64 = 0.5;
/// Cells of constant exitance across a face.
const CELLS: u32 = 16;

/// The corners of the faces, wound inwards.
pub fn faces() -> Vec<[DVec3; 4]> {
    let mut room = Shape::new();
    room.room(DVec3::ZERO, DVec3::ONE);
    room.positions.chunks(4).map(|c| [c[0], c[1], c[2], c[3]]).collect()
}

/// The irradiance at a point of face `on`: `Σ F(x→j) B_j`, with the exact factor from a point to a polygon.
pub fn irradiance(faces: &[[DVec3; 4]], on: usize, x: DVec3) -> f64 {
    let [a, b, c, _] = faces[on];
    let normal = (b - a).cross(c - a).normalize();
    let factor = |j: usize| point_to_polygon(normal, &faces[j].map(|p| p - x));
    (0..6).filter(|&j| j != on).map(|j| factor(j) * RADIOSITY[j]).sum()
}

/// The cube with exitances `M = B - ρH`, constant on cells.
pub fn scene() -> Scene {
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
