//! Short visible paths between neighbouring points of a surface.

use glam::Vec3;
use hplt_geom::{Extent, Hit, OrientedPoint, Ray, RayCaster, Scene, offset_origin};

/// Twice the least distance, scene units, by which `offset_origin` lifts a point, and more: paths stay above that.
const CLEARANCE: f32 = 3.0 / 65_536.0;

/// Height of the sight lines of a function over its support.
pub const SIGHT_LIFT: f32 = 0.05;
/// A step between two places on a surface that is lower than this, in supports, hides nothing.
const FLAT: f32 = 0.02;
/// How far sight lines go, in supports: beyond the corners of the polygon that they span.
const SIGHT: f32 = 1.5;

/// Surface that a sight line meets goes on from the point that it started at where the cosine between their normals is at least this:
/// a vault bends, a wall ends the floor.
const BEND: f32 = 0.5;
/// Times that a sight line follows the surface up.
const MAX_BENDS: u32 = 8;

/// A position and the unit normal of the side that is meant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Oriented {
    pub position: Vec3,
    pub normal: Vec3,
}

/// The surface around a point that is its own as far as functions of support `support` can tell: ten rays. Those in the
/// tangent plane start [`SIGHT_LIFT`] times the support above it, so that what is lower does not end the surface.
pub(crate) fn extent_of((scene, caster): (&Scene, &dyn RayCaster), point: &OrientedPoint, support: f32) -> Extent {
    let half_free = |direction: Vec3| {
        let t = caster.nearest(Ray::new(offset_origin(point.position, direction), direction)).t;
        (0.5 * t).max(CLEARANCE)
    };
    let (below, above) = (half_free(-point.normal), half_free(point.normal));
    let lift = (SIGHT_LIFT * support).min(0.5 * above);
    let place = Oriented { position: point.position, normal: point.normal };
    let line = SightLine { scene, caster, place, lift, reach: SIGHT * support };
    let inverse_depths = Extent::sector_directions(point.normal).map(|direction| match line.depth(direction) {
        Some(depth) => 1.0 / depth.max(CLEARANCE),
        None => 0.0,
    });
    Extent { below, above, sight_height: lift, inverse_depths }
}

/// A line of sight close above the surface around `place`, which it follows where that bends up.
struct SightLine<'a> {
    scene: &'a Scene,
    caster: &'a dyn RayCaster,
    place: Oriented,
    lift: f32,
    reach: f32,
}

impl SightLine<'_> {
    /// How far from the place, along a unit tangent, something ends the surface. `None` where nothing does within reach.
    fn depth(&self, tangent: Vec3) -> Option<f32> {
        let Self { scene, caster, place, lift, reach } = *self;
        let (mut from, mut direction, mut depth) = (place, tangent, 0.0);
        for _ in 0..=MAX_BENDS {
            let origin = offset_origin(from.position, from.normal) + lift * from.normal;
            let ahead = (reach - depth) / direction.dot(tangent);
            let hit = caster.nearest(Ray { origin, direction, t_max: ahead });
            if hit.is_miss() {
                return None;
            }
            depth += hit.t * direction.dot(tangent);
            let normal = scene.mesh().face_normal(hit.triangle) * if hit.is_front { 1.0 } else { -1.0 };
            if normal.dot(place.normal) < BEND {
                return Some(depth);
            }
            from = Oriented { position: scene.mesh().position_at(hit.triangle, hit.u, hit.v), normal };
            direction = (tangent - tangent.dot(normal) * normal).normalize_or(tangent);
        }
        Some(depth)
    }
}

/// The height of the free air above a point, along its unit normal, scene units: for
/// [`Extent::of_query`](hplt_geom::Extent::of_query). One ray.
pub fn free_height(caster: &dyn RayCaster, position: Vec3, normal: Vec3) -> f32 {
    height_of(&caster.nearest(upwards(position, normal)))
}

/// [`free_height`] of many points. Buffers of one worker.
#[derive(Debug, Default)]
pub struct FreeHeights {
    rays: Vec<Ray>,
    hits: Vec<Hit>,
}

impl FreeHeights {
    /// Those above these positions along their normals, in order.
    pub fn of(
        &mut self,
        caster: &dyn RayCaster,
        places: impl Iterator<Item = (Vec3, Vec3)>,
    ) -> impl Iterator<Item = f32> + '_ {
        self.rays.clear();
        self.rays.extend(places.map(|(position, normal)| upwards(position, normal)));
        self.hits.clear();
        self.hits.resize(self.rays.len(), Hit::MISS);
        caster.trace_nearest(&self.rays, &mut self.hits);
        self.hits.iter().map(height_of)
    }
}

fn upwards(position: Vec3, normal: Vec3) -> Ray {
    Ray::new(offset_origin(position, normal), normal)
}

fn height_of(hit: &Hit) -> f32 {
    hit.t.max(2.0 * CLEARANCE)
}

/// Whether the function at `point`, of support `support`, has a say at `query`, whose free height is known as far as it matters:
/// whether the [`sight_line`] between them is clear.
pub fn is_in_sight(caster: &dyn RayCaster, point: &OrientedPoint, query: &OrientedPoint, support: f32) -> bool {
    sight_line(point, query, support).is_none_or(|line| !caster.is_occluded(line))
}

/// The line from just above `query`, whose free height is known as far as it matters, to just above a function at `point` of support
/// `support`. `None` where the surface between them is flat and the extent of the function shows nothing so near: no ray need be cast
/// to know that it is clear.
pub fn sight_line(point: &OrientedPoint, query: &OrientedPoint, support: f32) -> Option<Ray> {
    let offset = query.position - point.position;
    let step = offset.dot((point.normal + query.normal).normalize_or_zero()).abs();
    let nearest = point.extent.inverse_depths.iter().fold(0.0, |largest: f32, d| largest.max(*d));
    if step <= FLAT * support && offset.length_squared() * nearest * nearest <= 1.0 {
        return None;
    }
    let lifted = |p: &OrientedPoint| {
        let lift = (SIGHT_LIFT * support).min(0.25 * p.extent.free_height());
        offset_origin(p.position, p.normal) + lift * p.normal
    };
    Some(Ray::segment(lifted(query), lifted(point)))
}

/// Whether light can go from just above `a` to just above `b` by way of a point above their middle, `slope` times their
/// distance high. True only when both legs are clear, so a chain of such paths never crosses a surface.
pub(crate) fn is_joined(caster: &dyn RayCaster, a: Oriented, b: Oriented, slope: f32) -> bool {
    let up = (a.normal + b.normal).normalize_or_zero();
    let height = slope * (a.position - b.position).length() + CLEARANCE;
    let apex = 0.5 * (a.position + b.position) + up * height;
    // A little beyond the apex, which may by chance lie exactly on a surface.
    let is_clear = |from: Oriented| {
        let leg = Ray::segment(offset_origin(from.position, from.normal), apex);
        !caster.is_occluded(Ray { t_max: 1.0 + 1.0 / 1024.0, ..leg })
    };
    is_clear(a) && is_clear(b)
}
