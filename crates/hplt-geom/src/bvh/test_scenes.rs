//! Procedural meshes and rays for tests.

use glam::{DVec3, Vec2, Vec3};

use crate::{
    AlphaMask, BuildPolicy, Material, Mesh, MeshInput, Rgb, Scene, SceneBuilder, Texture, TextureSlot, UvTransform,
    Wrap,
};

/// SplitMix64: numbers in `[0, 1)` that depend on the seed alone.
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(super) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(crate) fn unit(&mut self) -> f32 {
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

/// `n` coplanar triangles with one centre, all of one size or growing by a millionth each.
pub(super) fn nested(n: usize, same_size: bool) -> Soup {
    let mut vertices = Vec::with_capacity(3 * n);
    for i in 0..n {
        let size = if same_size { 0.5 } else { 0.25 + 0.25 * i as f32 / n as f32 };
        vertices.extend([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]].map(|[x, y]: [f32; 2]| Vec3::new(x, y, 0.0) * size));
    }
    (vertices, (0..n as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect())
}

/// Three unit quads that face +z: at z = 0 one with an `n × n` texture that `is_cut` cuts, behind it at -¼ a plain one, in
/// front at ¼ one whose mask cuts everything.
pub(super) fn masked_quad(n: u32, is_cut: impl Fn(u32, u32) -> bool) -> Scene {
    let texels = (0..n * n).map(|i| [255, 255, 255, if is_cut(i % n, i / n) { 0 } else { 255 }]).collect();
    let texture = Texture::from_rgba8(n, n, texels).unwrap();
    let slot = TextureSlot { texture, transform: UvTransform::default(), wrap: [Wrap::Repeat; 2] };
    let mask = |factor, texture| Some(AlphaMask { factor, texture, cutoff: 0.5 });
    let mut builder = SceneBuilder::new();
    for (z, alpha) in [(-0.25, None), (0.0, mask(1.0, Some(slot))), (0.25, mask(0.1, None))] {
        let plain = Material::diffuse("quad", Rgb::splat(0.5));
        let material = builder.push_material(Material { alpha, ..plain });
        let uvs = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(Vec2::from);
        let positions = uvs.map(|uv| DVec3::new(f64::from(uv.x) - 0.5, f64::from(uv.y) - 0.5, z));
        let triangles = &[[0, 1, 2], [0, 2, 3]];
        builder
            .push_mesh(MeshInput { name: "quad", positions: &positions, normals: &[], uvs: &uvs, triangles, material })
            .unwrap();
    }
    builder.build(BuildPolicy::default()).unwrap().0
}
