use hplt_geom::{Interrupted, OrientedPoint, Progress, RegionId, Rgb, parallel};
use hplt_sampling::random::Stage;

use crate::gather::{Counter, GROUPS, Groups};
use crate::paths::{Arrival, PathBuffers, PathSink, PathTracer};
use crate::{DirectLight, Model, Sender};

/// The usual [`FinalGatherOptions::contact`]. At 1, a gather on Sponza takes half as long again and is no better; at 0 it is a third
/// worse.
pub const CONTACT: f32 = 0.25;

/// Indirect irradiance read through one more gather.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FinalGather {
    /// Indirect irradiance, W/m².
    pub irradiance: Rgb,
    /// Its standard error from replicate groups of the point's own rays, W/m². An overestimate: a group of stratified rays is
    /// noisier than its share of all of them.
    pub noise: Rgb,
    /// Rays that left the scene.
    pub escaped: u32,
    /// Rays that were traced.
    pub n_rays: u32,
}

impl FinalGather {
    /// What this and the other one, of other rays of the same point, found together.
    fn joined(self, other: Self) -> Self {
        let n_rays = self.n_rays + other.n_rays;
        let share = |one: Self| one.n_rays as f32 / n_rays.max(1) as f32;
        let (here, there) = (share(self) * self.noise, share(other) * other.noise);
        Self {
            irradiance: share(self) * self.irradiance + share(other) * other.irradiance,
            noise: (here * here + there * there).map(f32::sqrt),
            escaped: self.escaped + other.escaped,
            n_rays,
        }
    }
}

/// The rays of a final gather.
#[derive(Debug, Clone, Copy)]
pub struct FinalGatherOptions<'a> {
    /// Rays per point; at least 8, best a power of two.
    pub n_rays: u32,
    /// With the seed it selects the rays: [`Stage::Error`] gives rays that no solver stage has used.
    pub stage: Stage,
    /// Seed.
    pub seed: u64,
    /// Sampled wherever a ray lands.
    pub light: &'a DirectLight<'a>,
    /// Rays that meet surface nearer than this, in supports of the functions there, do not read the field, which is too coarse
    /// to tell what happens at such a distance: they go on, as do those that meet surface which no function is in sight of.
    /// [`CONTACT`] usually.
    pub contact: f32,
}

/// The indirect irradiance at arbitrary points by a gather each over `sender`, the *indirect* irradiance; direct light is sampled
/// where rays land. The error of the basis enters only after two more bounces, and only from far enough for it to be small.
///
/// # Errors
/// When interrupted.
pub fn final_gather<E>(
    model: &Model<'_>,
    sender: &Sender<'_, E>,
    points: &[OrientedPoint],
    options: FinalGatherOptions<'_>,
    progress: &dyn Progress,
) -> Result<Vec<FinalGather>, Interrupted> {
    let mut found = vec![FinalGather::default(); points.len()];
    let all: Vec<usize> = (0..points.len()).collect();
    final_gather_more(model, sender, (points, &all), &mut found, options, progress)?;
    Ok(found)
}

/// Traces more rays at the points with these `indices`: `found` is what the first of their rays brought, as many at each of them, and
/// becomes what all `options.n_rays` did. The same as [`final_gather`] with so many at once, but for rounding and for how the noise is estimated.
///
/// # Errors
/// When interrupted; `found` is as it was then.
pub fn final_gather_more<E>(
    model: &Model<'_>,
    sender: &Sender<'_, E>,
    (points, indices): (&[OrientedPoint], &[usize]),
    found: &mut [FinalGather],
    options: FinalGatherOptions<'_>,
    progress: &dyn Progress,
) -> Result<(), Interrupted> {
    let Some(before) = indices.first().map(|&i| found[i].n_rays) else { return Ok(()) };
    let counter = Counter::new(progress, "final gather", indices.len());
    let n_levels = sender.n_levels.min(model.basis.n_levels());
    let tracer = PathTracer {
        scene: model.scene,
        caster: model.caster,
        light: options.light,
        seed: options.seed,
        stage: options.stage,
        rays: before..options.n_rays.max(GROUPS as u32),
        is_roulette: true,
        largest_support: if n_levels == 0 { 0.0 } else { model.basis.support(model.basis.coarsest_read(n_levels)) },
    };
    let gathering = Gathering { model, sender, contact: options.contact, n_levels, tracer };
    let more = parallel::try_map(indices.len(), PathBuffers::default, |buffers, k| {
        counter.step()?;
        let i = indices[k];
        debug_assert_eq!(found[i].n_rays, before, "as many rays at each");
        Ok(found[i].joined(gathering.point(&points[i], i as u32, buffers)))
    })?;
    indices.iter().zip(more).for_each(|(&i, joined)| found[i] = joined);
    Ok(())
}

struct Gathering<'a, E> {
    model: &'a Model<'a>,
    sender: &'a Sender<'a, E>,
    contact: f32,
    n_levels: usize,
    tracer: PathTracer<'a>,
}

impl<E> Gathering<'_, E> {
    fn point(&self, receiver: &OrientedPoint, id: u32, buffers: &mut PathBuffers) -> FinalGather {
        let n_rays = self.tracer.rays.len() as u32;
        if receiver.region == RegionId::DARK {
            return FinalGather { n_rays, ..FinalGather::default() };
        }
        let mut sink = Sink { gathering: self, groups: Groups::new(n_rays) };
        let escaped = self.tracer.trace(receiver, id, buffers, &mut sink);
        let (irradiance, noise) = sink.groups.mean_and_noise();
        FinalGather { irradiance, noise, escaped, n_rays }
    }
}

struct Sink<'a, E> {
    gathering: &'a Gathering<'a, E>,
    groups: Groups,
}

impl<E> PathSink for Sink<'_, E> {
    fn add_direct(&mut self, ray: u32, irradiance: Rgb) {
        self.groups.add(ray, irradiance);
    }

    fn read<'a>(&mut self, arrivals: &'a [Arrival], points: &[OrientedPoint], mut go_on: impl FnMut(&'a Arrival)) {
        let Gathering { model, sender, contact, n_levels, .. } = *self.gathering;
        let Sender { coefficients, reconstruction, .. } = *sender;
        let found = reconstruction.in_sight(model.basis, coefficients, n_levels, points);
        for (arrival, found) in arrivals.iter().zip(found) {
            let good = found.filter(|(_, support)| arrival.distance >= contact * support);
            let irradiance = match good {
                Some((irradiance, _)) => irradiance,
                None if !arrival.is_last => {
                    go_on(arrival);
                    continue;
                }
                None => {
                    let mut last = [Rgb::ZERO];
                    let query = std::slice::from_ref(&arrival.point);
                    reconstruction.reconstruct(model.basis, coefficients, n_levels, query, &mut last);
                    last[0]
                }
            };
            self.groups.add(arrival.ray, arrival.throughput * irradiance);
        }
    }
}
