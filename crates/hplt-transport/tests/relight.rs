//! Changed lights on the same links, against scenes that have those lights from the start.

use hplt_geom::glam::DVec3;
use hplt_geom::{
    Bvh, BvhOptions, Environment, LightGroups, Material, NoProgress, PointHierarchy, Rgb, Scene, SceneBuilder,
};
use hplt_reference::scenes::{self, Shape};
use hplt_sampling::random::Stage;
use hplt_sampling::{HierarchyOptions, poisson_hierarchy};
use hplt_transport::{
    DirectEstimator, DirectLight, DirectOptions, Error, LinkOptions, Linked, Relighting, Relit, SolveOptions,
    SparseRows, System, direct_irradiance, direct_irradiance_by_group, transport_links, weighted_sum,
};

/// Far below what rays can tell.
const TIGHT: SolveOptions =
    SolveOptions { method: hplt_transport::Method::Gmres { restart: 20 }, tolerance: 1e-6, max_sweeps: 1000 };

struct Lit {
    scene: Scene,
    bvh: Bvh,
    points: PointHierarchy,
    estimator: DirectEstimator,
}

impl Lit {
    fn new(scene: Scene, estimator: DirectEstimator) -> Self {
        let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
        let options = HierarchyOptions { n_levels: 1, ..HierarchyOptions::production() };
        let points = poisson_hierarchy(&scene, &bvh, &options, &NoProgress).unwrap().points;
        Self { scene, bvh, points, estimator }
    }

    fn link_as(&self, scene: &Scene, options: &LinkOptions) -> Linked {
        let (light_samples, sky_samples, estimator) = (256, 1024, self.estimator);
        let light = DirectLight::new(
            scene,
            DirectOptions { light_samples, sky_samples, estimator, ..DirectOptions::projection() },
        );
        transport_links(scene, &self.bvh, self.points.clone(), &light, options, &NoProgress).unwrap()
    }

    fn link(&self, options: &LinkOptions) -> Linked {
        self.link_as(&self.scene, options)
    }

    /// The scene with its lights multiplied.
    fn scaled(&self, factors: &[Rgb]) -> Scene {
        let mut scene = self.scene.clone();
        scene.scale_lights(&LightGroups::of(&self.scene), factors).unwrap();
        scene
    }
}

/// A Cornell box with a second lamp on the left wall, a bulb and a sky before its open front.
fn room(cells: u32) -> Scene {
    let mut builder = scenes::cornell_box();
    let lamp = builder.push_material(Material::emitter("side lamp", Rgb::ZERO, Rgb::new(4.0, 8.0, 20.0)));
    let corner = |y, z| DVec3::new(0.55, y, z);
    let corners = [corner(0.2, 0.2), corner(0.2, 0.35), corner(0.35, 0.35), corner(0.35, 0.2)];
    Shape::new().grid(corners, cells, cells).push_into(&mut builder, "side lamp", lamp);
    builder.push_point_light("bulb", DVec3::new(0.1, 0.4, 0.1), Rgb::new(0.3, 0.2, 0.1));
    builder.set_environment(Environment::constant(Rgb::splat(0.4)).unwrap());
    scenes::build(builder)
}

const NAMES: [&str; 4] = ["light", "side lamp", "bulb", "sky"];

fn options(n_levels: usize, n_rays: u32) -> LinkOptions {
    LinkOptions { n_levels, n_rays, solve: TIGHT, by_group: true, ..LinkOptions::production() }
}

fn relighting(linked: Linked) -> Relighting {
    let system = System::of(linked.basis.hierarchy());
    Relighting::new(linked.links, system, linked.groups, &NoProgress).unwrap()
}

fn flat(linked: &Linked) -> Vec<Rgb> {
    (0..linked.basis.n_levels()).flat_map(|l| linked.indirect.level(l).to_vec()).collect()
}

/// The largest difference per channel, over the mean of `b`.
fn difference(a: &[Rgb], b: &[Rgb]) -> f32 {
    assert_eq!(a.len(), b.len());
    let mean = b.iter().map(|b| b.element_sum()).sum::<f32>() / (3 * b.len()) as f32;
    a.iter().zip(b).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max) / mean
}

fn sum<'a>(groups: impl Iterator<Item = &'a Vec<Rgb>>) -> Vec<Rgb> {
    groups.fold(Vec::new(), |sum: Vec<Rgb>, of| {
        if sum.is_empty() { of.clone() } else { sum.iter().zip(of).map(|(a, b)| *a + *b).collect() }
    })
}

/// Keeping groups apart changes no bit of anything else, and they add up, whichever way lights are sampled.
#[test]
fn groups_add_up_to_the_whole_which_stays_as_it_was() {
    // One emitter among few, one among many, and whatever a cosine-distributed ray sees.
    for (cells, estimator) in
        [(1, DirectEstimator::Lights), (6, DirectEstimator::Lights), (1, DirectEstimator::Hemisphere)]
    {
        let lit = Lit::new(room(cells), estimator);
        let together = lit.link(&LinkOptions { by_group: false, ..options(3, 64) });
        let apart = lit.link(&options(3, 64));
        assert_eq!((&apart.links, &apart.first_bounce), (&together.links, &together.first_bounce));
        assert_eq!((&apart.direct, &apart.indirect), (&together.direct, &together.indirect));
        assert!(together.groups.is_empty());
        assert_eq!(apart.groups.iter().map(|g| &g.name[..]).collect::<Vec<_>>(), NAMES);
        assert!(difference(&sum(apart.groups.iter().map(|g| &g.first_bounce)), &apart.first_bounce) < 2e-6);
        let direct: Vec<Rgb> = (0..apart.basis.n_levels()).flat_map(|l| apart.direct.level(l).to_vec()).collect();
        assert!(difference(&sum(apart.groups.iter().map(|g| &g.direct)), &direct) < 2e-6);
        // Negative control: every group counts.
        for left_out in 0..4 {
            let rest = apart.groups.iter().enumerate().filter(|(k, _)| *k != left_out);
            assert!(difference(&sum(rest.map(|(_, g)| &g.first_bounce)), &apart.first_bounce) > 1e-2, "{left_out}");
        }
    }
}

#[test]
fn one_group_alone_is_the_whole() {
    let lit = Lit::new(scenes::build(scenes::cornell_box()), DirectEstimator::Auto);
    let linked = lit.link(&options(2, 64));
    assert_eq!((linked.groups.len(), &linked.groups[0].first_bounce), (1, &linked.first_bounce));
    let relit = relighting(linked).relight(&[Rgb::ONE], &TIGHT, &NoProgress).unwrap();
    assert_eq!(flat(&lit.link(&options(2, 64))), relit.indirect);
}

/// Every group alone is as bright as a scene that has only those lights: which light a ray asks is another, the mean is not.
#[test]
fn a_group_alone_is_the_scene_without_the_other_lights() {
    for (cells, estimator) in
        [(1, DirectEstimator::Lights), (6, DirectEstimator::Lights), (1, DirectEstimator::Hemisphere)]
    {
        let lit = Lit::new(room(cells), estimator);
        let options = options(1, 2048);
        let relighting = relighting(lit.link(&options));
        for (k, name) in NAMES.iter().enumerate() {
            let mut factors = [Rgb::ZERO; 4];
            factors[k] = Rgb::new(1.0, 2.0, 0.5);
            let relit = relighting.relight(&factors, &TIGHT, &NoProgress).unwrap();
            let scaled = lit.scaled(&factors);
            let truth = lit.link_as(&scaled, &options);
            assert_eq!(truth.links.n_rows(), relit.indirect.len());
            let mean = |v: &[Rgb]| v.iter().map(|e| e.as_dvec3()).sum::<DVec3>() / v.len() as f64;
            let ratio = mean(&relit.indirect) / mean(&flat(&truth));
            println!("{cells} {estimator:?} {name}: {ratio}");
            let tolerance = 0.02;
            assert!((ratio - 1.0).abs().max_element() < tolerance, "{name}: {ratio}");
            let direct = mean(&relit.direct) / mean(truth.direct.level(0));
            assert!((direct - 1.0).abs().max_element() < 2.0 * tolerance, "{name}: direct {direct}");
        }
    }
}

/// A bulb is asked by every ray whatever else shines, so that alone it is itself to the accuracy of the solver.
#[test]
fn a_bulb_alone_is_the_same_to_rounding() {
    let lit = Lit::new(room(1), DirectEstimator::Lights);
    let options = options(1, 64);
    let factors = [Rgb::ZERO, Rgb::ZERO, Rgb::splat(3.0), Rgb::ZERO];
    let relit = relighting(lit.link(&options)).relight(&factors, &TIGHT, &NoProgress).unwrap();
    let truth = lit.link_as(&lit.scaled(&factors), &options);
    let error = difference(&relit.indirect, &flat(&truth));
    assert!(error < 5e-6, "{error}");
    let other = lit.link_as(&lit.scaled(&[Rgb::ZERO, Rgb::ZERO, Rgb::splat(3.001), Rgb::ZERO]), &options);
    assert!(difference(&relit.indirect, &flat(&other)) > 1e-4, "negative control");
}

#[test]
fn the_same_lights_give_the_same_light_and_twice_the_lights_twice() {
    let linked = Lit::new(room(1), DirectEstimator::Lights).link(&options(3, 64));
    let before = flat(&linked);
    let relighting = relighting(linked);
    let relit = |factors: &[Rgb; 4]| relighting.relight(factors, &TIGHT, &NoProgress).unwrap();
    let same = relit(&[Rgb::ONE; 4]);
    assert!(difference(&same.indirect, &before) < 4e-6 && same.bound <= 1e-6);
    // Powers of two pass through every sum and product unrounded.
    let twice = relit(&[Rgb::splat(2.0); 4]);
    assert!(twice.indirect.iter().zip(&same.indirect).all(|(a, b)| *a == 2.0 * *b));
    assert!(twice.direct.iter().zip(&same.direct).all(|(a, b)| *a == 2.0 * *b));
    let red = relit(&[Rgb::X; 4]);
    assert!(red.indirect.iter().zip(&same.indirect).all(|(a, b)| a.y == 0.0 && a.z == 0.0 && a.x == b.x));
    let dark = relit(&[Rgb::ZERO; 4]);
    assert!(dark.indirect.iter().chain(&dark.direct).all(|e| *e == Rgb::ZERO) && dark.bound == 0.0);
    let other = relit(&[Rgb::ONE, Rgb::splat(1.01), Rgb::ONE, Rgb::ONE]);
    assert!(difference(&other.indirect, &before) > 1e-4, "negative control");
}

/// What was solved by group adds up to what is solved at once, within the bounds, and proves to in one sweep.
#[test]
fn solved_groups_make_a_change_of_light_a_sum() {
    let linked = Lit::new(room(1), DirectEstimator::Lights).link(&options(3, 64));
    let system = System::of(linked.basis.hierarchy());
    let mut relighting = relighting(linked);
    let factors = [Rgb::splat(0.3), Rgb::new(2.0, 0.0, 5.0), Rgb::ZERO, Rgb::splat(7.0)];
    let solved = relighting.relight(&factors, &TIGHT, &NoProgress).unwrap();
    assert!(weighted_sum(&system, relighting.groups(), &factors).unwrap().is_none());
    let loose = SolveOptions { tolerance: 1e-3, ..TIGHT };
    relighting.solve_groups(&loose, &NoProgress).unwrap();
    // Bounds are relative to the mean of a region and channel; here there is one region.
    let of_channel = |a: &Relit, k: usize| {
        let areas = system.unknowns().areas;
        let total: f32 = areas.iter().sum();
        let mean = solved.indirect.iter().zip(areas).map(|(e, area)| e[k] * area / total).sum::<f32>();
        a.indirect.iter().zip(&solved.indirect).map(|(a, b)| (a[k] - b[k]).abs()).fold(0.0, f32::max) / mean
    };
    let mean_difference = |a: &Relit| [0, 1, 2].map(|k| of_channel(a, k)).into_iter();
    let by_sum = weighted_sum(&system, relighting.groups(), &factors).unwrap().unwrap();
    assert!(by_sum.bound <= 1.1e-3 && by_sum.solve.is_none());
    assert!(mean_difference(&by_sum).all(|d| d <= by_sum.bound + 2e-6), "{:?}", by_sum.bound);
    assert!(mean_difference(&by_sum).any(|d| d > 2e-6), "negative control: the groups are solved loosely");
    let proved = relighting.relight(&factors, &loose, &NoProgress).unwrap();
    assert!(proved.bound <= 1e-3 && mean_difference(&proved).all(|d| d <= proved.bound + 2e-6));
    assert_eq!(proved.solve.as_ref().unwrap().sweeps, 1);
    // A dark group needs no solution of its own.
    let (_, mut groups) = relighting.into_parts();
    groups[2].solved = None;
    assert_eq!(weighted_sum(&system, &groups, &factors).unwrap().unwrap().indirect, by_sum.indirect);
}

/// What bounds errors is kept beside the links; whatever stands there instead, a bound holds.
#[test]
fn a_kept_barrier_bounds_as_before_and_a_wrong_one_never_wrongly() {
    let linked = Lit::new(room(1), DirectEstimator::Lights).link(&options(2, 64));
    let (n, system) = (linked.links.n_rows(), System::of(linked.basis.hierarchy()));
    let (links, groups) = (linked.links.clone(), linked.groups.clone());
    let fresh = relighting(linked);
    let loose = SolveOptions { tolerance: 1e-2, ..TIGHT };
    let exact = fresh.relight(&[Rgb::ONE; 4], &TIGHT, &NoProgress).unwrap();
    let relit = |barrier: &[Rgb]| {
        let (links, groups) = (links.clone(), groups.clone());
        let kept = Relighting::with_barrier(links, barrier, system.clone(), groups, &NoProgress).unwrap();
        kept.relight(&[Rgb::ONE; 4], &loose, &NoProgress).unwrap()
    };
    let (before, kept) = (fresh.relight(&[Rgb::ONE; 4], &loose, &NoProgress).unwrap(), relit(&fresh.barrier()));
    assert!(!fresh.barrier().is_empty() && (kept.bound / before.bound - 1.0).abs() < 1e-3, "{}", kept.bound);
    let areas = system.unknowns().areas;
    let mean = exact.indirect.iter().zip(areas).map(|(e, a)| *e * *a).sum::<Rgb>() / areas.iter().sum::<f32>();
    for barrier in [vec![Rgb::ONE; n], vec![Rgb::splat(1e-30); n], vec![Rgb::splat(f32::MAX); n], fresh.barrier()] {
        let relit = relit(&barrier);
        let error = |(a, b): (&Rgb, &Rgb)| ((*a - *b).abs() / mean).max_element();
        let error = relit.indirect.iter().zip(&exact.indirect).map(error).fold(0.0, f32::max);
        assert!(error <= relit.bound + 2e-6 && relit.bound <= 1e-2, "{error} {}", relit.bound);
    }
}

#[test]
fn bits_do_not_depend_on_threads() {
    let lit = Lit::new(room(6), DirectEstimator::Lights);
    let run = |n_threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| {
            let mut relighting = relighting(lit.link(&options(3, 32)));
            let factors = [Rgb::ZERO, Rgb::splat(3.0), Rgb::ONE, Rgb::splat(0.1)];
            let relit = relighting.relight(&factors, &TIGHT, &NoProgress).unwrap();
            relighting.solve_groups(&TIGHT, &NoProgress).unwrap();
            (relit, relighting.into_parts())
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn factors_that_no_light_can_have_are_refused_by_name() {
    let linked = Lit::new(room(1), DirectEstimator::Lights).link(&options(1, 8));
    let system = System::of(linked.basis.hierarchy());
    let relighting = relighting(linked);
    for bad in [-1.0, f32::NAN, f32::INFINITY] {
        let factors = [Rgb::ONE, Rgb::new(1.0, 1.0, bad), Rgb::ONE, Rgb::ONE];
        let is_named = |error: Error| matches!(error, Error::Factor { group, .. } if group == "side lamp");
        assert!(is_named(relighting.relight(&factors, &TIGHT, &NoProgress).unwrap_err()));
        assert!(is_named(weighted_sum(&system, relighting.groups(), &factors).unwrap_err()));
    }
    let too_bright = relighting.relight(&[Rgb::splat(f32::MAX); 4], &TIGHT, &NoProgress);
    assert!(matches!(too_bright, Err(Error::NotFinite { .. })));
}

#[test]
fn links_from_one_region_to_another_are_refused() {
    let mut builder = SceneBuilder::new();
    for (name, x) in [("left", 0.0), ("right", 3.0)] {
        let wall = builder.push_material(Material::emitter(name, Rgb::splat(0.5), Rgb::ONE));
        Shape::new().room(DVec3::new(x, 0.0, 0.0), DVec3::new(x + 1.0, 1.0, 1.0)).push_into(&mut builder, name, wall);
    }
    let linked = Lit::new(scenes::build(builder), DirectEstimator::Hemisphere).link(&options(2, 64));
    let hierarchy = linked.basis.hierarchy().clone();
    let system = System::of(&hierarchy);
    let n = system.len();
    let components = system.unknowns().components.to_vec();
    let other = components.iter().position(|&c| c != components[0]).expect("two lit regions");
    let mut links = SparseRows::new(n);
    links.push_row(&[(other as u32, Rgb::splat(0.1))]);
    (1..n).for_each(|_| links.push_row(&[]));
    let refused = Relighting::new(links, system.clone(), linked.groups.clone(), &NoProgress);
    assert!(matches!(refused, Err(Error::Links { row: 0, .. })));
    assert!(Relighting::new(linked.links, system, linked.groups, &NoProgress).is_ok(), "negative control");
}

/// The same samples, split: what each group brings directly adds up to the bit-identical whole, to rounding.
#[test]
fn direct_light_by_group_is_that_of_the_same_rays() {
    let lit = Lit::new(room(6), DirectEstimator::Lights);
    let points = &lit.points.levels[0].points;
    let light = DirectLight::new(&lit.scene, DirectOptions::projection());
    let whole = direct_irradiance(&light, &lit.bvh, points, Stage::Direct, &NoProgress).unwrap();
    let (sums, parts) = direct_irradiance_by_group(&light, &lit.bvh, points, Stage::Direct, &NoProgress).unwrap();
    assert_eq!(sums, whole);
    assert!(difference(&sum(parts.iter()), &whole) < 2e-6);
}
