use glam::Vec2;
use hplt_geom::{Hit, Interrupted, OrientedPoint, Progress, Ray, RegionId, Rgb, offset_origin, parallel};
use hplt_sampling::random::{Stage, Stream, unit_f32};
use hplt_sampling::warp;

use crate::gather::{Counter, GROUPS, Groups, Scratch, arrival, scramble};
use crate::next_event::NextEvents;
use crate::{DirectLight, Model, Sender};

/// A path that keeps meeting surface this near ends by reading the field all the same after so many segments.
const MAX_SEGMENTS: u32 = 16;

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
#[derive(Debug, Clone, Copy)]
pub struct FinalGatherOptions<'a> {
    /// Rays per point; a power of two, at least 8.
    pub n_rays: u32,
    /// With the seed it selects the rays: [`Stage::Error`] gives rays that no solver stage has used.
    pub stage: Stage,
    /// Seed.
    pub seed: u64,
    /// Sampled wherever a ray lands.
    pub light: &'a DirectLight<'a>,
    /// Rays that meet surface nearer than this, in supports of the functions there, do not read the field, which is too coarse
    /// to tell what happens at such a distance: they go on. 0 never, 1 usually.
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
    let counter = Counter::new(progress, "final gather", points.len());
    let n_levels = sender.n_levels.min(model.basis.n_levels());
    let coarsest = model.basis.coarsest_read(n_levels);
    let farthest_contact = if n_levels == 0 { 0.0 } else { options.contact * model.basis.support(coarsest) };
    let gathering = Gathering { model, sender, options, n_levels, farthest_contact };
    parallel::try_map(points.len(), Buffers::default, |buffers, i| {
        counter.step()?;
        Ok(gathering.point(&points[i], i as u32, buffers))
    })
}

#[derive(Default)]
struct Buffers {
    scratch: Scratch,
    events: NextEvents,
    direct: Vec<Rgb>,
    /// Where paths are now: arrival, ray of the receiver, product of the albedos so far.
    at: Vec<OrientedPoint>,
    ray: Vec<u32>,
    samples: Vec<Vec2>,
    throughput: Vec<Rgb>,
    distance: Vec<f32>,
    rays: Vec<Ray>,
    going_on: Vec<(u32, Rgb)>,
    hits: Vec<Hit>,
}

struct Gathering<'a, E> {
    model: &'a Model<'a>,
    sender: &'a Sender<'a, E>,
    options: FinalGatherOptions<'a>,
    n_levels: usize,
    farthest_contact: f32,
}

impl<E> Gathering<'_, E> {
    fn point(&self, receiver: &OrientedPoint, id: u32, buffers: &mut Buffers) -> FinalGather {
        if receiver.region == RegionId::DARK {
            return FinalGather { irradiance: Rgb::ZERO, noise: Rgb::ZERO, escaped: 0 };
        }
        let n_rays = self.options.n_rays.max(GROUPS as u32);
        let scramble = scramble(self.options.seed, self.options.stage, id);
        buffers.scratch.trace(self.model, receiver, scramble, n_rays);
        buffers.hits.clear();
        buffers.hits.extend_from_slice(&buffers.scratch.hits);
        let escaped = buffers.hits.iter().filter(|h| h.is_miss()).count() as u32;
        buffers.going_on.clear();
        buffers.going_on.extend((0..n_rays).map(|k| (k, Rgb::ONE)));
        let mut groups = Groups::new(n_rays);
        for segment in 1..=MAX_SEGMENTS {
            self.arrive(receiver.region, buffers);
            if buffers.at.is_empty() {
                break;
            }
            self.add_direct(id, segment, buffers, &mut groups);
            self.read_or_go_on(id, segment, buffers);
        }
        buffers.scratch.read_queries(self.model, self.sender, &mut groups);
        let (irradiance, noise) = groups.mean_and_noise();
        FinalGather { irradiance, noise, escaped }
    }

    /// Takes paths to what their rays hit.
    fn arrive(&self, region: RegionId, buffers: &mut Buffers) {
        let Buffers { at, ray, throughput, distance, going_on, hits, .. } = buffers;
        at.clear();
        ray.clear();
        throughput.clear();
        distance.clear();
        for (&(k, before), hit) in going_on.iter().zip(hits.iter()) {
            if hit.is_miss() {
                continue;
            }
            let surface = self.model.scene.surface_at(hit);
            let after = before * self.model.scene.albedo(&surface);
            if after != Rgb::ZERO {
                at.push(arrival(&surface, region));
                ray.push(k);
                throughput.push(after);
                distance.push(hit.t);
            }
        }
    }

    fn add_direct(&self, id: u32, segment: u32, buffers: &mut Buffers, groups: &mut Groups) {
        let Buffers { scratch, events, direct, at, ray, samples, throughput, .. } = buffers;
        let stream = Stream::new(self.options.seed, self.options.stage);
        samples.clear();
        samples.extend(ray.iter().map(|&k| match segment {
            1 => scratch.second[k as usize],
            _ => {
                let [_, _, c, d] = stream.words(id, k, segment - 1);
                Vec2::new(unit_f32(c), unit_f32(d))
            }
        }));
        self.options.light.irradiance_once(self.model.caster, at, samples, events, direct);
        for ((direct, throughput), &k) in direct.iter().zip(throughput.iter()).zip(ray.iter()) {
            groups.add(k, *throughput * *direct);
        }
    }

    /// Notes where the field is to be read, and casts the next ray of paths that met surface too near for that.
    fn read_or_go_on(&self, id: u32, segment: u32, buffers: &mut Buffers) {
        let Buffers { scratch, at, ray, throughput, distance, rays, going_on, hits, .. } = buffers;
        let stream = Stream::new(self.options.seed, self.options.stage);
        rays.clear();
        going_on.clear();
        for i in 0..at.len() {
            if segment == MAX_SEGMENTS || !self.is_contact(&at[i], distance[i]) {
                scratch.push_query(ray[i], throughput[i], at[i]);
                continue;
            }
            let [a, b, ..] = stream.words(id, ray[i], segment);
            let direction = warp::cosine_hemisphere(Vec2::new(unit_f32(a), unit_f32(b)), at[i].normal);
            rays.push(Ray::new(offset_origin(at[i].position, at[i].normal), direction));
            going_on.push((ray[i], throughput[i]));
        }
        hits.clear();
        hits.resize(rays.len(), Hit::MISS);
        self.model.caster.trace_nearest(rays, hits);
    }

    fn is_contact(&self, at: &OrientedPoint, distance: f32) -> bool {
        distance < self.farthest_contact && {
            let support = self.sender.reconstruction.support_at(self.model.basis, self.n_levels, at);
            distance < self.options.contact * support
        }
    }
}
