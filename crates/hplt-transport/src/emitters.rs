//! Emissive triangles as light sources.

use glam::{DVec3, Vec3};
use hplt_geom::radiometry::{area_kernel, luminance, polygon_form_factor};
use hplt_geom::{LightGroupId, LightGroups, Material, Rgb, Scene, TriangleId};

/// Above this many emitters a point samples some of them instead of all.
const MANY: usize = 32;

/// One side of one emissive triangle.
#[derive(Debug, Clone)]
pub(crate) struct Emitter {
    pub corners: [Vec3; 3],
    /// Unit normal on the side that emits.
    pub normal: Vec3,
    pub area: f32,
    pub triangle: TriangleId,
    pub is_front: bool,
    pub group: LightGroupId,
    /// Exitance when it is the same all over; `None` when textured.
    pub uniform_exitance: Option<Rgb>,
}

impl Emitter {
    /// The irradiance without occlusion at a point, over the exitance: the exact configuration factor.
    pub fn form_factor(&self, position: Vec3, normal: Vec3) -> f32 {
        let [a, b, c] = self.corners.map(|p| p.as_dvec3() - position.as_dvec3());
        let corners: [DVec3; 3] = if self.is_front { [a, b, c] } else { [a, c, b] };
        polygon_form_factor(normal.as_dvec3(), &corners).max(0.0) as f32
    }

    /// Whether any of it is above the horizon of a point that is in front of it.
    pub fn can_light(&self, position: Vec3, normal: Vec3) -> bool {
        (position - self.corners[0]).dot(self.normal) > 0.0
            && self.corners.iter().any(|c| (*c - position).dot(normal) > 0.0)
    }

    /// The point at barycentric weights `(1-u-v, u, v)`.
    pub fn point(&self, u: f32, v: f32) -> Vec3 {
        let [a, b, c] = self.corners;
        a * (1.0 - u - v) + b * u + c * v
    }

    /// The exitance there.
    pub fn exitance(&self, scene: &Scene, u: f32, v: f32) -> Rgb {
        self.uniform_exitance.unwrap_or_else(|| {
            scene.material(self.triangle).exitance_at(self.is_front, scene.mesh().uv_at(self.triangle, u, v))
        })
    }

    /// Irradiance per exitance and per share of the area around `target`, without occlusion.
    pub fn kernel(&self, position: Vec3, normal: Vec3, target: Vec3) -> f32 {
        let to = target - position;
        let distance_squared = to.length_squared();
        if distance_squared <= 0.0 {
            return 0.0;
        }
        let direction = to / distance_squared.sqrt();
        self.area * area_kernel(normal.dot(direction), -self.normal.dot(direction), distance_squared)
    }
}

/// All emitters of a scene.
#[derive(Debug, Clone)]
pub(crate) struct Emitters {
    pub all: Vec<Emitter>,
    /// Running share of the power, ending at 1; empty when every point samples every emitter.
    cumulative: Vec<f32>,
}

impl Emitters {
    pub fn new(scene: &Scene, groups: &LightGroups) -> Self {
        let mut all = Vec::new();
        for triangle in scene.emissive_triangles() {
            let material = scene.material(triangle);
            let Some(group) = groups.of_material(scene.mesh().material(triangle)) else { continue };
            for is_front in [true, false] {
                if material.emits.includes(is_front) {
                    all.push(emitter(scene, (material, group), triangle, is_front));
                }
            }
        }
        let cumulative = if all.len() > MANY { cumulative_power(scene, &all) } else { Vec::new() };
        Self { all, cumulative }
    }

    /// Whether points should sample some emitters rather than all of them.
    pub fn is_many(&self) -> bool {
        !self.cumulative.is_empty()
    }

    /// An emitter chosen by power with `u` in `[0, 1)`, the probability of that choice, and `u` made uniform again.
    pub fn choose(&self, u: f32) -> (&Emitter, f32, f32) {
        let i = self.cumulative.partition_point(|&c| c <= u).min(self.all.len() - 1);
        let below = if i == 0 { 0.0 } else { self.cumulative[i - 1] };
        let probability = self.cumulative[i] - below;
        (&self.all[i], probability, ((u - below) / probability).clamp(0.0, 1.0 - f32::EPSILON))
    }
}

fn emitter(
    scene: &Scene,
    (material, group): (&Material, LightGroupId),
    triangle: TriangleId,
    is_front: bool,
) -> Emitter {
    let side = if is_front { 1.0 } else { -1.0 };
    Emitter {
        corners: scene.mesh().corners(triangle),
        normal: scene.mesh().face_normal(triangle) * side,
        area: scene.mesh().area(triangle) as f32,
        triangle,
        is_front,
        group,
        uniform_exitance: material.exitance_texture.is_none().then_some(material.exitance),
    }
}

/// Shares proportional to area times luminance; textured emitters count with their factor.
fn cumulative_power(scene: &Scene, emitters: &[Emitter]) -> Vec<f32> {
    let power = |e: &Emitter| f64::from(e.area) * f64::from(luminance(scene.material(e.triangle).exitance));
    let total: f64 = emitters.iter().map(power).sum();
    let mut sum = 0.0;
    emitters
        .iter()
        .map(|e| {
            sum += power(e);
            (sum / total) as f32
        })
        .collect()
}
