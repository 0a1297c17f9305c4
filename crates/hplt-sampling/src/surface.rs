//! Uniform points on the sides of the surfaces of a scene.

use glam::{Vec2, Vec3};
use hplt_geom::{Material, Ray, RayCaster, Scene, TriangleId, offset_origin, parallel};

use crate::random::{unit_f32, unit_f64};
use crate::warp::uniform_triangle;

/// A point on one side of a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SidePoint {
    pub position: Vec3,
    /// Unit, on the side that is meant.
    pub normal: Vec3,
    pub triangle: TriangleId,
    pub is_front: bool,
    pub uv: Vec2,
}

/// One side of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Side {
    pub triangle: TriangleId,
    pub is_front: bool,
}

/// Draws points uniformly by area from a set of sides.
#[derive(Debug)]
pub(crate) struct SideSampler {
    sides: Vec<Side>,
    /// Area up to and including each side, scene units squared.
    cumulative: Vec<f64>,
    /// For each of equally many equal slices of the area: the first side that reaches into it.
    guide: Vec<u32>,
}

const MAX_GUIDE: usize = 1 << 20;

impl SideSampler {
    /// Over the sides that `includes` agrees to.
    pub(crate) fn build(scene: &Scene, includes: impl Fn(&Material, bool) -> bool) -> Self {
        let mesh = scene.mesh();
        let of_material: Vec<[bool; 2]> =
            scene.materials().iter().map(|m| [includes(m, true), includes(m, false)]).collect();
        let areas = parallel::map(mesh.n_triangles(), || (), |(), i| mesh.area(TriangleId(i as u32)));
        let (mut sides, mut cumulative, mut total) = (Vec::new(), Vec::new(), 0.0);
        for triangle in (0..mesh.n_triangles() as u32).map(TriangleId) {
            let [front, back] = of_material[mesh.material(triangle).0 as usize];
            let area = areas[triangle.index()];
            for is_front in [front.then_some(true), back.then_some(false)].into_iter().flatten() {
                total += area;
                sides.push(Side { triangle, is_front });
                cumulative.push(total);
            }
        }
        let guide = guide_of(&cumulative);
        Self { sides, cumulative, guide }
    }

    /// The area of all sides, scene units squared.
    pub(crate) fn area(&self) -> f64 {
        self.cumulative.last().copied().unwrap_or(0.0)
    }

    pub(crate) fn sides(&self) -> &[Side] {
        &self.sides
    }

    pub(crate) fn area_of(&self, side: usize) -> f64 {
        self.cumulative[side] - side.checked_sub(1).map_or(0.0, |before| self.cumulative[before])
    }

    /// The point that four random words choose; `None` where an alpha mask cuts the surface away, or without sides.
    pub(crate) fn sample(&self, scene: &Scene, words: [u32; 4]) -> Option<SidePoint> {
        if self.sides.is_empty() {
            return None;
        }
        let x = unit_f64(words[0], words[1]);
        let target = x * self.area();
        let mut i = self.guide[(x * self.guide.len() as f64) as usize] as usize;
        while i + 1 < self.sides.len() && self.cumulative[i] <= target {
            i += 1;
        }
        point_on(scene, self.sides[i], words[2], words[3])
    }
}

fn guide_of(cumulative: &[f64]) -> Vec<u32> {
    let Some(&total) = cumulative.last() else { return Vec::new() };
    let n = cumulative.len().min(MAX_GUIDE);
    let mut first = 0;
    (0..n)
        .map(|slice| {
            // One side early: rounding must not skip the right one.
            while first + 1 < cumulative.len() && cumulative[first] < total * (slice as f64 / n as f64) {
                first += 1;
            }
            first.saturating_sub(1) as u32
        })
        .collect()
}

/// A uniform point on one side; `None` where an alpha mask cuts it away.
pub(crate) fn point_on(scene: &Scene, side: Side, word_u: u32, word_v: u32) -> Option<SidePoint> {
    let weights = uniform_triangle(Vec2::new(unit_f32(word_u), unit_f32(word_v)));
    let Side { triangle, is_front } = side;
    let mesh = scene.mesh();
    let uv = mesh.uv_at(triangle, weights.x, weights.y);
    if scene.material(triangle).alpha.as_ref().is_some_and(|mask| !mask.is_opaque(uv)) {
        return None;
    }
    let normal = mesh.face_normal(triangle) * if is_front { 1.0 } else { -1.0 };
    Some(SidePoint { position: mesh.position_at(triangle, weights.x, weights.y), normal, triangle, is_front, uv })
}

impl SidePoint {
    /// Whether the side can be seen from just above it. Not so between coincident or nearly coincident surfaces, closer
    /// than the offset of rays: the ray that comes back down meets another surface first, or the wrong side of one.
    pub(crate) fn is_exposed(&self, caster: &dyn RayCaster) -> bool {
        let above = offset_origin(self.position, self.normal);
        let height = (above - self.position).dot(self.normal);
        let hit = caster.nearest(Ray { origin: above, direction: -self.normal, t_max: 2.0 * height });
        hit.is_miss() || hit.triangle == self.triangle || (hit.t >= 0.5 * height && hit.is_front == self.is_front)
    }
}
