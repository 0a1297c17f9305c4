//! The rays of gathers and of direct light, as the solver makes them.

use hplt_geom::glam::{Vec2, Vec3};
use hplt_geom::{Ray, RayCaster, Scene, TriangleId, offset_origin};
use hplt_sampling::random::{Stage, Stream, unit_f32};
use hplt_sampling::{sobol, warp};

/// Rays per receiver, hence per call.
pub const N_RAYS: usize = 256;

/// Gather rays and shadow segments of the same receivers, [`N_RAYS`] each.
pub struct Rays {
    /// Cosine-distributed from each receiver.
    pub gather: Vec<Ray>,
    /// From each receiver to random surface points.
    pub shadow: Vec<Ray>,
}

/// Uniform points of the surface.
struct Points<'a> {
    scene: &'a Scene,
    cumulative: Vec<f64>,
    stream: Stream,
    fronts_only: bool,
}

impl<'a> Points<'a> {
    fn new(scene: &'a Scene, stage: Stage, fronts_only: bool) -> Self {
        let mut total = 0.0;
        let mut add = |t| {
            total += scene.mesh().area(TriangleId(t));
            total
        };
        let cumulative = (0..scene.mesh().n_triangles() as u32).map(&mut add).collect();
        Self { scene, cumulative, stream: Stream::new(1, stage), fronts_only }
    }

    /// A position and the normal of a random side, or of the front.
    fn point(&self, index: u32) -> (Vec3, Vec3) {
        let [a, b, c, d] = self.stream.words(index, 0, 0);
        let total = self.cumulative[self.cumulative.len() - 1];
        let target = f64::from(unit_f32(a)) * total;
        let triangle = TriangleId(self.cumulative.partition_point(|&x| x < target) as u32);
        let Vec2 { x: u, y: v } = warp::uniform_triangle(Vec2::new(unit_f32(b), unit_f32(c)));
        let side = if self.fronts_only || d & 1 == 0 { 1.0 } else { -1.0 };
        (self.scene.mesh().position_at(triangle, u, v), self.scene.mesh().face_normal(triangle) * side)
    }
}

/// The rays of `n` receivers along a Morton curve. Receivers that see more sky than surface are left out: the back of an
/// open box would be a benchmark of rays that meet nothing. `fronts_only` leaves out the inside of closed bodies.
pub fn rays(scene: &Scene, caster: &impl RayCaster, n: u32, fronts_only: bool) -> Rays {
    let points = Points::new(scene, Stage::Candidates, fronts_only);
    let targets = Points::new(scene, Stage::Emission, fronts_only);
    let sees_surface = |&(position, normal): &(Vec3, Vec3)| {
        let origin = offset_origin(position, normal);
        let direction = |k| warp::cosine_hemisphere(sobol::sobol_2d(k, 1, 0), normal);
        (0..16).filter(|&k| caster.nearest(Ray::new(origin, direction(k))).is_miss()).count() <= 8
    };
    let candidates = (0..16 * n).map(|i| points.point(i));
    let mut receivers: Vec<(Vec3, Vec3)> = candidates.filter(sees_surface).take(n as usize).collect();
    receivers.sort_by_key(|(p, _)| morton(*p));
    let mut rays = Rays { gather: Vec::new(), shadow: Vec::new() };
    for (i, (position, normal)) in (0..n).zip(receivers) {
        let scramble = points.stream.word(i, 1, 0);
        let origin = offset_origin(position, normal);
        for k in 0..N_RAYS as u32 {
            let direction = warp::cosine_hemisphere(sobol::sobol_2d(k, scramble, 0), normal);
            rays.gather.push(Ray::new(origin, direction));
            let (p, n) = targets.point(i * N_RAYS as u32 + k);
            let n = if n.dot(origin - p) < 0.0 { -n } else { n };
            rays.shadow.push(Ray::segment(origin, offset_origin(p, n)));
        }
    }
    rays
}

fn morton(p: Vec3) -> u64 {
    let cell = ((p + Vec3::ONE) * 512.0).clamp(Vec3::ZERO, Vec3::splat(1023.0)).to_array().map(|x| x as u64);
    (0..30).map(|bit| (cell[bit % 3] >> (bit / 3) & 1) << bit).sum()
}
