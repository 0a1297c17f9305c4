use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DVec3, Vec2};
use hplt_basis::{Coefficients, Coverage, Reconstruction, ShepardBasis};
use hplt_geom::{
    Hit, Interrupted, OrientedPoint, Progress, Ray, RayCaster, RegionId, Rgb, SurfacePoint, offset_origin,
    order_by_cell,
};
use hplt_sampling::random::{Stage, hash};
use hplt_sampling::{sobol, warp};

use crate::Model;

/// Replicate groups that a gather's rays are split into, to learn its noise.
pub(crate) const GROUPS: usize = 8;

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
}

/// The rays of one receiver, neighbours in direction next to each other, so that whatever is looked up where they land is near what
/// was looked up before. Buffers of one worker.
#[derive(Default)]
pub(crate) struct Scratch {
    /// The number of each ray in its sequence, counted from the first of this gather.
    pub numbers: Vec<u32>,
    pub rays: Vec<Ray>,
    pub hits: Vec<Hit>,
    /// By number: two more coordinates of each ray's sample, for what is to be chosen where it lands.
    pub second: Vec<Vec2>,
    first: Vec<Vec2>,
    order: CellOrder,
}

impl Scratch {
    /// Traces cosine-distributed rays from `receiver`, those numbers of its sequence: hash-Owen-scrambled Sobol points, scrambled by
    /// receiver.
    pub fn trace(&mut self, caster: &dyn RayCaster, receiver: &OrientedPoint, scramble: u32, numbers: Range<u32>) {
        let origin = offset_origin(receiver.position, receiver.normal);
        self.first.clear();
        self.second.clear();
        for k in numbers {
            let [a, b, c, d] = sobol::sobol_4d(k, scramble);
            self.first.push(Vec2::new(a, b));
            self.second.push(Vec2::new(c, d));
        }
        self.order.sort(&self.first, &mut self.numbers);
        let to_world = warp::orthonormal_basis(receiver.normal);
        self.rays.clear();
        self.rays.extend(self.numbers.iter().map(|&k| {
            let direction = warp::cosine_hemisphere_in(self.first[k as usize], &to_world);
            Ray::new(origin, direction)
        }));
        self.hits.clear();
        self.hits.resize(self.rays.len(), Hit::MISS);
        caster.trace_nearest(&self.rays, &mut self.hits);
    }
}

/// Sorts points of the unit square by the cells of a grid along a Morton curve, about one point to a cell.
#[derive(Default)]
struct CellOrder {
    cells: Vec<u16>,
    ends: Vec<u32>,
}

impl CellOrder {
    /// Replaces `order` by the indices of `points`.
    fn sort(&mut self, points: &[Vec2], order: &mut Vec<u32>) {
        let Self { cells, ends } = self;
        let bits = (points.len().max(1).ilog2() / 2).min(8);
        let side = (1u32 << bits) as f32;
        cells.clear();
        cells.extend(points.iter().map(|p| interleaved((p.x * side) as u8) | interleaved((p.y * side) as u8) << 1));
        ends.resize(1 << (2 * bits), 0);
        order_by_cell(cells, ends, order);
    }
}

/// Moves bit `i` to bit `2i`.
fn interleaved(x: u8) -> u16 {
    let mut x = u16::from(x);
    x = (x | x << 4) & 0x0F0F;
    x = (x | x << 2) & 0x3333;
    (x | x << 1) & 0x5555
}

/// Gathers of several receivers, `(1/N) Σ ρ(y_k) F_s(y_k)` over the rays of each, which read the senders together: rays of
/// different receivers land side by side.
#[derive(Default)]
pub(crate) struct Batch {
    scratch: Scratch,
    surfaces: Vec<SurfacePoint>,
    albedos: Vec<Rgb>,
    gathers: Vec<Gathered>,
    landings: Vec<Landing>,
    queries: Vec<OrientedPoint>,
    values: Vec<Rgb>,
}

/// Where a ray found something that reflects light.
struct Landing {
    /// Index into the gathers of the batch.
    receiver: u32,
    ray: u32,
    albedo: Rgb,
}

impl Batch {
    /// Traces the rays of one more receiver.
    pub fn trace(&mut self, model: &Model<'_>, receiver: &OrientedPoint, scramble: u32, n_rays: u32) {
        self.scratch.trace(model.caster, receiver, scramble, 0..n_rays);
        let mut gathered = Gathered::default();
        let mut row_sum = DVec3::ZERO;
        let landed = || self.scratch.numbers.iter().zip(&self.scratch.hits).filter(|(_, hit)| !hit.is_miss());
        self.surfaces.clear();
        self.surfaces.extend(landed().map(|(_, hit)| model.scene.surface_at(hit)));
        gathered.escaped = n_rays - self.surfaces.len() as u32;
        model.scene.albedos(&self.surfaces, &mut self.albedos);
        for (((&ray, _), surface), &albedo) in landed().zip(&self.surfaces).zip(&self.albedos) {
            if albedo == Rgb::ZERO {
                continue;
            }
            row_sum += albedo.as_dvec3();
            self.landings.push(Landing { receiver: self.gathers.len() as u32, ray, albedo });
            self.queries.push(arrival(surface, receiver.region));
        }
        gathered.row_sum = (row_sum / f64::from(n_rays)).as_vec3();
        self.gathers.push(gathered);
    }

    /// Reads the senders wherever the `n_rays` rays of each receiver have landed, and empties the batch.
    pub fn read<E>(&mut self, model: &Model<'_>, sender: &Sender<'_, E>, n_rays: u32) -> (Vec<Gathered>, Coverage) {
        self.values.clear();
        self.values.resize(self.queries.len(), Rgb::ZERO);
        let coverage = sender.read(model.basis, &self.queries, &mut self.values);
        let mut groups = vec![Groups::new(n_rays); self.gathers.len()];
        for (landing, value) in self.landings.iter().zip(&self.values) {
            groups[landing.receiver as usize].add(landing.ray, *value * landing.albedo);
        }
        self.landings.clear();
        self.queries.clear();
        let mut gathers = std::mem::take(&mut self.gathers);
        for (gathered, groups) in gathers.iter_mut().zip(groups) {
            (gathered.irradiance, gathered.noise) = groups.mean_and_noise();
        }
        (gathers, coverage)
    }
}

/// What a gather ray meets, as a query: it is in the receiver's region, since the receiver sees it.
pub(crate) fn arrival(surface: &SurfacePoint, region: RegionId) -> OrientedPoint {
    OrientedPoint::new(surface.position, surface.normal, region)
}

/// What the rays of one receiver bring, in groups of consecutive rays.
#[derive(Clone)]
pub(crate) struct Groups {
    sums: [DVec3; GROUPS],
    n_rays: u32,
}

impl Groups {
    pub fn new(n_rays: u32) -> Self {
        Self { sums: [DVec3::ZERO; GROUPS], n_rays }
    }

    /// Enters what ray `ray` brings.
    pub fn add(&mut self, ray: u32, irradiance: Rgb) {
        self.sums[(u64::from(ray) * GROUPS as u64 / u64::from(self.n_rays)) as usize] += irradiance.as_dvec3();
    }

    /// The mean over all rays and its standard error over the groups.
    pub fn mean_and_noise(&self) -> (Rgb, Rgb) {
        let per_group = f64::from(self.n_rays) / GROUPS as f64;
        let mean = self.sums.iter().copied().sum::<DVec3>() / f64::from(self.n_rays);
        let squares: DVec3 = self.sums.iter().map(|s| (*s / per_group - mean) * (*s / per_group - mean)).sum();
        let variance = squares / (GROUPS * (GROUPS - 1)) as f64;
        (mean.as_vec3(), DVec3::new(variance.x.sqrt(), variance.y.sqrt(), variance.z.sqrt()).as_vec3())
    }
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
