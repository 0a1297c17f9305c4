//! The published variants in the Cornell box: gathers on the fly, each way of reading senders, and a whole bounce with its push-down.
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use hplt_basis::{ApproximateNearest, BasisOptions, ExactShepard, ShepardBasis, delta_from_absolute};
use hplt_geom::{Bvh, BvhOptions, NoProgress};
use hplt_reference::scenes;
use hplt_sampling::{HierarchyOptions, poisson_hierarchy};
use hplt_transport::{
    DirectLight, DirectOptions, Model, TransportOptions, project_direct, transport_absolute, transport_delta,
};

const N_RAYS: u32 = 128;

fn benches(criterion: &mut Criterion) {
    let scene = scenes::build(scenes::cornell_box());
    let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
    for (name, n_levels) in [("gathers, one level", 1), ("one bounce, four levels", 4)] {
        let options = HierarchyOptions { n_levels, ..HierarchyOptions::slides() };
        let hierarchy = poisson_hierarchy(&scene, &bvh, &options, &NoProgress).expect("a valid scene");
        let basis = ShepardBasis::build(hierarchy.points, BasisOptions::default());
        let model = Model { scene: &scene, caster: &bvh, basis: &basis };
        let light = DirectLight::new(&scene, DirectOptions::projection());
        let absolute = project_direct(&model, &light, &NoProgress).expect("not cancelled");
        let delta = delta_from_absolute(&basis, &absolute);
        let options = TransportOptions { n_rays: N_RAYS, max_bounces: 1, ..TransportOptions::slides() };
        let oracle = &options.threshold;
        let v1 = || transport_delta(&model, &delta, &ExactShepard, oracle, &options, &NoProgress).expect("finite");
        let v3 =
            |reading| transport_absolute(&model, &absolute, reading, oracle, &options, &NoProgress).expect("finite");

        let mut group = criterion.benchmark_group(name);
        group.sample_size(10).throughput(Throughput::Elements(v1().report.bounces[0].rays));
        group.bench_function("delta, shepard (V1)", |b| b.iter(v1));
        group.throughput(Throughput::Elements(v3(&ApproximateNearest).report.bounces[0].rays));
        group.bench_function("absolute, shepard", |b| b.iter(|| v3(&ExactShepard)));
        group.bench_function("absolute, nearest (V3)", |b| b.iter(|| v3(&ApproximateNearest)));
        group.finish();
    }
}

criterion_group!(all, benches);
criterion_main!(all);
