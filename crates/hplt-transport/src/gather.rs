use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use hplt_basis::{Coefficients, Coverage, Reconstruction, ShepardBasis};
use hplt_geom::{Hit, Interrupted, OrientedPoint, Progress, Ray, RegionId, Rgb, SurfacePoint, offset_origin, parallel};
use hplt_sampling::random::{Stage, hash};
use hplt_sampling::{sobol, warp};

use crate::Model;

/// Replicate groups that a gather's rays are split into, to learn its noise.
const GROUPS: usize = 8;

/// The field that gather rays read: `B_s = ρ·F_s`.
#[derive(Clone, Copy)]
pub struct Sender<'a, E> {
    /// Irradiance that arrived at the senders.
    pub coefficients: &'a Coefficients<E>,
    /// How it is read at a hit.
    pub reconstruction: &'a dyn Reconstruction<E>,
    /// How many of the coarsest levels are read; clamped to what there is.
    pub n_levels: usize,
}

impl<E> Sender<'_, E> {
    fn read(&self, basis: &ShepardBasis, queries: &[OrientedPoint], out: &mut [Rgb]) -> Coverage {
        let n_levels = self.n_levels.min(basis.n_levels());
        self.reconstruction.reconstruct(basis, self.coefficients, n_levels, queries, out)
    }
}

/// What one gather found.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Gathered {
    pub irradiance: Rgb,
    /// Standard error from the replicate groups.
    pub noise: Rgb,
    /// Mean albedo over all rays, misses counting zero: the row sum of the operator.
    pub row_sum: Rgb,
    pub escaped: u32,
    pub coverage: Coverage,
}

/// Buffers of one worker.
#[derive(Default)]
pub(crate) struct Scratch {
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    queries: Vec<OrientedPoint>,
    albedos: Vec<Rgb>,
    ray_of_query: Vec<u32>,
    values: Vec<Rgb>,
}

impl Scratch {
    /// Traces `n_rays` cosine-distributed rays from `receiver`: hash-Owen-scrambled Sobol points, scrambled by receiver.
    fn trace(&mut self, model: &Model<'_>, receiver: &OrientedPoint, scramble: u32, n_rays: u32) {
        let origin = offset_origin(receiver.position, receiver.normal);
        self.rays.clear();
        self.rays.extend(
            (0..n_rays)
                .map(|k| Ray::new(origin, warp::cosine_hemisphere(sobol::sobol_2d(k, scramble, 0), receiver.normal))),
        );
        self.hits.clear();
        self.hits.resize(self.rays.len(), Hit::MISS);
        model.caster.trace_nearest(&self.rays, &mut self.hits);
    }
}

/// `(1/N) Σ ρ(y_k) F_s(y_k)` over the rays of `receiver`.
pub(crate) fn gather<E>(
    model: &Model<'_>,
    sender: &Sender<'_, E>,
    receiver: &OrientedPoint,
    scramble: u32,
    n_rays: u32,
    scratch: &mut Scratch,
) -> Gathered {
    scratch.trace(model, receiver, scramble, n_rays);
    let mut result = Gathered::default();
    let mut row_sum = DVec3::ZERO;
    scratch.queries.clear();
    scratch.albedos.clear();
    scratch.ray_of_query.clear();
    for (k, hit) in scratch.hits.iter().enumerate() {
        if hit.is_miss() {
            result.escaped += 1;
            continue;
        }
        let surface = model.scene.surface_at(hit);
        let albedo = model.scene.albedo(&surface);
        if albedo == Rgb::ZERO {
            continue;
        }
        row_sum += albedo.as_dvec3();
        scratch.albedos.push(albedo);
        scratch.queries.push(arrival(&surface, receiver.region));
        scratch.ray_of_query.push(k as u32);
    }
    scratch.values.clear();
    scratch.values.resize(scratch.queries.len(), Rgb::ZERO);
    result.coverage = sender.read(model.basis, &scratch.queries, &mut scratch.values);
    let mut groups = [DVec3::ZERO; GROUPS];
    for ((value, albedo), &ray) in scratch.values.iter().zip(&scratch.albedos).zip(&scratch.ray_of_query) {
        groups[ray as usize * GROUPS / n_rays as usize] += (*value * *albedo).as_dvec3();
    }
    let (mean, noise) = mean_and_noise(&groups, n_rays);
    result.irradiance = mean.as_vec3();
    result.noise = noise.as_vec3();
    result.row_sum = (row_sum / f64::from(n_rays)).as_vec3();
    result
}

/// What a gather ray meets, as a query: it is in the receiver's region, since the receiver sees it.
fn arrival(surface: &SurfacePoint, region: RegionId) -> OrientedPoint {
    OrientedPoint::new(surface.position, surface.normal, region)
}

/// The mean over all rays and its standard error over the groups.
fn mean_and_noise(groups: &[DVec3; GROUPS], n_rays: u32) -> (DVec3, DVec3) {
    let per_group = f64::from(n_rays) / GROUPS as f64;
    let mean = groups.iter().copied().sum::<DVec3>() / f64::from(n_rays);
    let squares: DVec3 = groups.iter().map(|g| (*g / per_group - mean) * (*g / per_group - mean)).sum();
    let variance = squares / (GROUPS * (GROUPS - 1)) as f64;
    (mean, DVec3::new(variance.x.sqrt(), variance.y.sqrt(), variance.z.sqrt()))
}

/// The scramble of a receiver's rays.
pub(crate) fn scramble(seed: u64, stage: Stage, id: u32) -> u32 {
    hash(seed, stage, id, 0, 0)
}

/// Counts finished items, reports them now and then, and asks whether to go on.
pub(crate) struct Counter<'p> {
    progress: &'p dyn Progress,
    stage: &'static str,
    done: AtomicU64,
    total: u64,
}

impl<'p> Counter<'p> {
    pub fn new(progress: &'p dyn Progress, stage: &'static str, total: usize) -> Self {
        Self { progress, stage, done: AtomicU64::new(0), total: total as u64 }
    }

    /// One item is about to start.
    pub fn step(&self) -> Result<(), Interrupted> {
        let done = self.done.fetch_add(1, Ordering::Relaxed);
        if done.is_multiple_of(64) {
            self.progress.advance(self.stage, done, self.total);
        }
        self.progress.check()
    }
}

/// Indirect irradiance read through one more gather.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FinalGather {
    /// Indirect irradiance, W/m².
    pub irradiance: Rgb,
    /// Its standard error from replicate groups of the point's own rays, W/m². An overestimate: a group of stratified rays is
    /// noisier than its share of all of them.
    pub noise: Rgb,
    /// Rays that left the scene.
    pub escaped: u32,
}

/// The rays of a final gather.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FinalGatherOptions {
    /// Rays per point; a power of two, at least 8.
    pub n_rays: u32,
    /// With the seed it selects the rays: [`Stage::Error`] gives rays that no solver stage has used.
    pub stage: Stage,
    /// Seed.
    pub seed: u64,
}

/// The indirect irradiance at arbitrary points by a gather each over `sender`, the total (direct and indirect) irradiance.
/// The error of the basis enters only after one more bounce.
///
/// # Errors
/// When interrupted.
pub fn final_gather<E>(
    model: &Model<'_>,
    sender: &Sender<'_, E>,
    points: &[OrientedPoint],
    options: FinalGatherOptions,
    progress: &dyn Progress,
) -> Result<Vec<FinalGather>, Interrupted> {
    let counter = Counter::new(progress, "final gather", points.len());
    parallel::try_map(points.len(), Scratch::default, |scratch, i| {
        counter.step()?;
        if points[i].region == RegionId::DARK {
            return Ok(FinalGather { irradiance: Rgb::ZERO, noise: Rgb::ZERO, escaped: 0 });
        }
        let scramble = scramble(options.seed, options.stage, i as u32);
        let n_rays = options.n_rays.max(GROUPS as u32);
        let Gathered { irradiance, noise, escaped, .. } = gather(model, sender, &points[i], scramble, n_rays, scratch);
        Ok(FinalGather { irradiance, noise, escaped })
    })
}
