//! What is one region, what is dark, and what is neither lost nor invented.
mod common;

use common::{Shapes, cornell, one_sided, two_rooms};
use glam::{DVec3, Vec2, Vec3};
use hplt_geom::{
    Bvh, Environment, Material, NoProgress, OrientedPoint, Ray, RayCaster, RegionId, Scene, offset_origin,
};
use hplt_sampling::random::{Stage, Stream, unit_f32};
use hplt_sampling::sobol::sobol_2d;
use hplt_sampling::warp::{cosine_hemisphere, uniform_triangle};
use hplt_sampling::{Regions, random_surface_points};

fn regions(scene: &Scene, bvh: &Bvh) -> Regions {
    Regions::build(scene, bvh, 1, &NoProgress).unwrap()
}

/// Uniform points on both sides of all triangles: position, normal.
fn surface_points(scene: &Scene, n: usize) -> Vec<(Vec3, Vec3)> {
    let mesh = scene.mesh();
    let areas: Vec<f64> = (0..mesh.n_triangles()).map(|t| mesh.area(hplt_geom::TriangleId(t as u32))).collect();
    let total: f64 = areas.iter().sum();
    let stream = Stream::new(99, Stage::Reference);
    (0..n)
        .map(|i| {
            let words = stream.words(i as u32, 0, 0);
            let mut rest = total * f64::from(unit_f32(words[0]));
            let chosen = areas.iter().position(|&area| {
                rest -= area;
                rest < 0.0
            });
            let triangle = hplt_geom::TriangleId(chosen.unwrap_or(areas.len() - 1) as u32);
            let weights = uniform_triangle(Vec2::new(unit_f32(words[1]), unit_f32(words[2])));
            let side = if words[3] & 1 == 0 { 1.0 } else { -1.0 };
            (mesh.position_at(triangle, weights.x, weights.y), mesh.face_normal(triangle) * side)
        })
        .collect()
}

/// The share of points called dark although one of 128 rays meets a surface that is called lit.
fn lost_share(scene: &Scene, bvh: &Bvh, n: usize) -> f64 {
    let regions = regions(scene, bvh);
    let points = surface_points(scene, n);
    let labels = regions.locate(scene, bvh, &points);
    let mut lost = 0;
    for (i, (&(position, normal), _)) in
        points.iter().zip(&labels).enumerate().filter(|(_, (_, label))| **label == RegionId::DARK)
    {
        let seen: Vec<(Vec3, Vec3)> = (0..128)
            .filter_map(|k| {
                let direction = cosine_hemisphere(sobol_2d(k, i as u32, 3), normal);
                let hit = bvh.nearest(Ray::new(offset_origin(position, normal), direction));
                (!hit.is_miss()).then(|| scene.surface_at(&hit)).map(|s| (s.position, s.normal))
            })
            .collect();
        let is_lost = regions.locate(scene, bvh, &seen).iter().any(|&label| label != RegionId::DARK);
        if is_lost && std::env::var_os("SHOW").is_some() {
            println!("lost: {:?} {normal:?}", scene.frame().world_from_scene_point(position));
        }
        lost += usize::from(is_lost);
    }
    lost as f64 / n as f64
}

#[test]
fn cornell_box_loses_nothing() {
    let (scene, bvh) = cornell().build();
    let lost = lost_share(&scene, &bvh, 8_000);
    println!("lost {lost}");
    assert!(lost < 2e-3, "{lost}");
}

/// World-space points on the surface, with normals, as scene-space queries.
fn at(scene: &Scene, points: &[([f64; 3], [f32; 3])]) -> Vec<(Vec3, Vec3)> {
    points.iter().map(|&(p, n)| (scene.frame().scene_from_world_point(DVec3::from(p)), Vec3::from(n))).collect()
}

fn is_dark(scene: &Scene, bvh: &Bvh, points: &[([f64; 3], [f32; 3])]) -> Vec<bool> {
    let regions = regions(scene, bvh);
    let labels = regions.locate(scene, bvh, &at(scene, points));
    labels.into_iter().map(|label| label == RegionId::DARK).collect()
}

/// D8 and D9: however thin the wall, the room behind it is dark, right up to the wall and on the floor under it.
#[test]
fn a_wall_of_any_thickness_separates_two_rooms() {
    for thickness in [0.0, 1e-7, 8.5e-6, 8.5e-4, 8.5e-3, 0.085, 0.17] {
        let (scene, bvh) = two_rooms(thickness).build();
        let far = 1.0 + thickness;
        let points: Vec<([f64; 3], [f32; 3])> = (0..40)
            .flat_map(|i| {
                let z = 0.0125 + 0.025 * f64::from(i);
                [
                    ([1.0 - 1e-3, 0.0, z], [0.0, 1.0, 0.0]),
                    ([1.0, 0.5, z], [-1.0, 0.0, 0.0]),
                    ([far + 1e-3, 0.0, z], [0.0, 1.0, 0.0]),
                    ([far, 0.5, z], [1.0, 0.0, 0.0]),
                ]
            })
            .collect();
        let regions = regions(&scene, &bvh);
        let labels = regions.locate(&scene, &bvh, &at(&scene, &points));
        let dark = labels.iter().map(|&label| label == RegionId::DARK).collect::<Vec<_>>();
        assert!(dark.chunks(4).all(|d| d == [false, false, true, true]), "thickness {thickness}: {dark:?}");
        assert_eq!(regions.n_regions(), 1, "thickness {thickness}");
        let lit = random_surface_points(&scene, &bvh, &regions, 5_000, 3);
        assert_eq!(lit.len(), 5_000);
        for point in lit {
            let x = scene.frame().world_from_scene_point(point.position).x;
            let on_wall = (x - 1.0).abs() < 1e-6 && point.normal.x < -0.5;
            assert!(on_wall || x < 1.0, "thickness {thickness}: {x} {}", point.normal);
        }
    }
}

/// Negative control: a hole in the wall, and both rooms are one region.
#[test]
fn a_window_joins_two_rooms() {
    let mut s = Shapes::new();
    let white = s.white;
    s.cuboid([0.0; 3], [2.0, 1.0, 1.0], true, white).lamp_at([0.5, 0.9, 0.5], 0.3);
    s.quad([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.9, 0.0], white);
    let (scene, bvh) = s.build();
    assert_eq!(
        is_dark(&scene, &bvh, &[([1.5, 0.0, 0.5], [0.0, 1.0, 0.0]), ([1.0, 0.1, 0.1], [1.0, 0.0, 0.0])]),
        [false; 2]
    );
    assert_eq!(regions(&scene, &bvh).n_regions(), 1);
}

/// D12.
#[test]
fn a_closed_room_within_a_lit_room_is_dark_inside() {
    let mut s = Shapes::new();
    let white = s.white;
    s.cuboid([0.0; 3], [3.0; 3], true, white).lamp_at([1.5, 2.9, 1.5], 0.5);
    s.cuboid([1.0; 3], [2.0; 3], false, white).cuboid([1.1; 3], [1.9; 3], true, white);
    let (scene, bvh) = s.build();
    let points = [
        ([1.5, 1.1, 1.5], [0.0, 1.0, 0.0]),
        ([1.5, 1.0, 1.5], [0.0, 1.0, 0.0]),
        ([1.5, 2.0, 1.5], [0.0, -1.0, 0.0]),
        ([1.5, 2.0, 1.5], [0.0, 1.0, 0.0]),
        ([1.5, 1.0, 1.5], [0.0, -1.0, 0.0]),
    ];
    assert_eq!(is_dark(&scene, &bvh, &points), [true, true, true, false, false]);
}

/// D13: of many closed boxes, the two with a lamp are lit, each a region of its own.
#[test]
fn closed_boxes_are_regions_of_their_own() {
    let mut s = Shapes::new();
    let white = s.white;
    for i in 0..1000 {
        let min = [f64::from(i % 10), f64::from(i / 10 % 10), f64::from(i / 100)].map(|c| 2.0 * c);
        s.cuboid(min, min.map(|c| c + 1.0), true, white);
    }
    s.lamp_at([0.5, 0.9, 0.5], 0.2).lamp_at([8.5, 8.9, 8.5], 0.2);
    let (scene, bvh) = s.build();
    let regions = regions(&scene, &bvh);
    assert_eq!(regions.n_regions(), 2);
    let floor = |c: f64| ([c, c - 0.5, c], [0.0, 1.0, 0.0]);
    let labels = regions.locate(&scene, &bvh, &at(&scene, &[floor(0.5), floor(8.5), floor(4.5), floor(18.5)]));
    assert!(labels[0] != labels[1] && labels[..2].iter().all(|label| label.0 < 2), "{labels:?}");
    assert_eq!(labels[2..], [RegionId::DARK; 2]);
    for point in random_surface_points(&scene, &bvh, &regions, 2_000, 1) {
        let world = scene.frame().world_from_scene_point(point.position);
        assert!(world.cmple(DVec3::splat(1.001)).all() || world.cmpge(DVec3::splat(7.999)).all(), "{world}");
    }
}

/// H4, H5: the floor under a box that stands on it, the box's bottom and its inside are dark; so are the outsides.
#[test]
fn buried_sides_are_dark() {
    for lift in [0.0, 1e-8, 1e-6] {
        let mut s = Shapes::new();
        let white = s.white;
        s.cuboid([0.0; 3], [1.0; 3], true, white).lamp_at([0.5, 0.95, 0.5], 0.2);
        s.cuboid([0.3, lift, 0.3], [0.7, 0.5, 0.7], false, white);
        let (scene, bvh) = s.build();
        let regions = regions(&scene, &bvh);
        for point in random_surface_points(&scene, &bvh, &regions, 20_000, 5) {
            let p = scene.frame().world_from_scene_point(point.position);
            let under = p.y < 1e-3 && (p.x - 0.5).abs() < 0.2 - 1e-4 && (p.z - 0.5).abs() < 0.2 - 1e-4;
            assert!(!under, "lift {lift}: {p} {}", point.normal);
        }
        let points = [
            ([0.5, 0.5, 0.5], [0.0, -1.0, 0.0]),
            ([0.3, 0.2, 0.5], [1.0, 0.0, 0.0]),
            ([0.3, 0.2, 0.5], [-1.0, 0.0, 0.0]),
            ([0.0, 0.5, 0.5], [-1.0, 0.0, 0.0]),
        ];
        assert_eq!(is_dark(&scene, &bvh, &points), [true, true, false, true]);
    }
}

/// Two sheets with one gap below the height at which rays start: neither side of the gap gets a point.
#[test]
fn coincident_sheets_have_no_points_between_them() {
    let mut s = Shapes::new();
    let back = s.builder.push_material(Material::diffuse("back", Vec3::splat(0.2)));
    let white = s.white;
    s.cuboid([0.0; 3], [1.0; 3], true, white).lamp_at([0.5, 0.95, 0.5], 0.2);
    s.quad([0.2, 0.5, 0.2], [0.0, 0.0, 0.6], [0.6, 0.0, 0.0], white);
    s.quad([0.2, 0.5, 0.2], [0.6, 0.0, 0.0], [0.0, 0.0, 0.6], back);
    let (scene, bvh) = s.build();
    let points = random_surface_points(&scene, &bvh, &regions(&scene, &bvh), 40_000, 5);
    let on_sheet =
        points.iter().copied().filter(|p| (scene.frame().world_from_scene_point(p.position).y - 0.5).abs() < 1e-6);
    let (up, down): (Vec<OrientedPoint>, Vec<OrientedPoint>) =
        on_sheet.filter(|p| p.normal.y.abs() > 0.5).partition(|p| p.normal.y > 0.0);
    // Each side counts once: 0.36 of an area of 6 + 0.08 + 0.72.
    let expected = 40_000.0 * 0.36 / 6.8;
    for n in [up.len() as f64, down.len() as f64] {
        assert!((n / expected - 1.0).abs() < 0.1, "{n} for {expected}");
    }
}

#[test]
fn an_environment_lights_what_is_open_to_it_and_nothing_else() {
    let mut s = cornell();
    let (scene, bvh) = s.build();
    let outside = [([0.275, 0.55, 0.275], [0.0, 1.0, 0.0]), ([0.16, 0.1, 0.1], [0.0, 0.0, 1.0])];
    assert_eq!(is_dark(&scene, &bvh, &outside), [true, true]);
    s.builder.set_environment(Environment::constant(Vec3::ONE).unwrap());
    let (scene, bvh) = s.build();
    assert_eq!(is_dark(&scene, &bvh, &outside), [false, true]);
    assert_eq!(regions(&scene, &bvh).n_regions(), 1);
    s.builder.set_environment(Environment::constant(Vec3::ZERO).unwrap());
    let (scene, bvh) = s.build();
    assert_eq!(is_dark(&scene, &bvh, &outside), [true, true]);
}

#[test]
fn lights_without_a_surface_light_their_rooms() {
    let rooms = |add: &dyn Fn(&mut Shapes)| {
        let mut s = Shapes::new();
        let white = s.white;
        s.cuboid([0.0; 3], [1.0; 3], true, white).cuboid([2.0, 0.0, 0.0], [3.0, 1.0, 1.0], true, white);
        add(&mut s);
        let (scene, bvh) = s.build();
        is_dark(&scene, &bvh, &[([0.5, 0.0, 0.5], [0.0, 1.0, 0.0]), ([2.5, 0.0, 0.5], [0.0, 1.0, 0.0])])
    };
    assert_eq!(rooms(&|_| ()), [true, true]);
    assert_eq!(rooms(&|s| s.builder.push_point_light("", DVec3::splat(0.5), Vec3::ONE)), [false, true]);
    assert_eq!(rooms(&|s| s.builder.push_point_light("", DVec3::splat(0.5), Vec3::ZERO)), [true, true]);
    let spot = |s: &mut Shapes| {
        s.builder.push_spot_light("", DVec3::new(2.5, 0.5, 0.5), Vec3::NEG_Y, Vec3::ONE, 0.1, 0.2);
    };
    assert_eq!(rooms(&spot), [true, false]);
    assert_eq!(rooms(&|s| s.builder.push_directional_light("", Vec3::Y, Vec3::ONE, 0.0)), [true, true]);
}

#[test]
fn sides_that_do_not_reflect_get_no_points() {
    let mut s = Shapes::new();
    let (white, black) = (s.white, s.builder.push_material(one_sided("one-sided")));
    s.cuboid([0.0; 3], [1.0; 3], true, white).lamp_at([0.5, 0.95, 0.5], 0.2);
    s.quad([0.2, 0.5, 0.2], [0.0, 0.0, 0.6], [0.6, 0.0, 0.0], black);
    let (scene, bvh) = s.build();
    let points = random_surface_points(&scene, &bvh, &regions(&scene, &bvh), 10_000, 5);
    let on_sheet = |p: &&OrientedPoint| scene.frame().world_from_scene_point(p.position).y == 0.5;
    let mut of_sheet = points.iter().filter(on_sheet).filter(|p| p.normal.y.abs() > 0.5).peekable();
    assert!(of_sheet.peek().is_some() && of_sheet.all(|p| p.normal.y > 0.0));
}

/// A curtain with deep folds that stands on the floor.
fn curtain() -> Shapes {
    let mut s = Shapes::new();
    let white = s.white;
    s.cuboid([0.0; 3], [1.0; 3], true, white).lamp_at([0.5, 0.95, 0.5], 0.2);
    let (columns, rows) = (600u32, 20u32);
    let position = |i: u32, j: u32| {
        let t = f64::from(i) / f64::from(columns);
        let y = 0.8 * f64::from(j) / f64::from(rows);
        DVec3::new(0.2 + 0.6 * t + 0.004 * (240.0 * t).cos(), y, 0.7 + 0.06 * (120.0 * t).sin())
    };
    let positions: Vec<DVec3> = (0..=rows).flat_map(|j| (0..=columns).map(move |i| position(i, j))).collect();
    let at = |i: u32, j: u32| j * (columns + 1) + i;
    let cells = (0..rows).flat_map(|j| (0..columns).map(move |i| (i, j)));
    let triangles: Vec<[u32; 3]> = cells
        .flat_map(|(i, j)| [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]])
        .collect();
    s.mesh(&positions, &triangles, white);
    s
}

#[test]
fn folds_of_cloth_lose_less_than_a_thousandth() {
    let (scene, bvh) = curtain().build();
    let lost = lost_share(&scene, &bvh, 8_000);
    println!("lost {lost}");
    assert!(lost < 1e-3, "{lost}");
    assert_eq!(regions(&scene, &bvh).n_regions(), 1);
}

#[test]
fn cancelling_stops_the_search() {
    struct Cancelled;
    impl hplt_geom::Progress for Cancelled {
        fn advance(&self, _: &'static str, _: u64, _: u64) {}
        fn is_cancelled(&self) -> bool {
            true
        }
    }
    let (scene, bvh) = cornell().build();
    assert!(Regions::build(&scene, &bvh, 1, &Cancelled).is_err());
}
