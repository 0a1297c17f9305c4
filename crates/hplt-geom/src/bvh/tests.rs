use glam::{DVec3, Vec3};

use super::test_scenes::{Random, Soup, raw_mesh, scene, soup, sphere};
use super::*;
use crate::TriangleId;

/// A hierarchy over a mesh that is not mapped into scene space.
fn raw_bvh(mesh: &Mesh) -> Bvh {
    let cutouts = Cutouts::default();
    let (tree, _) = build_tree(mesh, &cutouts, BvhOptions::production());
    Bvh { tree, cutouts }
}

/// Möller-Trumbore in `f64`: the distances of all hits and their triangles.
fn brute_force(mesh: &Mesh, ray: &Ray) -> Vec<(f64, TriangleId)> {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let mut hits = Vec::new();
    for id in (0..mesh.n_triangles() as u32).map(TriangleId) {
        let [a, b, c] = mesh.corners(id).map(|p| p.as_dvec3());
        let (e1, e2) = (b - a, c - a);
        let p = d.cross(e2);
        let det = e1.dot(p);
        let s = o - a;
        let (u, v) = (s.dot(p) / det, d.dot(s.cross(e1)) / det);
        let t = e2.dot(s.cross(e1)) / det;
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= 0.0 && t < f64::from(ray.t_max) {
            hits.push((t, id));
        }
    }
    hits.sort_by(|a, b| a.0.total_cmp(&b.0));
    hits
}

#[test]
fn nearest_and_any_hit_agree_with_brute_force_on_soups() {
    let mut random = Random::new(1);
    for (n, size, flat) in [(1, 0.8, false), (2, 0.8, false), (40, 0.5, true), (300, 0.3, false), (3000, 0.1, false)] {
        let scene = scene(&soup(n, size, flat, &mut random));
        let (bvh, report) = Bvh::build(&scene, BvhOptions::default());
        assert_eq!(report.n_triangles, scene.mesh().n_triangles());
        let mut n_hits = 0;
        for _ in 0..600 {
            let target = random.in_cube() * 0.4;
            let origin = random.in_cube();
            let mut ray = Ray::new(origin, target - origin);
            if random.unit() < 0.5 {
                ray.t_max = random.unit() * 1.5;
            }
            let expected = brute_force(scene.mesh(), &ray);
            let found = bvh.nearest(ray);
            assert_eq!(found.is_miss(), expected.is_empty(), "{ray:?} {found:?} {expected:?}");
            assert_eq!(bvh.is_occluded(ray), !expected.is_empty());
            if let Some(&(t, _)) = expected.first() {
                n_hits += 1;
                assert!((f64::from(found.t) - t).abs() <= 1e-5 * (1.0 + t), "{found:?} {expected:?}");
                let nearby = expected.iter().take_while(|(other, _)| *other <= t + 1e-5);
                assert!(nearby.into_iter().any(|(_, id)| *id == found.triangle));
                let normal = scene.mesh().face_normal(found.triangle);
                assert_eq!(found.is_front, normal.dot(ray.direction) < 0.0);
                let p = scene.mesh().position_at(found.triangle, found.u, found.v);
                assert!((p - (ray.origin + ray.direction * found.t)).length() < 1e-5);
            }
        }
        assert!(n_hits > 5, "{n} triangles: only {n_hits} rays hit");
    }
}

/// The five placements of a closed sphere, and rays from inside in random directions, at vertices and at edge midpoints.
fn leaks(soup: Soup, center: DVec3, radius: f64, n_rays: usize, seed: u64) -> [usize; 3] {
    let mesh = raw_mesh(soup);
    let bvh = raw_bvh(&mesh);
    let mut random = Random::new(seed);
    let mut leaks = [0; 3];
    for _ in 0..n_rays {
        let origin = (center + random.direction().as_dvec3() * (0.5 * radius * f64::from(random.unit()))).as_vec3();
        let triangle = TriangleId(random.below(mesh.n_triangles()) as u32);
        let [a, b, _] = mesh.corners(triangle);
        let targets = [None, Some(a), Some(a * 0.5 + b * 0.5)];
        for (leaked, target) in leaks.iter_mut().zip(targets) {
            let direction = target.map_or_else(|| random.direction(), |target| target - origin);
            *leaked += usize::from(bvh.nearest(Ray::new(origin, direction)).is_miss());
        }
    }
    leaks
}

const PLACEMENTS: [([f64; 3], f64); 5] =
    [([0.0; 3], 2.0), ([148_376.0, 1_234.0, -223_423.0], 2.0), ([1e6; 3], 2.0), ([0.0; 3], 1e-6), ([0.0; 3], 1e8)];

#[test]
fn no_ray_leaves_a_closed_sphere() {
    for (i, (center, radius)) in PLACEMENTS.into_iter().enumerate() {
        let center = DVec3::from(center);
        let soup = sphere(100, 100, radius, center);
        assert_eq!(soup.1.len(), 19_800);
        assert_eq!(leaks(soup, center, radius, 20_000, i as u64), [0; 3], "placement {i}");
    }
}

#[test]
fn a_sphere_with_a_hole_leaks() {
    let mut soup = sphere(100, 100, 2.0, DVec3::ZERO);
    soup.1.truncate(19_700);
    let [random, vertex, _] = leaks(soup, DVec3::ZERO, 2.0, 20_000, 7);
    assert!(random > 0 && vertex == 0);
}

#[test]
fn rays_without_a_direction_or_with_numbers_that_are_not_finite_miss() {
    let scene = scene(&sphere(10, 10, 1.0, DVec3::ZERO));
    let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for axis in 0..3 {
            let mut broken = Vec3::new(0.1, 0.2, 0.3);
            broken[axis] = bad;
            for ray in [Ray::new(broken, Vec3::X), Ray::new(Vec3::ZERO, broken)] {
                assert!(bvh.nearest(ray) == Hit::MISS && !bvh.is_occluded(ray));
            }
        }
    }
    assert!(bvh.nearest(Ray::new(Vec3::ZERO, Vec3::ZERO)).is_miss());
    assert!(bvh.nearest(Ray { t_max: f32::NAN, ..Ray::new(Vec3::ZERO, Vec3::X) }).is_miss());
    assert!(!bvh.nearest(Ray::new(Vec3::ZERO, Vec3::X)).is_miss());
}
