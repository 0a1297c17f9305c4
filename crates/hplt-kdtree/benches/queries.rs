//! Building and querying, beside the `kiddo` crate: 167k points on the walls of a box, radii as in a hierarchy.
use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use glam::Vec3;
use hplt_kdtree::KdTree;
use kiddo::{ImmutableKdTree, SquaredEuclidean};

const N_POINTS: usize = 167_000;
const N_QUERIES: usize = 10_000;
/// About 9 points each, as many as a basis function overlaps.
const RADIUS: f32 = 0.0105;

fn box_surface(n: usize, seed: u32) -> Vec<Vec3> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
        ((word >> 22) ^ word) as f32 / 4_294_967_296.0
    };
    let face = |i: usize, u: f32, v: f32| match i % 6 {
        0 => Vec3::new(u, v, 0.0),
        1 => Vec3::new(u, v, 1.0),
        2 => Vec3::new(u, 0.0, v),
        3 => Vec3::new(u, 1.0, v),
        4 => Vec3::new(0.0, u, v),
        _ => Vec3::new(1.0, u, v),
    };
    (0..n).map(|i| face(i, next(), next())).collect()
}

fn benches(criterion: &mut Criterion) {
    let points = box_surface(N_POINTS, 1);
    let queries = box_surface(N_QUERIES, 2);
    let arrays: Vec<[f32; 3]> = points.iter().map(|p| p.to_array()).collect();
    let ours = KdTree::build(&points);
    let theirs: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(&arrays).expect("finite points");

    let mut build = criterion.benchmark_group("build 167k");
    build.sample_size(10);
    build.bench_function("hplt", |b| b.iter(|| KdTree::build(black_box(&points))));
    build.bench_function("kiddo", |b| {
        b.iter(|| ImmutableKdTree::<f32, 3>::new_from_slice(black_box(&arrays)).expect("finite points"))
    });
    build.finish();

    let mut group = criterion.benchmark_group("10k queries");
    group.sample_size(20);
    group.bench_function("within, hplt", |b| {
        b.iter(|| {
            let mut sum = 0u64;
            queries.iter().for_each(|&q| ours.within(q, RADIUS, |id, _| sum += u64::from(id)));
            sum
        })
    });
    group.bench_function("within, kiddo", |b| {
        b.iter(|| {
            let found = |q: &Vec3| {
                let center = q.to_array();
                let within = theirs.query(&center).within::<SquaredEuclidean<f32>>(RADIUS * RADIUS);
                within.unsorted().execute().iter().map(|item| u64::from(item.item)).sum::<u64>()
            };
            queries.iter().map(found).sum::<u64>()
        })
    });
    group.bench_function("nearest, hplt", |b| {
        b.iter(|| {
            let nearest = |&q: &Vec3| ours.nearest(q, f32::INFINITY, |_| true).map_or(0, |(id, _)| u64::from(id));
            queries.iter().map(nearest).sum::<u64>()
        })
    });
    group.bench_function("nearest, kiddo", |b| {
        b.iter(|| {
            let nearest = |q: &Vec3| theirs.query(&q.to_array()).nearest_one::<SquaredEuclidean<f32>>().execute().item;
            queries.iter().map(|q| u64::from(nearest(q))).sum::<u64>()
        })
    });
    group.bench_function("approximate nearest, hplt", |b| {
        b.iter(|| {
            let nearest = |&q: &Vec3| ours.approximate_nearest(q, |_| true).map_or(0, |(id, _)| u64::from(id));
            queries.iter().map(nearest).sum::<u64>()
        })
    });
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
