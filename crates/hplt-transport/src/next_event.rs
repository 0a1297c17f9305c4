//! Direct light at the many points that the rays of one receiver meet: about one shadow ray each.

use glam::Vec2;
use hplt_geom::radiometry::irradiance_from_uniform_radiance;
use hplt_geom::{Hit, LightGroupId, LightShape, OrientedPoint, Ray, RayCaster, Rgb, offset_origin};
use hplt_sampling::warp;

use crate::DirectLight;
use crate::emitters::{Aim, Choice, Guides, choosing};

/// Shadow rays of a batch of points.
#[derive(Default)]
pub(crate) struct NextEvents {
    rays: Vec<Ray>,
    brings: Vec<Rgb>,
    of: Vec<Origin>,
    occluded: Vec<bool>,
    hits: Vec<Hit>,
    guides: Guides,
    seen: Vec<(Origin, Rgb)>,
}

/// Whom a shadow ray serves, and whose light it brings.
#[derive(Clone, Copy)]
struct Origin {
    point: u32,
    group: LightGroupId,
}

impl NextEvents {
    fn clear(&mut self) {
        self.rays.clear();
        self.brings.clear();
        self.of.clear();
        self.seen.clear();
    }

    fn push(&mut self, point: usize, group: LightGroupId, ray: Ray, brings: Rgb) {
        if brings != Rgb::ZERO {
            self.rays.push(ray);
            self.brings.push(brings);
            self.of.push(Origin { point: point as u32, group });
        }
    }

    /// What arrived from which group of lights at which point, when [`DirectLight::irradiance_once`] last asked.
    pub fn arrivals(&self) -> impl Iterator<Item = (usize, LightGroupId, Rgb)> + '_ {
        let traced = self.of.iter().zip(&self.brings).zip(&self.occluded);
        let unoccluded = traced.filter(|(_, is_occluded)| !**is_occluded).map(|((of, brings), _)| (*of, *brings));
        let all = self.seen.iter().copied().chain(unoccluded);
        all.map(|(of, brings)| (of.point as usize, of.group, brings))
    }
}

impl DirectLight<'_> {
    /// Replaces `out` by unbiased estimates of the irradiance that arrives straight from lights at each of `points`, W/m².
    ///
    /// `samples` in `[0, 1)²`, one per point, choose the light; stratify them over the points.
    pub(crate) fn irradiance_once(
        &self,
        caster: &dyn RayCaster,
        points: &[OrientedPoint],
        samples: &[Vec2],
        events: &mut NextEvents,
        out: &mut Vec<Rgb>,
    ) {
        out.clear();
        out.resize(points.len(), Rgb::ZERO);
        events.clear();
        if self.is_by_hemisphere() {
            self.look_around(caster, points, samples, events);
        }
        for (i, (point, &sample)) in points.iter().zip(samples).enumerate() {
            let origin = offset_origin(point.position, point.normal);
            if !self.is_by_hemisphere() {
                self.towards_emitter((i, point), origin, sample, events);
                self.towards_sky((i, point), origin, sample, events);
            }
            self.towards_lights((i, point), origin, sample, events);
        }
        events.occluded.clear();
        events.occluded.resize(events.rays.len(), false);
        caster.trace_occluded(&events.rays, &mut events.occluded);
        for (point, _, brings) in events.arrivals() {
            out[point] += brings;
        }
    }

    /// One point on one emitter, chosen by what each would bring about.
    fn towards_emitter(
        &self,
        (i, point): (usize, &OrientedPoint),
        origin: glam::Vec3,
        sample: Vec2,
        events: &mut NextEvents,
    ) {
        let chosen = self.emitters().at(point, 1, &mut events.guides).choose(choosing(sample));
        let Some(Choice { emitter, probability, again }) = chosen else { return };
        let Aim { target, brings } =
            emitter.seen_from(point.position, point.normal).aim(self.scene, Vec2::new(again, sample.y));
        let ray = Ray::segment(origin, offset_origin(target, emitter.normal));
        events.push(i, emitter.group, ray, brings / probability);
    }

    fn towards_sky(
        &self,
        (i, point): (usize, &OrientedPoint),
        origin: glam::Vec3,
        sample: Vec2,
        events: &mut NextEvents,
    ) {
        let (Some(environment), Some(group)) = (self.scene.environment(), self.groups().of_environment()) else {
            return;
        };
        let Some(sampler) = self.sky() else {
            let direction = warp::cosine_hemisphere(sample, point.normal);
            let brings = irradiance_from_uniform_radiance(environment.radiance(direction));
            return events.push(i, group, Ray::new(origin, direction), brings);
        };
        // Half of the samples follow the map, half the cosine; each stands for two.
        let again = Vec2::new((2.0 * sample.x).fract(), sample.y);
        let direction = if sample.x < 0.5 {
            sampler.sample(environment, again).0
        } else {
            warp::cosine_hemisphere(again, point.normal)
        };
        let brings = 2.0 * sampler.weighted(environment, direction, point.normal.dot(direction), 1);
        events.push(i, group, Ray::new(origin, direction), brings);
    }

    fn towards_lights(
        &self,
        (i, point): (usize, &OrientedPoint),
        origin: glam::Vec3,
        sample: Vec2,
        events: &mut NextEvents,
    ) {
        for (k, light) in self.scene.lights().iter().enumerate() {
            let group = self.groups().of_light(k);
            match light.shape {
                LightShape::Point { position, intensity } => {
                    events.push(i, group, Ray::segment(origin, position), from_point(point, position, intensity));
                }
                LightShape::Spot { position, direction, intensity, cos_inner, cos_outer } => {
                    let cos = (point.position - position).normalize_or_zero().dot(direction);
                    let intensity = intensity * LightShape::spot_falloff(cos_inner, cos_outer, cos);
                    events.push(i, group, Ray::segment(origin, position), from_point(point, position, intensity));
                }
                LightShape::Directional { direction_to_light, irradiance, angular_radius } => {
                    let direction = match angular_radius > 0.0 {
                        true => warp::uniform_cone(sample, direction_to_light, angular_radius),
                        false => direction_to_light,
                    };
                    // The mean cosine over the disc, so that a facing surface receives exactly `irradiance`.
                    let facing = 0.5 * (1.0 + angular_radius.cos());
                    let brings = irradiance * (point.normal.dot(direction).max(0.0) / facing);
                    events.push(i, group, Ray::new(origin, direction), brings);
                }
                _ => {}
            }
        }
    }

    /// One cosine-distributed ray per point sees what emits.
    fn look_around(&self, caster: &dyn RayCaster, points: &[OrientedPoint], samples: &[Vec2], events: &mut NextEvents) {
        events.rays.extend(points.iter().zip(samples).map(|(point, &sample)| {
            let direction = warp::cosine_hemisphere(sample, point.normal);
            Ray::new(offset_origin(point.position, point.normal), direction)
        }));
        events.hits.clear();
        events.hits.resize(points.len(), Hit::MISS);
        caster.trace_nearest(&events.rays, &mut events.hits);
        for (i, (ray, hit)) in events.rays.iter().zip(&events.hits).enumerate() {
            if let Some((group, brings)) = self.seen(ray, hit) {
                events.seen.push((Origin { point: i as u32, group }, brings));
            }
        }
        events.rays.clear();
    }

    /// What arrives along a cosine-distributed ray straight from a light, W/m²; `None` where that does not shine.
    pub(crate) fn seen(&self, ray: &Ray, hit: &Hit) -> Option<(LightGroupId, Rgb)> {
        if !hit.is_miss() {
            let group = self.groups().of_material(self.scene.mesh().material(hit.triangle))?;
            return Some((group, self.scene.exitance(&self.scene.surface_at(hit))));
        }
        let group = self.groups().of_environment()?;
        self.scene.environment().map(|e| (group, irradiance_from_uniform_radiance(e.radiance(ray.direction))))
    }
}

/// The irradiance at `point` of a point light without occlusion.
pub(crate) fn from_point(point: &OrientedPoint, position: glam::Vec3, intensity: Rgb) -> Rgb {
    let to = position - point.position;
    let distance_squared = to.length_squared();
    if distance_squared > 0.0 {
        intensity * (point.normal.dot(to).max(0.0) / (distance_squared * distance_squared.sqrt()))
    } else {
        Rgb::ZERO
    }
}

#[cfg(test)]
mod tests {
    use hplt_geom::radiometry::luminance;
    use hplt_geom::{Bvh, BvhOptions, NoProgress, RegionId, Scene};
    use hplt_reference::scenes;
    use hplt_sampling::random::Stage;
    use hplt_sampling::sobol::{sobol_2d, sobol_4d};

    use super::*;
    use crate::{DirectOptions, direct_irradiance};

    /// What the rays of receivers on a grid over the floor of a Cornell box land on, by receiver.
    fn landings(scene: &Scene, bvh: &Bvh) -> Vec<Vec<(OrientedPoint, Vec2)>> {
        let receiver = |i: u32| {
            let (x, z) = (0.05 + 0.1 * (i % 10) as f64, 0.05 + 0.1 * (i / 10) as f64);
            let position = scene.frame().scene_from_world_point(glam::DVec3::new(0.55 * x, 0.3, 0.55 * z));
            (0..256u32).filter_map(move |k| {
                let [a, b, c, d] = sobol_4d(k, i.wrapping_mul(0x9E37_79B9));
                let direction = warp::cosine_hemisphere(Vec2::new(a, b), glam::Vec3::Y);
                let hit = bvh.nearest(Ray::new(position, direction));
                (!hit.is_miss()).then(|| {
                    let surface = scene.surface_at(&hit);
                    (OrientedPoint::new(surface.position, surface.normal, RegionId(0)), Vec2::new(c, d))
                })
            })
        };
        (0..100).map(|i| receiver(i).collect()).collect()
    }

    fn mean(values: &[Rgb]) -> f64 {
        values.iter().map(|v| f64::from(luminance(*v))).sum::<f64>() / values.len() as f64
    }

    /// One shadow ray at every landing is as bright on average as a thousand, also when its sample comes with the direction.
    #[test]
    fn one_sample_is_unbiased() {
        let scene = scenes::build(scenes::cornell_box());
        let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
        let light = DirectLight::new(&scene, DirectOptions::measurement());
        let (mut once, mut exact, mut own) = (Vec::new(), Vec::new(), Vec::new());
        for (i, of_receiver) in landings(&scene, &bvh).iter().enumerate() {
            let points: Vec<OrientedPoint> = of_receiver.iter().map(|l| l.0).collect();
            let together: Vec<Vec2> = of_receiver.iter().map(|l| l.1).collect();
            let apart: Vec<Vec2> = (0..points.len() as u32).map(|k| sobol_2d(k, i as u32, 7)).collect();
            let (mut events, mut out) = (NextEvents::default(), Vec::new());
            light.irradiance_once(&bvh, &points, &together, &mut events, &mut out);
            once.extend_from_slice(&out);
            light.irradiance_once(&bvh, &points, &apart, &mut events, &mut out);
            own.extend_from_slice(&out);
            exact.extend(direct_irradiance(&light, &bvh, &points, Stage::Direct, &NoProgress).unwrap());
        }
        let (once, own, exact) = (mean(&once), mean(&own), mean(&exact));
        println!("together {:.5} apart {:.5}", once / exact, own / exact);
        assert!((once / exact - 1.0).abs() < 3e-3 && (own / exact - 1.0).abs() < 3e-3, "{once} {own} {exact}");
    }
}
