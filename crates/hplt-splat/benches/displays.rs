//! The three displays of one field, with the overdraw of each: 5 levels on an open room of 8 faces, 320 × 240 samples.
#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use hplt_basis::{ApproximateNearest, ExactShepard, absolute_from_delta};
use hplt_geom::NoProgress;
use hplt_splat::{evaluate, flatten_delta, splat_absolute, splat_delta, splat_flattened};

fn benches(criterion: &mut Criterion) {
    let (basis, gbuffer) = (common::room_basis(4, 5), common::room_gbuffer(320, 240));
    let delta = common::adaptive_delta(&basis, common::spotted, 0.02);
    let absolute = absolute_from_delta(&basis, &delta);
    let flat = flatten_delta(&basis, &delta, 0.03);
    let overdraw = |name: &str, splatted: hplt_splat::Splatted| {
        let report = splatted.report;
        println!("{name}: overdraw {:.1}, weights {:.1} per sample", report.overdraw(), report.weights_per_sample());
    };
    overdraw("delta", splat_delta(&basis, &delta, &gbuffer, &NoProgress).expect("not cancelled"));
    overdraw("absolute", splat_absolute(&basis, &absolute, &gbuffer, &NoProgress).expect("not cancelled"));
    overdraw("flattened", splat_flattened(&basis, &flat, &gbuffer, &NoProgress).expect("not cancelled"));

    let mut group = criterion.benchmark_group("320 x 240");
    group.sample_size(10);
    group.bench_function("evaluate, delta", |b| {
        b.iter(|| evaluate(black_box(&basis), &delta, &ExactShepard, &gbuffer, &NoProgress))
    });
    group.bench_function("evaluate, absolute", |b| {
        b.iter(|| evaluate(black_box(&basis), &absolute, &ExactShepard, &gbuffer, &NoProgress))
    });
    group.bench_function("evaluate, absolute, nearest", |b| {
        b.iter(|| evaluate(black_box(&basis), &absolute, &ApproximateNearest, &gbuffer, &NoProgress))
    });
    group.bench_function("splat, delta", |b| b.iter(|| splat_delta(black_box(&basis), &delta, &gbuffer, &NoProgress)));
    group.bench_function("splat, absolute", |b| {
        b.iter(|| splat_absolute(black_box(&basis), &absolute, &gbuffer, &NoProgress))
    });
    group.bench_function("splat, flattened", |b| {
        b.iter(|| splat_flattened(black_box(&basis), &flat, &gbuffer, &NoProgress))
    });
    group.bench_function("flatten", |b| b.iter(|| flatten_delta(black_box(&basis), &delta, 0.03)));
    group.finish();
}

criterion_group!(displays, benches);
criterion_main!(displays);
