use std::sync::Arc;

use glam::{DVec3, Vec3};
use hplt_basis::{Absolute, Coefficients, ShepardBasis, restrict};
use hplt_geom::radiometry::irradiance_from_uniform_radiance;
use hplt_geom::{
    Hit, Interrupted, Light, LightGroupId, LightGroups, LightShape, OrientedPoint, Progress, Ray, RayCaster, RegionId,
    Rgb, Scene, TriangleId, offset_origin, parallel,
};
use hplt_sampling::random::{Stage, hash};
use hplt_sampling::{sobol, warp};

use crate::Model;
use crate::emitters::{Choice, Emitter, Emitters, Guides, choosing};
use crate::gather::Counter;
use crate::next_event::from_point;
use crate::sky::SkySampler;
use crate::visible::{Found, Visible};

/// How light that comes straight from emissive surfaces and the sky is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DirectEstimator {
    /// [`Hemisphere`](Self::Hemisphere) where more than a tenth of the surface emits, else [`Lights`](Self::Lights).
    #[default]
    Auto,
    /// Shadow rays to sampled points of the lights.
    Lights,
    /// Cosine-distributed rays that see the lights they hit: for furnaces and scenes where most surfaces emit.
    Hemisphere,
}

/// Shadow rays to an emitter after which a point that sees all of it needs no more.
const ENOUGH_TO_TELL: u32 = 128;

/// Triangles in the way of an emitter that are cut out of it, at least, rather than sampled around.
const LEAST_BLOCKERS: usize = 12;
/// One more for so many shadow rays that would be cast instead.
const RAYS_PER_BLOCKER: u32 = 16;

/// How direct light is sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DirectOptions {
    /// Seed of all rays.
    pub seed: u64,
    /// Shadow rays per emitter where there are few, per point where there are many; a power of two.
    pub light_samples: u32,
    /// Where there are few emitters, shadow rays to one that get there after which `light_samples` need not be cast, a power of two: what is dim is sampled
    /// longer.
    pub enough: u32,
    /// Rays per point towards the sky, or over the hemisphere; a power of two.
    pub sky_samples: u32,
    /// Which estimator.
    pub estimator: DirectEstimator,
    /// Where there are few emitters: form factors in closed form, and what is in the way cut out of them, as far as that goes. Without it all
    /// of their light is sampled.
    pub is_exact: bool,
}

impl DirectOptions {
    /// For senders: many points, each coarse.
    pub fn projection() -> Self {
        Self {
            seed: 0,
            light_samples: 16,
            enough: u32::MAX,
            sky_samples: 64,
            estimator: DirectEstimator::Auto,
            is_exact: true,
        }
    }

    /// For the points of a random walk: one ray per emitter.
    pub fn one_sample() -> Self {
        Self { light_samples: 1, sky_samples: 1, ..Self::projection() }
    }

    /// For what is looked at or measured: soft shadows without visible noise.
    pub fn display() -> Self {
        Self { light_samples: 64, sky_samples: 256, ..Self::projection() }
    }

    /// For results that are compared at a fraction of a per cent.
    pub fn measurement() -> Self {
        Self { light_samples: 1024, sky_samples: 4096, ..Self::projection() }
    }
}

/// The light sources of a scene, prepared for sampling. Preparing takes about n·log n steps for n emissive triangles; a clone, or the
/// same lights [with other options](Self::with_options), shares what is prepared.
#[derive(Debug, Clone)]
pub struct DirectLight<'s> {
    pub(crate) scene: &'s Scene,
    sources: Arc<Sources>,
    options: DirectOptions,
    by_hemisphere: bool,
}

#[derive(Debug)]
struct Sources {
    groups: LightGroups,
    emitters: Emitters,
    /// The share of the surface that emits is above a tenth.
    are_everywhere: bool,
    sky: Option<SkySampler>,
}

impl Sources {
    fn of(scene: &Scene) -> Self {
        let groups = LightGroups::of(scene);
        let emitters = Emitters::new(scene, &groups);
        let emitting: f64 = emitters.all.iter().map(|e| f64::from(e.area)).sum();
        let all: f64 = (0..scene.mesh().n_triangles() as u32).map(|t| scene.mesh().area(TriangleId(t))).sum();
        let sky = scene.environment().and_then(SkySampler::new);
        Self { groups, emitters, are_everywhere: emitting > 0.1 * all, sky }
    }
}

impl<'s> DirectLight<'s> {
    /// Collects emitters and prepares the environment of `scene`.
    pub fn new(scene: &'s Scene, options: DirectOptions) -> Self {
        Self::of(scene, Arc::new(Sources::of(scene)), options)
    }

    /// The same lights, sampled otherwise.
    pub fn with_options(&self, options: DirectOptions) -> Self {
        Self::of(self.scene, Arc::clone(&self.sources), options)
    }

    fn of(scene: &'s Scene, sources: Arc<Sources>, options: DirectOptions) -> Self {
        let by_hemisphere = match options.estimator {
            DirectEstimator::Lights => false,
            DirectEstimator::Hemisphere => true,
            DirectEstimator::Auto => sources.are_everywhere,
        };
        Self { scene, sources, options, by_hemisphere }
    }

    /// The groups of lights, by name.
    pub fn groups(&self) -> &LightGroups {
        &self.sources.groups
    }

    pub(crate) fn emitters(&self) -> &Emitters {
        &self.sources.emitters
    }

    /// What samples the sky, if there is one and the hemisphere is not looked at as a whole.
    pub(crate) fn sky(&self) -> Option<&SkySampler> {
        self.sources.sky.as_ref().filter(|_| !self.by_hemisphere)
    }

    /// How many sides of triangles emit.
    pub fn n_emitters(&self) -> usize {
        self.emitters().all.len()
    }

    /// Whether emissive surfaces and the sky are found by rays over the hemisphere.
    pub fn is_by_hemisphere(&self) -> bool {
        self.by_hemisphere
    }

    /// The irradiance that arrives at `point` straight from lights, W/m². `id` selects the samples.
    pub(crate) fn irradiance(
        &self,
        caster: &dyn RayCaster,
        point: &OrientedPoint,
        (stage, id): (Stage, u32),
        scratch: &mut Shadows,
    ) -> Rgb {
        let mut sum = DVec3::ZERO;
        self.arrivals(caster, point, (stage, id), scratch, |_, brings| sum += brings);
        sum.as_vec3()
    }

    /// The same by group of lights: calls `arrive` with whose light it is and what it brings, in a fixed order.
    fn arrivals(
        &self,
        caster: &dyn RayCaster,
        point: &OrientedPoint,
        (stage, id): (Stage, u32),
        scratch: &mut Shadows,
        mut arrive: impl FnMut(LightGroupId, DVec3),
    ) {
        if point.region == RegionId::DARK {
            return;
        }
        let sampler = PointSampler {
            light: self,
            point,
            origin: offset_origin(point.position, point.normal),
            seeds: Seeds { seed: self.options.seed, stage, id },
        };
        if self.by_hemisphere {
            sampler.hemisphere(caster, scratch, &mut arrive);
        } else {
            if self.emitters().is_many() {
                sampler.some_emitters(caster, scratch, &mut arrive);
            } else {
                for (i, emitter) in self.emitters().all.iter().enumerate() {
                    arrive(emitter.group, sampler.one_emitter(caster, emitter, i as u32, scratch));
                }
            }
            if let Some(group) = self.groups().of_environment() {
                arrive(group, sampler.sky(caster, scratch));
            }
        }
        for (i, light) in self.scene.lights().iter().enumerate() {
            arrive(self.groups().of_light(i), sampler.light(caster, light, i as u32, scratch));
        }
    }
}

/// The irradiance that arrives at `points` straight from lights, W/m², with the points' indices selecting the samples
/// of `stage`. Zero in dark regions.
///
/// Few emitters: for each of uniform exitance the exact unoccluded irradiance (Lambert's polygon formula) times the visible
/// fraction. That is exact where `caster` knows what may be in the way ([`RayCaster::visit_blockers`]) and it is not much; else a ratio
/// estimator that is free of noise where nothing is in the way ([`DirectOptions::is_exact`] switches both off). Many: chosen by about what each brings. The sky: constant
/// by cosine-distributed rays; a map by the balance heuristic between those and its radiance.
///
/// # Errors
/// When interrupted.
pub fn direct_irradiance(
    light: &DirectLight<'_>,
    caster: &dyn RayCaster,
    points: &[OrientedPoint],
    stage: Stage,
    progress: &dyn Progress,
) -> Result<Vec<Rgb>, Interrupted> {
    let counter = Counter::new(progress, "direct light", points.len());
    parallel::try_map(points.len(), Shadows::default, |scratch, i| {
        counter.step()?;
        Ok(light.irradiance(caster, &points[i], (stage, i as u32), scratch))
    })
}

/// As [`direct_irradiance`], to the bit, and from the same samples what each group of lights ([`DirectLight::groups`]) brings: by
/// group, then by point.
///
/// # Errors
/// When interrupted.
pub fn direct_irradiance_by_group(
    light: &DirectLight<'_>,
    caster: &dyn RayCaster,
    points: &[OrientedPoint],
    stage: Stage,
    progress: &dyn Progress,
) -> Result<(Vec<Rgb>, Vec<Vec<Rgb>>), Interrupted> {
    let counter = Counter::new(progress, "direct light", points.len());
    let n = light.groups().len();
    let by_point = parallel::try_map(points.len(), Shadows::default, |scratch, i| {
        counter.step()?;
        let (mut sum, mut parts) = (DVec3::ZERO, vec![DVec3::ZERO; n]);
        light.arrivals(caster, &points[i], (stage, i as u32), scratch, |group, brings| {
            sum += brings;
            parts[group.0 as usize] += brings;
        });
        Ok((sum.as_vec3(), parts.into_iter().map(|s| s.as_vec3()).collect::<Vec<_>>()))
    })?;
    let by_group = (0..n).map(|g| by_point.iter().map(|(_, parts)| parts[g]).collect()).collect();
    Ok((by_point.into_iter().map(|(sum, _)| sum).collect(), by_group))
}

/// Projects direct light onto the hierarchy: sampled at every function of the finest level, averaged over supports on
/// coarser ones ([`restrict`]), so that patches of light smaller than a coarse function are not lost.
///
/// # Errors
/// When interrupted.
pub fn project_direct(
    model: &Model<'_>,
    light: &DirectLight<'_>,
    progress: &dyn Progress,
) -> Result<Coefficients<Absolute>, Interrupted> {
    let basis: &ShepardBasis = model.basis;
    let Some(top) = basis.n_levels().checked_sub(1) else {
        return Ok(Coefficients::from_levels(Vec::new()));
    };
    let finest = direct_irradiance(light, model.caster, basis.points(top), Stage::Direct, progress)?;
    Ok(restrict(basis, finest))
}

/// Shadow rays with what each would bring.
#[derive(Default)]
pub(crate) struct Shadows {
    rays: Vec<Ray>,
    brings: Vec<Rgb>,
    /// Whose light each brings, where several groups are sampled together.
    groups: Vec<LightGroupId>,
    guides: Guides,
    occluded: Vec<bool>,
    hits: Vec<Hit>,
    visible: Visible,
}

impl Shadows {
    fn clear(&mut self) {
        self.rays.clear();
        self.brings.clear();
    }

    fn push(&mut self, ray: Ray, brings: Rgb) {
        if brings != Rgb::ZERO {
            self.rays.push(ray);
            self.brings.push(brings);
        }
    }

    /// What the unoccluded rays bring, and what all would bring.
    fn trace(&mut self, caster: &dyn RayCaster) -> (DVec3, DVec3) {
        self.occluded.clear();
        self.occluded.resize(self.rays.len(), false);
        caster.trace_occluded(&self.rays, &mut self.occluded);
        let (mut visible, mut all) = (DVec3::ZERO, DVec3::ZERO);
        for (brings, occluded) in self.brings.iter().zip(&self.occluded) {
            let brings = brings.as_dvec3();
            all += brings;
            if !occluded {
                visible += brings;
            }
        }
        (visible, all)
    }

    /// How many of the rays got there.
    fn n_seen(&self) -> u32 {
        self.occluded.iter().map(|&occluded| u32::from(!occluded)).sum()
    }
}

#[derive(Clone, Copy)]
struct Seeds {
    seed: u64,
    stage: Stage,
    id: u32,
}

impl Seeds {
    /// The scramble of the samples for light `index` of a kind.
    fn of(self, kind: u32, index: u32) -> u32 {
        hash(self.seed, self.stage, self.id, index, kind)
    }
}

/// What is visible of all, by the largest channel.
fn share(visible: DVec3, all: DVec3) -> f64 {
    if all.max_element() > 0.0 { visible.max_element() / all.max_element() } else { 0.0 }
}

/// Samples the lights from one point.
struct PointSampler<'a> {
    light: &'a DirectLight<'a>,
    point: &'a OrientedPoint,
    origin: Vec3,
    seeds: Seeds,
}

impl PointSampler<'_> {
    /// Cutting one triangle out takes about as long as this many rays take.
    fn max_blockers(&self) -> usize {
        let DirectOptions { light_samples, enough, .. } = self.light.options;
        LEAST_BLOCKERS + (light_samples.min(enough) / RAYS_PER_BLOCKER) as usize
    }

    fn segment_to(&self, emitter: &Emitter, target: Vec3) -> Ray {
        Ray::segment(self.origin, offset_origin(target, emitter.normal))
    }

    fn one_emitter(&self, caster: &dyn RayCaster, emitter: &Emitter, index: u32, shadows: &mut Shadows) -> DVec3 {
        let OrientedPoint { position, normal, .. } = *self.point;
        if !emitter.can_light(position, normal) {
            return DVec3::ZERO;
        }
        if !self.light.options.is_exact {
            let (visible, _) = self.cast_at(caster, (emitter, index), false, shadows);
            return visible / f64::from(self.light.options.light_samples);
        }
        let exact = |exitance: Rgb, fraction: f64| {
            exitance.as_dvec3() * (f64::from(emitter.form_factor(position, normal)) * fraction)
        };
        let max_blockers = self.max_blockers();
        if let Some(exitance) = emitter.uniform_exitance
            && let Some(fraction) = shadows.visible.fraction(caster, self.point, emitter, max_blockers)
        {
            return exact(exitance, fraction);
        }
        match (
            shadows.visible.look(caster, self.light.scene, self.point, emitter, max_blockers),
            emitter.uniform_exitance,
        ) {
            (Found::Nothing, _) => return DVec3::ZERO,
            (Found::Share(share), Some(exitance)) => {
                return exact(exitance, share * self.visible_share_of_left(caster, index, shadows));
            }
            _ => {}
        }
        let (visible, all) = self.cast_at(caster, (emitter, index), emitter.uniform_exitance.is_some(), shadows);
        match emitter.uniform_exitance {
            None => visible / f64::from(self.light.options.light_samples),
            // Exact form factor × visible fraction, the fraction weighted as the light arrives.
            Some(exitance) => exact(exitance, share(visible, all)),
        }
    }

    /// [`cast`](Self::cast) to samples of a whole emitter.
    fn cast_at(
        &self,
        caster: &dyn RayCaster,
        (emitter, index): (&Emitter, u32),
        only_share_counts: bool,
        shadows: &mut Shadows,
    ) -> (DVec3, DVec3) {
        let scramble = self.seeds.of(0, index);
        let seen = emitter.seen_from(self.point.position, self.point.normal);
        self.cast(caster, only_share_counts, shadows, |shadows, k| {
            let aim = seen.aim(self.light.scene, sobol::sobol_2d(k, scramble, 0));
            shadows.push(self.segment_to(emitter, aim.target), aim.brings);
        })
    }

    /// The visible share of what [`Visible::look`] left of an emitter, by rays.
    fn visible_share_of_left(&self, caster: &dyn RayCaster, index: u32, shadows: &mut Shadows) -> f64 {
        let scramble = self.seeds.of(0, index);
        let (visible, all) = self.cast(caster, true, shadows, |shadows, k| {
            if let Some((ray, cosine)) = shadows.visible.aim_at_left(sobol::sobol_2d(k, scramble, 0)) {
                shadows.push(ray, Rgb::splat(cosine));
            }
        });
        share(visible, all)
    }

    /// What the unoccluded shadow rays bring, and what all would; `push` adds ray `k`. Where only the share counts, the first are enough
    /// to tell if all of them get there, or as soon as [enough](DirectOptions::enough) do.
    fn cast(
        &self,
        caster: &dyn RayCaster,
        only_share_counts: bool,
        shadows: &mut Shadows,
        push: impl Fn(&mut Shadows, u32),
    ) -> (DVec3, DVec3) {
        let DirectOptions { light_samples: n, enough, .. } = self.light.options;
        let (mut visible, mut all, mut n_seen) = (DVec3::ZERO, DVec3::ZERO, 0);
        let (mut cast, mut goal) = (0, n.min(ENOUGH_TO_TELL).min(enough.saturating_mul(2)));
        loop {
            shadows.clear();
            (cast..goal).for_each(|k| push(shadows, k));
            let (more_visible, more) = shadows.trace(caster);
            (visible, all) = (visible + more_visible, all + more);
            n_seen += shadows.n_seen();
            if goal == n || only_share_counts && (visible == all || n_seen >= enough) {
                return (visible, all);
            }
            (cast, goal) = (goal, if enough < n { n.min(2 * goal) } else { n });
        }
    }

    fn some_emitters(
        &self,
        caster: &dyn RayCaster,
        shadows: &mut Shadows,
        arrive: &mut impl FnMut(LightGroupId, DVec3),
    ) {
        shadows.clear();
        shadows.groups.clear();
        let OrientedPoint { position, normal, .. } = *self.point;
        let n = self.light.options.light_samples;
        let scramble = self.seeds.of(1, 0);
        let mut guides = std::mem::take(&mut shadows.guides);
        let mut chooser = self.light.emitters().at(self.point, n, &mut guides);
        for k in 0..n {
            let by = choosing(sobol::sobol_2d(k, scramble, 1));
            let Some(Choice { emitter, probability, .. }) = chooser.choose(by) else { continue };
            let aim = emitter.seen_from(position, normal).aim(self.light.scene, sobol::sobol_2d(k, scramble, 0));
            let brings = aim.brings / (n as f32 * probability);
            if brings != Rgb::ZERO {
                shadows.groups.push(emitter.group);
            }
            shadows.push(self.segment_to(emitter, aim.target), brings);
        }
        shadows.guides = guides;
        shadows.trace(caster);
        for ((&group, brings), occluded) in shadows.groups.iter().zip(&shadows.brings).zip(&shadows.occluded) {
            if !occluded {
                arrive(group, brings.as_dvec3());
            }
        }
    }

    fn sky(&self, caster: &dyn RayCaster, shadows: &mut Shadows) -> DVec3 {
        let Some(environment) = self.light.scene.environment() else { return DVec3::ZERO };
        shadows.clear();
        let n = self.light.options.sky_samples;
        let scramble = self.seeds.of(2, 0);
        let normal = self.point.normal;
        for k in 0..n {
            let direction = warp::cosine_hemisphere(sobol::sobol_2d(k, scramble, 0), normal);
            let brings = match self.light.sky() {
                Some(sampler) => sampler.weighted(environment, direction, normal.dot(direction), n),
                None => irradiance_from_uniform_radiance(environment.radiance(direction)) / n as f32,
            };
            shadows.push(Ray::new(self.origin, direction), brings);
        }
        if let Some(sampler) = self.light.sky() {
            for k in 0..n {
                let (direction, _) = sampler.sample(environment, sobol::sobol_2d(k, scramble, 1));
                let brings = sampler.weighted(environment, direction, normal.dot(direction), n);
                shadows.push(Ray::new(self.origin, direction), brings);
            }
        }
        shadows.trace(caster).0
    }

    fn light(&self, caster: &dyn RayCaster, light: &Light, index: u32, shadows: &mut Shadows) -> DVec3 {
        shadows.clear();
        let OrientedPoint { position, normal, .. } = *self.point;
        let from_point = |at: Vec3, intensity: Rgb| from_point(self.point, at, intensity);
        match light.shape {
            LightShape::Point { position: at, intensity } => {
                shadows.push(Ray::segment(self.origin, at), from_point(at, intensity));
            }
            LightShape::Spot { position: at, direction, intensity, cos_inner, cos_outer } => {
                let cos = (position - at).normalize_or_zero().dot(direction);
                let falloff = LightShape::spot_falloff(cos_inner, cos_outer, cos);
                shadows.push(Ray::segment(self.origin, at), from_point(at, intensity * falloff));
            }
            LightShape::Directional { direction_to_light, irradiance, angular_radius } => {
                let n = if angular_radius > 0.0 { self.light.options.light_samples } else { 1 };
                let scramble = self.seeds.of(3, index);
                // The mean cosine over the disc, so that a facing surface receives exactly `irradiance`.
                let facing = 0.5 * (1.0 + angular_radius.cos());
                for k in 0..n {
                    let direction = if n == 1 {
                        direction_to_light
                    } else {
                        warp::uniform_cone(sobol::sobol_2d(k, scramble, 0), direction_to_light, angular_radius)
                    };
                    let brings = irradiance * (normal.dot(direction).max(0.0) / (n as f32 * facing));
                    shadows.push(Ray::new(self.origin, direction), brings);
                }
            }
            _ => {}
        }
        shadows.trace(caster).0
    }

    /// The mean over cosine-distributed rays of the exitance that they hit, or `π` times the radiance of the sky.
    fn hemisphere(&self, caster: &dyn RayCaster, shadows: &mut Shadows, arrive: &mut impl FnMut(LightGroupId, DVec3)) {
        let n = self.light.options.sky_samples;
        let scramble = self.seeds.of(4, 0);
        shadows.rays.clear();
        shadows.rays.extend((0..n).map(|k| {
            Ray::new(self.origin, warp::cosine_hemisphere(sobol::sobol_2d(k, scramble, 0), self.point.normal))
        }));
        shadows.hits.clear();
        shadows.hits.resize(n as usize, Hit::MISS);
        caster.trace_nearest(&shadows.rays, &mut shadows.hits);
        for (ray, hit) in shadows.rays.iter().zip(&shadows.hits) {
            if let Some((group, brings)) = self.light.seen(ray, hit) {
                arrive(group, brings.as_dvec3() / f64::from(n));
            }
        }
    }
}
