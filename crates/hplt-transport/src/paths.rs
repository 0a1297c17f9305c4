//! The paths of one gather: from a receiver to where the field is read.

use std::ops::Range;

use glam::Vec2;
use hplt_geom::{Extent, Hit, LightGroupId, OrientedPoint, Ray, RayCaster, Rgb, Scene, SurfacePoint, offset_origin};
use hplt_sampling::random::{Stage, Stream, unit_f32};
use hplt_sampling::{FreeHeights, SIGHT_LIFT, warp};

use crate::DirectLight;
use crate::gather::{Scratch, arrival, scramble};
use crate::next_event::NextEvents;
use crate::sight::SLIT;

/// A path that finds nowhere to read ends by reading all the same after so many segments.
const MAX_SEGMENTS: u32 = 16;
/// Throughput below which paths end by Russian roulette.
const LITTLE: f32 = 0.5;

/// How gathers trace their paths.
pub(crate) struct PathTracer<'a> {
    pub scene: &'a Scene,
    pub caster: &'a dyn RayCaster,
    /// Sampled wherever a path arrives.
    pub light: &'a DirectLight<'a>,
    pub seed: u64,
    pub stage: Stage,
    /// Which rays of the sequence of every receiver.
    pub rays: Range<u32>,
    /// Whether paths that carry little end at random everywhere, the others standing for them, or only in slits: rows of links add up
    /// to albedos where none end.
    pub is_roulette: bool,
    /// The largest support that is read, scene units. Where paths arrive lower than functions of that size see, the air above is
    /// measured.
    pub largest_support: f32,
}

/// Where a path is.
#[derive(Clone, Copy)]
pub(crate) struct Arrival {
    /// As a query.
    pub point: OrientedPoint,
    /// The ray of the receiver that began it, counted from the first of this gather.
    pub ray: u32,
    /// Product of the albedos so far, here included.
    pub throughput: Rgb,
    /// Length of its last segment, scene units.
    pub distance: f32,
    /// Whether it ends here.
    pub is_last: bool,
}

/// What becomes of the paths of a receiver.
pub(crate) trait PathSink {
    /// `irradiance` comes straight from lights by way of the path that began with `ray`; the albedos are in it.
    fn add_direct(&mut self, ray: u32, irradiance: Rgb);

    /// Whether [`add_direct_of`](Self::add_direct_of) is to be called too.
    fn wants_groups(&self) -> bool {
        false
    }

    /// What of [`add_direct`](Self::add_direct) comes from that group of lights.
    fn add_direct_of(&mut self, _group: LightGroupId, _irradiance: Rgb) {}

    /// Reads the field at `arrivals`, which are at `points`, unless that is no good place to read, which must be fine for a last
    /// arrival. Calls `go_on` with those that were not read: their paths go on.
    fn read<'a>(&mut self, arrivals: &'a [Arrival], points: &[OrientedPoint], go_on: impl FnMut(&'a Arrival));
}

/// Buffers of one worker.
#[derive(Default)]
pub(crate) struct PathBuffers {
    pub first: Scratch,
    events: NextEvents,
    direct: Vec<Rgb>,
    surfaces: Vec<SurfacePoint>,
    albedos: Vec<Rgb>,
    at: Vec<Arrival>,
    /// Arrivals above which the air is to be measured.
    low: Vec<u32>,
    heights: FreeHeights,
    points: Vec<OrientedPoint>,
    samples: Vec<Vec2>,
    /// Paths under way: ray of the receiver and throughput.
    going_on: Vec<(u32, Rgb)>,
    rays: Vec<Ray>,
    hits: Vec<Hit>,
}

impl PathTracer<'_> {
    /// Traces the paths of the receiver with this `id` and returns how many of their first rays left the scene.
    pub fn trace(&self, receiver: &OrientedPoint, id: u32, buffers: &mut PathBuffers, sink: &mut impl PathSink) -> u32 {
        let scramble = scramble(self.seed, self.stage, id);
        buffers.first.trace(self.caster, receiver, scramble, self.rays.clone());
        buffers.hits.clone_from(&buffers.first.hits);
        buffers.rays.clone_from(&buffers.first.rays);
        buffers.going_on.clear();
        buffers.going_on.extend(buffers.first.numbers.iter().map(|&k| (k, Rgb::ONE)));
        for segment in 1..=MAX_SEGMENTS {
            self.arrive(receiver, segment, buffers);
            if buffers.at.is_empty() {
                break;
            }
            self.add_direct(id, segment, buffers, sink);
            self.read_or_go_on(id, segment, buffers, sink);
        }
        buffers.first.hits.iter().filter(|h| h.is_miss()).count() as u32
    }

    /// Takes paths to what their rays hit.
    fn arrive(&self, receiver: &OrientedPoint, segment: u32, buffers: &mut PathBuffers) {
        let PathBuffers { surfaces, albedos, at, low, heights, going_on, rays, hits, .. } = buffers;
        let landed = || going_on.iter().zip(rays.iter()).zip(hits.iter()).filter(|(_, hit)| !hit.is_miss());
        surfaces.clear();
        surfaces.extend(landed().map(|(_, hit)| self.scene.surface_at(hit)));
        self.scene.albedos(surfaces, albedos);
        at.clear();
        low.clear();
        for ((((ray, before), cast), hit), (surface, albedo)) in landed().zip(surfaces.iter().zip(albedos.iter())) {
            let throughput = *before * *albedo;
            if throughput != Rgb::ZERO {
                // Where the path came from high above, the free air is known to be enough.
                let height = -hit.t * cast.direction.dot(surface.normal);
                if height < SIGHT_LIFT * self.largest_support {
                    low.push(at.len() as u32);
                }
                let point = arrival(surface, receiver.region);
                at.push(Arrival { point, ray: *ray, throughput, distance: hit.t, is_last: segment == MAX_SEGMENTS });
            }
        }
        let places = low.iter().map(|&i| (at[i as usize].point.position, at[i as usize].point.normal));
        let heights: Vec<f32> = heights.of(self.caster, places).collect();
        for (&i, height) in low.iter().zip(heights) {
            at[i as usize].point.extent = Extent::of_query(height);
        }
    }

    fn add_direct(&self, id: u32, segment: u32, buffers: &mut PathBuffers, sink: &mut impl PathSink) {
        let PathBuffers { first, events, direct, at, points, samples, .. } = buffers;
        let stream = Stream::new(self.seed, self.stage);
        points.clear();
        points.extend(at.iter().map(|a| a.point));
        samples.clear();
        samples.extend(at.iter().map(|a| match segment {
            1 => first.second[a.ray as usize],
            _ => {
                let [_, _, c, d] = stream.words(id, self.rays.start + a.ray, segment - 1);
                Vec2::new(unit_f32(c), unit_f32(d))
            }
        }));
        self.light.irradiance_once(self.caster, points, samples, events, direct);
        for (direct, arrival) in direct.iter().zip(at.iter()) {
            sink.add_direct(arrival.ray, arrival.throughput * *direct);
        }
        if sink.wants_groups() {
            events.arrivals().for_each(|(i, group, brings)| sink.add_direct_of(group, at[i].throughput * brings));
        }
    }

    /// The probability that a path goes on.
    fn survival(&self, arrival: &Arrival) -> f32 {
        let is_in_slit = arrival.point.extent.free_height() < SLIT * self.largest_support;
        if self.is_roulette || is_in_slit { (arrival.throughput.max_element() / LITTLE).min(1.0) } else { 1.0 }
    }

    /// Reads the field, and casts the next ray of paths that found no good place for that.
    fn read_or_go_on(&self, id: u32, segment: u32, buffers: &mut PathBuffers, sink: &mut impl PathSink) {
        let PathBuffers { at, points, rays, going_on, hits, .. } = buffers;
        let stream = Stream::new(self.seed, self.stage);
        rays.clear();
        going_on.clear();
        sink.read(at, points, |arrival| {
            let [a, b, ..] = stream.words(id, self.rays.start + arrival.ray, segment);
            let survival = self.survival(arrival);
            let (u, v) = (unit_f32(a), unit_f32(b));
            // The number that decides is uniform again for survivors.
            if u >= survival {
                return;
            }
            let OrientedPoint { position, normal, .. } = arrival.point;
            let direction = warp::cosine_hemisphere(Vec2::new(u / survival, v), normal);
            rays.push(Ray::new(offset_origin(position, normal), direction));
            going_on.push((arrival.ray, arrival.throughput / survival));
        });
        hits.clear();
        hits.resize(rays.len(), Hit::MISS);
        self.caster.trace_nearest(rays, hits);
    }
}
