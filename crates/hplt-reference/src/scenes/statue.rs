use std::f64::consts::{PI, TAU};

use hplt_geom::glam::DVec3;
use hplt_geom::radiometry::exitance_from_radiance;
use hplt_geom::{Camera, Material, Rgb, SceneBuilder, Sides};

use super::Shape;
use super::basic::geodesic_sphere;

/// The triangles of the statue at full size: as many as the scan it stands in for.
pub const STATUE_TRIANGLES: usize = 1_050_000;

/// Where the figure looks, as an angle about the y axis.
const FACE: f64 = 1.2;

/// Half the outline of the figure, from the middle of its foot to its crown: (radius, height), metres.
const OUTLINE: [(f64, f64); 20] = [
    (0.0, 0.0),
    (0.28, 0.0),
    (0.44, 0.02),
    (0.46, 0.12),
    (0.40, 0.24),
    (0.38, 0.45),
    (0.34, 0.75),
    (0.31, 0.98),
    (0.24, 1.18),
    (0.21, 1.30),
    (0.25, 1.45),
    (0.30, 1.60),
    (0.27, 1.72),
    (0.14, 1.80),
    (0.10, 1.87),
    (0.15, 1.96),
    (0.185, 2.08),
    (0.16, 2.22),
    (0.08, 2.31),
    (0.0, 2.33),
];

/// A closed room with a draped stone figure on a plinth, a rectangle light under the ceiling and three cameras.
///
/// The figure has about `n_triangles` triangles ([`STATUE_TRIANGLES`] for the full scene; the rest of the scene has
/// fewer than 200) and detail at several scales: a body, folds of a few centimetres, chisel marks of millimetres.
pub fn statue_room(n_triangles: usize) -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    room(&mut builder);
    let stone = builder.push_material(Material::diffuse("stone", Rgb::new(0.72, 0.69, 0.63)));
    let mut figure = geodesic_sphere(1.0, n_triangles).mapped(figure_at);
    figure.weld().smooth();
    // A millimetre into the plinth, so that foot and plinth do not coincide.
    for p in &mut figure.positions {
        p.y += 0.599;
    }
    figure.push_into(&mut builder, "figure", stone);
    for (name, eye, target, fov) in [
        ("front", [0.6, 1.7, 2.75], [0.0, 1.62, 0.0], 55f64),
        ("portrait", [0.75, 2.55, 1.25], [0.0, 2.45, 0.0], 40.0),
        ("corner", [-2.7, 0.9, 2.7], [0.3, 1.5, -0.4], 60.0),
    ] {
        let camera = Camera::look_at(DVec3::from(eye), DVec3::from(target), DVec3::Y, fov.to_radians());
        if let Ok(camera) = camera {
            builder.push_camera(Camera { name: name.into(), aspect: Some(1.0), ..camera });
        }
    }
    builder
}

/// Walls of different colours, a stepped plinth, a bench and the light.
fn room(builder: &mut SceneBuilder) {
    let plaster = builder.push_material(Material::diffuse("plaster", Rgb::new(0.74, 0.72, 0.68)));
    let ochre = builder.push_material(Material::diffuse("ochre", Rgb::new(0.66, 0.44, 0.16)));
    let blue = builder.push_material(Material::diffuse("blue", Rgb::new(0.12, 0.26, 0.52)));
    let floor = builder.push_material(Material::diffuse("floor", Rgb::new(0.42, 0.34, 0.27)));
    let marble = builder.push_material(Material::diffuse("marble", Rgb::new(0.32, 0.33, 0.35)));
    let mut shell = Shape::new();
    shell.room(DVec3::new(-3.0, 0.0, -3.0), DVec3::new(3.0, 4.0, 3.0));
    // Faces come as x-, x+, y-, y+, z-, z+.
    for (face, material) in [ochre, blue, floor, plaster, plaster, plaster].into_iter().enumerate() {
        let triangles = shell.triangles[2 * face..2 * face + 2].to_vec();
        let positions = shell.positions.clone();
        Shape { positions, normals: Vec::new(), triangles }.push_into(builder, "wall", material);
    }
    let mut plinth = Shape::new();
    plinth
        .cuboid(DVec3::new(-0.75, -0.01, -0.75), DVec3::new(0.75, 0.15, 0.75))
        .cuboid(DVec3::new(-0.6, 0.14, -0.6), DVec3::new(0.6, 0.52, 0.6))
        .cuboid(DVec3::new(-0.66, 0.51, -0.66), DVec3::new(0.66, 0.6, 0.66));
    plinth.push_into(builder, "plinth", marble);
    let mut bench = Shape::new();
    bench
        .cuboid(DVec3::new(-2.2, 0.42, -2.75), DVec3::new(2.2, 0.5, -2.2))
        .cuboid(DVec3::new(-2.0, -0.01, -2.65), DVec3::new(-1.85, 0.43, -2.3))
        .cuboid(DVec3::new(1.85, -0.01, -2.65), DVec3::new(2.0, 0.43, -2.3));
    bench.push_into(builder, "bench", floor);
    let exitance = exitance_from_radiance(Rgb::new(14.0, 12.6, 10.5));
    let lamp = Material { reflects: Sides::Front, ..Material::emitter("light", Rgb::ZERO, exitance) };
    let lamp = builder.push_material(lamp);
    let at = |x: f64, z: f64| DVec3::new(x, 3.9, z);
    Shape::new().quad([at(-0.2, 0.3), at(1.2, 0.3), at(1.2, 1.7), at(-0.2, 1.7)]).push_into(builder, "light", lamp);
}

/// The point of the figure for a direction: the outline turned about the y axis, then displaced.
fn figure_at(direction: DVec3) -> DVec3 {
    let along = (-direction.y).clamp(-1.0, 1.0).acos() / PI;
    let (radius, height) = outline(along);
    let flat = DVec3::new(direction.x, 0.0, direction.z).normalize_or_zero();
    let angle = flat.z.atan2(flat.x);
    // No displacement at foot and crown, where the angle has no meaning.
    let fade = smooth_step(0.10, 0.18, along) * (1.0 - smooth_step(0.93, 0.995, along));
    let cloth = smooth_step(0.12, 0.2, along) * (1.0 - smooth_step(0.66, 0.74, along));
    let twist = angle + 0.9 * height;
    let folds = 0.035 * (7.0 * twist + 1.5 * (2.0 * height).sin()).sin() + 0.016 * (17.0 * twist - 2.0 * height).sin();
    let sash = 0.03 * (-(40.0 * (height - 1.15 - 0.25 * (angle + 0.6).sin())).powi(2) * 0.02).exp();
    // Wider than deep; the head turns to one side.
    let stretch = DVec3::new(1.12, 1.0, 0.9);
    let lean = DVec3::new(0.05 * (height * 1.7).sin(), 0.0, 0.03 * (height * 1.3).sin());
    let base = flat * (radius + fade * cloth * (folds * (radius / 0.35) + sash)) * stretch + DVec3::Y * height + lean;
    let hair = smooth_step(0.86, 0.9, along) * (1.0 - smooth_step(0.98, 0.995, along));
    let curls = 0.012 * hair * ((60.0 * angle / TAU * 2.0).sin() * (90.0 * height).sin());
    let smooth = 1.0 - 0.75 * smooth_step(0.68, 0.74, along);
    let marks = smooth * (0.02 * noise(base * 4.0) + 0.008 * noise(base * 13.0) + 0.0025 * noise(base * 45.0));
    base + (flat * 0.9 + DVec3::Y * 0.2 * direction.y)
        * fade
        * (marks + curls + face(angle, height) + arms(angle, height))
}

/// Brow, eyes, nose, lips and chin, in metres outwards.
fn face(angle: f64, height: f64) -> f64 {
    let (a, h) = (0.17 * turned(angle - FACE), height - 2.09);
    let side = a.abs();
    let nose = 0.042 * bell(a / 0.019) * smooth_step(0.075, -0.025, h) * smooth_step(-0.048, -0.03, h);
    let eyes = -0.017 * bell((side - 0.055) / 0.024) * bell((h - 0.035) / 0.019)
        + 0.008 * bell((side - 0.055) / 0.014) * bell((h - 0.032) / 0.011);
    let brow = 0.013 * bell((side - 0.05) / 0.035) * bell((h - 0.072) / 0.013);
    let lips = 0.012 * bell(a / 0.032) * (bell((h + 0.079) / 0.0085) + bell((h + 0.1) / 0.0095));
    let chin = 0.022 * bell(a / 0.036) * bell((h + 0.142) / 0.024);
    nose + eyes + brow + lips + chin
}

/// Arms that are folded in front of the body.
fn arms(angle: f64, height: f64) -> f64 {
    let a = turned(angle - FACE);
    let side = a.abs();
    let lower = bell((height - 1.36 - 0.05 * a.sin()) / 0.062) * smooth_step(1.65, 1.35, side);
    let cut = 0.4 * bell((height - 1.362 - 0.05 * a.sin() - 0.012) / 0.012) * smooth_step(0.75, 0.5, side);
    let upper = bell((side - 1.5) / 0.2) * smooth_step(1.32, 1.4, height) * smooth_step(1.68, 1.56, height);
    0.085 * lower.max(upper) - 0.04 * cut * lower
}

fn bell(x: f64) -> f64 {
    (-0.5 * x * x).exp()
}

/// The angle in [-π, π].
fn turned(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

/// The outline at `along` in `[0, 1]`, by Catmull-Rom splines, about uniform in length.
fn outline(along: f64) -> (f64, f64) {
    let n = OUTLINE.len();
    let place = (along * (n - 1) as f64).clamp(0.0, (n - 1) as f64);
    let i = (place as usize).min(n - 2);
    let t = place - i as f64;
    let point = |k: isize| OUTLINE[(i as isize + k).clamp(0, n as isize - 1) as usize];
    let spline = |a: f64, b: f64, c: f64, d: f64| {
        b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
    };
    let [a, b, c, d] = [point(-1), point(0), point(1), point(2)];
    (spline(a.0, b.0, c.0, d.0).max(0.0), spline(a.1, b.1, c.1, d.1).max(0.0))
}

/// 0 at `from`, 1 at `to`, flat beyond both; `from` may be the larger one.
fn smooth_step(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Smooth noise in [-1, 1] with one bump per unit.
fn noise(p: DVec3) -> f64 {
    let cell = p.floor();
    let f = p - cell;
    let w = f * f * (3.0 - 2.0 * f);
    let at = |x: i64, y: i64, z: i64| lattice(cell.x as i64 + x, cell.y as i64 + y, cell.z as i64 + z);
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let row = |y: i64, z: i64| mix(at(0, y, z), at(1, y, z), w.x);
    mix(mix(row(0, 0), row(1, 0), w.y), mix(row(0, 1), row(1, 1), w.y), w.z)
}

fn lattice(x: i64, y: i64, z: i64) -> f64 {
    let seed = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ (z as u64).wrapping_mul(0x1656_67b1_9e37_79f9);
    2.0 * super::random::Random::new(seed).uniform() - 1.0
}

#[cfg(test)]
mod tests {
    use super::super::build;
    use super::*;

    #[test]
    fn the_figure_is_closed_and_of_the_size_asked_for() {
        let mut figure = geodesic_sphere(1.0, 20_000).mapped(figure_at);
        figure.weld();
        assert!((figure.triangles.len() as f64 / 20_000.0 - 1.0).abs() < 0.05);
        let mut edges = std::collections::HashMap::new();
        for &[a, b, c] in &figure.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *edges.entry((from.min(to), from.max(to))).or_insert(0) += if from < to { 1 } else { -1 };
            }
        }
        assert!(edges.values().all(|&balance| balance == 0));
        let (min, max) = figure.bounds();
        assert!(min.y > -1e-9 && (2.2..2.4).contains(&max.y), "{min} {max}");
    }

    #[test]
    fn the_room_is_lit_and_has_cameras() {
        let scene = build(statue_room(2_000));
        assert_eq!(scene.emissive_triangles().count(), 2);
        assert_eq!(scene.cameras().len(), 3);
    }
}
