//! Building and tracing: `cargo bench -p hplt-geom --bench bvh`. Rays are those of a gather: cosine-distributed, from random
//! surface points, 64 per point; one thread.

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use hplt_geom::{Bvh, BvhOptions, Hit, RayCaster, Scene};

mod scenes;

fn all_scenes() -> [(&'static str, Scene); 3] {
    [("cornell", scenes::cornell()), ("colonnade", scenes::colonnade()), ("bumpy_sphere", scenes::bumpy_sphere(800))]
}

fn build(c: &mut Criterion) {
    let mut group = c.benchmark_group("build");
    group.sample_size(10);
    for (name, scene) in all_scenes() {
        group.throughput(Throughput::Elements(scene.mesh().n_triangles() as u64));
        for (preset, options) in [("fast", BvhOptions::fast()), ("production", BvhOptions::production())] {
            group.bench_function(format!("{name}/{preset}"), |b| b.iter(|| Bvh::build(&scene, options)));
        }
    }
}

fn rays(c: &mut Criterion) {
    const N_RECEIVERS: usize = 1 << 10;
    const N_RAYS: usize = 64;
    let mut group = c.benchmark_group("rays");
    group.sample_size(20).throughput(Throughput::Elements((N_RECEIVERS * N_RAYS) as u64));
    for (name, scene) in all_scenes() {
        let (bvh, _) = Bvh::build(&scene, BvhOptions::production());
        let rays = scenes::gather_rays(&scene, N_RECEIVERS, N_RAYS);
        group.bench_function(format!("{name}/nearest"), |b| {
            let new_hits = || vec![Hit::MISS; N_RAYS];
            b.iter_batched_ref(
                new_hits,
                |hits| rays.chunks(N_RAYS).for_each(|batch| bvh.trace_nearest(batch, hits)),
                BatchSize::SmallInput,
            );
        });
        group.bench_function(format!("{name}/occluded"), |b| {
            let new_answers = || vec![false; N_RAYS];
            b.iter_batched_ref(
                new_answers,
                |occluded| rays.chunks(N_RAYS).for_each(|batch| bvh.trace_occluded(batch, occluded)),
                BatchSize::SmallInput,
            );
        });
    }
}

criterion_group!(benches, build, rays);
criterion_main!(benches);
