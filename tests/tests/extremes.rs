//! Stiff and extreme input: bright and dim, many, tiny, coincident, far away, broken.

use hplt::geom::glam::{DVec3, Vec3};
use hplt::geom::{
    BuildPolicy, Bvh, BvhOptions, Material, MeshInput, NoProgress, Rgb, Scene, SceneBuilder, SceneReport, Sides,
};
use hplt::reference::scenes::{self, Shape};
use hplt::sampling::Warning;
use hplt::transport::{Leak, TransportOptions, leaks};
use hplt_tests::checks::{hemisphere, worst};
use hplt_tests::{Prepared, Setup, area_mean};

fn furnace_wall(albedo: f32) -> Material {
    Material::emitter("wall", Rgb::splat(albedo), Rgb::ONE)
}

fn unit_room() -> Shape {
    Shape::new().room(DVec3::ZERO, DVec3::ONE).clone()
}

/// A furnace of the given triangles, and what was repaired.
fn furnace_of(shape: &Shape, albedo: f32, policy: BuildPolicy) -> (Scene, SceneReport) {
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(furnace_wall(albedo));
    shape.push_into(&mut builder, "room", wall);
    builder.build(policy).unwrap()
}

/// Solves a furnace and asserts that it is one, no ray lost.
fn assert_furnace(what: &str, scene: Scene, expected: f32) {
    let prepared = Prepared::new(scene, hemisphere(2, 16, 1e-6));
    let solved = prepared.solve().unwrap();
    assert_eq!(solved.report.n_escaped(), 0, "{what}");
    let error = worst(&solved.finest(), Rgb::splat(expected));
    assert!(error <= 1e-5 * expected, "{what}: {error:e}");
}

/// C8: lamps of 1e-12 and 1e12 W/m² in one room: each alone is right to rounding, together the bright one rules.
#[test]
fn c8_a_dim_and_a_bright_lamp_in_one_room() {
    let lit = |exitances: [f32; 2]| {
        let mut builder = SceneBuilder::new();
        let wall = builder.push_material(Material::diffuse("wall", Rgb::splat(0.5)));
        unit_room().push_into(&mut builder, "room", wall);
        for (i, exitance) in exitances.into_iter().enumerate() {
            let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::splat(exitance)));
            let (x, y) = (0.2 + 0.4 * i as f64, 0.9);
            let corners = [(0.0, 0.0), (0.2, 0.0), (0.2, 0.2), (0.0, 0.2)];
            Shape::new().quad(corners.map(|(a, b)| DVec3::new(x + a, y, 0.4 + b))).push_into(
                &mut builder,
                "lamp",
                lamp,
            );
        }
        let transport = TransportOptions { n_rays: 64, ..TransportOptions::production() };
        Prepared::new(scenes::build(builder), Setup { n_levels: 3, transport, ..Setup::default() })
            .solve()
            .unwrap()
            .finest()
    };
    let (dim, bright, both) = (lit([1e-12, 1e-12]), lit([1e12, 1e12]), lit([1e-12, 1e12]));
    for (d, b) in dim.iter().zip(&bright) {
        assert!((*d * 1e24 / *b - Rgb::ONE).abs().max_element() < 1e-4, "{d} {b}");
    }
    assert!(both.iter().zip(&bright).all(|(e, b)| e.is_finite() && e.cmple(*b * 1.0001).all()));
}

/// D4: zero-area, collinear and repeated-index triangles are dropped and counted; the furnace does not notice.
#[test]
fn d4_degenerate_triangles_are_dropped() {
    let mut shape = unit_room();
    shape.triangle([DVec3::ZERO, DVec3::ZERO, DVec3::X]);
    shape.triangle([DVec3::ZERO, DVec3::X * 0.3, DVec3::X]);
    shape.triangles.push([0, 0, 1]);
    let (scene, report) = furnace_of(&shape, 0.5, BuildPolicy::default());
    assert_eq!(report.degenerate, 3);
    assert_furnace("degenerate", scene, 2.0);
}

/// D5: a vertex that is no number is an error that says where; dropped on request, and counted.
#[test]
fn d5_vertices_that_are_no_numbers() {
    for bad in [f64::NAN, f64::INFINITY, -f64::INFINITY, 1e19] {
        let mut shape = unit_room();
        shape.triangle([DVec3::new(0.5, bad, 0.5), DVec3::X, DVec3::Z]);
        let mut builder = SceneBuilder::new();
        let wall = builder.push_material(furnace_wall(0.5));
        shape.push_into(&mut builder, "room", wall);
        let message = builder.build(BuildPolicy::default()).unwrap_err().to_string();
        assert!(message.contains("room") && message.contains("position.y"), "{message}");
        let (scene, report) = furnace_of(&shape, 0.5, BuildPolicy { drop_bad_triangles: true, ..Default::default() });
        assert_eq!(report.non_finite, 1);
        assert_furnace("dropped", scene, 2.0);
    }
}

/// D6: twenty thousand copies of a wall are one wall; the tree stays flat and the energy single.
#[test]
fn d6_coincident_copies_are_one_surface() {
    let mut shape = unit_room();
    let last = shape.triangles[11];
    shape.triangles.extend(std::iter::repeat_n(last, 20_000));
    let (scene, report) = furnace_of(&shape, 0.5, BuildPolicy::default());
    assert_eq!((report.duplicates, scene.mesh().n_triangles()), (20_000, 12));
    // The same place with corners a hair apart cannot be merged.
    for i in 0..20_000 {
        let shift = DVec3::splat(1e-9 * f64::from(i));
        shape.triangle(last.map(|v| shape.positions[v as usize] + shift));
    }
    let (stacked, _) = furnace_of(&shape, 0.5, BuildPolicy::default());
    let (_, tree) = Bvh::build(&stacked, BvhOptions::default());
    let limit = 64 + 2 * (stacked.mesh().n_triangles() as f64).log2().ceil() as usize;
    assert!(tree.binary_depth <= limit, "{tree:?}");
    assert_furnace("stacked", scene, 2.0);
}

/// D7: two materials in one place: the first in the file wins, counted.
#[test]
fn d7_two_materials_in_one_place() {
    let build = |first: f32, second: f32| {
        let mut builder = SceneBuilder::new();
        for albedo in [first, second] {
            let wall = builder.push_material(furnace_wall(albedo));
            unit_room().push_into(&mut builder, "room", wall);
        }
        builder.build(BuildPolicy::default()).unwrap()
    };
    for (first, second, expected) in [(0.5, 0.9, 2.0), (0.75, 0.0, 4.0)] {
        let (scene, report) = build(first, second);
        assert_eq!((report.duplicates, report.duplicates_of_other_material), (12, 12));
        assert_furnace("two materials", scene, expected);
    }
}

/// D13: sixty closed boxes, one of them lit: the others are exactly black, and none of them costs a gather.
#[test]
fn d13_one_lit_box_among_many() {
    let mut builder = SceneBuilder::new();
    let dark = builder.push_material(Material::diffuse("dark", Rgb::splat(0.9)));
    let lit = builder.push_material(furnace_wall(0.9));
    for i in 0..60 {
        let min = DVec3::new(f64::from(i % 20), f64::from(i / 20), 0.0) * 1.5;
        let wall = if i == 47 { lit } else { dark };
        Shape::new().room(min, min + 1.0).push_into(&mut builder, "box", wall);
    }
    let prepared = Prepared::new(scenes::build(builder), Setup { radius: 0.05, ..hemisphere(1, 16, 1e-6) });
    let solved = prepared.solve().unwrap();
    assert_eq!(prepared.basis.hierarchy().n_regions, 1);
    assert!(worst(&solved.finest(), Rgb::splat(10.0)) <= 2e-5);
    let frame = prepared.scene.frame();
    let middle = frame.scene_from_world_point(DVec3::new(7.0, 2.0, 0.0) * 1.5 + 0.5);
    for point in prepared.basis.points(0) {
        let distance = frame.world_from_scene_length((point.position - middle).length());
        assert!(distance < 1.0, "a function in a dark box: {point:?}");
    }
    let elsewhere = prepared.locate_world(&[(DVec3::new(0.5, 0.0, 0.5), Vec3::Y)]);
    assert_eq!(prepared.interpolated_at(&solved, &elsewhere), [Rgb::ZERO]);
}

/// D14: walls wound the wrong way reflect all the same: surfaces are two-sided.
#[test]
fn d14_inverted_winding_reflects_the_same() {
    let solve = |invert: bool| {
        let mut shape = unit_room();
        if invert {
            shape.triangles.iter_mut().step_by(2).for_each(|t| t.swap(1, 2));
        }
        let mut builder = SceneBuilder::new();
        let wall = builder.push_material(Material::diffuse("wall", Rgb::splat(0.6)));
        shape.push_into(&mut builder, "room", wall);
        builder.push_point_light("lamp", DVec3::new(0.4, 0.6, 0.5), Rgb::ONE);
        let transport = TransportOptions { n_rays: 64, ..TransportOptions::production() };
        let setup = Setup { n_levels: 3, transport, ..Setup::default() };
        let prepared = Prepared::new(scenes::build(builder), setup);
        let solved = prepared.solve().unwrap();
        area_mean(prepared.basis.points(2), &solved.finest())
    };
    let (right, wrong) = (solve(false), solve(true));
    assert!((wrong / right - 1.0).abs() < 0.02, "{right} {wrong}");
}

/// D15: shading normals that are missing, zero, no numbers or upside down leave the transport alone.
#[test]
fn d15_bad_shading_normals_do_not_matter() {
    for normal in [Vec3::ZERO, Vec3::NAN, Vec3::splat(7.0), Vec3::NEG_Y] {
        let shape = unit_room();
        let normals = vec![normal; shape.positions.len()];
        let mut builder = SceneBuilder::new();
        let wall = builder.push_material(furnace_wall(0.5));
        let (positions, triangles) = (&shape.positions, &shape.triangles);
        let mesh = MeshInput { name: "room", positions, normals: &normals, uvs: &[], triangles, material: wall };
        builder.push_mesh(mesh).unwrap();
        let (scene, report) = builder.build(BuildPolicy::default()).unwrap();
        // Zero means that the file has none.
        let is_bad = normal.is_nan() || normal.length() > 2.0;
        assert_eq!(report.repaired_normals > 0, is_bad, "{normal}");
        assert_furnace("normals", scene, 2.0);
    }
}

/// A room of 1 m whose first wall is drawn in by `gap` on all sides, so that a slit runs around it.
fn room_with_slit(gap: f64) -> Shape {
    let mut room = unit_room();
    let inwards = |x: f64| 0.5 + (x - 0.5) * (1.0 - 2.0 * gap);
    room.positions[0..4].iter_mut().for_each(|p| *p = DVec3::new(p.x, inwards(p.y), inwards(p.z)));
    room
}

/// D18: gaps of a thousandth between the walls leak what they must, and the leak is counted.
#[test]
fn d18_a_gap_leaks_and_is_counted() {
    let leak = |gap: f64| {
        let mut builder = SceneBuilder::new();
        // The outside reflects nothing, so that every ray starts inside.
        let wall = builder.push_material(Material { reflects: Sides::Front, ..furnace_wall(0.5) });
        room_with_slit(gap).push_into(&mut builder, "room", wall);
        let prepared = Prepared::new(scenes::build(builder), hemisphere(1, 64, 1e-2));
        let solved = prepared.solve().unwrap();
        assert_eq!(solved.report.n_escaped() > 0, gap > 0.0, "gap {gap}");
        let points =
            hplt::sampling::random_surface_points(&prepared.scene, &prepared.bvh.bvh, &prepared.regions, 2000, 3);
        let gathered = prepared.gather(&solved, &points, 256);
        gathered.iter().map(|g| f64::from(g.escaped)).sum::<f64>() / (256.0 * points.len() as f64)
    };
    assert_eq!(leak(0.0), 0.0);
    let (narrow, wide) = (leak(1e-3), leak(1e-2));
    println!("leaked shares: {narrow:e} {wide:e}");
    // The slit is 4·gap of six faces: 0.067 and 0.67 %, at points uniform in area.
    assert!((3e-4..1.5e-3).contains(&narrow) && (3e-3..1.5e-2).contains(&wide), "{narrow:e} {wide:e}");
}

/// What leaves through cracks of a room with lit walls of that albedo, where that is most.
fn worst_leak(shape: &Shape, albedo: f32) -> Option<Leak> {
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(furnace_wall(albedo));
    shape.push_into(&mut builder, "room", wall);
    let prepared = Prepared::new(scenes::build(builder), Setup { n_levels: 1, ..Setup::default() });
    let found = leaks(&prepared.scene, &prepared.bvh, prepared.basis.points(0), 1 << 18, 1, &NoProgress).unwrap();
    found.into_iter().max_by(|a, b| a.lost().total_cmp(&b.lost()))
}

/// A room of 1 m whose ceiling is two halves with a slit of `width` between them.
fn room_with_cut_ceiling(width: f64) -> Shape {
    let mut room = unit_room();
    let is_ceiling = |t: &[u32; 3]| t.iter().all(|&v| room.positions[v as usize].y == 1.0);
    let triangles: Vec<[u32; 3]> = room.triangles.iter().filter(|t| !is_ceiling(t)).copied().collect();
    room.triangles = triangles;
    for (from, to) in [(0.0, 0.5 - 0.5 * width), (0.5 + 0.5 * width, 1.0)] {
        let at = |x: f64, z: f64| DVec3::new(x, 1.0, z);
        room.quad([at(from, 0.0), at(to, 0.0), at(to, 1.0), at(from, 1.0)]);
    }
    room
}

/// A room of 1 m in whose ceiling a vertex lies `short` of the diagonal that it should lie on, and the area of the hole.
fn room_with_t_junction(short: f64) -> (Shape, f64) {
    let mut room = room_with_cut_ceiling(1.0);
    let at = |x: f64, z: f64| DVec3::new(x, 1.0, z);
    let middle = at(0.5 + short * 0.5f64.sqrt(), 0.5 - short * 0.5f64.sqrt());
    room.triangle([at(0.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)]);
    room.triangle([at(0.0, 0.0), at(1.0, 0.0), middle]).triangle([middle, at(1.0, 0.0), at(1.0, 1.0)]);
    (room, 0.5 * 2f64.sqrt() * short)
}

/// D18: what leaves through gaps, through a vertex that misses its edge, and where three walls share an edge, is measured, and it is
/// serious where `leak/(1-ρ)` is above a hundredth. Walls see a slit by its share of their area, by reciprocity.
#[test]
fn d18_cracks_are_measured_and_serious_where_much_is_reflected() {
    // Fins that share an edge with the floor and one with a wall.
    let mut fins = unit_room();
    fins.quad([DVec3::ZERO, DVec3::X, DVec3::new(1.0, 0.3, 0.4), DVec3::new(0.0, 0.3, 0.4)]);
    fins.quad([DVec3::ZERO, DVec3::Z, DVec3::new(0.3, 0.4, 1.0), DVec3::new(0.3, 0.4, 0.0)]);
    let (t_junction, hole) = room_with_t_junction(1.5e-3);
    // The surface beside a slit in a corner sees so much of it that it passes for open: a third of the leak.
    for (what, shape, slit, at_corner) in [
        ("closed", unit_room(), 0.0, 1.0),
        ("three walls at an edge", fins, 0.0, 1.0),
        ("gap of 1.5e-3", room_with_cut_ceiling(1.5e-3), 1.5e-3, 1.0),
        ("gap of 1.5e-4", room_with_cut_ceiling(1.5e-4), 1.5e-4, 1.0),
        ("gaps of 1e-3 in corners", room_with_slit(1e-3), 4e-3, 0.6),
        ("T-junction", t_junction, hole, 1.0),
    ] {
        for albedo in [0.5f32, 0.99] {
            let leak = worst_leak(&shape, albedo).expect("rooms are enclosed");
            let expected = at_corner * slit / 6.0;
            println!("{what}, albedo {albedo}: {:.2e} for {expected:.2e}, {:.4} lost", leak.share(), leak.lost());
            // Four standard deviations of the count.
            let noise = 4.0 * (expected / leak.rays as f64).sqrt();
            assert!((leak.share() - expected).abs() <= 0.1 * expected + noise, "{what}: {leak:?}");
            let lost = expected / (1.0 - f64::from(albedo));
            assert!((0.5..2.0).contains(&(leak.lost() / lost)) || leak.lost().max(lost) < 2e-3, "{what}: {leak:?}");
            assert_eq!(leak.is_serious(), lost > 0.01, "{what}, {albedo}: {leak:?}");
        }
    }
}

/// What is open on purpose, in part or wholly, is not taken for cracks: open ground, a skylight, a shed without a wall, a grating of
/// bars, a colonnade.
#[test]
fn d18_openings_are_not_cracks() {
    let mut bars = room_with_cut_ceiling(1.0);
    for i in 0..10 {
        let at = |x: f64, z: f64| DVec3::new(0.1 * (f64::from(i) + x), 1.0, z);
        bars.quad([at(0.0, 0.0), at(0.5, 0.0), at(0.5, 1.0), at(0.0, 1.0)]);
    }
    let mut shed = unit_room();
    shed.triangles.truncate(10);
    for (what, shape) in [("skylight", room_with_cut_ceiling(0.1)), ("bars", bars), ("shed", shed)] {
        let leak = worst_leak(&shape, 0.9);
        println!("{what}: {leak:?}");
        assert!(leak.is_none_or(|leak| leak.lost() < 2e-3 && !leak.is_serious()), "{what}: {leak:?}");
    }
    let ground = scenes::plane_under_sky(10.0, Rgb::splat(0.9), Rgb::ONE);
    for (what, builder) in [("ground", ground), ("Cornell box", scenes::cornell_box())] {
        let prepared = Prepared::new(scenes::build(builder), Setup { n_levels: 1, ..Setup::default() });
        let found = leaks(&prepared.scene, &prepared.bvh, prepared.basis.points(0), 1 << 18, 1, &NoProgress).unwrap();
        assert!(found.iter().all(|leak| leak.lost() < 2e-3), "{what}: {found:?}");
    }
}

/// A triangle a kilometre wide, and above it `n` of a millimetre, a centimetre apart, under the sun.
fn crumbs_over_a_kilometre(n: u32) -> Scene {
    let mut builder = SceneBuilder::new();
    let ground = builder.push_material(Material::diffuse("ground", Rgb::splat(0.5)));
    Shape::new()
        .triangle([DVec3::new(-500.0, 0.0, -500.0), DVec3::new(0.0, 0.0, 500.0), DVec3::new(500.0, 0.0, -500.0)])
        .push_into(&mut builder, "ground", ground);
    let across = f64::from(n).sqrt().ceil() as u32;
    let mut crumbs = Shape::new();
    for i in 0..n {
        let at = DVec3::new(f64::from(i % across), 100.0, f64::from(i / across)) * 0.01;
        crumbs.triangle([at, at + DVec3::Z * 1e-3, at + DVec3::X * 1e-3]);
    }
    crumbs.push_into(&mut builder, "crumbs", ground);
    builder.push_directional_light("sun", Vec3::Y, Rgb::ONE, 0.0);
    scenes::build(builder)
}

/// D23: a triangle a kilometre wide among many of a millimetre: no explosion of points, and they are lit.
#[test]
fn d23_a_kilometre_among_millimetres() {
    assert_crumbs_are_lit(5000, 100_000);
}

/// D23 at its full size: functions are as wide as the kilometre asks for, and a thousand crumbs share one.
#[test]
#[ignore = "slow: a million crumbs"]
fn d23_a_kilometre_among_a_million_millimetres() {
    assert_crumbs_are_lit(1_000_000, 100_000);
}

fn assert_crumbs_are_lit(n: u32, most_functions: usize) {
    let prepared = Prepared::new(crumbs_over_a_kilometre(n), Setup { n_levels: 2, ..Setup::default() });
    let n_functions = prepared.basis.hierarchy().n_points();
    println!("{n} crumbs: {n_functions} functions, at most {:?} MiB", hplt_tests::peak_memory().map(|b| b >> 20));
    assert!(n_functions < most_functions, "{n_functions}");
    let up = prepared.locate_world(&[(DVec3::new(2e-4, 1.0, 2e-4), Vec3::Y)]);
    assert!((prepared.direct_at(&up)[0].x - 1.0).abs() < 1e-6);
}

/// E1, E2, E3: more levels than the points allow, a radius beyond the scene, one far below it.
#[test]
fn e1_e2_e3_radii_beyond_reason() {
    use hplt::geom::NoProgress;
    use hplt::sampling::{HierarchyOptions, Radius, poisson_hierarchy};
    let scene = scenes::build(scenes::furnace_box(Rgb::splat(0.5), Rgb::ONE));
    let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
    let make = |n_levels, coarsest_radius| {
        let options =
            HierarchyOptions { n_levels, coarsest_radius, max_points: 10_000, ..HierarchyOptions::production() };
        poisson_hierarchy(&scene, &bvh, &options, &NoProgress)
    };
    let many = make(20, Radius::Fraction(0.1)).unwrap();
    assert!(many.points.levels.len() < 20);
    assert!(many.report.warnings.iter().any(|w| matches!(w, Warning::FewerLevels { asked: 20, .. })));
    let huge = make(1, Radius::World(1e6)).unwrap();
    assert!(huge.report.warnings.iter().any(|w| matches!(w, Warning::RadiusCapped { .. })));
    assert!(huge.points.n_points() >= 6, "{}", huge.points.n_points());
    assert!(make(1, Radius::Fraction(1e-6)).unwrap_err().to_string().contains("points"));
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(make(2, Radius::Fraction(bad)).is_err(), "{bad}");
    }
}

/// E6: more points, functions or links than 32 bits can number are refused before anything is allocated, whatever limit the caller
/// raises, and sums of bytes do not wrap. (Cells of a grid are at most 2¹⁶ across, since finer radii are refused.)
#[test]
fn e6_counts_beyond_32_bits_are_refused() {
    use hplt::geom::NoProgress;
    use hplt::sampling::{Error, HierarchyOptions, Radius, poisson_hierarchy};
    use hplt::transport::{DirectLight, DirectOptions, LinkOptions, SparseRows, transport_links};
    let scene = scenes::build(scenes::furnace_box(Rgb::splat(0.5), Rgb::ONE));
    let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
    let before = hplt_tests::peak_memory();
    for radius in [1e-5, 1e-6, 1e-12, 1e-300, f64::MIN_POSITIVE] {
        let options = HierarchyOptions {
            n_levels: 1,
            coarsest_radius: Radius::World(radius),
            max_points: u64::MAX,
            ..HierarchyOptions::production()
        };
        let error = poisson_hierarchy(&scene, &bvh, &options, &NoProgress).err();
        // The estimate saturates where it does not fit in 64 bits.
        let Some(Error::TooManyPoints { estimate, bytes, .. }) = error else { panic!("radius {radius}: {error:?}") };
        assert!(estimate > 1 << 32 && bytes >= estimate, "radius {radius}: {estimate} points, {bytes} bytes");
        assert!(radius > 1e-11 || estimate == u64::MAX, "{estimate}");
    }
    let coarse = Setup { n_levels: 1, ..Setup::default() };
    let prepared = Prepared::new(scene.clone(), coarse);
    let light = DirectLight::new(&scene, DirectOptions::projection());
    for max_functions in [0, (1 << 25) + 1, 1 << 33, usize::MAX] {
        let options = LinkOptions { max_functions, ..LinkOptions::production() };
        let points = prepared.basis.hierarchy().clone();
        let error = transport_links(&scene, &bvh, points, &light, &options, &NoProgress).unwrap_err().to_string();
        assert!(error.contains("max_functions"), "{error}");
    }
    // Where no more functions may come, none do, not even those of the second level, which is everywhere otherwise.
    let n = prepared.basis.n_functions(0);
    let linked = prepared.link(&LinkOptions { max_functions: n, n_levels: 3, ..LinkOptions::production() });
    assert_eq!((linked.basis.n_levels(), linked.basis.n_functions(0)), (1, n));
    // Links are counted in 64 bits; functions in 32, and more are refused.
    let links = 3usize << 32;
    assert!(SparseRows::memory_of(1 << 20, links) > 8 * links);
    assert!(std::panic::catch_unwind(|| SparseRows::new(1 << 32)).is_err());
    if let (Some(before), Some(after)) = (before, hplt_tests::peak_memory()) {
        // Other tests may run beside this one; four thousand million points of 48 bytes they do not take.
        assert!(after - before < 8 << 30, "{before} {after}");
    }
}

/// D22: ten million triangles: the furnace is exact, the BVH within 90 bytes a triangle, as the command estimates.
#[test]
#[ignore = "slow: ten million triangles"]
fn d22_ten_million_triangles() {
    let n = 913;
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(furnace_wall(0.5));
    let mut room = Shape::new();
    for [a, b, c, d] in room_faces() {
        room.grid([a, b, c, d], n, n);
    }
    // Neighbouring faces agree on the corners of their common edge to the last bit only on a grid of exact fractions.
    let snapped = room.mapped(|p| (p * f64::from(n)).round() / f64::from(n));
    snapped.push_into(&mut builder, "room", wall);
    let scene = scenes::build(builder);
    let n_triangles = scene.mesh().n_triangles();
    assert!(n_triangles >= 10_000_000, "{n_triangles}");
    let (_, report) = Bvh::build(&scene, BvhOptions::default());
    println!("{n_triangles} triangles: {} bytes each", report.memory as f64 / n_triangles as f64);
    println!("at most {:?} MiB after the BVH", hplt_tests::peak_memory().map(|b| b >> 20));
    assert!(report.memory as f64 <= 1.1 * 90.0 * n_triangles as f64, "{report:?}");
    assert_furnace("ten million triangles", scene, 2.0);
    println!("at most {:?} MiB in all", hplt_tests::peak_memory().map(|b| b >> 20));
}

fn room_faces() -> Vec<[DVec3; 4]> {
    let room = unit_room();
    room.positions.chunks(4).map(|c| [c[0], c[1], c[2], c[3]]).collect()
}
