//! Cost of a basis, of a reconstruction per query, exact and approximate, and of a push-down.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::Vec3;
use hplt_basis::{
    Absolute, ApproximateNearest, BasisOptions, Coefficients, ExactShepard, Reconstruction, ShepardBasis, restrict,
};
use hplt_geom::{OrientedPoint, PointHierarchy, PointLevel, RegionId, Rgb};

fn point(i: u32, n: u32) -> OrientedPoint {
    // A low-discrepancy set (Roberts' R2) stands in for Poisson discs.
    let (x, z) = ((f64::from(i) * 0.754_877_666).fract(), (f64::from(i) * 0.569_840_291).fract());
    let area = 1.0 / n as f32;
    OrientedPoint::new(Vec3::new(x as f32, 0.0, z as f32), Vec3::Y, RegionId(0)).with_area(area)
}

fn benches(c: &mut Criterion) {
    let levels = [1_000u32, 4_000, 16_000, 64_000]
        .map(|n| PointLevel::new((0.7 / n as f32).sqrt(), (0..n).map(|i| point(i, n)).collect()));
    let build =
        || ShepardBasis::build(PointHierarchy { levels: levels.to_vec(), n_regions: 1 }, BasisOptions::default());
    let basis = build();
    let field: Coefficients<Absolute> = restrict(&basis, vec![Rgb::ONE; basis.n_functions(3)]);
    let queries: Vec<OrientedPoint> = (0..4096).map(|i| point(i * 7919 + 13, 1)).collect();
    let mut out = vec![Rgb::ZERO; queries.len()];
    let mut group = c.benchmark_group("build");
    group.sample_size(10);
    group.bench_function("trees and parents of 85k functions", |b| b.iter(build));
    group.finish();
    let mut group = c.benchmark_group("reconstruct 64k functions");
    group.throughput(Throughput::Elements(queries.len() as u64));
    group.bench_function("shepard", |b| b.iter(|| ExactShepard.reconstruct(&basis, &field, 4, &queries, &mut out)));
    group.bench_function("nearest", |b| {
        b.iter(|| ApproximateNearest.reconstruct(&basis, &field, 4, &queries, &mut out));
    });
    group.finish();
    c.bench_function("push down 16k to 64k", |b| b.iter(|| basis.parents(3).push_down(field.level(2))));
}

criterion_group!(all, benches);
criterion_main!(all);
