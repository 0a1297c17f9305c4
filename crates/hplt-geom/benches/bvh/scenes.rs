//! Procedural scenes with the shape of real ones, and the rays that a gather casts in them.

use hplt_geom::glam::{DVec3, Vec3};
use hplt_geom::{BuildPolicy, Material, MeshInput, Ray, Rgb, Scene, SceneBuilder, offset_origin};

/// Vertices and triangles under construction.
#[derive(Default)]
pub struct Shape {
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

impl Shape {
    /// A grid of `nu × nv` quads over the unit square, mapped by `f`.
    fn grid(&mut self, nu: u32, nv: u32, f: impl Fn(f64, f64) -> DVec3) {
        let first = self.positions.len() as u32;
        for j in 0..=nv {
            for i in 0..=nu {
                self.positions.push(f(f64::from(i) / f64::from(nu), f64::from(j) / f64::from(nv)));
            }
        }
        let at = |i: u32, j: u32| first + j * (nu + 1) + i;
        for j in 0..nv {
            for i in 0..nu {
                self.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                self.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
    }

    fn quad(&mut self, corner: [f64; 3], u: [f64; 3], v: [f64; 3]) {
        let [corner, u, v] = [corner, u, v].map(DVec3::from);
        self.grid(1, 1, |s, t| corner + u * s + v * t);
    }

    /// A box that is `turn` radians around y.
    fn block(&mut self, center: [f64; 3], half: [f64; 3], turn: f64) {
        let place = |p: DVec3| {
            let (s, c) = turn.sin_cos();
            DVec3::from(center) + DVec3::new(c * p.x + s * p.z, p.y, c * p.z - s * p.x)
        };
        let h = DVec3::from(half);
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                self.grid(1, 1, |s, t| {
                    let mut p = DVec3::ZERO;
                    p[axis] = side;
                    p[(axis + 1) % 3] = (2.0 * s - 1.0) * side;
                    p[(axis + 2) % 3] = 2.0 * t - 1.0;
                    place(p * h)
                });
            }
        }
    }

    fn into_scene(self) -> Scene {
        let mut builder = SceneBuilder::new();
        let material = builder.push_material(Material::diffuse("plain", Rgb::splat(0.5)));
        let mesh = MeshInput {
            name: "shape",
            positions: &self.positions,
            normals: &[],
            uvs: &[],
            triangles: &self.triangles,
            material,
        };
        builder.push_mesh(mesh).expect("the mesh is well formed");
        builder.build(BuildPolicy::default()).expect("the mesh has triangles").0
    }
}

/// Five walls and two turned blocks: 34 triangles.
pub fn cornell() -> Scene {
    let mut shape = Shape::default();
    shape.quad([0.0; 3], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]);
    shape.quad([0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    shape.quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    shape.quad([0.0; 3], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    shape.quad([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]);
    shape.block([0.66, 0.15, 0.6], [0.15, 0.15, 0.15], 0.3);
    shape.block([0.34, 0.3, 0.33], [0.15, 0.3, 0.15], -0.3);
    shape.into_scene()
}

/// A hall with two storeys of round columns, arches and drapes, and large plain walls: about 280,000 triangles.
pub fn colonnade() -> Scene {
    use std::f64::consts::TAU;
    let mut shape = Shape::default();
    shape.block([0.0, -0.1, 0.0], [15.0, 0.1, 8.0], 0.0);
    for side in [-1.0, 1.0] {
        shape.quad([-15.0, 0.0, side * 8.0], [30.0, 0.0, 0.0], [0.0, 10.0, 0.0]);
        shape.quad([side * 15.0, 0.0, -8.0], [0.0, 0.0, 16.0], [0.0, 10.0, 0.0]);
        for floor in 0..2 {
            let base = 5.0 * f64::from(floor);
            shape.block([0.0, base + 4.8, side * 6.0], [15.0, 0.2, 2.0], 0.0);
            for column in 0..14 {
                let x = f64::from(column) * 2.2 - 14.3;
                let z = side * 4.2;
                shape.grid(48, 40, |u, v| {
                    let flutes = 0.02 * (16.0 * TAU * u).cos();
                    let r = 0.3 + flutes + 0.15 * (2.0 * v - 1.0).powi(8);
                    DVec3::new(x + r * (TAU * u).cos(), base + 4.6 * v, z + r * (TAU * u).sin())
                });
                if column % 2 == 0 {
                    shape.grid(30, 30, |u, v| {
                        let fold = 0.15 * (5.0 * TAU * u + 2.0 * v).sin();
                        DVec3::new(x + 0.4 + 1.4 * u, base + 1.0 + 3.4 * v, z + fold)
                    });
                }
            }
        }
    }
    shape.into_scene()
}

/// A room with a bumpy sphere of `2·n²` triangles in it.
pub fn bumpy_sphere(n: u32) -> Scene {
    use std::f64::consts::{PI, TAU};
    let mut shape = Shape::default();
    shape.block([0.0; 3], [1.5; 3], 0.0);
    shape.grid(n, n, |u, v| {
        let (theta, phi) = (PI * (1e-3 + 0.998 * v), TAU * u);
        let bumps = (40.0 * phi).sin() * (37.0 * theta).sin() + 0.3 * (170.0 * phi).cos() * (190.0 * theta).sin();
        let r = 1.0 + 0.03 * bumps * theta.sin();
        DVec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin()) * r
    });
    shape.into_scene()
}

/// SplitMix64.
pub struct Random(pub u64);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// `n_receivers · n_rays` cosine-distributed rays from area-weighted random surface points on a random side, in the order of
/// the receivers: what a gather casts.
pub fn gather_rays(scene: &Scene, n_receivers: usize, n_rays: usize) -> Vec<Ray> {
    let mesh = scene.mesh();
    let mut cumulative = Vec::with_capacity(mesh.n_triangles());
    let mut total = 0.0;
    for t in 0..mesh.n_triangles() as u32 {
        total += mesh.area(hplt_geom::TriangleId(t));
        cumulative.push(total);
    }
    let mut random = Random(1);
    let mut rays = Vec::with_capacity(n_receivers * n_rays);
    for _ in 0..n_receivers {
        let target = f64::from(random.unit()) * total;
        let triangle = hplt_geom::TriangleId(cumulative.partition_point(|&c| c < target) as u32);
        let (s, v) = (random.unit().sqrt(), random.unit());
        let position = mesh.position_at(triangle, s * (1.0 - v), s * v);
        let side = if random.unit() < 0.5 { 1.0 } else { -1.0 };
        let normal = mesh.face_normal(triangle) * side;
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let origin = offset_origin(position, normal);
        for _ in 0..n_rays {
            let (r2, phi) = (random.unit(), random.unit() * std::f32::consts::TAU);
            let r = r2.sqrt();
            let local = Vec3::new(r * phi.cos(), r * phi.sin(), (1.0 - r2).max(1e-6).sqrt());
            rays.push(Ray::new(origin, tangent * local.x + bitangent * local.y + normal * local.z));
        }
    }
    rays
}
