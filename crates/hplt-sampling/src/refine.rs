//! The next finer level of a hierarchy, only where it is wanted.

use glam::Vec3;
use hplt_geom::{
    Extent, Interrupted, OrientedPoint, PointLevel, Progress, Ray, RayCaster, Scene, offset_origin, parallel,
};

use crate::morton::morton_code;
use crate::poisson::{Level, distance_squared};
use crate::random::{Stage, hash};
use crate::sobol::sobol_2d;
use crate::visibility::extent_of;
use crate::warp::concentric_disc;

/// Candidates around each refined point: where it stands alone, twice what a maximal set of half its radius takes in its
/// support; where its neighbours are refined too, some fifteen times.
const CANDIDATES: u32 = 64;
/// Least cosine between the normals of a point and a candidate around it; beyond, others stand nearer to the candidate.
const MIN_COSINE: f32 = 0.1;
const STAGE: &str = "placing points";

/// Points of half the Poisson radius of `coarse` around those of its points that `is_refined` says, each within the support
/// (twice the radius) and in sight of one of them: a maximal Poisson-disk set of candidates that rays from just above find. A
/// candidate is in the region of the point that it was found from.
///
/// `level` is the number of the new level; with `seed` it selects the candidates. Runs in parallel; the same bits at any thread
/// count. Cost: about 130 rays per refined point, and ten per new one.
///
/// # Errors
/// When cancelled.
pub fn refined_level(
    scene: &Scene,
    caster: &dyn RayCaster,
    coarse: &PointLevel,
    is_refined: &[bool],
    (level, seed): (u32, u64),
    progress: &dyn Progress,
) -> Result<PointLevel, Interrupted> {
    let radius = 0.5 * coarse.poisson_radius;
    let refined: Vec<u32> = (0..coarse.points.len() as u32).filter(|&i| is_refined[i as usize]).collect();
    let around = Around { scene, caster, support: 2.0 * coarse.poisson_radius, seed, level };
    let found = parallel::try_map(refined.len(), Vec::new, |rays, k| {
        progress.check()?;
        Ok(around.candidates(refined[k], &coarse.points[refined[k] as usize], rays))
    })?;
    // One candidate of every point in turn, so that early ones are spread over all.
    let candidates: Vec<OrientedPoint> =
        (0..CANDIDATES as usize).flat_map(|k| found.iter().filter_map(move |of_point| of_point[k])).collect();
    let mut new = Level::new(radius, 4 * refined.len());
    let mut start = 0;
    while start < candidates.len() {
        progress.check()?;
        progress.advance(STAGE, start as u64, candidates.len() as u64);
        let end = (2 * start).max(1024).min(candidates.len());
        let batch: Vec<u32> = (start as u32..end as u32).collect();
        new.throw(&candidates, &batch, |point| extent_of((scene, caster), point, 2.0 * radius));
        start = end;
    }
    let mut points = new.into_points();
    points.sort_by_cached_key(|p| morton_code(p.position));
    points.iter_mut().for_each(|p| p.area = radius * radius);
    Ok(PointLevel { is_refined: vec![false; points.len()], ..PointLevel::new(radius, points) })
}

struct Around<'a> {
    scene: &'a Scene,
    caster: &'a dyn RayCaster,
    support: f32,
    seed: u64,
    level: u32,
}

impl Around<'_> {
    /// What rays along the normal meet around `point`, from places in the air that are in sight of it.
    fn candidates(&self, id: u32, point: &OrientedPoint, rays: &mut Vec<Ray>) -> Vec<Option<OrientedPoint>> {
        let scramble = hash(self.seed, Stage::Candidates, id, self.level, 2);
        let (tangent, bitangent) = point.normal.any_orthonormal_pair();
        let origin = offset_origin(point.position, point.normal);
        // From high above, to find what is raised, and from low, to get under what overhangs.
        let heights = [0.33 * self.support, 0.05 * self.support].map(|h| h.min(0.9 * point.extent.above));
        rays.clear();
        rays.extend((0..CANDIDATES).map(|k| {
            let disc = concentric_disc(sobol_2d(k, scramble, 0)) * self.support;
            let start = origin + tangent * disc.x + bitangent * disc.y + point.normal * heights[k as usize % 2];
            Ray::segment(origin, start)
        }));
        let mut blocked = vec![false; rays.len()];
        self.caster.trace_occluded(rays, &mut blocked);
        let look_down = |(ray, blocked): (&Ray, &bool)| {
            if *blocked {
                return None;
            }
            let start = ray.origin + ray.direction * ray.t_max;
            self.below(point, start)
        };
        rays.iter().zip(&blocked).map(look_down).collect()
    }

    fn below(&self, point: &OrientedPoint, start: Vec3) -> Option<OrientedPoint> {
        let depth = (start - point.position).dot(point.normal) + self.support / 3.0;
        let hit = self.caster.nearest(Ray { origin: start, direction: -point.normal, t_max: depth });
        if hit.is_miss() {
            return None;
        }
        let surface = self.scene.surface_at(&hit);
        // Free at least up to where the ray came from.
        let extent = Extent::of_query(hit.t);
        let candidate = OrientedPoint { extent, ..OrientedPoint::new(surface.position, surface.normal, point.region) };
        let reflects = self.scene.material(surface.triangle).reflects.includes(surface.is_front);
        let is_near = point.normal.dot(surface.normal) > MIN_COSINE
            && distance_squared(point, surface.position) < self.support * self.support;
        (reflects && is_near && point.is_continued_at(&candidate)).then_some(candidate)
    }
}
