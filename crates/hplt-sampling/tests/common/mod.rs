//! Small scenes, and what to cast rays with.
#![allow(dead_code, reason = "every test binary uses a part of it")]

use glam::{DVec3, Vec3};
use hplt_geom::{BuildPolicy, Bvh, BvhOptions, Material, MaterialId, MeshInput, Scene, SceneBuilder, Sides};

/// Collects quads and boxes.
pub struct Shapes {
    pub builder: SceneBuilder,
    pub white: MaterialId,
    pub lamp: MaterialId,
}

impl Shapes {
    pub fn new() -> Self {
        let mut builder = SceneBuilder::new();
        let white = builder.push_material(Material::diffuse("white", Vec3::splat(0.7)));
        let lamp = builder.push_material(Material::emitter("lamp", Vec3::splat(0.7), Vec3::ONE));
        Self { builder, white, lamp }
    }

    pub fn mesh(&mut self, positions: &[DVec3], triangles: &[[u32; 3]], material: MaterialId) -> &mut Self {
        let mesh = MeshInput { name: "mesh", positions, normals: &[], uvs: &[], triangles, material };
        self.builder.push_mesh(mesh).unwrap();
        self
    }

    /// A parallelogram whose front is on the side of `u × v`.
    pub fn quad(&mut self, origin: [f64; 3], u: [f64; 3], v: [f64; 3], material: MaterialId) -> &mut Self {
        let (o, u, v) = (DVec3::from(origin), DVec3::from(u), DVec3::from(v));
        self.mesh(&[o, o + u, o + u + v, o + v], &[[0, 1, 2], [0, 2, 3]], material)
    }

    /// The six faces of a box as one mesh, fronts outside, or inside for a room.
    pub fn cuboid(&mut self, min: [f64; 3], max: [f64; 3], is_room: bool, material: MaterialId) -> &mut Self {
        let (a, b) = (DVec3::from(min), DVec3::from(max));
        let corner = |i: usize| DVec3::new([a.x, b.x][i & 1], [a.y, b.y][i >> 1 & 1], [a.z, b.z][i >> 2 & 1]);
        let positions: Vec<DVec3> = (0..8).map(corner).collect();
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles: Vec<[u32; 3]> = faces
            .iter()
            .flat_map(|&[p, q, r, s]| [[p, q, r], [p, r, s]])
            .map(|[p, q, r]| if is_room { [p, r, q] } else { [p, q, r] })
            .collect();
        self.mesh(&positions, &triangles, material)
    }

    /// A small square lamp that looks down.
    pub fn lamp_at(&mut self, center: [f64; 3], size: f64) -> &mut Self {
        let [x, y, z] = center;
        let lamp = self.lamp;
        self.quad([x - 0.5 * size, y, z - 0.5 * size], [size, 0.0, 0.0], [0.0, 0.0, size], lamp)
    }

    pub fn build(&self) -> (Scene, Bvh) {
        let (scene, _) = self.builder.clone().build(BuildPolicy::default()).unwrap();
        let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
        (scene, bvh)
    }
}

/// A box of 0.55 m, open at the front, with a lamp and two blocks that stand on the floor.
pub fn cornell() -> Shapes {
    let mut s = Shapes::new();
    let (l, white) = (0.55, s.white);
    s.quad([0.0; 3], [0.0, 0.0, l], [l, 0.0, 0.0], white)
        .quad([0.0, l, 0.0], [l, 0.0, 0.0], [0.0, 0.0, l], white)
        .quad([0.0, 0.0, l], [0.0, l, 0.0], [l, 0.0, 0.0], white)
        .quad([0.0; 3], [0.0, l, 0.0], [0.0, 0.0, l], white)
        .quad([l, 0.0, 0.0], [0.0, 0.0, l], [0.0, l, 0.0], white)
        .lamp_at([0.275, 0.5495, 0.275], 0.12)
        .cuboid([0.08, 0.0, 0.1], [0.24, 0.165, 0.26], false, white)
        .cuboid([0.3, 0.0, 0.3], [0.46, 0.33, 0.46], false, white);
    s
}

/// Two closed rooms, `[0, 1]³` and the one beside it, on one floor and under one ceiling: a lamp in the first, a wall of
/// the given thickness between them (one sheet when 0).
pub fn two_rooms(thickness: f64) -> Shapes {
    let mut s = Shapes::new();
    let (white, t) = (s.white, thickness);
    let length = 2.0 + t;
    s.cuboid([0.0; 3], [length, 1.0, 1.0], true, white).lamp_at([0.5, 0.9, 0.5], 0.3);
    s.quad([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], white);
    if t > 0.0 {
        s.quad([1.0 + t, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], white);
    }
    s
}

pub fn one_sided(name: &str) -> Material {
    Material { reflects: Sides::Front, ..Material::diffuse(name, Vec3::splat(0.5)) }
}

/// A bumpy ball of `2 n²` triangles in a closed room of 2 m, standing clear of the floor.
pub fn statue(n: u32) -> Shapes {
    let mut s = Shapes::new();
    let white = s.white;
    s.cuboid([0.0; 3], [2.0; 3], true, white).lamp_at([1.0, 1.95, 1.0], 0.5);
    let position = |i: u32, j: u32| {
        let (a, b) = (
            std::f64::consts::TAU * f64::from(i % n) / f64::from(n),
            std::f64::consts::PI * f64::from(j) / f64::from(n),
        );
        let direction = DVec3::new(b.sin() * a.cos(), b.cos(), b.sin() * a.sin());
        let bumps = 0.03 * (40.0 * direction.x).sin() * (40.0 * direction.y).sin() * (40.0 * direction.z).sin();
        DVec3::new(1.0, 0.8, 1.0) + direction * (0.5 + bumps)
    };
    let positions: Vec<DVec3> = (0..=n).flat_map(|j| (0..=n).map(move |i| position(i, j))).collect();
    let at = |i: u32, j: u32| j * (n + 1) + i;
    let cells = (0..n).flat_map(|j| (0..n).map(move |i| (i, j)));
    let triangles: Vec<[u32; 3]> = cells
        .flat_map(|(i, j)| [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]])
        .collect();
    s.mesh(&positions, &triangles, white);
    s
}
