//! A room that is open towards the camera, with a block in it, and points on all its walls.
#![allow(dead_code)] // every test binary uses a part

use glam::{DVec3, Vec3};
use hplt_basis::{Absolute, BasisOptions, Coefficients, Delta, ExactShepard, Reconstruction, ShepardBasis};
use hplt_geom::{
    BuildPolicy, Bvh, BvhOptions, Camera, Environment, Material, MeshInput, NoProgress, OrientedPoint, PointHierarchy,
    PointLevel, RegionId, Rgb, Scene, SceneBuilder,
};
use hplt_splat::{GBuffer, GBufferOptions};

/// A rectangle: a corner and two edges, its front towards `edge_u × edge_v`.
#[derive(Clone, Copy)]
pub struct Rectangle {
    pub corner: DVec3,
    pub edge_u: DVec3,
    pub edge_v: DVec3,
}

impl Rectangle {
    pub fn new(corner: [f64; 3], edge_u: [f64; 3], edge_v: [f64; 3]) -> Self {
        Self { corner: corner.into(), edge_u: edge_u.into(), edge_v: edge_v.into() }
    }

    pub fn push(&self, builder: &mut SceneBuilder, material: Material) {
        let (c, u, v) = (self.corner, self.edge_u, self.edge_v);
        let material = builder.push_material(material);
        let input = MeshInput {
            name: "rectangle",
            positions: &[c, c + u, c + u + v, c + v],
            normals: &[],
            uvs: &[],
            triangles: &[[0, 1, 2], [0, 2, 3]],
            material,
        };
        builder.push_mesh(input).unwrap();
    }
}

/// Floor, ceiling, left, right and back wall of the unit cube around the origin, seen from inside.
pub fn walls() -> Vec<Rectangle> {
    let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    let corner = [-0.5; 3];
    vec![
        Rectangle::new(corner, z, x),
        Rectangle::new([-0.5, 0.5, -0.5], x, z),
        Rectangle::new(corner, y, z),
        Rectangle::new([0.5, -0.5, -0.5], z, y),
        Rectangle::new(corner, x, y),
    ]
}

/// Top, front, left and right side of a block on the floor.
pub fn block() -> Vec<Rectangle> {
    vec![
        Rectangle::new([0.0, -0.1, -0.2], [0.0, 0.0, 0.3], [0.3, 0.0, 0.0]),
        Rectangle::new([0.0, -0.5, 0.1], [0.3, 0.0, 0.0], [0.0, 0.4, 0.0]),
        Rectangle::new([0.0, -0.5, -0.2], [0.0, 0.0, 0.3], [0.0, 0.4, 0.0]),
        Rectangle::new([0.3, -0.5, -0.2], [0.0, 0.4, 0.0], [0.0, 0.0, 0.3]),
    ]
}

pub fn room() -> Vec<Rectangle> {
    [walls(), block()].concat()
}

pub fn scene_of(rectangles: &[Rectangle]) -> Scene {
    let mut builder = SceneBuilder::new();
    for rectangle in rectangles {
        rectangle.push(&mut builder, Material::diffuse("wall", Rgb::splat(0.5)));
    }
    builder.set_environment(Environment::constant(Rgb::new(0.25, 0.5, 0.75)).unwrap());
    builder.build(BuildPolicy::default()).unwrap().0
}

pub fn camera() -> Camera {
    Camera::look_at(DVec3::new(0.1, 0.05, 1.6), DVec3::ZERO, DVec3::Y, 0.8).unwrap()
}

pub fn gbuffer_of(scene: &Scene, camera: &Camera, options: GBufferOptions) -> GBuffer {
    let bvh = Bvh::build(scene, BvhOptions::fast()).0;
    GBuffer::trace(scene, &bvh, camera, options, &NoProgress).unwrap()
}

pub fn room_gbuffer(width: u32, height: u32) -> GBuffer {
    gbuffer_of(&scene_of(&room()), &camera(), GBufferOptions::preview(width, height))
}

/// A small deterministic generator for test positions.
pub struct Noise(pub u64);

impl Noise {
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// Jittered grids on rectangles (in scene space), `n`, `2n`, `4n` … cells per unit of length, `r` a cell wide.
pub fn hierarchy(rectangles: &[Rectangle], n: usize, n_levels: usize) -> PointHierarchy {
    let mut noise = Noise(7);
    let level = |l: usize| {
        let size = 1.0 / (n << l) as f32;
        let mut points = Vec::new();
        for rectangle in rectangles {
            let [c, u, v] = [rectangle.corner, rectangle.edge_u, rectangle.edge_v].map(|x| x.as_vec3());
            let normal = u.cross(v).normalize();
            let [columns, rows] = [u, v].map(|e| (e.length() / size).ceil() as usize);
            let area = u.length() * v.length() / (columns * rows) as f32;
            for i in 0..columns * rows {
                let s = ((i % columns) as f32 + 0.3 + 0.4 * noise.next()) / columns as f32;
                let t = ((i / columns) as f32 + 0.3 + 0.4 * noise.next()) / rows as f32;
                points.push(OrientedPoint::new(c + u * s + v * t, normal, RegionId(0)).with_area(area));
            }
        }
        PointLevel::new(size, points)
    };
    PointHierarchy { levels: (0..n_levels).map(level).collect(), n_regions: 1 }
}

pub fn room_basis(n: usize, n_levels: usize) -> ShepardBasis {
    ShepardBasis::build(hierarchy(&room(), n, n_levels), BasisOptions::default())
}

/// Smooth everywhere, different on walls of different orientation, between 0.4 and 3.
pub fn smooth(p: &OrientedPoint) -> Rgb {
    let OrientedPoint { position: x, normal: n, .. } = *p;
    Rgb::new(1.5 + 0.5 * x.x + 0.3 * n.x, 1.2 + x.y * x.z + 0.2 * n.y, 1.0 + x.z * x.z + 0.5 * x.x * x.y)
}

/// [`smooth`] with a spot of radius 0.1 in the middle of the back wall.
pub fn spotted(p: &OrientedPoint) -> Rgb {
    let distance = (p.position - Vec3::new(-0.2, 0.15, -0.5)).length() / 0.1;
    smooth(p) + Rgb::splat(2.0 / (1.0 + distance * distance).powi(3))
}

pub fn absolute(basis: &ShepardBasis, field: impl Fn(&OrientedPoint) -> Rgb) -> Coefficients<Absolute> {
    Coefficients::from_levels((0..basis.n_levels()).map(|l| basis.points(l).iter().map(&field).collect()).collect())
}

/// A field in delta encoding as a transport makes it: finer functions have details only below coarser ones whose detail
/// exceeds `threshold`, all others are zero.
pub fn adaptive_delta(
    basis: &ShepardBasis,
    field: impl Fn(&OrientedPoint) -> Rgb,
    threshold: f32,
) -> Coefficients<Delta> {
    let mut delta = Coefficients::<Delta>::zeros(basis);
    let mut active = vec![true; basis.n_functions(0)];
    for level in 0..basis.n_levels() {
        let points = basis.points(level);
        let mut inherited = vec![Rgb::ZERO; points.len()];
        if level > 0 {
            ExactShepard.reconstruct(basis, &delta, level, points, &mut inherited);
        }
        let mut next = vec![false; if level + 1 < basis.n_levels() { basis.n_functions(level + 1) } else { 0 }];
        for i in (0..points.len()).filter(|&i| active[i]) {
            let detail = field(&points[i]) - inherited[i];
            delta.level_mut(level)[i] = detail;
            if detail.abs().max_element() > threshold && !next.is_empty() {
                basis.parents(level + 1).children(i as u32).iter().for_each(|&child| next[child as usize] = true);
            }
        }
        active = next;
    }
    delta
}

/// The largest difference in any channel.
pub fn max_difference(a: &[Rgb], b: &[Rgb]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max)
}

pub fn max_value(a: &[Rgb]) -> f32 {
    a.iter().map(|a| a.abs().max_element()).fold(0.0, f32::max)
}

/// The root mean square difference over the samples that meet a surface.
pub fn rms_difference(gbuffer: &GBuffer, a: &[Rgb], b: &[Rgb]) -> f64 {
    let samples = (0..gbuffer.n_samples()).filter(|&i| !gbuffer.is_background(i));
    let sum: f64 = samples.map(|i| f64::from((a[i] - b[i]).length_squared()) / 3.0).sum();
    (sum / gbuffer.n_surface_samples() as f64).sqrt()
}
