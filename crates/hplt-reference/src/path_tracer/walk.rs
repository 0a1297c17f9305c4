//! One path: direct light at every vertex, and a cosine-distributed step to the next.

use std::f64::consts::{FRAC_1_PI, PI};

use hplt_geom::glam::DVec3;
use hplt_geom::{Rgb, TriangleId};

use super::PathTracer;
use super::estimate::Emission;
use super::rng::{PathNumbers, VertexNumbers};
use super::tree::Meeting;
use super::vertex::Vertex;

/// Shadow rays end this much before their light.
const BEFORE_LIGHT: f64 = 1.0 - 1e-9;
/// Russian roulette ends at least this part of all paths, so that albedo 1 comes to an end too.
const MIN_ABSORPTION: f64 = 0.005;

/// How long paths get and how they find emitters.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rules {
    pub(super) emission: Emission,
    pub(super) min_bounces: u32,
    pub(super) max_bounces: Option<u32>,
}

/// What one path contributes to the irradiance of its start.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Arrived {
    pub(super) direct: DVec3,
    pub(super) indirect: DVec3,
    pub(super) n_rays: u64,
}

impl PathTracer<'_> {
    /// An unbiased sample of the irradiance at `start`.
    pub(super) fn walk(&self, start: Vertex, numbers: &mut PathNumbers, rules: Rules) -> Arrived {
        let mut arrived = Arrived::default();
        let mut at = start;
        let mut throughput = DVec3::ONE;
        let mut bounce = 0;
        loop {
            let vertex_numbers = numbers.vertex(bounce);
            let (mut light, next) = self.gather(&at, &vertex_numbers, rules.emission, &mut arrived.n_rays);
            light *= throughput;
            if bounce == 0 {
                arrived.direct += light;
            } else {
                arrived.indirect += light;
            }
            let Some(next) = next else { break };
            if rules.max_bounces.is_some_and(|max| bounce >= max) {
                break;
            }
            throughput *= self.albedo(&next);
            bounce += 1;
            let strongest = throughput.max_element();
            if strongest <= 0.0 {
                break;
            }
            if bounce >= rules.min_bounces {
                let survival = strongest.min(1.0 - MIN_ABSORPTION);
                if numbers.uniform() >= survival {
                    break;
                }
                throughput /= survival;
            }
            at = next;
        }
        arrived
    }

    /// The light that arrives at a vertex straight from emitters, and the surface that the cosine-distributed ray meets.
    fn gather(
        &self,
        at: &Vertex,
        numbers: &VertexNumbers,
        emission: Emission,
        n_rays: &mut u64,
    ) -> (DVec3, Option<Vertex>) {
        let mut light = self.punctual_light(at, numbers, n_rays);
        light += self.sampled_environment(at, numbers, n_rays);
        if emission == Emission::NextEvent {
            light += self.sampled_emitter(at, numbers, n_rays);
        }
        let direction = at.cosine_direction(numbers.direction);
        if !at.sees(direction) {
            return (light, None);
        }
        *n_rays += 1;
        let cosine = at.normal.dot(direction);
        let pdf = cosine * FRAC_1_PI;
        let Some(meeting) = self.tree.nearest(self.scene, at.position, direction, at.triangle) else {
            if let Some(environment) = self.scene.environment() {
                let radiance = environment.radiance(direction.as_vec3()).as_dvec3();
                let other = self.lights.environment_pdf_solid_angle(self.scene, direction);
                light += radiance * (cosine / (pdf + other));
            }
            return (light, None);
        };
        let next = Vertex::from_meeting(self.scene, &meeting);
        let exitance = self.exitance(&next);
        if exitance != Rgb::ZERO {
            let other = match emission {
                Emission::Hit => 0.0,
                Emission::NextEvent => self.emitter_pdf_solid_angle(&next, direction, &meeting),
            };
            light += exitance.as_dvec3() * (FRAC_1_PI * cosine / (pdf + other));
        }
        (light, Some(next))
    }

    fn punctual_light(&self, at: &Vertex, numbers: &VertexNumbers, n_rays: &mut u64) -> DVec3 {
        let mut light = DVec3::ZERO;
        let (pick, distant) = (numbers.punctual_pick, numbers.distant);
        self.lights.punctual(self.scene, at.position, pick, distant, |arrival| {
            let direction = arrival.direction;
            if !at.sees(direction) || arrival.irradiance == DVec3::ZERO {
                return;
            }
            *n_rays += 1;
            let skip = [at.triangle, TriangleId::NONE];
            if !self.tree.is_occluded(self.scene, at.position, direction, arrival.t_max, skip) {
                light += arrival.irradiance * (at.normal.dot(direction) / direction.length());
            }
        });
        light
    }

    fn sampled_environment(&self, at: &Vertex, numbers: &VertexNumbers, n_rays: &mut u64) -> DVec3 {
        let Some((direction, radiance, pdf)) = self.lights.sample_environment(self.scene, numbers.distant) else {
            return DVec3::ZERO;
        };
        if !at.sees(direction) || pdf <= 0.0 {
            return DVec3::ZERO;
        }
        *n_rays += 1;
        let skip = [at.triangle, TriangleId::NONE];
        if self.tree.is_occluded(self.scene, at.position, direction, f64::INFINITY, skip) {
            return DVec3::ZERO;
        }
        let cosine = at.normal.dot(direction);
        radiance * (cosine / (pdf + cosine * FRAC_1_PI))
    }

    fn sampled_emitter(&self, at: &Vertex, numbers: &VertexNumbers, n_rays: &mut u64) -> DVec3 {
        let Some(sample) = self.lights.sample_emitter(self.scene, numbers.emitter_pick, numbers.emitter) else {
            return DVec3::ZERO;
        };
        let direction = sample.position - at.position;
        if sample.triangle == at.triangle || !at.sees(direction) {
            return DVec3::ZERO;
        }
        let facing = -sample.normal.dot(direction);
        let material = self.scene.material(sample.triangle);
        let exitance = material.exitance_at(facing > 0.0, sample.uv);
        let is_there = || material.alpha.as_ref().is_none_or(|mask| mask.is_opaque(sample.uv));
        if facing == 0.0 || exitance == Rgb::ZERO || !is_there() {
            return DVec3::ZERO;
        }
        *n_rays += 1;
        let skip = [at.triangle, sample.triangle];
        if self.tree.is_occluded(self.scene, at.position, direction, BEFORE_LIGHT, skip) {
            return DVec3::ZERO;
        }
        let distance = direction.length();
        let cosine = at.normal.dot(direction) / distance;
        let pdf = sample.pdf_area * distance.powi(3) / facing.abs();
        exitance.as_dvec3() * (FRAC_1_PI * cosine / (pdf + cosine * FRAC_1_PI))
    }

    /// The density with which light sampling picks the point of an emitter that a ray met.
    fn emitter_pdf_solid_angle(&self, met: &Vertex, direction: DVec3, meeting: &Meeting) -> f64 {
        let t = meeting.crossing.t;
        let facing = met.geometric.dot(direction).abs().max(f64::MIN_POSITIVE);
        self.lights.emitter_pdf_area(met.triangle) * t * t / facing
    }

    pub(super) fn exitance(&self, at: &Vertex) -> Rgb {
        self.scene.material(at.triangle).exitance_at(at.is_front, at.uv)
    }

    pub(super) fn albedo(&self, at: &Vertex) -> DVec3 {
        self.scene.material(at.triangle).albedo_at(at.is_front, at.uv).as_dvec3()
    }

    /// The radiance along a ray from `origin`, by one path: what the first surface emits and reflects, or the
    /// environment. Also the rays it took.
    pub(super) fn radiance(
        &self,
        origin: DVec3,
        direction: DVec3,
        numbers: &mut PathNumbers,
        rules: Rules,
    ) -> (DVec3, u64) {
        let Some(meeting) = self.tree.nearest(self.scene, origin, direction, TriangleId::NONE) else {
            let sky = self.scene.environment().map_or(Rgb::ZERO, |e| e.radiance(direction.as_vec3()));
            return (sky.as_dvec3(), 1);
        };
        let met = Vertex::from_meeting(self.scene, &meeting);
        let exitance = self.exitance(&met).as_dvec3();
        let albedo = self.albedo(&met);
        if albedo == DVec3::ZERO {
            return (exitance / PI, 1);
        }
        let (u, v) = (meeting.crossing.u as f32, meeting.crossing.v as f32);
        let side = if met.is_front { 1.0 } else { -1.0 };
        let normal = self.scene.mesh().shading_normal_at(met.triangle, u, v).as_dvec3() * side;
        let arrived = self.walk(Vertex { normal, ..met }, numbers, rules);
        ((exitance + albedo * (arrived.direct + arrived.indirect)) / PI, 1 + arrived.n_rays)
    }
}
