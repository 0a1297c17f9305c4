//! Places on the surface where a path turns.

use hplt_geom::glam::{DVec2, DVec3, Vec2, Vec3};
use hplt_geom::{Scene, TriangleId};

use super::tree::{Meeting, Tree};

/// How far a given point may lie from its surface, scene units: tried in this order.
const REACH: [f64; 2] = [1e-6, 1e-4];
/// Surfaces this close to each other are the same place.
const SAME_PLACE: f64 = 2e-7;
/// A start on an edge is moved inside by this part of the triangle.
const INSIDE: f64 = 1e-6;

/// A vertex of a path: a point on one side of a triangle, or in the air.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    pub(super) position: DVec3,
    /// Unit geometric normal on this side.
    pub(super) geometric: DVec3,
    /// Unit normal that irradiance is measured against.
    pub(super) normal: DVec3,
    /// [`TriangleId::NONE`] in the air.
    pub(super) triangle: TriangleId,
    pub(super) is_front: bool,
    pub(super) uv: Vec2,
}

impl Vertex {
    /// The surface where a ray arrived.
    pub(super) fn from_meeting(scene: &Scene, meeting: &Meeting) -> Self {
        let crossing = &meeting.crossing;
        on_triangle(scene, meeting.triangle, crossing.u, crossing.v, crossing.is_front)
    }

    /// The surface at a point that should lie on it, on the side that `normal` points to; a point in the air when there is
    /// none near.
    pub(super) fn from_point(scene: &Scene, tree: &Tree, position: Vec3, normal: Vec3) -> Self {
        let point = position.as_dvec3();
        let normal = normal.as_dvec3().normalize_or(DVec3::Y);
        for reach in REACH {
            let mut near = tree.near(point, reach);
            let facing = |t: TriangleId| unit_normal(scene, t).dot(normal);
            if near.iter().any(|n| facing(n.0).abs() > 0.5) {
                near.retain(|n| facing(n.0).abs() > 0.5);
            }
            let nearest = near.iter().map(|n| n.2).fold(f64::INFINITY, f64::min);
            near.retain(|n| n.2 <= nearest + SAME_PLACE);
            let best = near.into_iter().min_by_key(|n| (facing(n.0) < 0.0, n.0));
            if let Some((triangle, (u, v), _)) = best {
                let (u, v) = moved_inside(u, v);
                return Self { normal, ..on_triangle(scene, triangle, u, v, facing(triangle) >= 0.0) };
            }
        }
        let (triangle, is_front, uv) = (TriangleId::NONE, true, Vec2::ZERO);
        Self { position: point, geometric: normal, normal, triangle, is_front, uv }
    }

    /// The direction around the normal for two uniform numbers, with density `cosθ/π`.
    pub(super) fn cosine_direction(&self, numbers: DVec2) -> DVec3 {
        let disc = concentric_disc(numbers);
        let height = (1.0 - disc.length_squared()).max(0.0).sqrt();
        let (tangent, bitangent) = self.normal.any_orthonormal_pair();
        tangent * disc.x + bitangent * disc.y + self.normal * height
    }

    /// Whether light along `direction` (away from the surface) can arrive on this side.
    pub(super) fn sees(&self, direction: DVec3) -> bool {
        self.normal.dot(direction) > 0.0 && self.geometric.dot(direction) > 0.0
    }
}

/// The uniform point of the unit disc for a uniform point of the unit square (Shirley & Chiu 1997).
fn concentric_disc(numbers: DVec2) -> DVec2 {
    let p = numbers * 2.0 - 1.0;
    if p == DVec2::ZERO {
        return p;
    }
    let quarter = std::f64::consts::FRAC_PI_4;
    let (radius, angle) =
        if p.x.abs() > p.y.abs() { (p.x, quarter * (p.y / p.x)) } else { (p.y, 2.0 * quarter - quarter * (p.x / p.y)) };
    DVec2::from_angle(angle) * radius
}

fn on_triangle(scene: &Scene, triangle: TriangleId, u: f64, v: f64, is_front: bool) -> Vertex {
    let mesh = scene.mesh();
    let [a, b, c] = mesh.corners(triangle).map(|p| p.as_dvec3());
    let geometric = unit_normal(scene, triangle) * if is_front { 1.0 } else { -1.0 };
    let uv = if mesh.has_uvs() { mesh.uv_at(triangle, u as f32, v as f32) } else { Vec2::ZERO };
    let position = a + (b - a) * u + (c - a) * v;
    Vertex { position, geometric, normal: geometric, triangle, is_front, uv }
}

pub(super) fn unit_normal(scene: &Scene, triangle: TriangleId) -> DVec3 {
    let [a, b, c] = scene.mesh().corners(triangle).map(|p| p.as_dvec3());
    (b - a).cross(c - a).normalize()
}

fn moved_inside(u: f64, v: f64) -> (f64, f64) {
    let weights = DVec3::new(1.0 - u - v, u, v).max(DVec3::splat(INSIDE));
    let weights = weights / weights.element_sum();
    (weights.y, weights.z)
}
