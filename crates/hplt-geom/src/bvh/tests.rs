use std::ops::ControlFlow;

use glam::{DVec3, Vec2, Vec3};

use super::binary::BinaryKind;
use super::test_scenes::{Random, Soup, masked_quad, nested, raw_mesh, scene, soup, sphere};
use super::triangle::Packet;
use super::{Bvh, BvhOptions, Cutouts, Query, build, build_tree, dispatch, top_down, wide};
use crate::{Hit, Mesh, Ray, RayCaster, Shaft, TriangleId, offset_origin};

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

/// Whatever a segment of a shaft meets is among what the shaft visits, and of a small one in a large soup that is a small part.
#[test]
fn shafts_visit_every_triangle_that_blocks_one_of_their_segments() {
    let mut random = Random::new(7);
    for (n, size, few) in [(1, 0.8, 1.0), (300, 0.3, 1.0), (3000, 0.1, 0.2)] {
        let scene = scene(&soup(n, size, false, &mut random));
        let (bvh, report) = Bvh::build(&scene, BvhOptions::default());
        let (mut n_met, mut n_visited) = (0, 0);
        for _ in 0..100 {
            let apex = random.in_cube();
            let corner = random.in_cube();
            let polygon = [corner, corner + 0.2 * random.direction(), corner + 0.2 * random.direction()];
            let mut visited = Vec::new();
            let shaft = Shaft::new(apex, &polygon);
            let is_able = bvh.visit_blockers(&shaft, &mut |blocker| {
                visited.push(sorted(blocker.corners));
                ControlFlow::Continue(())
            });
            assert!(is_able);
            n_visited += visited.len();
            for _ in 0..50 {
                let (u, v) = (random.unit(), random.unit());
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let target = polygon[0] * (1.0 - u - v) + polygon[1] * u + polygon[2] * v;
                for (_, id) in brute_force(scene.mesh(), &Ray::segment(apex, target)) {
                    n_met += 1;
                    assert!(visited.contains(&sorted(scene.mesh().corners(id))), "{id:?}");
                }
            }
        }
        assert!(n_met > 0 && n_visited as f64 <= few * 100.0 * report.n_boxes as f64, "{n_met} {n_visited}");
    }
}

#[test]
fn a_visit_ends_where_the_visitor_says_so_and_cuts_leave_out_what_is_behind() {
    let mut random = Random::new(8);
    let scene = scene(&soup(300, 0.3, false, &mut random));
    let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
    let mut shaft = Shaft::new(Vec3::splat(-1.0), &[Vec3::X, Vec3::Y, Vec3::Z].map(|p| p * 2.0));
    let count = |shaft: &Shaft, limit: usize| {
        let mut n = 0;
        bvh.visit_blockers(shaft, &mut |_| {
            n += 1;
            if n == limit { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        n
    };
    let all = count(&shaft, usize::MAX);
    assert!(all > 10 && count(&shaft, 3) == 3);
    shaft.cut(Vec3::ZERO, Vec3::ONE.normalize());
    let half = count(&shaft, usize::MAX);
    assert!(0 < half && half < all, "{half} of {all}");
}

fn sorted(corners: [Vec3; 3]) -> [[u32; 3]; 3] {
    let mut corners = corners.map(|c| c.to_array().map(f32::to_bits));
    corners.sort_unstable();
    corners
}

/// How many rays leave a closed sphere from inside: in random directions, at vertices and at edge midpoints. They are traced in
/// batches.
fn leaks(soup: Soup, center: DVec3, radius: f64, n_rays: usize, seed: u64) -> [usize; 3] {
    const BATCH: usize = 256;
    let mesh = raw_mesh(soup);
    let bvh = raw_bvh(&mesh);
    let mut random = Random::new(seed);
    let mut leaks = [0; 3];
    let mut hits = [Hit::MISS; BATCH];
    for kind in 0..leaks.len() {
        for first in (0..n_rays).step_by(BATCH) {
            let rays: Vec<Ray> = (first..n_rays.min(first + BATCH))
                .map(|_| {
                    let offset = random.direction().as_dvec3() * (0.5 * radius * f64::from(random.unit()));
                    let origin = (center + offset).as_vec3();
                    let [a, b, _] = mesh.corners(TriangleId(random.below(mesh.n_triangles()) as u32));
                    let direction = [random.direction(), a - origin, a * 0.5 + b * 0.5 - origin][kind];
                    Ray::new(origin, direction)
                })
                .collect();
            bvh.trace_nearest(&rays, &mut hits[..rays.len()]);
            leaks[kind] += hits[..rays.len()].iter().filter(|hit| hit.is_miss()).count();
        }
    }
    leaks
}

/// The five placements of a closed sphere.
const PLACEMENTS: [([f64; 3], f64); 5] =
    [([0.0; 3], 2.0), ([148_376.0, 1_234.0, -223_423.0], 2.0), ([1e6; 3], 2.0), ([0.0; 3], 1e-6), ([0.0; 3], 1e8)];

fn leaks_of_all_placements(n_rays: usize) -> [[usize; 3]; 5] {
    let mut placement = 0;
    PLACEMENTS.map(|(center, radius)| {
        let center = DVec3::from(center);
        let soup = sphere(100, 100, radius, center);
        assert_eq!(soup.1.len(), 19_800);
        placement += 1;
        leaks(soup, center, radius, n_rays, placement)
    })
}

#[test]
fn no_ray_leaves_a_closed_sphere() {
    assert_eq!(leaks_of_all_placements(20_000), [[0; 3]; 5]);
}

#[test]
#[ignore = "a minute: ten million rays"]
fn no_ray_of_ten_million_leaves_a_closed_sphere() {
    assert_eq!(leaks_of_all_placements(700_000), [[0; 3]; 5]);
}

#[test]
fn no_ray_leaves_a_box_whose_walls_are_split() {
    for (center, radius) in [([0.0; 3], 2.0), ([300.0, -20.0, 80.0], 2.0), ([0.0; 3], 1e-6), ([0.0; 3], 1e8)] {
        let center = DVec3::from(center);
        // A thin octahedron along the diagonal, with a finely tessellated sphere in it: its walls are large for this scene.
        let (mut vertices, mut triangles) = sphere(2, 4, 1.0, DVec3::ZERO);
        for p in &mut vertices {
            *p = (center + (p.as_dvec3() * 0.1 + f64::from(p.y)) * radius).as_vec3();
        }
        let (fine_vertices, fine_triangles) = sphere(60, 60, radius * 0.01, center);
        let first = vertices.len() as u32;
        vertices.extend(fine_vertices);
        triangles.extend(fine_triangles.iter().map(|t| t.map(|v| v + first)));
        let mesh = raw_mesh((vertices, triangles));
        let (tree, report) = build_tree(&mesh, &Cutouts::default(), BvhOptions::production());
        assert!((8 + 8..1000).contains(&(report.n_boxes - report.n_triangles)), "{report:?}");
        let bvh = Bvh { tree, cutouts: Cutouts::default() };
        let mut random = Random::new(21);
        for i in 0..30_000 {
            let outward = random.direction();
            let origin = (center + outward.as_dvec3() * (0.02 * radius)).as_vec3();
            let [a, b, _] = mesh.corners(TriangleId(random.below(8) as u32));
            let along = random.unit();
            let target = [outward + origin, a, a * along + b * (1.0 - along)][i % 3];
            assert!(!bvh.nearest(Ray::new(origin, target - origin)).is_miss(), "{center} {origin} {target}");
        }
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

#[test]
fn rays_along_axes_hit_vertices_edges_and_faces_of_a_box() {
    // A closed box as a 1×1×1 grid of coordinates, so that rays run in face planes and along edges.
    let mesh = raw_mesh(sphere(2, 4, 1.0, DVec3::ZERO));
    let bvh = raw_bvh(&mesh);
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            for zero in [0.0, -0.0] {
                let mut direction = Vec3::splat(zero);
                direction[axis] = sign;
                for origin in [Vec3::ZERO, Vec3::splat(0.125), Vec3::new(0.25, -0.0, 0.0), Vec3::new(0.0, 0.5, 0.25)] {
                    assert!(!bvh.nearest(Ray::new(origin, direction)).is_miss(), "{origin} {direction}");
                }
                // In the plane of a face pair's shared edges, from outside.
                let hit = bvh.nearest(Ray::new(-4.0 * direction, direction));
                assert!(
                    (hit.t - 3.0).abs() < 1e-6
                        && hit.is_front == bvh.nearest(Ray::new(-4.0 * direction, direction)).is_front
                );
            }
        }
    }
}

#[test]
fn a_ray_in_the_plane_of_a_sheet_misses_it_and_one_beside_it_is_not_lost() {
    let soup = (vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::new(1.0, 1.0, 0.0)], vec![[0, 1, 2], [2, 1, 3]]);
    let bvh = raw_bvh(&raw_mesh(soup));
    assert!(bvh.nearest(Ray::new(Vec3::new(-1.0, 0.5, 0.0), Vec3::X)).is_miss());
    // On the diagonal that the two triangles share, the lower id wins.
    let hit = bvh.nearest(Ray::new(Vec3::new(0.5, 0.5, 1.0), Vec3::NEG_Z));
    assert_eq!((hit.t, hit.triangle), (1.0, TriangleId(0)));
    let grazing = Vec3::new(1.0, 0.0, -1e-30);
    assert_eq!(bvh.nearest(Ray::new(Vec3::new(-1.0, 0.5, 1e-30), grazing)).t, 1.0);
}

#[test]
fn the_length_of_the_direction_scales_distances_exactly() {
    let scene = scene(&sphere(20, 20, 1.0, DVec3::ZERO));
    let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
    let direction = Vec3::new(0.3, -0.7, 0.2);
    let unit = bvh.nearest(Ray::new(Vec3::ZERO, direction));
    for exponent in [-120, -60, -10, 10, 60, 120] {
        let scale = 2f32.powi(exponent);
        let ray = Ray::new(Vec3::ZERO, direction * scale);
        let hit = bvh.nearest(ray);
        assert_eq!(hit, Hit { t: unit.t / scale, ..unit });
        assert!(!bvh.is_occluded(Ray { t_max: hit.t, ..ray }), "the range is half-open");
        assert!(bvh.is_occluded(Ray { t_max: hit.t.next_up(), ..ray }));
    }
    assert!(!bvh.nearest(Ray::new(Vec3::ZERO, Vec3::splat(f32::from_bits(1)))).is_miss());
}

#[test]
fn among_equal_distances_the_front_wins_then_the_lowest_id() {
    let corners = [Vec3::new(0.1, 0.2, 0.3), Vec3::new(1.3, 0.1, 0.7), Vec3::new(0.4, 1.7, 0.2)];
    let mut random = Random::new(3);
    // Every order of the corners: half of them face up, half down. Far triangles force several leaves.
    let orders = [[0, 2, 1], [0, 1, 2], [1, 2, 0], [2, 1, 0], [1, 0, 2], [2, 0, 1]];
    for first in 0..orders.len() {
        let mut triangles: Vec<[u32; 3]> = (0..orders.len()).map(|i| orders[(i + first) % orders.len()]).collect();
        let mut vertices = corners.to_vec();
        for i in 0..40 {
            let base = Vec3::new(5.0 + i as f32, 0.0, 0.0);
            triangles.push([0, 1, 2].map(|k| k + vertices.len() as u32));
            vertices.extend([base, base + Vec3::X, base + Vec3::Y]);
        }
        let mesh = raw_mesh((vertices, triangles));
        let bvh = raw_bvh(&mesh);
        for _ in 0..200 {
            let (a, b) = (random.unit() * 0.5, random.unit() * 0.5);
            let target = corners[0] * (1.0 - a - b) + corners[1] * a + corners[2] * b;
            let direction = random.direction();
            let ray = Ray::new(target - direction, direction);
            let hit = bvh.nearest(ray);
            let is_front = |t: u32| mesh.face_normal(TriangleId(t)).dot(direction) < 0.0;
            let expected = (0..6).find(|&t| is_front(t)).unwrap();
            assert_eq!((hit.triangle, hit.is_front), (TriangleId(expected), true));
            let found = mesh.position_at(hit.triangle, hit.u, hit.v);
            assert!((found - target).length() < 1e-3, "{found} {target}");
        }
    }
}

#[test]
fn results_do_not_depend_on_the_batch_or_on_the_instruction_set() {
    let mut random = Random::new(5);
    let scene = scene(&soup(5_000, 0.2, true, &mut random));
    let (bvh, report) = Bvh::build(&scene, BvhOptions::default());
    assert_eq!(Bvh::build(&scene, BvhOptions::default()).1, report);
    let rays: Vec<Ray> = (0..4_000)
        .map(|i| {
            let direction = if i % 4 == 0 { Vec3::AXES[i / 4 % 3] } else { random.direction() };
            let origin = (random.in_cube() * 16.0).round() / 16.0;
            Ray { t_max: if i % 3 == 0 { random.unit() } else { f32::INFINITY }, ..Ray::new(origin * 0.4, direction) }
        })
        .collect();
    let mut whole = vec![Hit::MISS; rays.len()];
    bvh.trace_nearest(&rays, &mut whole);
    assert!(whole.iter().filter(|hit| !hit.is_miss()).count() > rays.len() / 4);
    for size in [1, 7, 64] {
        let mut parts = vec![Hit::MISS; rays.len()];
        for (rays, hits) in rays.chunks(size).zip(parts.chunks_mut(size)) {
            bvh.trace_nearest(rays, hits);
        }
        assert_eq!(parts, whole);
    }
    let mut portable = vec![Hit::MISS; rays.len()];
    dispatch::run_portable(bvh.target(), Query::Nearest(&rays, &mut portable));
    let bits = |hits: &[Hit]| hits.iter().map(|h| [h.t, h.u, h.v].map(f32::to_bits)).collect::<Vec<_>>();
    assert!(portable == whole && bits(&portable) == bits(&whole));
    let (mut occluded, mut occluded_portable) = (vec![false; rays.len()], vec![false; rays.len()]);
    bvh.trace_occluded(&rays, &mut occluded);
    dispatch::run_portable(bvh.target(), Query::Occluded(&rays, &mut occluded_portable));
    assert_eq!(occluded, occluded_portable);
    assert!(occluded.iter().zip(&whole).all(|(&occluded, hit)| occluded != hit.is_miss()));
}

#[test]
fn a_scene_of_several_groups_has_all_its_triangles_and_the_same_hits_as_a_top_down_tree() {
    // More than one group of boxes for PLOC; 160,000 triangles.
    let mesh = raw_mesh(sphere(283, 283, 1.0, DVec3::ZERO));
    let primitives = build::primitives(&mesh, true, |_| true);
    let (grouped, is_top_down) = build::binary_tree(&primitives, BvhOptions::fast());
    assert!(primitives.len() > build::GROUP && !is_top_down);
    let mut found = vec![0u32; mesh.n_triangles()];
    for (i, node) in grouped.nodes.iter().enumerate() {
        match node.kind {
            BinaryKind::Leaf(triangle) => found[triangle as usize] += 1,
            BinaryKind::Inner(first) => {
                let children = [0, 1].map(|side| grouped.nodes[first as usize + side].bounds);
                assert!(first as usize > i && children[0].union(children[1]) == node.bounds);
            }
        }
    }
    assert!(found.iter().all(|&n| n >= 1) && found.iter().sum::<u32>() as usize == primitives.len());

    let bvh = raw_bvh(&mesh);
    let (tree, _) = wide::collapse(&top_down::build(&primitives, 60), &mesh, |_| false);
    let other = Bvh { tree, cutouts: Cutouts::default() };
    let mut random = Random::new(17);
    let origin = random.in_cube() * 0.5;
    let rays: Vec<Ray> = (0..5_000).map(|_| Ray::new(origin, random.direction())).collect();
    let (mut batch, mut alone) = (vec![Hit::MISS; rays.len()], vec![Hit::MISS; rays.len()]);
    bvh.trace_nearest(&rays, &mut batch);
    rays.iter().zip(&mut alone).for_each(|(ray, hit)| *hit = other.nearest(*ray));
    assert_eq!(batch, alone);
}

#[cfg(feature = "rayon")]
#[test]
fn the_tree_is_the_same_at_any_thread_count() {
    let mesh = raw_mesh(sphere(283, 283, 1.0, DVec3::ZERO));
    let build_by = |n_threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| build_tree(&mesh, &Cutouts::default(), BvhOptions::fast()))
    };
    let (serial, serial_report) = build_by(1);
    for n_threads in [2, 3] {
        let (tree, report) = build_by(n_threads);
        assert_eq!(report, serial_report);
        assert!(tree.nodes.iter().zip(&serial.nodes).all(|(a, b)| (a.planes, a.children) == (b.planes, b.children)));
        let ids = |packet: &Packet| std::array::from_fn::<_, { Packet::LANES }, _>(|lane| packet.id(lane));
        assert!(tree.packets.iter().map(ids).eq(serial.packets.iter().map(ids)));
    }
}

/// How many of `n` rays that leave a hit meet its triangle again.
fn self_hits(mesh: &Mesh, n: usize) -> usize {
    let bvh = raw_bvh(mesh);
    let mut random = Random::new(11);
    let mut again = 0;
    for _ in 0..n {
        let triangle = TriangleId(random.below(mesh.n_triangles()) as u32);
        let (s, v) = (random.unit().sqrt(), random.unit());
        let side = if random.unit() < 0.5 { 1.0 } else { -1.0 };
        let normal = mesh.face_normal(triangle) * side;
        let origin = offset_origin(mesh.position_at(triangle, s * (1.0 - v), s * v), normal);
        let direction = random.direction();
        let direction = if direction.dot(normal) < 0.0 { -direction } else { direction };
        again += usize::from(bvh.nearest(Ray::new(origin, direction)).triangle == triangle);
    }
    again
}

#[test]
fn a_ray_that_leaves_a_triangle_does_not_meet_it_again() {
    check_self_hits(50_000);
}

#[test]
#[ignore = "five million rays"]
fn a_ray_of_a_million_that_leaves_a_triangle_does_not_meet_it_again() {
    check_self_hits(1_000_000);
}

fn check_self_hits(n: usize) {
    let room = sphere(2, 4, 0.5, DVec3::ZERO);
    assert_eq!(self_hits(&raw_mesh(room), n), 0);
    assert_eq!(self_hits(&raw_mesh(sphere(60, 60, 0.5, DVec3::ZERO)), n), 0);
    for scale in [1e-1, 1e8] {
        let mut random = Random::new(12);
        let (mut vertices, triangles) = soup(500, 1.0, false, &mut random);
        vertices.iter_mut().for_each(|p| *p *= scale);
        assert_eq!(self_hits(&raw_mesh((vertices, triangles)), n), 0, "scale {scale}");
    }
}

#[test]
fn an_alpha_mask_lets_through_exactly_the_texels_that_it_cuts() {
    const N: u32 = 8;
    let is_cut = |column: u32, row: u32| (column * 5 + row * 3).is_multiple_of(4);
    let scene = masked_quad(N, is_cut);
    let (bvh, report) = Bvh::build(&scene, BvhOptions::default());
    assert_eq!((report.n_masked, report.n_triangles, report.n_invisible), (2, 4, 2));
    for row in 0..N {
        for column in 0..N {
            let uv = (Vec2::new(column as f32, row as f32) + 0.5) / N as f32;
            // The masked quad is at z = 0, a plain one behind it at z = -0.25, an invisible one in front.
            let ray = Ray::new(Vec3::new(uv.x - 0.5, uv.y - 0.5, 0.5), Vec3::NEG_Z);
            let hit = bvh.nearest(ray);
            let expected = if is_cut(column, row) { 0.75 } else { 0.5 };
            assert!((hit.t - expected).abs() < 1e-6, "{column} {row}: {hit:?}");
            assert_eq!(bvh.is_occluded(Ray { t_max: 0.6, ..ray }), !is_cut(column, row));
        }
    }
}

#[test]
fn many_triangles_in_one_place_give_a_shallow_tree() {
    for same_size in [true, false] {
        let mesh = raw_mesh(nested(20_000, same_size));
        let (tree, report) = build_tree(&mesh, &Cutouts::default(), BvhOptions::production());
        assert!(report.is_top_down);
        assert!(report.binary_depth <= build::depth_limit(20_000), "{report:?}");
        assert_eq!(report.n_triangles, 20_000);
        let bvh = Bvh { tree, cutouts: Cutouts::default() };
        let hit = bvh.nearest(Ray::new(Vec3::new(0.01, 0.01, 1.0), Vec3::NEG_Z));
        assert_eq!((hit.t, hit.triangle), (1.0, TriangleId(0)));
    }
}

#[test]
fn median_splits_bound_the_depth_where_bins_do_not() {
    // Each triangle is half as far from the corner as the one before: bins cut off one or two at a time.
    let vertices = (0..120).flat_map(|i| {
        let base = Vec3::splat(2f32.powi(-i));
        [base, base + base * Vec3::X * 0.1, base + base * Vec3::Y * 0.1]
    });
    let mesh = raw_mesh((vertices.collect(), (0..120).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect()));
    let primitives = build::primitives(&mesh, false, |_| true);
    let binned = top_down::build(&primitives, usize::MAX);
    let bounded = top_down::build(&primitives, 5);
    assert!(binned.depth() > 20, "{}", binned.depth());
    assert!(bounded.depth() <= 5 + 7 + 1, "{}", bounded.depth());
}

#[test]
fn the_fast_preset_finds_the_same_hits() {
    let mut random = Random::new(8);
    let scene = scene(&soup(2_000, 0.2, false, &mut random));
    let (fast, _) = Bvh::build(&scene, BvhOptions::fast());
    let (production, report) = Bvh::build(&scene, BvhOptions::production());
    assert!(!report.is_top_down && report.memory > 0 && report.expected_cost > 1.0);
    for _ in 0..2_000 {
        let ray = Ray::new(random.in_cube(), random.direction());
        assert_eq!(fast.nearest(ray), production.nearest(ray));
    }
}
