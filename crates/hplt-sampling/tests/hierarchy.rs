//! Poisson-disk hierarchies: distances, coverage, areas, limits, bits.
mod common;

use common::{Shapes, cornell, two_rooms};
use glam::{DVec3, Vec3};
use hplt_geom::{Bvh, NoProgress, OrientedPoint, PointLevel, Progress, RegionId, Scene};
use hplt_kdtree::KdTree;
use hplt_sampling::poisson::{distance_squared, rejection_distance_squared};
use hplt_sampling::{Error, Hierarchy, HierarchyOptions, Radius, Warning, poisson_hierarchy, random_surface_points};

fn make(scene: &Scene, bvh: &Bvh, options: &HierarchyOptions) -> Hierarchy {
    poisson_hierarchy(scene, bvh, options, &NoProgress).unwrap()
}

fn levels(n_levels: usize) -> HierarchyOptions {
    HierarchyOptions { n_levels, ..HierarchyOptions::slides() }
}

fn tree(points: &[OrientedPoint]) -> KdTree {
    KdTree::build(&points.iter().map(|p| p.position).collect::<Vec<_>>())
}

/// Pairs that are nearer than `radius` whichever of the two came first.
fn violations(level: &PointLevel, radius: f32) -> usize {
    let tree = tree(&level.points);
    let limit = radius * radius;
    let mut n = 0;
    for (i, point) in level.points.iter().enumerate() {
        tree.within(point.position, radius, |j, _| {
            let other = &level.points[j as usize];
            let nearer = |a, b| rejection_distance_squared(a, b) < limit * 0.999_999;
            n += usize::from((j as usize) < i && nearer(point, other) && nearer(other, point));
        });
    }
    n
}

/// The sum of the weights of a basis of support `2r`, with the kernel `2h³ - 3h² + 1`.
fn weight_sum(level: &PointLevel, tree: &KdTree, point: &OrientedPoint) -> f32 {
    let support = 2.0 * level.poisson_radius;
    let mut sum = 0.0;
    tree.within(point.position, support, |i, _| {
        let function = &level.points[i as usize];
        let h = distance_squared(function, point.position).sqrt() / support;
        if function.region == point.region && h < 1.0 {
            let cos = function.normal.dot(point.normal).max(0.0);
            sum += (1.0 - h * h * (3.0 - 2.0 * h)) * cos * cos;
        }
    });
    sum
}

fn uncovered(level: &PointLevel, points: &[OrientedPoint], least: f32) -> usize {
    let tree = tree(&level.points);
    points.iter().filter(|p| weight_sum(level, &tree, p) <= least).count()
}

#[test]
fn cornell_box_levels_keep_their_distance_and_cover_fresh_points() {
    let (scene, bvh) = cornell().build();
    let hierarchy = make(&scene, &bvh, &levels(5));
    println!("{:?}", hierarchy.report);
    let counts = &hierarchy.report.points_per_level;
    assert!((190..320).contains(&counts[0]), "{counts:?}");
    let fresh = random_surface_points(&scene, &bvh, &hierarchy.regions, 50_000, 77);
    for (i, level) in hierarchy.points.levels.iter().enumerate() {
        assert_eq!(level.points.len() as u64, counts[i]);
        assert_eq!(violations(level, level.poisson_radius), 0, "level {i}");
        // Negative control: the test sees pairs that are nearer than a radius a little larger.
        assert!(violations(level, level.poisson_radius * 1.2) > 0, "level {i}");
        let missed = uncovered(level, &fresh, 0.0);
        assert!(missed <= 5, "level {i}: {missed} of 50000");
        if i > 0 {
            assert_eq!(level.poisson_radius * 2.0, hierarchy.points.levels[i - 1].poisson_radius);
        }
    }
    assert!(hierarchy.report.uncovered_fraction <= 1e-4 && hierarchy.report.warnings.is_empty());
}

/// Fewer points than a maximal set leave gaps, and the coverage test sees them.
#[test]
fn a_thinned_level_is_seen_to_have_gaps() {
    let (scene, bvh) = cornell().build();
    let hierarchy = make(&scene, &bvh, &levels(3));
    let fresh = random_surface_points(&scene, &bvh, &hierarchy.regions, 5_000, 77);
    let full = &hierarchy.points.levels[2];
    let thin = PointLevel { points: full.points.iter().copied().step_by(8).collect(), ..full.clone() };
    assert!(uncovered(&thin, &fresh, 0.0) > 50);
}

/// B11: shares add up to the reachable area, on every level, and each patch of the surface gets its own.
#[test]
fn areas_add_up() {
    let mut s = Shapes::new();
    let white = s.white;
    s.cuboid([0.0; 3], [1.0; 3], true, white).lamp_at([0.5, 0.9, 0.5], 0.5);
    let (scene, bvh) = s.build();
    let hierarchy = make(&scene, &bvh, &levels(4));
    // Six faces, and the lamp with both sides.
    let expected = 6.0 + 0.5;
    assert!((hierarchy.report.reachable_area / expected - 1.0).abs() < 0.01, "{}", hierarchy.report.reachable_area);
    let scale = scene.frame().scale();
    for level in &hierarchy.points.levels {
        let sum: f64 = level.points.iter().map(|p| f64::from(p.area)).sum::<f64>() * scale * scale;
        assert!((sum / hierarchy.report.reachable_area - 1.0).abs() < 1e-5, "{sum}");
        for axis in [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z] {
            let facing = level.points.iter().filter(|p| p.normal.dot(axis) > 0.9);
            let sum: f64 = facing.map(|p| f64::from(p.area)).sum::<f64>() * scale * scale;
            let expected = if axis.y != 0.0 { 1.25 } else { 1.0 };
            assert!((sum / expected - 1.0).abs() < 0.05, "{axis}: {sum}");
        }
    }
}

/// E8: chi-square of the counts in 10 × 10 equal cells of the floor, far from edges. A Poisson-disk set is more even than
/// independent points, so only the upper tail counts; the candidates themselves are independent.
#[test]
fn random_points_are_uniform_in_area() {
    let (scene, bvh) = two_rooms(0.0).build();
    let regions = hplt_sampling::Regions::build(&scene, &bvh, 3, &NoProgress).unwrap();
    let points = random_surface_points(&scene, &bvh, &regions, 100_000, 3);
    let mut bins = [0f64; 100];
    for point in &points {
        let p = scene.frame().world_from_scene_point(point.position);
        if point.normal.y > 0.9 && p.y < 1e-3 {
            bins[(p.x * 10.0).clamp(0.0, 9.0) as usize * 10 + (p.z * 10.0).clamp(0.0, 9.0) as usize] += 1.0;
        }
    }
    // The lit room: six faces of 1 m², and both sides of the lamp.
    let expected = 100_000.0 / (6.0 + 0.18) / 100.0;
    let chi_square: f64 = bins.iter().map(|n| (n - expected).powi(2) / expected).sum();
    // 100 degrees of freedom; alpha = 1e-4 is 161.3, and 1 - 1e-4 is 54.
    assert!((54.0..161.3).contains(&chi_square), "{chi_square}");
    let area = points.iter().map(|p| f64::from(p.area)).sum::<f64>() * scene.frame().scale().powi(2);
    assert!((area / 6.18 - 1.0).abs() < 0.01, "{area}");
}

#[test]
fn both_sides_of_a_sheet_have_points_of_their_own() {
    let mut s = Shapes::new();
    let white = s.white;
    s.cuboid([0.0; 3], [1.0; 3], true, white).lamp_at([0.5, 0.95, 0.5], 0.2);
    s.quad([0.2, 0.4, 0.2], [0.0, 0.0, 0.6], [0.6, 0.0, 0.0], white);
    let (scene, bvh) = s.build();
    for level in &make(&scene, &bvh, &levels(3)).points.levels {
        let of_sheet = |p: &&OrientedPoint| {
            (scene.frame().world_from_scene_point(p.position).y - 0.4).abs() < 1e-6 && p.normal.y.abs() > 0.9
        };
        let up = level.points.iter().filter(of_sheet).filter(|p| p.normal.y > 0.0).count();
        let down = level.points.iter().filter(of_sheet).filter(|p| p.normal.y < 0.0).count();
        assert!(up >= 4 && down >= 4, "{up} {down}");
    }
}

/// D8, D9, D12: no function in the dark, and none of another region within reach of a fresh point.
#[test]
fn no_function_lies_in_a_dark_room() {
    for thickness in [0.0, 8.5e-4] {
        let (scene, bvh) = two_rooms(thickness).build();
        let hierarchy = make(&scene, &bvh, &levels(4));
        assert_eq!(hierarchy.points.n_regions, 1);
        for point in hierarchy.points.levels.iter().flat_map(|level| &level.points) {
            let x = scene.frame().world_from_scene_point(point.position).x;
            assert!(point.region != RegionId::DARK && (x < 1.0 - 1e-6 || point.normal.x < 0.5) && x < 1.0 + 1e-6);
        }
    }
}

/// E2: a radius beyond the scene leaves points on every side, and everything covered.
#[test]
fn a_radius_larger_than_the_scene_is_capped() {
    let (scene, bvh) = cornell().build();
    let options = HierarchyOptions { coarsest_radius: Radius::World(1e6), ..levels(1) };
    let hierarchy = make(&scene, &bvh, &options);
    assert!(matches!(hierarchy.report.warnings[..], [Warning::RadiusCapped { .. }, ..]));
    let level = &hierarchy.points.levels[0];
    let fresh = random_surface_points(&scene, &bvh, &hierarchy.regions, 10_000, 1);
    assert!(level.points.len() < 80 && uncovered(level, &fresh, 0.0) == 0, "{}", level.points.len());
}

/// E3: refused before anything is allocated, with the estimate in the message.
#[test]
fn too_small_a_radius_is_refused_with_the_estimate() {
    let (scene, bvh) = cornell().build();
    let options = HierarchyOptions { coarsest_radius: Radius::Fraction(1e-6), ..levels(1) };
    let error = poisson_hierarchy(&scene, &bvh, &options, &NoProgress).unwrap_err();
    let Error::TooManyPoints { estimate, bytes, limit, .. } = error else { panic!("{error}") };
    // 1.1547 · 1.86 m² / (9.5e-7 m)².
    assert!(
        (2.2e12..2.6e12).contains(&(estimate as f64))
            && bytes == estimate * size_of::<OrientedPoint>() as u64
            && limit == 20_000_000
    );
    assert!(error.to_string().starts_with(&format!("{estimate} points estimated at a radius of ")), "{error}");
}

/// E4.
#[test]
fn options_out_of_range_are_refused() {
    let (scene, bvh) = cornell().build();
    for value in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        for radius in [Radius::Fraction(value), Radius::World(value)] {
            let options = HierarchyOptions { coarsest_radius: radius, ..levels(3) };
            let error = poisson_hierarchy(&scene, &bvh, &options, &NoProgress).unwrap_err();
            assert!(matches!(error, Error::Radius(_)), "{error}");
        }
    }
    for n in [0, 31, usize::MAX] {
        assert_eq!(poisson_hierarchy(&scene, &bvh, &levels(n), &NoProgress).unwrap_err(), Error::Levels(n));
    }
}

/// E1, H18.
#[test]
fn levels_beyond_the_limit_are_left_out_with_a_warning() {
    let (scene, bvh) = cornell().build();
    let options = HierarchyOptions { max_points: 3_000, ..levels(8) };
    let hierarchy = make(&scene, &bvh, &options);
    assert_eq!(hierarchy.points.levels.len(), 2);
    assert!(matches!(hierarchy.report.warnings[..], [Warning::FewerLevels { asked: 8, made: 2, .. }]));
    assert!(hierarchy.points.n_points() <= 3_000);
}

/// E5: specks far smaller than any radius, and a wire, each get points on their side, and the wire is covered.
#[test]
fn small_islands_are_not_lost() {
    let mut s = Shapes::new();
    let white = s.white;
    s.cuboid([0.0; 3], [1.0; 3], true, white).lamp_at([0.5, 0.95, 0.5], 0.2);
    let specks: Vec<f64> = (1..10).map(|i| 0.1 * f64::from(i)).collect();
    for &x in &specks {
        s.mesh(
            &[DVec3::new(x, 0.5, 0.5), DVec3::new(x, 0.5, 0.5 + 1e-4), DVec3::new(x + 1e-4, 0.5, 0.5)],
            &[[0, 1, 2]],
            white,
        );
    }
    let (scene, bvh) = s.build();
    let hierarchy = make(&scene, &bvh, &levels(5));
    for level in &hierarchy.points.levels[3..] {
        for &x in &specks {
            for side in [1.0, -1.0] {
                let near = |p: &&OrientedPoint| {
                    let world = scene.frame().world_from_scene_point(p.position);
                    (world - DVec3::new(x, 0.5, 0.5)).length() < 1e-3 && p.normal.y * side > 0.9
                };
                assert_eq!(level.points.iter().filter(near).count(), 1, "{x} {side}");
            }
        }
    }
}

#[test]
fn a_scene_without_light_has_no_points() {
    let mut s = Shapes::new();
    let white = s.white;
    s.cuboid([0.0; 3], [1.0; 3], true, white);
    let (scene, bvh) = s.build();
    let hierarchy = make(&scene, &bvh, &levels(3));
    assert_eq!((hierarchy.points.n_points(), hierarchy.points.n_regions), (0, 0));
    assert!(hierarchy.report.warnings.contains(&Warning::NothingReachable));
    assert!(random_surface_points(&scene, &bvh, &hierarchy.regions, 100, 0).is_empty());
}

#[test]
fn seeds_give_different_points_and_the_same_counts_roughly() {
    let (scene, bvh) = cornell().build();
    let of_seed = |seed| make(&scene, &bvh, &HierarchyOptions { seed, ..levels(3) }).points;
    let all = [0, 1, u64::MAX].map(of_seed);
    assert!(all[0] != all[1] && all[1] != all[2]);
    for points in &all[1..] {
        let ratio = points.levels[2].points.len() as f64 / all[0].levels[2].points.len() as f64;
        assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
    }
}

#[cfg(feature = "rayon")]
#[test]
fn the_points_have_the_same_bits_at_any_thread_count() {
    let (scene, bvh) = cornell().build();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let hierarchy = pool.install(|| make(&scene, &bvh, &levels(4)));
        (hierarchy.points, hierarchy.report)
    };
    let one = with(1);
    for threads in [2, 3, 8] {
        assert!(with(threads) == one, "{threads} threads");
    }
}

#[test]
fn cancelling_stops_at_the_next_chunk() {
    struct After(std::sync::atomic::AtomicU64);
    impl Progress for After {
        fn advance(&self, _: &'static str, _: u64, _: u64) {}
        fn is_cancelled(&self) -> bool {
            self.0.fetch_sub(1, std::sync::atomic::Ordering::Relaxed) <= 1
        }
    }
    let (scene, bvh) = cornell().build();
    for after in [1, 6, 8] {
        let progress = After(std::sync::atomic::AtomicU64::new(after));
        let error = poisson_hierarchy(&scene, &bvh, &levels(3), &progress).unwrap_err();
        assert!(matches!(error, Error::Interrupted(_)));
    }
}
