//! Suites that any implementation of one of the workspace's traits can be put through.
//!
//! ```
//! use hplt_geom::{Hit, Ray, RayCaster};
//! use hplt_reference::{conformance, scenes};
//!
//! /// Sees nothing.
//! struct Blind;
//!
//! impl RayCaster for Blind {
//!     fn trace_nearest(&self, _rays: &[Ray], hits: &mut [Hit]) {
//!         hits.fill(Hit::MISS);
//!     }
//!     fn trace_occluded(&self, _rays: &[Ray], occluded: &mut [bool]) {
//!         occluded.fill(false);
//!     }
//! }
//!
//! let scene = scenes::build(scenes::cornell_box());
//! let report = conformance::ray_caster(&Blind, &scene, 1000, 0);
//! assert!(!report.passed());
//! ```

use std::fmt;

use hplt_geom::glam::{DVec3, Vec3};
use hplt_geom::{Hit, Ray, RayCaster, Scene, TriangleId};

use crate::path_tracer::{Crossing, PathNumbers, ShearedRay};

/// Failures that a report keeps in words.
const KEPT: usize = 20;
/// Distances and positions must agree within this, scene units.
const TOLERANCE: f64 = 2e-6;

/// What a suite found.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Report {
    /// How many things were checked.
    pub n_checks: u64,
    /// How many of them were wrong.
    pub n_failures: u64,
    /// The first 20 of those, in words.
    pub failures: Vec<String>,
}

impl Report {
    /// Whether something was checked and nothing was wrong.
    pub fn passed(&self) -> bool {
        self.n_checks > 0 && self.n_failures == 0
    }

    /// `Err` with the report when it did not pass.
    ///
    /// # Errors
    /// When anything failed, or nothing was checked.
    pub fn into_result(self) -> Result<Self, Self> {
        if self.passed() { Ok(self) } else { Err(self) }
    }

    fn check(&mut self, holds: bool, failure: impl FnOnce() -> String) {
        self.n_checks += 1;
        if holds {
            return;
        }
        self.n_failures += 1;
        if self.failures.len() < KEPT {
            self.failures.push(failure());
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {} checks failed", self.n_failures, self.n_checks)?;
        self.failures.iter().try_for_each(|failure| write!(f, "\n  {failure}"))
    }
}

impl std::error::Error for Report {}

/// Holds a [`RayCaster`] against brute force in `f64` over all triangles of `scene`, with `n_rays` rays of three kinds:
/// anywhere, aimed at vertices and edges, and along the axes. Then bad rays, segments and the independence of a ray from
/// its batch. Costs `n_rays × n_triangles` triangle tests.
///
/// A hit passes when it lies as near as the nearest crossing and on its own triangle, to 2e-6 scene units. Where the ray
/// touches an outline, what one of eight rays 2e-6 beside it meets passes too; a leak between two triangles that share
/// a visible edge does not. Scenes with alpha masks are refused, since a rounding of a texture coordinate may turn a texel.
pub fn ray_caster(caster: &dyn RayCaster, scene: &Scene, n_rays: usize, seed: u64) -> Report {
    let mut report = Report::default();
    if scene.materials().iter().any(|material| material.alpha.is_some()) {
        report.check(false, || "the scene has alpha masks: expected one without".into());
        return report;
    }
    let rays = test_rays(scene, n_rays, seed);
    let mut hits = vec![Hit::MISS; rays.len()];
    caster.trace_nearest(&rays, &mut hits);
    for (ray, hit) in rays.iter().zip(&hits) {
        check_nearest(scene, ray, hit, &mut report);
    }
    check_occlusion(caster, scene, &rays, &hits, &mut report);
    check_batches(caster, &rays, &hits, &mut report);
    check_bad_rays(caster, &mut report);
    report
}

fn check_nearest(scene: &Scene, ray: &Ray, hit: &Hit, report: &mut Report) {
    let length = f64::from(ray.direction.length());
    let slack = |t: f64| TOLERANCE + 1e-6 * t * length;
    let found = if hit.is_miss() { f64::INFINITY } else { f64::from(hit.t) };
    let agrees = |t: f64| t == found || (t - found).abs() * length <= slack(t);
    let expected = brute_force(scene, ray);
    // A nearer hit than any in f64 lies on an outline; the check of its weights below says whether it is one.
    let right = agrees(expected) || found < expected;
    let beside = |t: f64| agrees(t) || (t - found).abs() * length <= 1e-4;
    report.check(right || any_beside(scene, ray, beside), || {
        format!("{ray:?} meets a surface at t = {expected}, but found {hit:?}")
    });
    if hit.is_miss() {
        return;
    }
    let gap = distance_to_triangle(scene, ray, hit);
    report.check(gap <= slack(found), || format!("{ray:?}: the weights of {hit:?} lie {gap} beside the ray's end"));
    let facing = -scene.mesh().face_normal(hit.triangle).dot(ray.direction) / ray.direction.length();
    report.check(facing.abs() < 1e-5 || hit.is_front == (facing > 0.0), || format!("{ray:?}: wrong side of {hit:?}"));
}

/// Whether `holds` for the nearest distance along any of eight rays a hair beside `ray`: at an outline either answer is
/// right, at an edge between two visible triangles none but theirs.
fn any_beside(scene: &Scene, ray: &Ray, holds: impl Fn(f64) -> bool) -> bool {
    let (a, b) = ray.direction.as_dvec3().normalize().any_orthonormal_pair();
    (0..8).any(|i| {
        let angle = std::f64::consts::FRAC_PI_4 * (f64::from(i) + 0.37);
        let offset = (a * angle.cos() + b * angle.sin()) * TOLERANCE;
        holds(nearest_distance(scene, ray.origin.as_dvec3() + offset, ray.direction.as_dvec3()))
    })
}

/// How far the point that a hit's weights give lies from the point that its distance gives.
fn distance_to_triangle(scene: &Scene, ray: &Ray, hit: &Hit) -> f64 {
    let on_triangle = scene.mesh().position_at(hit.triangle, hit.u, hit.v).as_dvec3();
    let on_ray = ray.origin.as_dvec3() + ray.direction.as_dvec3() * f64::from(hit.t);
    on_triangle.distance(on_ray)
}

/// A segment that ends before its hit is free, one that ends behind it is blocked.
fn check_occlusion(caster: &dyn RayCaster, scene: &Scene, rays: &[Ray], hits: &[Hit], report: &mut Report) {
    for (factor, expected) in [(0.999, false), (1.001, true)] {
        let met = || rays.iter().zip(hits).filter(|(_, hit)| !hit.is_miss() && hit.t > 1e-4);
        let segments: Vec<Ray> = met().map(|(ray, hit)| Ray { t_max: hit.t * factor, ..*ray }).collect();
        let mut occluded = vec![!expected; segments.len()];
        caster.trace_occluded(&segments, &mut occluded);
        let mut nearest = vec![Hit::MISS; segments.len()];
        caster.trace_nearest(&segments, &mut nearest);
        for ((segment, found), hit) in segments.iter().zip(occluded).zip(nearest) {
            let outline = |found: bool| any_beside(scene, segment, |t| (t < f64::from(segment.t_max)) == found);
            report.check(found == expected || outline(found), || {
                format!("{segment:?}: occluded is {found}, expected {expected}")
            });
            let met = !hit.is_miss();
            report.check(met == expected || outline(met), || format!("{segment:?}: t_max is not respected by {hit:?}"));
        }
    }
}

/// The same bits alone and in company.
fn check_batches(caster: &dyn RayCaster, rays: &[Ray], hits: &[Hit], report: &mut Report) {
    for (ray, hit) in rays.iter().zip(hits).step_by(7) {
        let alone = caster.nearest(*ray);
        report.check(alone == *hit, || format!("{ray:?}: {alone:?} alone, {hit:?} in a batch"));
    }
    caster.trace_nearest(&[], &mut []);
    caster.trace_occluded(&[], &mut []);
}

/// Rays that cannot meet anything.
fn check_bad_rays(caster: &dyn RayCaster, report: &mut Report) {
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    let mut rays = vec![Ray::new(Vec3::ZERO, Vec3::ZERO)];
    for value in bad {
        for axis in 0..3 {
            let mut vector = Vec3::new(0.1, 0.2, 0.3);
            vector[axis] = value;
            rays.push(Ray::new(vector, Vec3::X));
            rays.push(Ray::new(Vec3::ZERO, vector));
        }
    }
    for ray in rays {
        let hit = caster.nearest(ray);
        report.check(hit.is_miss(), || format!("{ray:?} is no ray, but found {hit:?}"));
        report.check(!caster.is_occluded(ray), || format!("{ray:?} is no ray, but is occluded"));
    }
}

/// The distance to the nearest crossing over all triangles; infinite without one.
fn brute_force(scene: &Scene, ray: &Ray) -> f64 {
    nearest_distance(scene, ray.origin.as_dvec3(), ray.direction.as_dvec3())
}

fn nearest_distance(scene: &Scene, origin: DVec3, direction: DVec3) -> f64 {
    crossings(scene, origin, direction).map(|(_, c)| c.t).fold(f64::INFINITY, f64::min)
}

fn crossings(scene: &Scene, origin: DVec3, direction: DVec3) -> impl Iterator<Item = (TriangleId, Crossing)> + '_ {
    let sheared = ShearedRay::new(origin, direction);
    let triangles = (0..scene.mesh().n_triangles() as u32).map(TriangleId);
    triangles.filter_map(move |t| sheared.cross(&scene.mesh().corners(t)).map(|crossing| (t, crossing)))
}

fn test_rays(scene: &Scene, n: usize, seed: u64) -> Vec<Ray> {
    let mesh = scene.mesh();
    let Some((min, max)) = mesh.bounds() else { return Vec::new() };
    let (min, size) = (min.as_dvec3(), (max - min).as_dvec3());
    let mut numbers = PathNumbers::new(seed, 0);
    (0..n)
        .map(|i| {
            let mut inside = || min + size * DVec3::new(numbers.uniform(), numbers.uniform(), numbers.uniform());
            let (origin, target) = (inside().as_vec3(), inside());
            let corners = mesh.corners(TriangleId((numbers.uniform() * mesh.n_triangles() as f64) as u32));
            let direction = match i % 4 {
                0 => target.as_vec3() - origin,
                1 => corners[i % 3] - origin,
                2 => corners[0].lerp(corners[1], numbers.uniform() as f32) - origin,
                _ => Vec3::AXES[i / 4 % 3] * if numbers.uniform() < 0.5 { -1.0 } else { 1.0 },
            };
            Ray::new(origin, direction)
        })
        .filter(|ray| ray.direction.length() > 1e-3)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes;

    /// Brute force with a fault to plant.
    struct Naive<'s> {
        scene: &'s Scene,
        spoil: fn(Ray, Hit) -> Hit,
    }

    impl Naive<'_> {
        fn hit(&self, ray: Ray) -> Hit {
            let finite = ray.origin.is_finite() && ray.direction.is_finite() && ray.direction != Vec3::ZERO;
            let all = crossings(self.scene, ray.origin.as_dvec3(), ray.direction.as_dvec3());
            let nearest = all.min_by(|a, b| a.1.t.total_cmp(&b.1.t)).filter(|_| finite);
            nearest.filter(|(_, c)| c.t < f64::from(ray.t_max)).map_or(Hit::MISS, |(triangle, c)| {
                let (t, u, v) = (c.t as f32, c.u as f32, c.v as f32);
                (self.spoil)(ray, Hit { t, u, v, triangle, is_front: c.is_front })
            })
        }
    }

    impl RayCaster for Naive<'_> {
        fn trace_nearest(&self, rays: &[Ray], hits: &mut [Hit]) {
            hits.iter_mut().zip(rays).for_each(|(hit, ray)| *hit = self.hit(*ray));
        }

        fn trace_occluded(&self, rays: &[Ray], occluded: &mut [bool]) {
            occluded.iter_mut().zip(rays).for_each(|(o, ray)| *o = !self.hit(*ray).is_miss());
        }
    }

    #[test]
    fn brute_force_conforms_to_itself_and_planted_faults_do_not() {
        let scene = scenes::build(scenes::cornell_box());
        let report = |spoil| ray_caster(&Naive { scene: &scene, spoil }, &scene, 2000, 1);
        report(|_, hit| hit).into_result().unwrap();
        let faults: [fn(Ray, Hit) -> Hit; 5] = [
            |_, hit| Hit { t: hit.t * 1.0001, ..hit },
            |_, hit| Hit { is_front: !hit.is_front, ..hit },
            |_, hit| Hit { u: hit.v, v: hit.u, ..hit },
            |_, hit| if hit.u < 0.01 { Hit::MISS } else { hit },
            |ray, hit| if ray.t_max.is_finite() { Hit::MISS } else { hit },
        ];
        for (i, fault) in faults.into_iter().enumerate() {
            assert!(!report(fault).passed(), "fault {i} is not seen");
        }
    }

    #[test]
    fn a_report_of_nothing_does_not_pass() {
        assert!(!Report::default().passed());
    }
}
