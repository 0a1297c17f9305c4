use std::f64::consts::{PI, TAU};

use hplt_geom::glam::DVec3;
use hplt_geom::radiometry::exitance_from_radiance;
use hplt_geom::{Camera, Material, MaterialId, Rgb, SceneBuilder, Sides};

use super::Shape;
use super::basic::geodesic_sphere;

/// The triangles of the colonnade at full size: as many as the atrium it stands in for.
pub const COLONNADE_TRIANGLES: usize = 279_000;

/// Half the court, from column axis to column axis, m.
const COURT: DVec3 = DVec3::new(8.75, 0.0, 3.75);
/// Half the building, m.
const WALLS: DVec3 = DVec3::new(12.5, 0.0, 7.5);
const BAY: f64 = 2.5;
/// Half the thickness of arches and beams, m.
const HALF: f64 = 0.25;
const FLOOR_2: f64 = 4.5;
const CEILING_1: f64 = 4.2;
const CEILING_2: f64 = 7.9;
const ROOF: f64 = 8.2;
const SPRINGING: f64 = 2.95;
const LINTEL: f64 = 7.45;

/// A court between two storeys of columns, arches below and beams above, with drapes, lit by a rectangle that closes the
/// open roof; four cameras. About `n_triangles` triangles, at least some 12 000 ([`COLONNADE_TRIANGLES`] for the full
/// scene).
pub fn colonnade(n_triangles: usize) -> SceneBuilder {
    let detail = detail_for(n_triangles);
    let mut builder = SceneBuilder::new();
    Parts::new(detail).push_into(&mut builder);
    let radiance = Rgb::new(20.0, 19.0, 17.6);
    let light = Material {
        reflects: Sides::Front,
        ..Material::emitter("roof_light", Rgb::ZERO, exitance_from_radiance(radiance))
    };
    let light = builder.push_material(light);
    let at = |x: f64, z: f64| DVec3::new(x * (COURT.x - 0.1), 8.8, z * (COURT.z - 0.1));
    Shape::new().quad([at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]).push_into(
        &mut builder,
        "roof_light",
        light,
    );
    cameras(&mut builder);
    builder
}

/// The fineness that comes nearest to a number of triangles, which grows with it in steps.
fn detail_for(n_triangles: usize) -> f64 {
    let guess = (n_triangles as f64 / COLONNADE_TRIANGLES as f64).sqrt();
    let (mut low, mut high) = (0.3 * guess, 1.5 * guess);
    let mut best = (usize::MAX, guess);
    for _ in 0..12 {
        let middle = 0.5 * (low + high);
        let found = Parts::new(middle).n_triangles();
        let off = found.abs_diff(n_triangles);
        if off < best.0 {
            best = (off, middle);
        }
        if found < n_triangles {
            low = middle;
        } else {
            high = middle;
        }
    }
    best.1
}

fn cameras(builder: &mut SceneBuilder) {
    for (name, eye, target) in [
        ("court_west", [-8.0, 1.7, 0.4], [8.0, 3.6, -0.4]),
        ("court_east", [8.2, 5.9, 0.9], [-8.0, 1.8, -0.6]),
        ("arcade", [-11.2, 1.7, 5.9], [9.0, 1.9, 5.2]),
        ("gallery", [-10.2, 6.1, 5.6], [4.0, 4.6, -1.0]),
    ] {
        let camera = Camera::look_at(DVec3::from(eye), DVec3::from(target), DVec3::Y, 65f64.to_radians());
        if let Ok(camera) = camera {
            builder.push_camera(Camera { name: name.into(), aspect: Some(16.0 / 9.0), ..camera });
        }
    }
}

/// The meshes by material, before they enter a scene.
struct Parts {
    tiles: [Shape; 2],
    walls: Shape,
    panels: [Shape; 2],
    stone: Shape,
    marble: Shape,
    /// With shading normals.
    turned: Shape,
    gilded: Shape,
    drapes: [Shape; 3],
}

impl Parts {
    fn new(detail: f64) -> Self {
        let fine = |n: f64, least: u32| ((n * detail).round() as u32).max(least);
        let mut parts = Self {
            tiles: tiles(),
            walls: Shape::new(),
            panels: Default::default(),
            stone: Shape::new(),
            marble: Shape::new(),
            turned: Shape::new(),
            gilded: Shape::new(),
            drapes: Default::default(),
        };
        parts.shell();
        parts.pilasters_and_panels();
        ring(&mut parts.stone, 0.35, CEILING_1, FLOOR_2);
        ring(&mut parts.stone, 0.35, CEILING_2, ROOF);
        beam(&mut parts.stone, LINTEL, CEILING_2 + 0.01);
        parapet(&mut parts.walls);
        parts.dentils();
        for (place, _) in bays() {
            parts.columns(place, &fine);
        }
        for (place, along) in bays() {
            arch(&mut parts.stone, place, along, fine(28.0, 6));
            parts.balustrade(place, along, &fine);
        }
        parts.hang_drapes(&fine);
        parts.fountain(&fine);
        parts
    }

    fn shapes(&self) -> [&Shape; 12] {
        let [a, b] = &self.tiles;
        let [c, d] = &self.panels;
        let [e, f, g] = &self.drapes;
        [a, b, c, d, e, f, g, &self.walls, &self.stone, &self.marble, &self.turned, &self.gilded]
    }

    fn n_triangles(&self) -> usize {
        self.shapes().iter().map(|shape| shape.triangles.len()).sum()
    }

    fn push_into(&self, builder: &mut SceneBuilder) {
        let looks = [
            ("tile_light", [0.52, 0.47, 0.40]),
            ("tile_dark", [0.28, 0.22, 0.18]),
            ("panel_red", [0.48, 0.14, 0.09]),
            ("panel_blue", [0.12, 0.20, 0.36]),
            ("drape_red", [0.60, 0.06, 0.05]),
            ("drape_green", [0.08, 0.36, 0.10]),
            ("drape_blue", [0.07, 0.14, 0.50]),
            ("wall", [0.60, 0.52, 0.42]),
            ("stone", [0.58, 0.53, 0.45]),
            ("marble", [0.68, 0.66, 0.62]),
            ("column", [0.64, 0.60, 0.53]),
            ("gilded", [0.60, 0.46, 0.22]),
        ];
        for (shape, (name, albedo)) in self.shapes().into_iter().zip(looks) {
            let material: MaterialId = builder.push_material(Material::diffuse(name, Rgb::from(albedo)));
            shape.push_into(builder, name, material);
        }
    }

    /// The outer walls, seen from inside.
    fn shell(&mut self) {
        let (x, z) = (WALLS.x, WALLS.z);
        let corners = [(-x, -z), (-x, z), (x, z), (x, -z)];
        for i in 0..4 {
            let ((ax, az), (bx, bz)) = (corners[i], corners[(i + 1) % 4]);
            let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
            self.walls.quad([at(bx, 0.0, bz), at(ax, 0.0, az), at(ax, 9.4, az), at(bx, 9.4, bz)]);
        }
    }

    /// Flat pillars on the long walls, and painted panels between them.
    fn pilasters_and_panels(&mut self) {
        for i in 0..=10 {
            let x = (f64::from(i) - 5.0) * 2.3;
            for side in [-1.0, 1.0] {
                let slab = |shape: &mut Shape, x0: f64, x1: f64, y0: f64, y1: f64, depth: f64| {
                    let (a, b) = (side * (WALLS.z - depth), side * (WALLS.z + 0.05));
                    shape.cuboid(DVec3::new(x0, y0, a.min(b)), DVec3::new(x1, y1, a.max(b)));
                };
                slab(&mut self.stone, x - 0.2, x + 0.2, -0.01, CEILING_1 + 0.02, 0.16);
                slab(&mut self.stone, x - 0.2, x + 0.2, FLOOR_2 - 0.02, CEILING_2 + 0.02, 0.16);
                if i < 10 {
                    slab(&mut self.panels[i as usize % 2], x + 0.45, x + 1.85, 0.9, 3.2, 0.05);
                    slab(&mut self.panels[(i as usize + 1) % 2], x + 0.45, x + 1.85, 5.2, 7.1, 0.05);
                }
            }
        }
    }

    /// Rows of small blocks under the edges of both slabs.
    fn dentils(&mut self) {
        for (top, size) in [(CEILING_1 + 0.02, 0.12), (CEILING_2 + 0.02, 0.14)] {
            for (along, across, n) in [(DVec3::X, DVec3::Z, 48), (DVec3::Z, DVec3::X, 20)] {
                let half = COURT.dot(along) - HALF - 0.04;
                for i in 0..n {
                    let s = half * (2.0 * (f64::from(i) + 0.5) / f64::from(n) - 1.0);
                    for side in [-1.0, 1.0] {
                        let middle =
                            along * s + across * side * (COURT.dot(across) - HALF - 0.03) + DVec3::Y * (top - size);
                        let extent = along * 0.5 * size + across * 0.06 + DVec3::Y * size;
                        self.marble.cuboid(middle - extent.with_y(0.0), middle + extent);
                    }
                }
            }
        }
    }

    /// The lower and the upper column at one corner of a bay, and the pier between capital and slab.
    fn columns(&mut self, place: DVec3, fine: &impl Fn(f64, u32) -> u32) {
        self.column(place, 0.0, SPRINGING, 0.25, fine);
        self.column(place + DVec3::Y * FLOOR_2, 0.0, LINTEL - FLOOR_2, 0.2, fine);
        let extent = DVec3::new(HALF, 0.0, HALF);
        self.stone.cuboid(place - extent + DVec3::Y * SPRINGING, place + extent + DVec3::Y * (CEILING_1 + 0.02));
    }

    fn column(&mut self, foot: DVec3, from: f64, to: f64, radius: f64, fine: &impl Fn(f64, u32) -> u32) {
        let r = radius;
        let block =
            |y0: f64, y1: f64, half: f64| (foot + DVec3::new(-half, y0, -half), foot + DVec3::new(half, y1, half));
        let (min, max) = block(from - 0.01, from + 0.14, 1.45 * r);
        self.marble.cuboid(min, max);
        let (min, max) = block(to - 0.09, to + 0.01, 1.32 * r);
        self.marble.cuboid(min, max);
        let around = fine(40.0, 8);
        let base: Vec<(f64, f64)> = (0..=fine(10.0, 3))
            .map(|i| f64::from(i) / f64::from(fine(10.0, 3)))
            .map(|t| (r * (1.36 - 0.3 * t + 0.11 * (2.0 * PI * t).sin().abs()), from + 0.13 + 0.2 * t))
            .collect();
        self.turned.append(&lathe(foot, &base, around, 0, 0.0));
        let (low, high) = (from + 0.31, to - 0.42);
        let rows = fine(14.0, 3);
        let shaft: Vec<(f64, f64)> = (0..=rows)
            .map(|i| f64::from(i) / f64::from(rows))
            .map(|t| (r * (1.0 - 0.16 * t * t), low + (high - low) * t))
            .collect();
        self.turned.append(&lathe(foot, &shaft, fine(80.0, 12), 20, 0.035 * r));
        let rows = fine(12.0, 3);
        let capital: Vec<(f64, f64)> = (0..=rows)
            .map(|i| f64::from(i) / f64::from(rows))
            .map(|t| (r * (0.88 + 0.42 * t * t + 0.09 * (3.0 * PI * t).sin().max(0.0)), high - 0.02 + 0.36 * t))
            .collect();
        self.gilded.append(&lathe(foot, &capital, around, 8, 0.05 * r));
    }

    /// A rail on small turned posts in front of one upper bay.
    fn balustrade(&mut self, place: DVec3, along: DVec3, fine: &impl Fn(f64, u32) -> u32) {
        let across = DVec3::new(along.z, 0.0, along.x).abs();
        let rail = |y0: f64, y1: f64, half: f64| {
            let start = place + along * 0.21 - across * half + DVec3::Y * y0;
            let end = place + along * (BAY - 0.21) + across * half + DVec3::Y * y1;
            (start.min(end), start.max(end))
        };
        let (min, max) = rail(FLOOR_2 + 0.82, FLOOR_2 + 0.92, 0.09);
        self.marble.cuboid(min, max);
        let (min, max) = rail(FLOOR_2 - 0.01, FLOOR_2 + 0.1, 0.08);
        self.marble.cuboid(min, max);
        let rows = fine(12.0, 4);
        let outline: Vec<(f64, f64)> = (0..=rows)
            .map(|i| f64::from(i) / f64::from(rows))
            .map(|t| (0.035 + 0.035 * (PI * t.powf(0.7)).sin().powi(2), FLOOR_2 + 0.09 + 0.74 * t))
            .collect();
        for i in 0..7 {
            let s = 0.44 + 0.27 * f64::from(i);
            self.turned.append(&lathe(place + along * s, &outline, fine(12.0, 5), 0, 0.0));
        }
    }

    /// Single sheets of cloth from the upper floor down into the lower bays of the long sides, and three banners over the court.
    fn hang_drapes(&mut self, fine: &impl Fn(f64, u32) -> u32) {
        let (n_u, n_v) = (fine(52.0, 12), fine(36.0, 6));
        for (i, (place, along)) in bays().enumerate() {
            if along.x == 0.0 || i % 2 == 1 {
                continue;
            }
            // Behind the arches, towards the wall.
            let inwards = DVec3::Z * place.z.signum();
            let origin = place + along * 0.35 + inwards * 0.62 + DVec3::Y * 4.15;
            let phase = i as f64;
            let cloth = |u: f64, v: f64| {
                let pinch = 1.0 - 0.35 * (PI * v).sin().powi(2) * (0.5 + 0.5 * (phase).sin());
                let x = 0.9 + (u - 0.5) * 1.8 * pinch;
                let ripple = (0.035 + 0.075 * v) * (TAU * 6.0 * u + phase + 0.8 * v).sin();
                let drop = (3.1 + 0.08 * (TAU * 2.0 * u + phase).sin()) * v;
                origin + along * x + inwards * ripple - DVec3::Y * drop
            };
            let mut sheet = Shape::new();
            sheet.surface(n_u, n_v, cloth).smooth();
            self.drapes[(i / 2) % 3].append(&sheet);
        }
        for (i, x) in [-5.0, 0.0, 5.0].into_iter().enumerate() {
            let banner = |u: f64, v: f64| {
                let z = (u - 0.5) * 6.4;
                let sag = 1.1 * (1.0 - (2.0 * u - 1.0).powi(2));
                let wave = 0.05 * (TAU * 3.0 * u).sin() * (TAU * v).cos();
                DVec3::new(x + (v - 0.5) * 1.3 + 0.12 * (PI * u).sin() * (TAU * v).sin(), 7.3 - sag + wave, z)
            };
            let mut sheet = Shape::new();
            sheet.surface(n_u, n_v, banner).smooth();
            self.drapes[i].append(&sheet);
        }
    }

    /// A round basin with a ball in the middle of the court.
    fn fountain(&mut self, fine: &impl Fn(f64, u32) -> u32) {
        let outline = [
            (1.3, -0.02),
            (1.3, 0.16),
            (1.12, 0.2),
            (1.08, 0.52),
            (1.22, 0.6),
            (1.22, 0.7),
            (1.02, 0.7),
            (0.9, 0.4),
            (0.2, 0.34),
            (0.16, 0.9),
            (0.24, 1.0),
            (0.5, 1.1),
            (0.62, 1.22),
            (0.58, 1.26),
            (0.3, 1.16),
            (0.0, 1.14),
        ];
        let mut basin = lathe(DVec3::ZERO, &outline, fine(72.0, 16), 0, 0.0);
        basin.normals.clear();
        self.marble.append(&basin);
        let n = (f64::from(fine(30.0, 6))).powi(2) as usize;
        let ball = geodesic_sphere(0.24, n).mapped(|p| p + DVec3::Y * 1.36);
        self.marble.append(&ball);
    }
}

/// The corner where each bay starts, and the direction along it, once round the court.
fn bays() -> impl Iterator<Item = (DVec3, DVec3)> {
    let sides = [
        (DVec3::new(-COURT.x, 0.0, COURT.z), DVec3::X, 7),
        (DVec3::new(COURT.x, 0.0, COURT.z), DVec3::NEG_Z, 3),
        (DVec3::new(COURT.x, 0.0, -COURT.z), DVec3::NEG_X, 7),
        (DVec3::new(-COURT.x, 0.0, -COURT.z), DVec3::Z, 3),
    ];
    sides.into_iter().flat_map(|(start, along, n)| (0..n).map(move |i| (start + along * BAY * f64::from(i), along)))
}

/// The floor as a chequerboard of square metres.
fn tiles() -> [Shape; 2] {
    let mut tiles = [Shape::new(), Shape::new()];
    for i in 0..25 {
        for j in 0..15 {
            let (x, z) = (f64::from(i) - WALLS.x, f64::from(j) - WALLS.z);
            let at = |dx: f64, dz: f64| DVec3::new(x + dx, 0.0, z + dz);
            tiles[(i + j) as usize % 2].quad([at(0.0, 0.0), at(0.0, 1.0), at(1.0, 1.0), at(1.0, 0.0)]);
        }
    }
    tiles
}

/// A slab over the galleries: it overhangs the column axes by `overhang` and ends in the walls.
fn ring(shape: &mut Shape, overhang: f64, bottom: f64, top: f64) {
    let inner = COURT - DVec3::new(overhang, 0.0, overhang);
    let outer = WALLS;
    let corner = |half: DVec3, i: usize, y: f64| {
        let (sx, sz) = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)][i % 4];
        DVec3::new(sx * half.x, y, sz * half.z)
    };
    for i in 0..4 {
        let [a, b] = [i, i + 1];
        shape.quad([corner(outer, a, top), corner(outer, b, top), corner(inner, b, top), corner(inner, a, top)]);
        shape.quad([
            corner(outer, b, bottom),
            corner(outer, a, bottom),
            corner(inner, a, bottom),
            corner(inner, b, bottom),
        ]);
        shape.quad(
            [corner(inner, b, bottom), corner(inner, a, bottom), corner(inner, a, top), corner(inner, b, top)]
                .map(|p| p),
        );
    }
}

/// A low wall on the roof, round the opening, up to the light.
fn parapet(shape: &mut Shape) {
    let half = COURT - DVec3::new(0.3, 0.0, 0.3);
    let corner = |i: usize, y: f64| {
        let (sx, sz) = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)][i % 4];
        DVec3::new(sx * half.x, y, sz * half.z)
    };
    for i in 0..4 {
        let bottom = ROOF - 0.05;
        shape.quad([corner(i + 1, bottom), corner(i, bottom), corner(i, 8.75), corner(i + 1, 8.75)]);
    }
}

/// A beam over all upper columns: bottom and both sides.
fn beam(shape: &mut Shape, bottom: f64, top: f64) {
    let inner = COURT - DVec3::new(HALF, 0.0, HALF);
    let outer = COURT + DVec3::new(HALF, 0.0, HALF);
    let corner = |half: DVec3, i: usize, y: f64| {
        let (sx, sz) = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)][i % 4];
        DVec3::new(sx * half.x, y, sz * half.z)
    };
    for i in 0..4 {
        let [a, b] = [i, i + 1];
        shape.quad([
            corner(outer, b, bottom),
            corner(outer, a, bottom),
            corner(inner, a, bottom),
            corner(inner, b, bottom),
        ]);
        shape.quad([corner(inner, b, bottom), corner(inner, a, bottom), corner(inner, a, top), corner(inner, b, top)]);
        shape.quad([corner(outer, a, bottom), corner(outer, b, bottom), corner(outer, b, top), corner(outer, a, top)]);
    }
}

/// The wall over a round arch between two piers: both faces and the soffit.
fn arch(shape: &mut Shape, place: DVec3, along: DVec3, n: u32) {
    let across = along.cross(DVec3::Y);
    let radius = 0.5 * BAY - HALF;
    let top = CEILING_1 + 0.01;
    let curve = |u: f64| {
        let angle = PI * (1.0 - u);
        along * (0.5 * BAY + radius * angle.cos()) + DVec3::Y * (SPRINGING + radius * angle.sin())
    };
    let face = |u: f64, v: f64, side: f64| {
        let low = curve(u);
        place + across * (HALF * side) + low.with_y(low.y + (top - low.y) * v)
    };
    shape.surface(n, 3, |u, v| face(u, v, 1.0));
    shape.surface(n, 3, |u, v| face(1.0 - u, v, -1.0));
    shape.surface(n, 2, |u, v| place + curve(u) + across * (HALF * (2.0 * v - 1.0)));
}

/// An outline (radius, height) turned about the vertical through `foot`, with `n_flutes` grooves of `depth`; smooth.
fn lathe(foot: DVec3, outline: &[(f64, f64)], n_around: u32, n_flutes: u32, depth: f64) -> Shape {
    let rows = outline.len() as u32 - 1;
    let mut shape = Shape::new();
    shape.surface(n_around, rows, |u, v| {
        let (radius, height) = outline[(v * f64::from(rows)).round() as usize];
        // The seam closes exactly: the last column of vertices is the first.
        let angle = -TAU * (u % 1.0);
        let groove = if n_flutes > 0 { depth * (1.0 - (angle * f64::from(n_flutes) * 0.5).sin().abs()) } else { 0.0 };
        let r = (radius - groove).max(0.0);
        foot + DVec3::new(r * angle.cos(), height, r * angle.sin())
    });
    shape.weld().smooth();
    shape
}

#[cfg(test)]
mod tests {
    use super::super::build;
    use super::*;

    #[test]
    fn the_colonnade_has_the_size_asked_for() {
        for n in [40_000, COLONNADE_TRIANGLES] {
            let found = colonnade(n).n_triangles();
            assert!((found as f64 / n as f64 - 1.0).abs() < 0.03, "{found} of {n}");
        }
    }

    #[test]
    fn nothing_in_it_repeats_or_is_degenerate_beyond_a_few_poles() {
        let (scene, report) = colonnade(20_000).build(hplt_geom::BuildPolicy::default()).unwrap();
        assert_eq!((report.duplicates, report.non_finite, report.repaired_normals), (0, 0, 0));
        assert!(report.degenerate < 100, "{report:?}");
        assert_eq!(scene.emissive_triangles().count(), 2);
    }

    #[test]
    fn columns_and_slabs_face_outwards() {
        let scene = build(colonnade(20_000));
        // The light faces down.
        let light = scene.emissive_triangles().next().unwrap();
        assert!(scene.mesh().face_normal(light).y < -0.999);
    }
}
