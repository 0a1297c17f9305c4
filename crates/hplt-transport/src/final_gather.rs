use hplt_geom::{Hit, Interrupted, OrientedPoint, Progress, Ray, RegionId, Rgb, offset_origin, parallel};
use hplt_sampling::random::{Stage, Stream, unit_f32};
use hplt_sampling::warp;

use crate::direct::Shadows;
use crate::gather::{Counter, GROUPS, Groups, Scratch, arrival, scramble};
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
    /// Where given, rays that meet surface nearer than the support of the finest sender level do not read the field, which is
    /// too coarse to tell what happens at such a distance: they sample this light there and go on. Best with
    /// [`DirectOptions::one_sample`](crate::DirectOptions::one_sample). Off in scenes lit by hemisphere.
    pub contact_light: Option<&'a DirectLight<'a>>,
}

/// The indirect irradiance at arbitrary points by a gather each over `sender`, the total (direct and indirect) irradiance.
/// The error of the basis enters only after one more bounce, and, with a
/// [`contact_light`](FinalGatherOptions::contact_light), only from far enough for it to be small.
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
    let contact = options.contact_light.filter(|light| !light.is_by_hemisphere());
    let gathering = Gathering { model, sender, options, contact, near: near_distance(model, sender) };
    parallel::try_map(points.len(), Buffers::default, |buffers, i| {
        counter.step()?;
        Ok(gathering.point(&points[i], i as u32, buffers))
    })
}

/// The support of the finest sender level.
fn near_distance<E>(model: &Model<'_>, sender: &Sender<'_, E>) -> f32 {
    let n_levels = sender.n_levels.min(model.basis.n_levels());
    n_levels.checked_sub(1).map_or(0.0, |finest| model.basis.support(finest))
}

#[derive(Default)]
struct Buffers {
    scratch: Scratch,
    shadows: Shadows,
    paths: Vec<Path>,
    rays: Vec<Ray>,
    hits: Vec<Hit>,
}

/// A ray that met surface nearby and goes on from there.
#[derive(Clone, Copy)]
struct Path {
    /// The ray of the receiver that it began with.
    ray: u32,
    /// The product of the albedos so far.
    throughput: Rgb,
    at: OrientedPoint,
}

struct Gathering<'a, E> {
    model: &'a Model<'a>,
    sender: &'a Sender<'a, E>,
    options: FinalGatherOptions<'a>,
    contact: Option<&'a DirectLight<'a>>,
    near: f32,
}

impl<E> Gathering<'_, E> {
    fn point(&self, receiver: &OrientedPoint, id: u32, buffers: &mut Buffers) -> FinalGather {
        if receiver.region == RegionId::DARK {
            return FinalGather { irradiance: Rgb::ZERO, noise: Rgb::ZERO, escaped: 0 };
        }
        let n_rays = self.options.n_rays.max(GROUPS as u32);
        let scramble = scramble(self.options.seed, self.options.stage, id);
        let scratch = &mut buffers.scratch;
        scratch.trace(self.model, receiver, scramble, n_rays);
        buffers.paths.clear();
        let mut escaped = 0;
        for k in 0..n_rays {
            let hit = scratch.hits[k as usize];
            let begin = Path { ray: k, throughput: Rgb::ONE, at: *receiver };
            if hit.is_miss() {
                escaped += 1;
            } else if let Some(path) = self.arrive(&begin, &hit, scratch, 0) {
                buffers.paths.push(path);
            }
        }
        let mut groups = Groups::new(n_rays);
        for segment in 1..=MAX_SEGMENTS {
            if buffers.paths.is_empty() {
                break;
            }
            self.advance(segment, id, buffers, &mut groups);
        }
        buffers.scratch.read_queries(self.model, self.sender, &mut groups);
        let (irradiance, noise) = groups.mean_and_noise();
        FinalGather { irradiance, noise, escaped }
    }

    /// What becomes of a path that meets surface: it goes on when that is near, else the field is to be read there.
    fn arrive(&self, path: &Path, hit: &Hit, scratch: &mut Scratch, segment: u32) -> Option<Path> {
        let surface = self.model.scene.surface_at(hit);
        let throughput = path.throughput * self.model.scene.albedo(&surface);
        if throughput == Rgb::ZERO {
            return None;
        }
        let at = arrival(&surface, path.at.region);
        if self.contact.is_some() && hit.t < self.near && segment < MAX_SEGMENTS {
            return Some(Path { throughput, at, ..*path });
        }
        scratch.push_query(path.ray, throughput, at);
        None
    }

    /// Lights all paths where they are and sends each on along one ray.
    fn advance(&self, segment: u32, id: u32, buffers: &mut Buffers, groups: &mut Groups) {
        let Buffers { scratch, shadows, paths, rays, hits } = buffers;
        let Some(light) = self.contact else { return };
        let stream = Stream::new(self.options.seed, self.options.stage);
        rays.clear();
        for path in paths.iter() {
            let [a, b, c, _] = stream.words(id, path.ray, segment);
            let sample = (self.options.stage, c);
            let direct = light.irradiance(self.model.caster, &path.at, sample, shadows);
            groups.add(path.ray, path.throughput * direct);
            let u = glam::Vec2::new(unit_f32(a), unit_f32(b));
            let direction = warp::cosine_hemisphere(u, path.at.normal);
            rays.push(Ray::new(offset_origin(path.at.position, path.at.normal), direction));
        }
        hits.clear();
        hits.resize(rays.len(), Hit::MISS);
        self.model.caster.trace_nearest(rays, hits);
        let mut next = Vec::with_capacity(paths.len());
        for (path, hit) in paths.iter().zip(hits.iter()) {
            if !hit.is_miss() {
                next.extend(self.arrive(path, hit, scratch, segment));
            }
        }
        *paths = next;
    }
}
