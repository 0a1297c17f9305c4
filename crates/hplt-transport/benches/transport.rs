//! Direct light, links, their solve, and a final gather in the Cornell box.
use criterion::{Criterion, criterion_group, criterion_main};
use hplt_basis::LayeredNearest;
use hplt_geom::{Bvh, BvhOptions, NoProgress};
use hplt_reference::scenes;
use hplt_sampling::random::Stage;
use hplt_sampling::{HierarchyOptions, poisson_hierarchy, random_surface_points, refined_level};
use hplt_transport::{
    DirectLight, DirectOptions, FinalGatherOptions, LinkOptions, Method, Model, Sender, SolveOptions, Unknowns,
    direct_irradiance, final_gather, solve, transport_links,
};

fn benches(criterion: &mut Criterion) {
    let scene = scenes::build(scenes::cornell_box());
    let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
    let one_level = HierarchyOptions { n_levels: 1, ..HierarchyOptions::slides() };
    let hierarchy = poisson_hierarchy(&scene, &bvh, &one_level, &NoProgress).expect("a valid scene");
    let points = random_surface_points(&scene, &bvh, &hierarchy.regions, 256, 1);
    let light = DirectLight::new(&scene, DirectOptions::measurement());
    let options = LinkOptions { n_levels: 3, ..LinkOptions::preview() };
    let link = || transport_links(&scene, &bvh, hierarchy.points.clone(), &light, &options, &NoProgress);
    let linked = link().expect("a finite solution");

    let mut group = criterion.benchmark_group("cornell");
    group.sample_size(10);
    let coarse = &hierarchy.points.levels[0];
    let all = vec![true; coarse.points.len()];
    group.bench_function("refine 270 functions", |b| {
        b.iter(|| refined_level(&scene, &bvh, coarse, &all, (1, 0), &NoProgress));
    });
    group.bench_function("direct light at 256 points", |b| {
        b.iter(|| direct_irradiance(&light, &bvh, &points, Stage::Direct, &NoProgress));
    });
    group.bench_function("links, 3 levels of 128 rays", |b| b.iter(link));

    let components = vec![0; linked.links.n_rows()];
    let areas = vec![1.0; linked.links.n_rows()];
    let unknowns = Unknowns { components: &components, n_components: 1, areas: &areas };
    for method in [Method::Bounces, Method::GaussSeidel, Method::BiCgStab, Method::Gmres { restart: 20 }] {
        let options = SolveOptions { method, ..SolveOptions::default() };
        group.bench_function(format!("solve by {method:?}"), |b| {
            b.iter(|| solve(&linked.links, &linked.first_bounce, &unknowns, &options, &NoProgress));
        });
    }

    let model = Model { scene: &scene, caster: &bvh, basis: &linked.basis };
    let sender = Sender { coefficients: &linked.indirect, reconstruction: &LayeredNearest, n_levels: usize::MAX };
    let options = FinalGatherOptions { n_rays: 256, stage: Stage::FinalGather, seed: 0, light: &light, contact: 1.0 };
    group.bench_function("final gather, 256 points of 256 rays", |b| {
        b.iter(|| final_gather(&model, &sender, &points, options, &NoProgress));
    });
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
