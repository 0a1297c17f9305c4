//! Procedural meshes and rays for tests.

use glam::{DVec3, Vec3};

use crate::{BuildPolicy, Material, Mesh, MeshInput, Rgb, Scene, SceneBuilder};

/// SplitMix64: numbers in `[0, 1)` that depend on the seed alone.
pub(super) struct Random(u64);

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(super) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(super) fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }

    pub(super) fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    pub(super) fn in_cube(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - Vec3::ONE
    }

    pub(super) fn direction(&mut self) -> Vec3 {
        loop {
            let p = self.in_cube();
            if (0.01..=1.0).contains(&p.length_squared()) {
                return p.normalize();
            }
        }
    }
}

/// Vertices and triangles.
pub(super) type Soup = (Vec<Vec3>, Vec<[u32; 3]>);

/// A closed sphere of `2·columns·(rows - 1)` triangles with shared vertices.
pub(super) fn sphere(rows: u32, columns: u32, radius: f64, center: DVec3) -> Soup {
    let point = |row: u32, column: u32| {
        let theta = std::f64::consts::PI * f64::from(row) / f64::from(rows);
        let phi = std::f64::consts::TAU * f64::from(column) / f64::from(columns);
        let p = DVec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
        (center + p * radius).as_vec3()
    };
    let mut vertices = vec![point(0, 0)];
    for row in 1..rows {
        vertices.extend((0..columns).map(|column| point(row, column)));
    }
    vertices.push(point(rows, 0));
    let last = vertices.len() as u32 - 1;
    let at = |row: u32, column: u32| match row {
        0 => 0,
        r if r == rows => last,
        r => 1 + (r - 1) * columns + column % columns,
    };
    let mut triangles = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let [a, b, c, d] = [at(row, column), at(row, column + 1), at(row + 1, column + 1), at(row + 1, column)];
            if row > 0 {
                triangles.push([a, b, c]);
            }
            if row + 1 < rows {
                triangles.push([a, c, d]);
            }
        }
    }
    (vertices, triangles)
}

/// `n` triangles of edge up to `size` in the cube `[-1, 1]³`; `flat` ones lie in axis-aligned planes on a coarse grid.
pub(super) fn soup(n: usize, size: f32, flat: bool, random: &mut Random) -> Soup {
    let mut vertices = Vec::new();
    for _ in 0..n {
        let center = random.in_cube();
        let axis = random.below(3);
        let plane = (random.unit() * 4.0).floor() * 0.25;
        for _ in 0..3 {
            let mut p = center + random.in_cube() * size;
            if flat {
                p = (p * 16.0).round() / 16.0;
                p[axis] = plane;
            }
            vertices.push(p);
        }
    }
    let triangles = (0..n as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    (vertices, triangles)
}

pub(super) fn scene((vertices, triangles): &Soup) -> Scene {
    let mut builder = SceneBuilder::new();
    let material = builder.push_material(Material::diffuse("plain", Rgb::splat(0.5)));
    let positions: Vec<DVec3> = vertices.iter().map(|p| p.as_dvec3()).collect();
    let mesh = MeshInput { name: "soup", positions: &positions, normals: &[], uvs: &[], triangles, material };
    builder.push_mesh(mesh).unwrap();
    builder.build(BuildPolicy::default()).unwrap().0
}

/// A mesh as it is, not mapped into scene space.
pub(super) fn raw_mesh((positions, triangles): Soup) -> Mesh {
    let face_normals = triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            crate::mesh::doubled_area_vector(a, b, c).normalize_or_zero().as_vec3()
        })
        .collect();
    let materials = vec![crate::MaterialId(0); triangles.len()];
    Mesh { positions, triangles, face_normals, materials, uvs: Vec::new(), shading_normals: Vec::new() }
}
