//! Levels of maximal Poisson-disk sets over the surface that light reaches.

use hplt_geom::{OrientedPoint, PointHierarchy, PointLevel, Progress, RayCaster, Scene, parallel};

use crate::candidates::{Candidates, random_points};
use crate::components::Components;
use crate::morton::{coherent_order, morton_code};
use crate::options::{HierarchyOptions, LevelPlan};
use crate::poisson::Level;
use crate::random::Stage;
use crate::report::{HierarchyReport, Warning};
use crate::surface::SideSampler;
use crate::visibility::extent_of;
use crate::{Error, Regions};

/// Fresh points that measure the coverage, at most.
const MAX_FRESH: usize = 1 << 15;
/// Fresh points over the largest uncovered share that is accepted: enough to tell it from twice as much.
const FRESH_FOR_ONE: f64 = 100.0;
/// Fresh points per candidate, at most.
const FRESH_PER_CANDIDATE: usize = 2;
/// Times that the candidates grow by half before the rest of the gaps is accepted.
const MAX_ROUNDS: usize = 8;
/// A round after which more than this share of the gaps is left is the last: they are slivers, which no number of functions of
/// this size fills.
const LEAST_GAIN: f64 = 0.5;
/// Candidates per point from which areas are counted on a coarse level.
const AREA_CANDIDATES: usize = 16;
const STAGE: &str = "placing points";

/// What [`poisson_hierarchy`] makes.
#[derive(Debug, Clone)]
pub struct Hierarchy {
    /// The points.
    pub points: PointHierarchy,
    /// The regions of the air, to locate other points.
    pub regions: Regions,
    /// Counts and warnings.
    pub report: HierarchyReport,
}

/// Levels of Poisson-disk sets over the surface that light reaches, radii halving.
///
/// On every level, no two points of a region are nearer than `r` in the metric of
/// [`rejection_distance_squared`](crate::poisson::rejection_distance_squared), and every candidate is a point or that near
/// to one. Where a thousandth of the surface or more may be left uncovered, that holds for all candidates on the finest level, and on
/// each of the others for the first ones, some ten per point, and those of small parts: with all of them a coarse level would end up
/// with a function for every sliver between two others. Candidates are added until no more than `max_uncovered` of the surface is
/// left without a function of the finest level, or, where slivers may be left, until they help little. They are uniform in area, with at least one on each side of every connected component. Points carry the
/// area that they stand for (their share of the candidates) and lie along a Morton curve. Runs in parallel; the same bits at
/// any thread count.
///
/// # Errors
/// On options out of range, when even the coarsest level would exceed `max_points` (before it is allocated), and when
/// cancelled.
pub fn poisson_hierarchy(
    scene: &Scene,
    caster: &dyn RayCaster,
    options: &HierarchyOptions,
    progress: &dyn Progress,
) -> Result<Hierarchy, Error> {
    options.check()?;
    let components = Components::find(scene.mesh());
    let regions = Regions::build_on(scene, caster, &components, options.seed, progress)?;
    let sampler = SideSampler::build(scene, |material, is_front| material.reflects.includes(is_front));
    let plan = LevelPlan::make(scene, options, sampler.area(), regions.lit_share())?;
    let mut report = HierarchyReport { warnings: plan.warnings.clone(), ..HierarchyReport::default() };
    let mut candidates = Candidates::new(scene, caster, &regions, &sampler, options.seed);
    let mut levels: Vec<Level> = plan.radii.iter().map(|&r| Level::new(r, plan.expected(r))).collect();
    if regions.n_regions() > 0 {
        fill(&mut levels, (&mut candidates, &components), &plan, options, &mut report, progress)?;
    } else {
        report.warnings.push(Warning::NothingReachable);
        levels.truncate(1);
    }
    let n_points: usize = levels.iter().map(Level::len).sum();
    report.candidates = candidates.n_drawn();
    report.n_rays = regions.n_rays() + candidates.n_rays();
    report.reachable_fraction = candidates.reachable_fraction();
    report.dark_fraction = 1.0 - report.reachable_fraction;
    report.n_regions = regions.n_regions();
    report.memory = n_points * size_of::<OrientedPoint>() + regions.memory();
    report.peak_memory = report.memory + size_of_val(candidates.points());
    let scale = scene.frame().scale();
    report.reachable_area = candidates.reachable_area() * scale * scale;
    let levels: Vec<PointLevel> = finish(levels, &candidates, &plan);
    report.points_per_level = levels.iter().map(|level| level.points.len() as u64).collect();
    report.radii = levels.iter().map(|level| f64::from(level.poisson_radius) * scale).collect();
    let points = PointHierarchy { levels, n_regions: regions.n_regions() };
    Ok(Hierarchy { points, regions, report })
}

/// Throws candidates on all levels until fresh points find themselves covered.
fn fill(
    levels: &mut [Level],
    (candidates, components): (&mut Candidates<'_>, &Components),
    plan: &LevelPlan,
    options: &HierarchyOptions,
    report: &mut HierarchyReport,
    progress: &dyn Progress,
) -> Result<(), Error> {
    let mut wanted = plan.n_candidates;
    let mut before = f64::INFINITY;
    for round in 0..MAX_ROUNDS {
        let first = candidates.points().len();
        candidates.draw(wanted, progress)?;
        if round == 0 {
            candidates.draw_on_small_components(components);
        }
        throw_all(levels, (candidates, first), plan, progress)?;
        let fresh = (FRESH_FOR_ONE / options.max_uncovered.max(f64::MIN_POSITIVE)).min(MAX_FRESH as f64) as usize;
        report.uncovered_fraction = uncovered_fraction(levels, candidates, fresh, round as u32);
        if report.uncovered_fraction <= options.max_uncovered {
            return Ok(());
        }
        if options.accepts_slivers() && report.uncovered_fraction > LEAST_GAIN * before {
            break;
        }
        before = report.uncovered_fraction;
        wanted = candidates.points().len() / 2;
    }
    report.warnings.push(Warning::Uncovered { fraction: report.uncovered_fraction });
    Ok(())
}

/// Offers the candidates from `first` on to the levels, in batches that double: to the finest all, to the others as many as
/// they need.
fn throw_all(
    levels: &mut [Level],
    (candidates, first): (&Candidates<'_>, usize),
    plan: &LevelPlan,
    progress: &dyn Progress,
) -> Result<(), Error> {
    let (points, caster) = (candidates.points(), candidates.caster());
    let mut start = first;
    let mut batches: Vec<Vec<u32>> = Vec::new();
    while start < points.len() {
        let end = (2 * start).max(1024).min(points.len());
        let order = coherent_order(end - start, |i| points[start + i].position).into_iter();
        batches.push(order.map(|i| start as u32 + i).collect());
        start = end;
    }
    let finest = levels.len() - 1;
    let cells: Vec<std::sync::Mutex<&mut Level>> = levels.iter_mut().map(std::sync::Mutex::new).collect();
    parallel::try_map(
        cells.len(),
        || (),
        |(), i| {
            // The finest level takes longest, so it starts first. Nobody else locks it.
            let mut level = cells[finest - i].lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            let (radius, support) = (level.radius(), 2.0 * level.radius());
            let n_needed = if i == 0 { usize::MAX } else { plan.n_needed(radius).unwrap_or(usize::MAX) };
            let is_needed = |k: &u32| (*k as usize) < n_needed || !candidates.is_uniform(*k as usize);
            for batch in &batches {
                progress.check()?;
                let batch: Vec<u32> = batch.iter().copied().filter(is_needed).collect();
                level.throw(points, &batch, |point| extent_of((candidates.scene(), caster), point, support));
            }
            level.settle();
            progress.advance(STAGE, i as u64 + 1, cells.len() as u64);
            Ok(())
        },
    )
    .map(|_: Vec<()>| ())
}

fn uncovered_fraction(levels: &[Level], candidates: &mut Candidates<'_>, most: usize, round: u32) -> f64 {
    let n = (FRESH_PER_CANDIDATE * candidates.points().len()).min(most);
    let fresh = candidates.fresh(n, round);
    let Some(finest) = levels.last() else { return 0.0 };
    let missed = parallel::map(fresh.len(), || (), |(), i| !finest.covers(&fresh[i]));
    missed.iter().filter(|&&missed| missed).count() as f64 / fresh.len().max(1) as f64
}

/// Areas and order.
fn finish(levels: Vec<Level>, candidates: &Candidates<'_>, plan: &LevelPlan) -> Vec<PointLevel> {
    let order = coherent_order(candidates.points().len(), |i| candidates.points()[i].position);
    let share = |l: usize| {
        let counts = count_owned(&levels[l], candidates, &order);
        let n_used: u64 = counts.iter().map(|&n| u64::from(n)).sum();
        let unit = candidates.reachable_area() / n_used.max(1) as f64;
        counts.iter().map(|&count| (f64::from(count) * unit) as f32).collect::<Vec<_>>()
    };
    let areas: Vec<Vec<f32>> = parallel::map(levels.len(), || (), |(), l| share(l));
    let in_order = |level: Level, areas: &[f32]| {
        let mut points = level.into_points();
        points.iter_mut().zip(areas).for_each(|(point, &area)| point.area = area);
        let mut keys: Vec<(u64, u32)> =
            points.iter().enumerate().map(|(i, point)| (morton_code(point.position), i as u32)).collect();
        keys.sort_unstable();
        keys.iter().map(|&(_, i)| points[i as usize]).collect::<Vec<_>>()
    };
    let together = levels.into_iter().zip(&areas).zip(&plan.radii);
    together.map(|((level, areas), &r)| PointLevel::new(r, in_order(level, areas))).collect()
}

/// For each point of a level the number of uniform candidates that it is the nearest of; all candidates, or on coarse
/// levels the first ones. `order` lists them all.
fn count_owned(level: &Level, candidates: &Candidates<'_>, order: &[u32]) -> Vec<u32> {
    const CHUNK: usize = 4096;
    let end = (AREA_CANDIDATES * level.len()).max(1 << 16);
    let owners = parallel::map(
        order.len().div_ceil(CHUNK),
        || (),
        |(), chunk| {
            let chunk = &order[chunk * CHUNK..order.len().min((chunk + 1) * CHUNK)];
            let used = chunk.iter().map(|&i| i as usize).filter(|&i| i < end && candidates.is_uniform(i));
            used.filter_map(|i| level.nearest(&candidates.points()[i])).collect::<Vec<_>>()
        },
    );
    let mut counts = vec![0u32; level.len()];
    owners.into_iter().flatten().for_each(|owner| counts[owner as usize] += 1);
    counts
}

/// `n` points of the surface that light reaches, uniform in area and independent of the candidates: for measuring
/// errors. Each stands for an equal share of the reachable area. Fewer than `n`, possibly none, when hardly anything is
/// reachable.
pub fn random_surface_points(
    scene: &Scene,
    caster: &dyn RayCaster,
    regions: &Regions,
    n: usize,
    seed: u64,
) -> Vec<OrientedPoint> {
    let sampler = SideSampler::build(scene, |material, is_front| material.reflects.includes(is_front));
    let (mut points, drawn) = random_points(scene, caster, regions, &sampler, (seed, Stage::Error, 0), n);
    let area = (sampler.area() / drawn.max(1) as f64) as f32;
    points.iter_mut().for_each(|point| point.area = area);
    points
}
