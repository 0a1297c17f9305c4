//! Regions, candidates and Poisson-disk levels on a closed room with two blocks.
use criterion::{Criterion, criterion_group, criterion_main};
use hplt_geom::NoProgress;
use hplt_sampling::{HierarchyOptions, Regions, poisson_hierarchy, random_surface_points};

#[path = "../tests/common/mod.rs"]
mod common;

fn benches(criterion: &mut Criterion) {
    let (scene, bvh) = common::cornell().build();
    let mut group = criterion.benchmark_group("cornell");
    group.sample_size(10);
    group.bench_function("regions", |b| b.iter(|| Regions::build(&scene, &bvh, 0, &NoProgress)));
    let regions = Regions::build(&scene, &bvh, 0, &NoProgress).expect("not cancelled");
    group
        .bench_function("100k random points", |b| b.iter(|| random_surface_points(&scene, &bvh, &regions, 100_000, 0)));
    let points: Vec<_> =
        random_surface_points(&scene, &bvh, &regions, 100_000, 1).iter().map(|p| (p.position, p.normal)).collect();
    group.bench_function("locate 100k points", |b| b.iter(|| regions.locate(&scene, &bvh, &points)));
    for n_levels in [4, 6] {
        let options = HierarchyOptions { n_levels, ..HierarchyOptions::slides() };
        group.bench_function(format!("{n_levels} levels"), |b| {
            b.iter(|| poisson_hierarchy(&scene, &bvh, &options, &NoProgress))
        });
    }
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
