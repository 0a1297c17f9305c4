//! Emissive triangles, and rectangles of two, as light sources.

use std::ops::Deref;

use glam::{DVec3, Vec2, Vec3};
use hplt_geom::radiometry::{area_kernel, cosine_pdf_solid_angle, luminance, polygon_form_factor};
use hplt_geom::{LightGroupId, LightGroups, Material, OrientedPoint, Rgb, Scene, TriangleId, parallel};
use hplt_sampling::warp::{self, Rectangle, SphericalRectangle, SphericalTriangle};

use crate::light_tree::{Cut, LightTree};

/// Above this many emitters a point samples some of them instead of all.
const MANY: usize = 32;
/// Least cosine in the estimate of what an emitter brings, which only guides the choice of one.
const LEAST_COSINE: f32 = 0.05;
/// Area over squared distance above which an emitter is sampled by solid angle.
const LOOMING: f32 = 0.1;
/// By how much of its diagonal the fourth corner of a rectangle may be elsewhere, and the cosine of its angle.
const SKEW: f32 = 1e-5;

/// The corners of a triangle or a rectangle, as the mesh winds them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Corners {
    /// The last one twice in a triangle.
    all: [Vec3; 4],
    n: usize,
}

impl Corners {
    pub const fn triangle([a, b, c]: [Vec3; 3]) -> Self {
        Self { all: [a, b, c, c], n: 3 }
    }

    pub const fn rectangle(all: [Vec3; 4]) -> Self {
        Self { all, n: 4 }
    }

    pub fn map(self, f: impl Fn(Vec3) -> Vec3) -> Self {
        Self { all: self.all.map(f), ..self }
    }

    /// The mean of the corners.
    pub fn center(&self) -> Vec3 {
        self.iter().sum::<Vec3>() / self.n as f32
    }

    /// A triangle's right-angled corner between the two ends of its longest side, if it has a right angle.
    fn right_angle(&self) -> Option<[Vec3; 3]> {
        let [a, b, c, _] = self.all;
        let is_right = |&[p, q, r]: &[Vec3; 3]| {
            (p - q).normalize_or_zero().dot((r - q).normalize_or_zero()).abs() <= SKEW && p != q && q != r
        };
        [[a, b, c], [b, c, a], [c, a, b]].into_iter().find(is_right)
    }
}

impl Deref for Corners {
    type Target = [Vec3];

    fn deref(&self) -> &[Vec3] {
        &self.all[..self.n]
    }
}

/// One side of one emissive triangle, or of two that make a rectangle.
#[derive(Debug, Clone)]
pub(crate) struct Emitter {
    pub corners: Corners,
    /// The same for looking at it, if it is a rectangle.
    pub rectangle: Option<Box<Rectangle>>,
    /// Unit normal on the side that emits.
    pub normal: Vec3,
    pub area: f32,
    /// The one it is, or one of the two.
    pub triangle: TriangleId,
    pub is_front: bool,
    pub group: LightGroupId,
    /// Exitance when it is the same all over; `None` when textured.
    pub uniform_exitance: Option<Rgb>,
    /// Area times luminance, not 0; textured emitters count with their factor.
    pub power: f32,
}

/// An emitter as a point sees it.
pub(crate) struct Seen<'e> {
    emitter: &'e Emitter,
    position: Vec3,
    normal: Vec3,
    /// Where it looms.
    shape: Option<Shape>,
}

enum Shape {
    Triangle(SphericalTriangle),
    Rectangle(SphericalRectangle),
}

impl Seen<'_> {
    /// A point of it to send a shadow ray to, by where the light comes from: uniform in solid angle where it looms large, else in
    /// area. `u` is uniform in the unit square.
    pub fn aim(&self, scene: &Scene, u: Vec2) -> Aim {
        let Self { emitter, position, normal, .. } = *self;
        let (target, solid_angle) = match &self.shape {
            Some(Shape::Triangle(triangle)) => {
                let direction = triangle.sample(u);
                let distance = (emitter.corners[0] - position).dot(emitter.normal) / direction.dot(emitter.normal);
                (position + distance * direction, triangle.solid_angle())
            }
            Some(Shape::Rectangle(rectangle)) => {
                let Vec2 { x: s, y: t } = rectangle.sample(u);
                (emitter.point(s, t), rectangle.solid_angle())
            }
            None => {
                let Vec2 { x: s, y: t } = if emitter.is_rectangle() { u } else { warp::uniform_triangle(u) };
                let target = emitter.point(s, t);
                let exitance = emitter.exitance(scene, || Vec2::new(s, t));
                return Aim { target, brings: exitance * emitter.kernel(position, normal, target) };
            }
        };
        let cos = normal.dot((target - position).normalize_or_zero()).max(0.0);
        let weight = cosine_pdf_solid_angle(cos) * solid_angle as f32;
        Aim { target, brings: emitter.exitance(scene, || emitter.weights_of(target)) * weight }
    }
}

impl Emitter {
    /// The irradiance without occlusion at a point, over the exitance: the exact configuration factor.
    pub fn form_factor(&self, position: Vec3, normal: Vec3) -> f32 {
        let mut corners = self.corners.all.map(|p| p.as_dvec3() - position.as_dvec3());
        let corners: &mut [DVec3] = &mut corners[..self.corners.n];
        if !self.is_front {
            corners.reverse();
        }
        polygon_form_factor(normal.as_dvec3(), corners).max(0.0) as f32
    }

    /// Whether any of it is above the horizon of a point that is in front of it.
    pub fn can_light(&self, position: Vec3, normal: Vec3) -> bool {
        (position - self.corners[0]).dot(self.normal) > 0.0
            && self.corners.iter().any(|c| (*c - position).dot(normal) > 0.0)
    }

    /// About what it brings to a point, and 0 only where that is nothing: guides the choice of an emitter.
    pub fn guide(&self, position: Vec3, normal: Vec3) -> f64 {
        if !self.can_light(position, normal) {
            return 0.0;
        }
        if self.looms(position) {
            let factor = f64::from(self.form_factor(position, normal)).max(f64::from(f32::MIN_POSITIVE));
            return f64::from(self.power / self.area) * std::f64::consts::PI * factor;
        }
        let to = self.corners.center() - position;
        let distance_squared = to.length_squared().max(self.area * 0.1).max(f32::MIN_POSITIVE);
        let direction = to.normalize_or_zero();
        let cosines = normal.dot(direction).max(LEAST_COSINE) * (-self.normal.dot(direction)).max(LEAST_COSINE);
        f64::from(self.power) * f64::from(cosines) / f64::from(distance_squared)
    }

    /// The point at barycentric weights `(1-u-v, u, v)` of the first corner and its neighbours; of a rectangle, the first weight may
    /// be negative.
    pub fn point(&self, u: f32, v: f32) -> Vec3 {
        let [a, b, .., last] = self.corners.all;
        a * (1.0 - u - v) + b * u + last * v
    }

    fn is_rectangle(&self) -> bool {
        self.corners.n == 4
    }

    /// For shadow rays to it from one point.
    pub fn seen_from(&self, position: Vec3, normal: Vec3) -> Seen<'_> {
        let [a, b, c, _] = self.corners.all;
        let shape = match (self.looms(position), &self.rectangle) {
            (false, _) => None,
            (true, Some(rectangle)) => SphericalRectangle::new(rectangle, position).map(Shape::Rectangle),
            (true, None) => SphericalTriangle::new([a - position, b - position, c - position]).map(Shape::Triangle),
        };
        Seen { emitter: self, position, normal, shape }
    }

    /// Whether it takes up so much of the view that points of it bring very different amounts.
    fn looms(&self, position: Vec3) -> bool {
        let nearest = self.corners.iter().map(|c| c.distance_squared(position)).fold(f32::INFINITY, f32::min);
        self.area > LOOMING * nearest
    }

    /// The barycentric weights of the second and third corner at a point of its plane, within the triangle of the first three.
    fn weights_of(&self, target: Vec3) -> Vec2 {
        let [a, b, c, _] = self.corners.all;
        let normal = (b - a).cross(c - a);
        let share = |p: Vec3, q: Vec3| (p.cross(q).dot(normal) / normal.length_squared()).clamp(0.0, 1.0);
        let (s, t) = (share(target - a, c - a), share(b - a, target - a));
        Vec2::new(s, t) / (s + t).max(1.0)
    }

    /// The exitance at these barycentric weights, which only a triangle with a texture asks for.
    fn exitance(&self, scene: &Scene, weights: impl FnOnce() -> Vec2) -> Rgb {
        self.uniform_exitance.unwrap_or_else(|| {
            let Vec2 { x: u, y: v } = weights();
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

/// Where a shadow ray goes.
pub(crate) struct Aim {
    pub target: Vec3,
    /// What it brings if nothing is in the way, over the probability density: irradiance, W/m².
    pub brings: Rgb,
}

/// All emitters of a scene.
#[derive(Debug, Clone)]
pub(crate) struct Emitters {
    pub all: Vec<Emitter>,
    /// `None` when every point samples every emitter.
    pub tree: Option<LightTree>,
}

/// One emitter of all.
pub(crate) struct Choice<'e> {
    pub emitter: &'e Emitter,
    /// Of this choice.
    pub probability: f32,
    /// The number that chose, made uniform in `[0, 1)` again.
    pub again: f32,
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
        Self::of(with_rectangles(all))
    }

    fn of(mut all: Vec<Emitter>) -> Self {
        let tree = (all.len() > MANY).then(|| LightTree::build(&mut all));
        Self { all, tree }
    }

    /// Whether points should sample some emitters rather than all of them.
    pub fn is_many(&self) -> bool {
        self.tree.is_some()
    }

    /// How `point` chooses between them, so many times.
    pub fn at<'e, 'g>(&'e self, point: &OrientedPoint, n_draws: u32, guides: &'g mut Guides) -> Chooser<'e, 'g> {
        let OrientedPoint { position, normal, .. } = *point;
        match &self.tree {
            Some(tree) => tree.cut(&self.all, (position, normal), n_draws, &mut guides.cut),
            // One leaf of all.
            None => {
                guides.cut.clear();
                guides.cut.push((0, 1.0));
            }
        }
        let total = guides.cut.iter().map(|(_, importance)| importance).sum();
        Chooser { emitters: self, position, normal, total, guides }
    }
}

/// Buffers of choices.
#[derive(Default)]
pub(crate) struct Guides {
    cut: Cut,
    members: Vec<f64>,
}

/// What one point knows of the emitters.
pub(crate) struct Chooser<'e, 'g> {
    emitters: &'e Emitters,
    position: Vec3,
    normal: Vec3,
    /// Of the importances of the cut.
    total: f64,
    guides: &'g mut Guides,
}

impl<'e> Chooser<'e, '_> {
    /// An emitter chosen by about what each brings to the point, with `u` in `[0, 1)`. `None` where none brings anything, or where
    /// the choice falls on a group of them of which that is true.
    pub fn choose(&mut self, u: f64) -> Option<Choice<'e>> {
        let all = &self.emitters.all;
        if let [only] = &all[..] {
            let again = (u as f32).min(1.0 - f32::EPSILON);
            return only.can_light(self.position, self.normal).then_some(Choice {
                emitter: only,
                probability: 1.0,
                again,
            });
        }
        let (i, of_cut, u) = pick(self.guides.cut.iter().map(|(_, importance)| *importance), self.total, u)?;
        let (members, of_members, u) = match &self.emitters.tree {
            Some(tree) => tree.descend(all, self.guides.cut[i].0, (self.position, self.normal), u)?,
            None => (0..all.len(), 1.0, u),
        };
        let members = &all[members];
        let guides = &mut self.guides.members;
        guides.clear();
        guides.extend(members.iter().map(|emitter| emitter.guide(self.position, self.normal)));
        let (i, of_guides, again) = pick(guides.iter().copied(), guides.iter().sum(), u)?;
        let again = (again as f32).min(1.0 - f32::EPSILON);
        Some(Choice { emitter: &members[i], probability: (of_cut * of_members * of_guides) as f32, again })
    }
}

/// The index that `u` in `[0, 1)` chooses by weights of the given sum, its probability, and `u` made uniform again. `None` where all are 0.
fn pick(weights: impl Iterator<Item = f64>, total: f64, u: f64) -> Option<(usize, f64, f64)> {
    let (mut rest, mut last) = (u * total, None);
    for (i, weight) in weights.enumerate() {
        if weight > 0.0 {
            // Rounding may leave a rest: it belongs to the last.
            let again = (rest / weight).clamp(0.0, 1.0 - f64::EPSILON);
            last = Some((i, weight / total, again));
            if rest < weight {
                break;
            }
        }
        rest -= weight;
    }
    last
}

/// The first coordinate of a sample with the bits that it lacks to choose among millions, taken from the second.
pub(crate) fn choosing(sample: Vec2) -> f64 {
    f64::from(sample.x) + f64::from(sample.y) * f64::from(f32::EPSILON) * 0.5
}

/// The same emitters, with every two triangles that make a rectangle of one light as one of them, in the place of the first.
fn with_rectangles(mut all: Vec<Emitter>) -> Vec<Emitter> {
    let bits = |p: Vec3| p.to_array().map(f32::to_bits);
    let mut halves: Vec<_> = parallel::map(
        all.len(),
        || (),
        |(), i| {
            let Emitter { group, is_front, uniform_exitance, corners, .. } = &all[i];
            let (exitance, [p, q, r]) = uniform_exitance.zip(corners.right_angle())?;
            let mut diagonal = [bits(p), bits(r)];
            diagonal.sort_unstable();
            Some(((diagonal, bits(exitance), *group, *is_front), i, [p, q, r]))
        },
    )
    .into_iter()
    .flatten()
    .collect();
    halves.sort_unstable_by_key(|&(key, i, _)| (key, i));
    let mut is_second = vec![false; all.len()];
    for same in halves.chunk_by(|a, b| a.0 == b.0) {
        // The first joins the next that is its other half; all others stay alone.
        let Some((&(_, first, [_, s, _]), rest)) = same.split_first() else { continue };
        let completes = |&&(_, i, [p, q, r]): &&(_, usize, [Vec3; 3])| {
            (p + r - q).distance(s) <= SKEW * p.distance(r) && all[first].normal.dot(all[i].normal) > 0.0
        };
        if let Some(&(_, second, [p, q, r])) = rest.iter().find(completes) {
            let Emitter { area, power, .. } = all[second];
            is_second[second] = true;
            let whole = &mut all[first];
            whole.corners = Corners::rectangle([p, q, r, s]);
            whole.rectangle = Rectangle::new(p, [q - p, s - p]).map(Box::new);
            whole.area += area;
            whole.power = (whole.power + power).min(f32::MAX);
        }
    }
    let mut is_second = is_second.into_iter();
    all.retain(|_| !is_second.next().unwrap_or(false));
    all
}

fn emitter(
    scene: &Scene,
    (material, group): (&Material, LightGroupId),
    triangle: TriangleId,
    is_front: bool,
) -> Emitter {
    let side = if is_front { 1.0 } else { -1.0 };
    let area = scene.mesh().area(triangle) as f32;
    Emitter {
        corners: Corners::triangle(scene.mesh().corners(triangle)),
        rectangle: None,
        normal: scene.mesh().face_normal(triangle) * side,
        area,
        triangle,
        is_front,
        group,
        uniform_exitance: material.exitance_texture.is_none().then_some(material.exitance),
        power: (area * luminance(material.exitance)).clamp(f32::MIN_POSITIVE, f32::MAX),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use glam::Mat3;
    use hplt_reference::scenes;
    use hplt_sampling::sobol::sobol_2d;

    use super::*;

    /// A triangle that emits on its front.
    pub(crate) fn triangle_light(corners: [Vec3; 3], exitance: f32) -> Emitter {
        let cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let area = 0.5 * cross.length();
        Emitter {
            corners: Corners::triangle(corners),
            rectangle: None,
            normal: cross.normalize(),
            area,
            triangle: TriangleId(0),
            is_front: true,
            group: LightGroupId(0),
            uniform_exitance: Some(Rgb::splat(exitance)),
            power: area * exitance,
        }
    }

    /// A point just below a lamp, and beside its corner: what one sample brings never exceeds what the emitter as a whole could by
    /// much, where samples by area would bring hundreds of times as much, and the mean is exact.
    #[test]
    fn near_emitters_have_no_fireflies() {
        let scene = scenes::build(scenes::cornell_box());
        let emitters = Emitters::new(&scene, &LightGroups::of(&scene));
        let [lamp] = &emitters.all[..] else { panic!("{} emitters", emitters.all.len()) };
        let [a, b, c, _] = lamp.corners.all;
        let area = 0.5 * lamp.area;
        let half = Emitter { corners: Corners::triangle([a, b, c]), rectangle: None, area, ..lamp.clone() };
        for (lamp, (share, depth, tilt)) in [lamp, &half]
            .into_iter()
            .flat_map(|lamp| [(0.33, 0.05, 0.0), (0.25, 0.02, 0.5), (0.0, 0.01, 0.5)].map(|place| (lamp, place)))
        {
            let size = lamp.area.sqrt();
            let position = lamp.point(share, share) + lamp.normal * depth * size;
            let normal = (-lamp.normal + tilt * (lamp.corners[1] - lamp.corners[0]).normalize()).normalize();
            let exitance = luminance(lamp.uniform_exitance.unwrap());
            let n = 4096;
            let seen = lamp.seen_from(position, normal);
            let brings = |k: u32| luminance(seen.aim(&scene, sobol_2d(k, 1, 0)).brings) / exitance;
            let (mut sum, mut most, mut most_by_area) = (0.0, 0f32, 0f32);
            for k in 0..n {
                let b = brings(k);
                sum += f64::from(b);
                most = most.max(b);
                let sample = sobol_2d(k, 1, 0);
                let Vec2 { x: u, y: v } = if lamp.is_rectangle() { sample } else { warp::uniform_triangle(sample) };
                most_by_area = most_by_area.max(lamp.kernel(position, normal, lamp.point(u, v)));
            }
            let exact = f64::from(lamp.form_factor(position, normal));
            assert!((sum / f64::from(n) / exact - 1.0).abs() < 2e-3, "{} {exact}", sum / f64::from(n));
            assert!(most <= 2.0 && (share == 0.0 || most_by_area > 10.0 * most), "{most} {most_by_area}");
        }
    }

    /// Two halves of a rectangle are one emitter, whichever way its diagonal goes and its corners are listed, with the form factor and
    /// the area of both; other pairs stay two.
    #[test]
    fn two_right_triangles_of_one_light_are_a_rectangle() {
        let turn = Mat3::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 0.7);
        let at = |x: f32, y: f32| turn * Vec3::new(x, y, 0.25);
        let [a, b, c, d] = [at(0.0, 0.0), at(0.3, 0.0), at(0.3, 0.8), at(0.0, 0.8)];
        let (position, normal) = (turn * Vec3::new(0.1, 0.2, 0.6), (turn * Vec3::new(0.3, 0.1, -0.8)).normalize());
        for (first, second) in [([a, b, c], [c, d, a]), ([c, a, b], [a, c, d]), ([b, c, d], [d, a, b])] {
            let halves = vec![triangle_light(first, 2.0), triangle_light(second, 2.0)];
            let expected: f32 = halves.iter().map(|e| e.form_factor(position, normal)).sum();
            let joined = with_rectangles(halves);
            assert!(joined.len() == 1 && joined[0].is_rectangle());
            assert!((joined[0].area - 0.24).abs() < 1e-6 && (joined[0].power - 0.48).abs() < 1e-6);
            let found = joined[0].form_factor(position, normal);
            assert!(expected > 0.05 && (found / expected - 1.0).abs() < 1e-5, "{found} {expected}");
        }
        let others = [
            [triangle_light([a, b, c], 2.0), triangle_light([c, d, a], 1.0)],
            [triangle_light([a, b, c], 2.0), triangle_light([a, d, c], 2.0)],
            [triangle_light([a, b, c], 2.0), triangle_light([c, at(0.01, 0.8), a], 2.0)],
            [triangle_light([a, b, c], 2.0), Emitter { is_front: false, ..triangle_light([c, d, a], 2.0) }],
            [triangle_light([a, b, c], 2.0), Emitter { uniform_exitance: None, ..triangle_light([c, d, a], 2.0) }],
            [triangle_light([a, b, c], 2.0), triangle_light([a, b, c], 2.0)],
        ];
        for other in others {
            assert_eq!(with_rectangles(other.to_vec()).len(), 2, "{other:?}");
        }
        let three =
            vec![triangle_light([a, b, c], 2.0), triangle_light([c, d, a], 2.0), triangle_light([a, b, c], 2.0)];
        assert_eq!(with_rectangles(three).len(), 2);
    }
}
