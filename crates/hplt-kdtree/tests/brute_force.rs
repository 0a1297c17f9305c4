//! Every query against a linear search, bit for bit.
use glam::Vec3;
use hplt_kdtree::{KdTree, LEAF_SIZE};
use proptest::prelude::*;

fn distance_squared(a: Vec3, b: Vec3) -> f32 {
    let d = a - b;
    (d.x * d.x + d.y * d.y) + d.z * d.z
}

fn brute_within(points: &[Vec3], center: Vec3, radius: f32) -> Vec<(u32, f32)> {
    let all = points.iter().enumerate().map(|(i, &p)| (i as u32, distance_squared(p, center)));
    all.filter(|&(_, d)| d <= radius * radius).collect()
}

fn brute_nearest(points: &[Vec3], center: Vec3, radius: f32, accept: impl Fn(u32) -> bool) -> Option<(u32, f32)> {
    let found = brute_within(points, center, radius);
    found.into_iter().filter(|&(id, _)| accept(id)).min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)))
}

/// The four nearest.
fn brute_few_nearest(points: &[Vec3], center: Vec3, radius: f32, accept: impl Fn(u32) -> bool) -> Vec<(u32, f32)> {
    let mut found = brute_within(points, center, radius);
    found.retain(|&(id, _)| accept(id));
    found.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    found.truncate(4);
    found
}

fn within(tree: &KdTree, center: Vec3, radius: f32) -> Vec<(u32, f32)> {
    let mut found = Vec::new();
    tree.within(center, radius, |id, d| found.push((id, d)));
    found.sort_by_key(|&(id, _)| id);
    found
}

/// Clouds that trees find hard: on a lattice (ties, duplicates), on a line, huge, tiny, ordinary.
fn clouds() -> impl Strategy<Value = Vec<Vec3>> {
    let lattice = (-3i8..4, -3i8..4, -3i8..4).prop_map(|(x, y, z)| Vec3::new(x.into(), y.into(), z.into()));
    let line = (-50i8..50).prop_map(|t| Vec3::new(1.0, 2.0, 3.0) * f32::from(t));
    let huge = (-1e18f32..1e18, -1e18f32..1e18, -1.0f32..1.0).prop_map(|(x, y, z)| Vec3::new(x, y, z));
    let ordinary = (-1f32..1.0, -1f32..1.0, -1f32..1.0).prop_map(|(x, y, z)| Vec3::new(x, y, z));
    let tiny = (-1e-30f32..1e-30, -1e-42f32..1e-42, 0f32..1.0).prop_map(|(x, y, z)| Vec3::new(x, y, z * 1e-20));
    let sizes = 0..(12 * LEAF_SIZE);
    prop_oneof![
        prop::collection::vec(lattice, sizes.clone()),
        prop::collection::vec(line, sizes.clone()),
        prop::collection::vec(huge, sizes.clone()),
        prop::collection::vec(tiny, sizes.clone()),
        prop::collection::vec(ordinary, sizes),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn queries_equal_a_linear_search(
        points in clouds(), pick in any::<prop::sample::Index>(), reach in any::<prop::sample::Index>(),
        shift in -0.5f32..0.5, modulus in 1u32..4,
    ) {
        let tree = KdTree::build(&points);
        prop_assert_eq!(tree.len(), points.len());
        let any_point = |i: &prop::sample::Index| points.get(i.index(points.len().max(1))).copied().unwrap_or(Vec3::ONE);
        let center = any_point(&pick) * (1.0 + shift * f32::from(shift > 0.0));
        // Exactly as far as some point: the boundary is included.
        let radius = distance_squared(center, any_point(&reach)).sqrt();
        prop_assert_eq!(within(&tree, center, radius), brute_within(&points, center, radius));
        let accept = |id: u32| id.is_multiple_of(modulus);
        for radius in [radius, f32::INFINITY] {
            prop_assert_eq!(tree.nearest(center, radius, accept), brute_nearest(&points, center, radius, accept));
            let (few, n) = tree.few_nearest::<4>(center, radius, accept);
            prop_assert_eq!(&few[..n], &brute_few_nearest(&points, center, radius, accept)[..]);
        }
    }

    #[test]
    fn approximate_nearest_is_an_accepted_point_at_the_distance_it_says(points in clouds(), at in -2f32..2.0) {
        let tree = KdTree::build(&points);
        let center = Vec3::new(at, -at, 0.3);
        let accept = |id: u32| id.is_multiple_of(2);
        if let Some((id, d)) = tree.approximate_nearest(center, accept) {
            prop_assert!(accept(id) && d == distance_squared(points[id as usize], center));
        }
        prop_assert_eq!(tree.approximate_nearest(center, |_| true).is_none(), points.is_empty());
        if !points.is_empty() && points.len() <= LEAF_SIZE {
            prop_assert_eq!(tree.approximate_nearest(center, |_| true), tree.nearest(center, f32::INFINITY, |_| true));
        }
    }
}

/// A cloud from a small generator of our own, so that the test needs no randomness.
fn cloud(n: usize, seed: u32) -> Vec<Vec3> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        (state >> 8) as f32 / 16_777_216.0
    };
    (0..n).map(|_| Vec3::new(next(), next(), next())).collect()
}

#[test]
fn empty_single_and_pair() {
    let empty = KdTree::build(&[]);
    assert!(empty.is_empty() && empty.nearest(Vec3::ZERO, f32::INFINITY, |_| true).is_none());
    assert!(empty.approximate_nearest(Vec3::ZERO, |_| true).is_none());
    assert_eq!(within(&empty, Vec3::ZERO, f32::INFINITY), []);
    let one = KdTree::build(&[Vec3::X]);
    assert_eq!(one.nearest(Vec3::ZERO, 1.0, |_| true), Some((0, 1.0)));
    assert_eq!(one.nearest(Vec3::ZERO, 0.999, |_| true), None);
    let two = KdTree::build(&[Vec3::X, Vec3::X]);
    assert_eq!(two.nearest(Vec3::ZERO, 2.0, |_| true), Some((0, 1.0)));
    assert_eq!(two.nearest(Vec3::ZERO, 2.0, |id| id == 1), Some((1, 1.0)));
    assert_eq!(within(&two, Vec3::X, 0.0), [(0, 0.0), (1, 0.0)]);
    assert_eq!(two.few_nearest(Vec3::ZERO, 2.0, |_| true), ([], 0));
    let none = KdTree::default();
    assert!(none.is_empty() && none.nearest(Vec3::ZERO, 1.0, |_| true).is_none());
    assert!(none.approximate_nearest(Vec3::ZERO, |_| true).is_none());
    assert_eq!(within(&none, Vec3::ZERO, 1.0), []);
}

#[test]
fn a_negative_or_nan_radius_or_center_finds_nothing() {
    let tree = KdTree::build(&cloud(100, 1));
    for radius in [-1.0, f32::NAN] {
        assert_eq!(within(&tree, Vec3::ZERO, radius), []);
        assert_eq!(tree.nearest(Vec3::ZERO, radius, |_| true), None);
    }
    assert_eq!(within(&tree, Vec3::NAN, 10.0), []);
    assert_eq!(tree.nearest(Vec3::NAN, f32::INFINITY, |_| true), None);
}

#[test]
fn a_large_cloud_equals_a_linear_search_and_is_laid_out_as_documented() {
    let points = cloud(20_000, 2);
    let tree = KdTree::build(&points);
    for (i, &center) in points.iter().step_by(997).enumerate() {
        let radius = 0.01 * (1 + i) as f32;
        assert_eq!(within(&tree, center, radius), brute_within(&points, center, radius));
        assert_eq!(tree.nearest(center, 1.0, |id| id % 7 == 3), brute_nearest(&points, center, 1.0, |id| id % 7 == 3));
    }
    let mut covered = 0;
    for leaf in tree.nodes().iter().filter(|node| node.is_leaf()) {
        assert_eq!(leaf.range().start, covered);
        assert!(leaf.range().len() <= LEAF_SIZE);
        covered = leaf.range().end;
    }
    assert_eq!(covered, points.len());
    for (&id, &p) in tree.order().iter().zip(tree.points()) {
        assert_eq!(points[id as usize], p);
    }
    assert_eq!(tree.memory(), tree.nodes().len() * 8 + points.len() * 16);
}

/// The point of the approximation: it is nearly always right, and never by looking at everything.
#[test]
fn approximate_nearest_finds_the_nearest_for_most_queries() {
    let points = cloud(20_000, 2);
    let tree = KdTree::build(&points);
    let queries = cloud(3_000, 3);
    let right = queries
        .iter()
        .filter(|&&q| tree.approximate_nearest(q, |_| true) == tree.nearest(q, f32::INFINITY, |_| true))
        .count();
    assert!((queries.len() / 5..queries.len()).contains(&right), "{right} of {}", queries.len());
}

/// Every point is in the leaf that its own position leads to, and every split is across the widest extent of the points below.
#[test]
fn splits_are_across_the_widest_extent() {
    let points = cloud(3000, 6).into_iter().enumerate().map(|(i, p)| p * Vec3::new(1.0, 0.4, 1.0 + (i % 2) as f32));
    let points: Vec<Vec3> = points.collect();
    let tree = KdTree::build(&points);
    for (id, &point) in points.iter().enumerate() {
        assert_eq!(tree.approximate_nearest(point, |_| true), Some((id as u32, 0.0)));
    }
    let mut n_splits = [0; 3];
    let mut pending = vec![(0, 0..points.len())];
    while let Some((i, range)) = pending.pop() {
        let node = tree.nodes()[i];
        if node.is_leaf() {
            assert_eq!(node.range(), range);
            continue;
        }
        let extent_along = |axis: usize| {
            let along = || tree.points()[range.clone()].iter().map(|p| p[axis]);
            along().fold(f32::NEG_INFINITY, f32::max) - along().fold(f32::INFINITY, f32::min)
        };
        assert!((0..3).all(|axis| extent_along(axis) <= extent_along(node.axis())));
        n_splits[node.axis()] += 1;
        let half = range.start + range.len() / 2;
        pending.extend([(i + 1, range.start..half), (node.right(), half..range.end)]);
    }
    assert!(n_splits.iter().all(|&n| n > 5), "{n_splits:?}");
}

#[cfg(feature = "rayon")]
#[test]
fn the_tree_has_the_same_bits_at_any_thread_count() {
    let mut points = cloud(50_000, 4);
    points.extend_from_within(..10_000);
    let build = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| KdTree::build(&points))
    };
    let one = build(1);
    for threads in [2, 3, 8] {
        assert!(build(threads) == one, "{threads} threads");
    }
}

#[test]
fn leaves_hold_every_point_once() {
    let points = cloud(1000, 5);
    let tree = KdTree::build(&points);
    let mut ids = tree.order().to_vec();
    assert_eq!((tree.points().len(), ids.len()), (1000, 1000));
    assert!(tree.points().iter().zip(&ids).all(|(p, &id)| *p == points[id as usize]));
    ids.sort_unstable();
    assert!(ids.into_iter().eq(0..1000));
}
