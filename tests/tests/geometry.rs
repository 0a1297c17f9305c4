//! Geometry: no leaks, sides, needles, regions.

use hplt::basis::{Layered, Reconstruction};
use hplt::geom::glam::{DVec3, Vec3};
use hplt::geom::{Material, OrientedPoint, Rgb, SceneBuilder};
use hplt::reference::scenes::{self, Shape};
use hplt::transport::{LinkOptions, Threshold, TransportOptions};
use hplt_tests::{Prepared, Setup, Solved};

/// A few rays: what is exactly black does not depend on how many.
fn quick() -> Setup {
    let threshold = Threshold { absolute: 0.0, relative: 0.1, noise: 2.0 };
    Setup {
        transport: TransportOptions { n_rays: 64, tolerance: 1e-2, threshold, ..TransportOptions::production() },
        ..Setup::default()
    }
}

/// A grid of points on an axis-aligned rectangle, world space, lifted onto the surface.
fn grid(prepared: &Prepared, corner: DVec3, u: DVec3, v: DVec3, n: usize) -> Vec<OrientedPoint> {
    let normal = u.cross(v).normalize().as_vec3();
    let frame = prepared.scene.frame();
    let points: Vec<(Vec3, Vec3)> = (0..n * n)
        .map(|i| {
            let (a, b) = ((i % n) as f64 + 0.5, (i / n) as f64 + 0.5);
            let world = corner + u * (a / n as f64) + v * (b / n as f64);
            (frame.scene_from_world_point(world), normal)
        })
        .collect();
    prepared.locate(&points)
}

/// Total irradiance at points by interpolation, and by a final gather.
fn totals(prepared: &Prepared, solved: &Solved, points: &[OrientedPoint]) -> [Vec<Rgb>; 2] {
    let direct = prepared.direct_at(points);
    let (indirect, _) = prepared.interpolate(&solved.indirect, points);
    let gathered = prepared.gather(solved, points, 256);
    [
        direct.iter().zip(&indirect).map(|(d, i)| *d + *i).collect(),
        direct.iter().zip(&gathered).map(|(d, g)| *d + g.irradiance).collect(),
    ]
}

fn all_black(values: &[Vec<Rgb>; 2]) -> bool {
    values.iter().flatten().all(|v| *v == Rgb::ZERO)
}

fn all_lit(values: &[Vec<Rgb>; 2]) -> bool {
    values.iter().flatten().all(|v| v.min_element() > 0.0)
}

/// D2: one emitting triangle receives nothing on either side, not even from itself.
#[test]
fn d2_one_triangle_does_not_light_itself() {
    let mut builder = SceneBuilder::new();
    let lamp = builder.push_material(Material::emitter("lamp", Rgb::splat(0.8), Rgb::ONE));
    Shape::new().triangle([DVec3::ZERO, DVec3::X, DVec3::Y]).push_into(&mut builder, "t", lamp);
    let prepared = Prepared::new(scenes::build(builder), Setup::default());
    let solved = prepared.solve().unwrap();
    assert!(solved.finest().iter().all(|e| *e == Rgb::ZERO));
    for normal in [Vec3::Z, Vec3::NEG_Z] {
        let at = prepared.scene.frame().scene_from_world_point(DVec3::new(0.2, 0.2, 0.0));
        let point = [OrientedPoint::new(at, normal, hplt::geom::RegionId(0))];
        assert_eq!(prepared.direct_at(&point)[0], Rgb::ZERO);
    }
}

/// D8, D9: a dark room behind a wall of any thickness, zero included, stays exactly black, and the lit room is lit.
#[test]
fn d9_a_dark_room_behind_a_thin_wall_is_exactly_black() {
    for thickness in [0.0, 1e-4, 0.01, 0.1, 0.3] {
        let setup = Setup { n_levels: 3, ..quick() };
        let prepared = Prepared::new(scenes::build(scenes::two_rooms(thickness)), setup);
        let solved = prepared.solve().unwrap();
        assert_eq!(solved.report.n_escaped(), 0, "thickness {thickness}");
        let t = thickness;
        let dark = [
            // The wall's dark side, then floor and ceiling of the dark room right up to the wall.
            grid(&prepared, DVec3::new(t, 0.0, 0.0), DVec3::Y, DVec3::Z, 12),
            grid(&prepared, DVec3::new(t, 0.0, 0.0), DVec3::Z, DVec3::X * 0.2, 24),
            grid(&prepared, DVec3::new(t, 1.0, 0.0), DVec3::X * 0.2, DVec3::Z, 24),
        ];
        for points in dark {
            assert!(all_black(&totals(&prepared, &solved, &points)), "thickness {thickness}");
        }
        let lit = [
            grid(&prepared, DVec3::ZERO, DVec3::Z, DVec3::Y, 12),
            grid(&prepared, DVec3::new(-0.2, 0.0, 0.0), DVec3::Z, DVec3::X * 0.2, 12),
        ];
        for points in lit {
            assert!(all_lit(&totals(&prepared, &solved, &points)), "thickness {thickness}");
        }
    }
}

/// D12: a closed room inside a lit one.
#[test]
fn d12_a_nested_room_is_exactly_black() {
    let prepared = Prepared::new(scenes::build(scenes::nested_rooms()), quick());
    let solved = prepared.solve().unwrap();
    let inner_floor = grid(&prepared, DVec3::splat(-0.5), DVec3::Z, DVec3::X, 16);
    assert!(all_black(&totals(&prepared, &solved, &inner_floor)));
    let top = grid(&prepared, DVec3::new(-0.501, 0.501, -0.501), DVec3::Z * 1.002, DVec3::X * 1.002, 16);
    assert!(all_lit(&totals(&prepared, &solved, &top)));
}

/// The floor under a box that stands on it gets no functions and no light; right beside the box it is lit.
#[test]
fn under_a_box_is_black_and_beside_it_is_not() {
    let prepared = Prepared::new(scenes::build(scenes::box_on_floor()), quick());
    let solved = prepared.solve().unwrap();
    let under = grid(&prepared, DVec3::new(0.751, 0.0, 0.751), DVec3::Z * 0.498, DVec3::X * 0.498, 16);
    assert!(all_black(&totals(&prepared, &solved, &under)));
    let beside = grid(&prepared, DVec3::new(1.251, 0.0, 0.751), DVec3::Z * 0.5, DVec3::X * 0.05, 16);
    assert!(all_lit(&totals(&prepared, &solved, &beside)));
    for level in 0..prepared.basis.n_levels() {
        for point in prepared.basis.points(level) {
            let world = prepared.scene.frame().world_from_scene_point(point.position);
            let inside = (world - DVec3::new(1.0, 0.24, 1.0)).abs().cmplt(DVec3::new(0.2499, 0.2599, 0.2499)).all();
            assert!(!inside, "level {level}: a function under or in the box at {world}");
        }
    }
}

/// D10: the two sides of a single sheet are independent: lamp above, dark closed half-room below.
#[test]
fn d10_the_sides_of_a_sheet_are_independent() {
    let mut builder = SceneBuilder::new();
    let white = builder.push_material(Material::diffuse("white", Rgb::splat(0.6)));
    Shape::new().room(DVec3::ZERO, DVec3::ONE).push_into(&mut builder, "room", white);
    let h = 0.5;
    let at = |x: f64, z: f64| DVec3::new(x, h, z);
    Shape::new().quad([at(0.0, 0.0), at(0.0, 1.0), at(1.0, 1.0), at(1.0, 0.0)]).push_into(&mut builder, "sheet", white);
    builder.push_point_light("lamp", DVec3::new(0.5, 0.8, 0.5), Rgb::ONE);
    let prepared = Prepared::new(scenes::build(builder), quick());
    let solved = prepared.solve().unwrap();
    let above = grid(&prepared, at(0.0, 0.0), DVec3::Z, DVec3::X, 10);
    let below = grid(&prepared, at(0.0, 0.0), DVec3::X, DVec3::Z, 10);
    assert!(all_lit(&totals(&prepared, &solved, &above)));
    assert!(all_black(&totals(&prepared, &solved, &below)));
}

/// D10 in the open: a square lamp above a two-sided sheet: its upper side receives the form factor of A14, the lower one exactly 0.
#[test]
fn d10_a_sheet_under_a_lamp_is_lit_from_one_side() {
    for gap in [0.1, 1.0] {
        let mut builder = SceneBuilder::new();
        let sheet = builder.push_material(Material::diffuse("sheet", Rgb::splat(0.6)));
        let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::ONE));
        let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        let square = |y: f64| [at(0.0, y, 0.0), at(1.0, y, 0.0), at(1.0, y, 1.0), at(0.0, y, 1.0)];
        Shape::new().quad(square(0.0)).push_into(&mut builder, "sheet", sheet);
        Shape::new().quad(square(gap)).push_into(&mut builder, "lamp", lamp);
        let prepared = Prepared::new(scenes::build(builder), quick());
        let solved = prepared.solve().unwrap();
        let sides = [Vec3::Y, Vec3::NEG_Y].map(|normal| {
            let places: Vec<_> = hplt_tests::checks::cells(40).map(|(u, v)| (at(u, 0.0, v), normal)).collect();
            prepared.interpolated_at(&solved, &prepared.locate_world(&places))
        });
        let mean = sides[0].iter().map(|e| f64::from(e.x)).sum::<f64>() / sides[0].len() as f64;
        let exact = hplt::reference::closed_forms::parallel_rectangles(1.0 / gap, 1.0 / gap);
        println!("gap {gap}: {mean} for {exact}");
        assert!((mean / exact - 1.0).abs() < 0.005, "gap {gap}: {mean} for {exact}");
        assert!(sides[1].iter().all(|e| *e == Rgb::ZERO), "gap {gap}: light on the lower side");
    }
}

/// E5: triangles far smaller than any distance between functions: those that hang alone have a function on each side, those that
/// lie about are covered, and all receive their light.
#[test]
fn e5_crumbs_have_functions_or_are_covered() {
    let size = 1e-3;
    let crumb = |at: DVec3| [at, at + DVec3::X * size, at + DVec3::Z * size];
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(Material::emitter("wall", Rgb::splat(0.5), Rgb::ONE));
    Shape::new().room(DVec3::ZERO, DVec3::ONE).push_into(&mut builder, "room", wall);
    // Both sides of the crumbs reflect, the upper ones emit nothing: what they receive is 2 all the same.
    let paper = builder.push_material(Material::diffuse("paper", Rgb::splat(0.5)));
    let hanging: Vec<DVec3> =
        (0..27).map(|i| DVec3::new(f64::from(i % 3), f64::from(i / 3 % 3), f64::from(i / 9)) * 0.3 + 0.2).collect();
    let lying: Vec<DVec3> = (0..400)
        .map(|i| DVec3::new(f64::from(i % 20), 0.04, f64::from(i / 20)) * 0.04 + DVec3::new(0.1, 0.0, 0.1))
        .collect();
    let mut crumbs = Shape::new();
    hanging.iter().chain(&lying).for_each(|&at| {
        crumbs.triangle(crumb(at));
    });
    crumbs.push_into(&mut builder, "crumbs", paper);
    let mut setup = hplt_tests::checks::hemisphere(2, 256, 1e-4);
    setup.radius = 0.06;
    let prepared = Prepared::new(scenes::build(builder), setup);
    assert!(prepared.placed.uncovered_fraction <= 1e-3, "{}", prepared.placed.uncovered_fraction);
    let frame = prepared.scene.frame();
    let top = prepared.basis.n_levels() - 1;
    let functions: Vec<(DVec3, Vec3)> =
        prepared.basis.points(top).iter().map(|p| (frame.world_from_scene_point(p.position), p.normal)).collect();
    for &at in &hanging {
        for normal in [Vec3::Y, Vec3::NEG_Y] {
            let on = |(p, n): &(DVec3, Vec3)| (*p - at).length() < 2.0 * size && n.dot(normal) > 0.9;
            assert!(functions.iter().any(on), "no function at {at} {normal}");
        }
    }
    let solved = prepared.solve().unwrap();
    let middle = DVec3::new(0.3, 0.0, 0.3) * size;
    let places: Vec<_> =
        hanging.iter().chain(&lying).flat_map(|&at| [(at + middle, Vec3::Y), (at + middle, Vec3::NEG_Y)]).collect();
    let values = prepared.interpolated_at(&solved, &prepared.locate_world(&places));
    let worst = hplt_tests::checks::worst(&values, Rgb::splat(2.0));
    // The paper does not emit: it takes a trace of light from what faces it.
    assert!(worst < 0.05, "{worst}");
}

/// D3: walls cut into needles of aspect 10⁶ do not leak and do not change the furnace.
#[test]
fn d3_needle_walls_do_not_leak() {
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(Material::emitter("wall", Rgb::splat(0.5), Rgb::ONE));
    let mut room = Shape::new();
    room.room(DVec3::ZERO, DVec3::ONE);
    // Replace one wall: fans of slivers between two corners and points 1e-6 apart on the far edge.
    room.triangles.truncate(room.triangles.len() - 2);
    let kept = room.triangles.len();
    let mut full = Shape::new();
    full.room(DVec3::ZERO, DVec3::ONE);
    for triangle in &full.triangles[kept..] {
        let [a, b, c] = triangle.map(|v| full.positions[v as usize]);
        let mut before = b;
        for i in 1..=8 {
            let next = if i == 8 { c } else { b + (c - b) * (f64::from(i) * 1e-6) };
            room.triangle([a, before, next]);
            before = next;
        }
    }
    room.push_into(&mut builder, "needles", wall);
    let setup = Setup { n_levels: 3, ..Setup::default() };
    let prepared = Prepared::new(scenes::build(builder), setup);
    let solved = prepared.solve().unwrap();
    assert_eq!(solved.report.n_escaped(), 0);
    for e in solved.finest() {
        assert!((e / 2.0 - Rgb::ONE).abs().max_element() < 2e-3, "{e}");
    }
}

/// D11: irradiance does not bleed round an inside corner between a lit and a black-walled side of an edge: near a step
/// lower than the Poisson radius the error stays small and shrinks with the radius.
#[test]
fn d11_a_low_step_does_not_bleed() {
    let step = 0.02;
    let errors: Vec<f64> = [3, 5]
        .into_iter()
        .map(|n_levels| {
            let mut builder = SceneBuilder::new();
            let white = builder.push_material(Material::diffuse("white", Rgb::splat(0.7)));
            Shape::new().room(DVec3::ZERO, DVec3::ONE).push_into(&mut builder, "room", white);
            Shape::new().cuboid(DVec3::new(0.5, 0.0, 0.2), DVec3::new(0.8, step, 0.8)).push_into(
                &mut builder,
                "step",
                white,
            );
            builder.push_point_light("lamp", DVec3::new(0.2, 0.9, 0.5), Rgb::ONE);
            let prepared = Prepared::new(scenes::build(builder), Setup { n_levels: 1, ..Setup::default() });
            let linked = prepared.link(&LinkOptions { n_levels, ..LinkOptions::production() });
            let shade = grid(&prepared, DVec3::new(0.801, 0.0, 0.3), DVec3::Z * 0.4, DVec3::X * 0.05, 12);
            let lit = grid(&prepared, DVec3::new(0.5, step, 0.3), DVec3::Z * 0.4, DVec3::X * 0.05, 12);
            let points = [shade, lit].concat();
            let mut interpolated = vec![Rgb::ZERO; points.len()];
            let n_all = linked.basis.n_levels();
            Layered.reconstruct(&linked.basis, &linked.indirect, n_all, &points, &mut interpolated);
            let direct = prepared.direct_at(&points);
            let gathered = prepared.gather_linked(&linked, &points, 4096);
            let sum: f64 = (0..points.len())
                .map(|i| {
                    let truth = direct[i] + gathered[i].irradiance;
                    f64::from((interpolated[i] - gathered[i].irradiance).abs().max_element() / truth.max_element())
                })
                .sum();
            sum / points.len() as f64
        })
        .collect();
    println!("mean error beside a step: {errors:?}");
    assert!(errors[1] < 0.05 && errors[1] < errors[0], "{errors:?}");
}

/// H3: a plate half a millimetre under the ceiling faces the same way as the ceiling does and is far nearer to it than any
/// support is wide. The slit between them stays dark inside, the plate's lit side and the ceiling around it do not.
#[test]
fn a_slit_between_parallel_layers_stays_dark() {
    let mut builder = SceneBuilder::new();
    let white = builder.push_material(Material::diffuse("white", Rgb::splat(0.7)));
    Shape::new().room(DVec3::ZERO, DVec3::ONE).push_into(&mut builder, "room", white);
    let at = |x: f64, z: f64| DVec3::new(x, 0.9995, z);
    Shape::new().quad([at(0.35, 0.35), at(0.65, 0.35), at(0.65, 0.65), at(0.35, 0.65)]).push_into(
        &mut builder,
        "plate",
        white,
    );
    builder.push_point_light("lamp", DVec3::new(0.3, 0.3, 0.5), Rgb::ONE);
    let prepared = Prepared::new(scenes::build(builder), quick());
    let solved = prepared.solve().unwrap();
    let mean_of = |values: &[Rgb]| values.iter().map(|v| v.y).sum::<f32>() / values.len() as f32;
    let ceiling = |corner: DVec3| grid(&prepared, corner, DVec3::X * 0.2, DVec3::Z * 0.2, 8);
    let beside = totals(&prepared, &solved, &ceiling(DVec3::new(0.7, 1.0, 0.4)));
    let plate = totals(&prepared, &solved, &ceiling(DVec3::new(0.4, 0.9995, 0.4)));
    let slit = totals(&prepared, &solved, &ceiling(DVec3::new(0.4, 1.0, 0.4)));
    for (mode, share) in [(0, 0.02), (1, 0.005)] {
        let lit = mean_of(&beside[mode]);
        println!("slit {}, plate {}, beside {lit}", mean_of(&slit[mode]), mean_of(&plate[mode]));
        assert!(mean_of(&slit[mode]) < share * lit);
        assert!(mean_of(&plate[mode]) > 0.5 * lit);
    }
}
