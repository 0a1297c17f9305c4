//! Small scenes with known answers.

use hplt_geom::glam::DVec3;
use hplt_geom::{Environment, Material, Rgb, SceneBuilder, Sides};

use super::Shape;
use super::random::Random;
use super::shape::cuboid_faces;

/// A closed unit cube of 12 triangles whose walls all have the given albedo and exitance: `B = M/(1-ρ)` everywhere.
pub fn furnace_box(albedo: Rgb, exitance: Rgb) -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(Material::emitter("wall", albedo, exitance));
    Shape::new().room(DVec3::ZERO, DVec3::ONE).push_into(&mut builder, "furnace", wall);
    builder
}

/// A closed unit cube with a material per face, in the order x-, x+, y-, y+, z-, z+.
pub fn cube(materials: [Material; 6]) -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    for (face, material) in cuboid_faces(DVec3::ZERO, DVec3::ONE).into_iter().zip(materials) {
        let [a, b, c, d] = face;
        let id = builder.push_material(material);
        Shape::new().quad([a, d, c, b]).push_into(&mut builder, "face", id);
    }
    builder
}

/// The inside of a sphere at the origin, of about `facets` triangles, each of the material that `material` gives for
/// the unit vector towards its middle. The corners lie on the sphere; the faceting error is `O(1/facets)`.
///
/// `materials` are the distinct materials, `choose` returns an index into them.
pub fn sphere(radius: f64, facets: usize, materials: &[Material], choose: impl Fn(DVec3) -> usize) -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    let ids: Vec<_> = materials.iter().map(|m| builder.push_material(m.clone())).collect();
    let ball = geodesic_sphere(radius, facets);
    let mut parts = vec![Shape::new(); ids.len()];
    for &[a, b, c] in &ball.triangles {
        let corners = [a, c, b].map(|v| ball.positions[v as usize]);
        let middle = (corners[0] + corners[1] + corners[2]).normalize();
        parts[choose(middle)].triangle(corners);
    }
    for (part, id) in parts.iter().zip(ids) {
        part.push_into(&mut builder, "sphere", id);
    }
    builder
}

/// Two spheres around the origin: the outside of the inner one and the inside of the outer one, about `facets`
/// triangles each.
pub fn concentric_spheres(
    inner_radius: f64,
    outer_radius: f64,
    facets: usize,
    inner: Material,
    outer: Material,
) -> SceneBuilder {
    let mut builder = sphere(outer_radius, facets, &[outer], |_| 0);
    let inner = builder.push_material(inner);
    geodesic_sphere(inner_radius, facets).push_into(&mut builder, "inner", inner);
    builder
}

/// Two unit squares that face each other across `gap`: the lower one (y = 0) emits 1 W/m² and is black, the upper one
/// is black. Their form factor is [`closed_forms::parallel_rectangles`](crate::closed_forms::parallel_rectangles).
pub fn parallel_plates(gap: f64) -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    let emitter = builder.push_material(Material::emitter("emitter", Rgb::ZERO, Rgb::ONE));
    let receiver = builder.push_material(Material::diffuse("receiver", Rgb::ZERO));
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    Shape::new().quad([at(0.0, 0.0, 0.0), at(0.0, 0.0, 1.0), at(1.0, 0.0, 1.0), at(1.0, 0.0, 0.0)]).push_into(
        &mut builder,
        "emitter",
        emitter,
    );
    Shape::new().quad([at(0.0, gap, 0.0), at(1.0, gap, 0.0), at(1.0, gap, 1.0), at(0.0, gap, 1.0)]).push_into(
        &mut builder,
        "receiver",
        receiver,
    );
    builder
}

/// Two rectangles that share the edge x ∈ [0, 1]: the horizontal one of depth `emitter_width` emits 1 W/m², the
/// vertical one of height `receiver_height` receives; both are black.
pub fn perpendicular_plates(emitter_width: f64, receiver_height: f64) -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    let emitter = builder.push_material(Material::emitter("emitter", Rgb::ZERO, Rgb::ONE));
    let receiver = builder.push_material(Material::diffuse("receiver", Rgb::ZERO));
    let (w, h) = (emitter_width, receiver_height);
    Shape::new().quad([DVec3::ZERO, DVec3::new(0.0, 0.0, w), DVec3::new(1.0, 0.0, w), DVec3::X]).push_into(
        &mut builder,
        "emitter",
        emitter,
    );
    Shape::new().quad([DVec3::ZERO, DVec3::X, DVec3::new(1.0, h, 0.0), DVec3::new(0.0, h, 0.0)]).push_into(
        &mut builder,
        "receiver",
        receiver,
    );
    builder
}

/// Two closed rooms of one cubic metre side by side, a wall of `thickness` metres between them: the room at x < 0 has
/// a lamp under its ceiling, the one at x > 0 has none and must stay black.
///
/// Floor and ceiling run through under and above the wall as single sheets (the coplanar leak). At thickness 0 the
/// wall is two coincident sheets back to back.
pub fn two_rooms(thickness: f64) -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    let shell = builder.push_material(Material::diffuse("shell", Rgb::new(0.7, 0.7, 0.65)));
    let lit_wall = builder.push_material(Material::diffuse("lit wall", Rgb::new(0.6, 0.6, 0.6)));
    let dark_wall = builder.push_material(Material::diffuse("dark wall", Rgb::new(0.5, 0.6, 0.7)));
    let end = 1.0 + thickness;
    Shape::new().room(DVec3::new(-1.0, 0.0, 0.0), DVec3::new(end, 1.0, 1.0)).push_into(&mut builder, "shell", shell);
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    Shape::new().quad([at(0.0, 0.0, 0.0), at(0.0, 0.0, 1.0), at(0.0, 1.0, 1.0), at(0.0, 1.0, 0.0)]).push_into(
        &mut builder,
        "lit wall",
        lit_wall,
    );
    let t = thickness;
    Shape::new().quad([at(t, 0.0, 0.0), at(t, 1.0, 0.0), at(t, 1.0, 1.0), at(t, 0.0, 1.0)]).push_into(
        &mut builder,
        "dark wall",
        dark_wall,
    );
    lamp(DVec3::new(-0.65, 0.98, 0.35), 0.3, Rgb::splat(20.0), &mut builder);
    builder
}

/// A closed room of one cubic metre in the middle of a closed room of three: only the outer one has a lamp; the inner
/// one must stay black. The inner walls are boxes of 1 mm.
pub fn nested_rooms() -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    let outer = builder.push_material(Material::diffuse("outer", Rgb::splat(0.7)));
    let inner = builder.push_material(Material::diffuse("inner", Rgb::splat(0.6)));
    let mut shape = Shape::new();
    shape.room(DVec3::splat(-1.5), DVec3::splat(1.5)).push_into(&mut builder, "outer room", outer);
    let mut shape = Shape::new();
    shape.cuboid(DVec3::splat(-0.501), DVec3::splat(0.501)).room(DVec3::splat(-0.5), DVec3::splat(0.5));
    shape.push_into(&mut builder, "inner room", inner);
    lamp(DVec3::new(-0.5, 1.45, -0.5), 1.0, Rgb::splat(5.0), &mut builder);
    builder
}

/// A cube of half a metre on the floor of a closed room of two metres, a lamp under the ceiling: the floor under the
/// cube, the cube's bottom and its inside must stay black.
pub fn box_on_floor() -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    let room = builder.push_material(Material::diffuse("room", Rgb::splat(0.7)));
    let cube = builder.push_material(Material::diffuse("cube", Rgb::new(0.7, 0.4, 0.2)));
    Shape::new().room(DVec3::ZERO, DVec3::splat(2.0)).push_into(&mut builder, "room", room);
    Shape::new().cuboid(DVec3::new(0.75, 0.0, 0.75), DVec3::new(1.25, 0.5, 1.25)).push_into(&mut builder, "cube", cube);
    lamp(DVec3::new(0.7, 1.95, 0.7), 0.6, Rgb::splat(10.0), &mut builder);
    builder
}

/// A closed room with `n_boxes` random boxes floating in it, every surface of its own random albedo `ρ ≤ 0.95` per
/// channel and exitance `(1-ρ)·radiosity`: the radiosity is `radiosity` everywhere (generalised furnace).
pub fn cluttered_room(seed: u64, n_boxes: usize, radiosity: f32) -> SceneBuilder {
    boxes_furnace(seed, n_boxes, radiosity, 0.95)
}

/// 500 random boxes in a closed room, through each other: [`cluttered_room`] with unit radiosity and albedos up to 0.99.
pub fn random_boxes_furnace(seed: u64) -> SceneBuilder {
    boxes_furnace(seed, 500, 1.0, 0.99)
}

fn boxes_furnace(seed: u64, n_boxes: usize, radiosity: f32, most_albedo: f64) -> SceneBuilder {
    let mut random = Random::new(seed);
    let mut builder = SceneBuilder::new();
    let furnace_material = |random: &mut Random, emits: Sides, builder: &mut SceneBuilder| {
        let albedo = (random.vector() * most_albedo).as_vec3();
        let emitter = Material::emitter("clutter", albedo, (Rgb::ONE - albedo) * radiosity);
        builder.push_material(Material { emits, ..emitter })
    };
    let material = furnace_material(&mut random, Sides::Front, &mut builder);
    Shape::new().room(DVec3::ZERO, DVec3::new(3.0, 2.0, 2.5)).push_into(&mut builder, "room", material);
    for _ in 0..n_boxes {
        let size = random.vector() * 0.4 + 0.05;
        let min = random.vector() * (DVec3::new(2.9, 1.9, 2.4) - size) + 0.05;
        // Both sides emit: boxes that overlap enclose cavities, which must be furnaces too.
        let material = furnace_material(&mut random, Sides::Both, &mut builder);
        Shape::new().cuboid(min, min + size).push_into(&mut builder, "box", material);
    }
    builder
}

/// The inside of a torus around the y axis (radii 1 m and 0.4 m, `n_around × n_across` quads), as a generalised
/// furnace: four albedos by sector, exitance `(1-ρ)·radiosity`, radiosity `radiosity` everywhere.
pub fn torus(n_around: u32, n_across: u32, radiosity: f32) -> SceneBuilder {
    use std::f64::consts::TAU;
    let mut builder = SceneBuilder::new();
    let mut parts = vec![Shape::new(); 4];
    let at = |i: u32, j: u32| {
        let (a, b) =
            (TAU * f64::from(i % n_around) / f64::from(n_around), TAU * f64::from(j % n_across) / f64::from(n_across));
        let r = 1.0 + 0.4 * b.cos();
        DVec3::new(r * a.cos(), 0.4 * b.sin(), r * a.sin())
    };
    for i in 0..n_around {
        for j in 0..n_across {
            let sector = (4 * i / n_around) as usize;
            parts[sector].quad([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    for (part, albedo) in parts.iter().zip([0.0, 0.3, 0.6, 0.95]) {
        let exitance = Rgb::splat((1.0 - albedo) * radiosity);
        let id = builder.push_material(Material::emitter("torus", Rgb::splat(albedo), exitance));
        part.push_into(&mut builder, "torus", id);
    }
    builder
}

/// One unit square in the plane y = 0 that reflects on both sides, its front up.
pub fn single_sheet(albedo: Rgb) -> SceneBuilder {
    plane(1.0, albedo)
}

/// A square ground plane of `size` metres around the origin, front up, under a uniform sky.
///
/// # Panics
/// When `sky_radiance` is negative or not finite.
pub fn plane_under_sky(size: f64, albedo: Rgb, sky_radiance: Rgb) -> SceneBuilder {
    let mut builder = plane(size, albedo);
    match Environment::constant(sky_radiance) {
        Ok(sky) => builder.set_environment(sky),
        Err(error) => panic!("sky radiance: {error}"),
    }
    builder
}

fn plane(size: f64, albedo: Rgb) -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    let sheet = builder.push_material(Material::diffuse("sheet", albedo));
    let h = 0.5 * size;
    let corner = |x: f64, z: f64| DVec3::new(x, 0.0, z);
    Shape::new().quad([corner(-h, -h), corner(-h, h), corner(h, h), corner(h, -h)]).push_into(
        &mut builder,
        "sheet",
        sheet,
    );
    builder
}

/// A square lamp that hangs horizontally from `min`, emits downwards and reflects nothing.
pub(super) fn lamp(min: DVec3, size: f64, exitance: Rgb, builder: &mut SceneBuilder) {
    let id =
        builder.push_material(Material { reflects: Sides::Front, ..Material::emitter("lamp", Rgb::ZERO, exitance) });
    let at = |x: f64, z: f64| min + DVec3::new(x * size, 0.0, z * size);
    Shape::new().quad([at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)]).push_into(builder, "lamp", id);
}

/// A sphere seen from outside, of `20·n²` triangles, the number nearest to `facets`: an icosahedron whose faces are
/// split into `n²` and whose corners are pushed out to the sphere.
pub fn geodesic_sphere(radius: f64, facets: usize) -> Shape {
    let n = ((facets as f64 / 20.0).sqrt().round() as u32).max(1);
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    let corner = |i: usize| {
        let (s, t) = ([1.0, -1.0][i & 1], golden * [1.0, -1.0][(i >> 1) & 1]);
        match i / 4 {
            0 => DVec3::new(0.0, s, t),
            1 => DVec3::new(s, t, 0.0),
            _ => DVec3::new(t, 0.0, s),
        }
    };
    let mut shape = Shape::new();
    for (a, b, c) in icosahedron_faces(corner) {
        subdivide([corner(a), corner(b), corner(c)], n, radius, &mut shape);
    }
    shape
}

/// The 20 triples of mutual neighbours, counter-clockwise from outside.
fn icosahedron_faces(corner: impl Fn(usize) -> DVec3) -> Vec<(usize, usize, usize)> {
    let near = |a: usize, b: usize| (corner(a) - corner(b)).length() < 2.1;
    let mut faces = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(a, c) {
                    let outwards = (corner(b) - corner(a)).cross(corner(c) - corner(a)).dot(corner(a));
                    faces.push(if outwards > 0.0 { (a, b, c) } else { (a, c, b) });
                }
            }
        }
    }
    faces
}

fn subdivide([a, b, c]: [DVec3; 3], n: u32, radius: f64, shape: &mut Shape) {
    // Symmetric in the corners of an edge, so that neighbouring faces get the same bits.
    let at = |i: u32, j: u32| (a * f64::from(n - i - j) + b * f64::from(i) + c * f64::from(j)).normalize() * radius;
    let first = shape.positions.len() as u32;
    let index = |i: u32, j: u32| first + j * (n + 1) + i - (j * j - j) / 2;
    for j in 0..=n {
        for i in 0..=n - j {
            shape.positions.push(at(i, j));
        }
    }
    for j in 0..n {
        for i in 0..n - j {
            shape.triangles.push([index(i, j), index(i + 1, j), index(i, j + 1)]);
            if i + j + 1 < n {
                shape.triangles.push([index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)]);
            }
        }
    }
}
