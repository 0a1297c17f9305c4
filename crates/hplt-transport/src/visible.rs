//! Visibility of emitters: what is left of one when what is in the way is cut out of it. All that is, for an exact answer, or what a
//! few rays meet, which is all that it takes to prove an emitter hidden and to find the sliver of one that is not.

use std::ops::{ControlFlow, Range};

use glam::{DVec3, Vec2, Vec3};
use hplt_geom::radiometry::raised_form_factor;
use hplt_geom::{Blocker, OrientedPoint, Ray, RayCaster, Scene, Shaft, offset_origin};
use hplt_sampling::warp::SphericalTriangle;

use crate::emitters::Emitter;

/// Pieces after which rays are cheaper.
const MAX_PIECES: usize = 48;

/// Corners of a rectangle after the horizon has cut it, rounding counted where it is seen edge-on.
const MAX_CORNERS: usize = 6;

/// Share of an emitter that counts as cut out before anything is.
const HEAD_START: f64 = 1.0 / 32.0;
/// Share that is left of an emitter above which it is no better to sample that than all of it.
const MUCH: f64 = 0.5;
/// Share that may be left of an emitter that counts as hidden: rounding leaves slivers where triangles meet.
const NOTHING: f64 = 1e-7;

/// What must be left of the distance between a point and the plane of an emitter when both are moved off their surfaces.
const NEAR: f32 = 0.8;

/// What can be seen of a convex polygon, as convex pieces relative to the eye.
#[derive(Debug, Default)]
pub(crate) struct Visible {
    eye: DVec3,
    normal: DVec3,
    corners: Vec<DVec3>,
    pieces: Vec<Range<usize>>,
    blockers: Vec<[Vec3; 3]>,
    /// Of the step before, while blockers are cut out.
    before: (Vec<DVec3>, Vec<Range<usize>>),
    /// What [`look`](Self::look) left, as triangles, with the solid angles of all up to each of them.
    left: Vec<(SphericalTriangle, f64)>,
    /// The plane of the emitter: all of its points have this product with this normal.
    plane: (DVec3, f64),
    /// One piece on its way through the planes of a blocker.
    rest: Vec<DVec3>,
    inside: Vec<DVec3>,
    outside: Vec<DVec3>,
}

/// What a few rays tell of an emitter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Found {
    /// All of it is hidden.
    Nothing,
    /// Parts of it that make this share of its unoccluded irradiance may be visible; the rest is hidden.
    Share(f64),
    /// Nothing that would help.
    Unknown,
}

impl Visible {
    /// Casts a ray to the middle of the largest piece of `emitter` and cuts out the triangle that it meets, again and again, until
    /// nothing is left, a ray gets there, or nothing would be left only after more than `max_cuts` of them at this rate. What is left
    /// then can be sampled ([`aim_at_left`](Self::aim_at_left)).
    pub fn look(
        &mut self,
        caster: &dyn RayCaster,
        scene: &Scene,
        point: &OrientedPoint,
        emitter: &Emitter,
        max_cuts: usize,
    ) -> Found {
        if !self.begin(point, emitter) {
            return Found::Unknown;
        }
        let (whole, whole_area) = (self.form_factor(), self.area());
        let (mut left, mut n_cuts) = (whole_area, 0);
        while let Some(middle) = self.middle_of_largest_piece(NOTHING * whole_area) {
            let is_slow = n_cuts as f64 > max_cuts as f64 * (HEAD_START + 1.0 - left / whole_area);
            if is_slow || self.pieces.len() > MAX_PIECES {
                break;
            }
            let hit = caster.nearest(Ray { origin: self.eye.as_vec3(), direction: middle.as_vec3(), t_max: 1.0 });
            if hit.is_miss() || scene.material(hit.triangle).alpha.is_some() {
                break;
            }
            self.cut_out(scene.mesh().corners(hit.triangle).map(|corner| corner.as_dvec3() - self.eye));
            let before = std::mem::replace(&mut left, self.area());
            if left >= before {
                break;
            }
            n_cuts += 1;
        }
        if left > MUCH * whole_area {
            return Found::Unknown;
        }
        if left <= NOTHING * whole_area {
            return Found::Nothing;
        }
        self.triangulate();
        Found::Share((self.form_factor() / whole).min(1.0))
    }

    /// A ray to a point of what [`look`](Self::look) left, uniform in solid angle, and its cosine at the receiver. `u` is uniform in the
    /// unit square. `None` where all is too small for rays.
    pub fn aim_at_left(&self, u: Vec2) -> Option<(Ray, f32)> {
        let at = f64::from(u.x) * self.left.last()?.1;
        let i = self.left.partition_point(|&(_, until)| until <= at).min(self.left.len() - 1);
        let (triangle, until) = &self.left[i];
        let again = ((at - until + triangle.solid_angle()) / triangle.solid_angle()).clamp(0.0, 1.0);
        let towards = triangle.sample(Vec2::new(again as f32, u.y)).as_dvec3();
        let target = towards * (self.plane.1 / towards.dot(self.plane.0));
        let ray = Ray { origin: self.eye.as_vec3(), direction: target.as_vec3(), t_max: 1.0 };
        let cosine = towards.dot(self.normal).max(0.0) as f32;
        ray.direction.is_finite().then_some((ray, cosine))
    }

    /// `None` where all pieces are smaller than `least`.
    fn middle_of_largest_piece(&self, least: f64) -> Option<DVec3> {
        let with_area = |piece: &Range<usize>| (piece.clone(), self.area_of(piece));
        let (piece, area) = self.pieces.iter().map(with_area).max_by(|a, b| a.1.total_cmp(&b.1))?;
        (area > least).then(|| self.corners[piece.clone()].iter().sum::<DVec3>() / piece.len() as f64)
    }

    fn triangulate(&mut self) {
        self.left.clear();
        let mut until = 0.0;
        for piece in &self.pieces {
            let corners = &self.corners[piece.clone()];
            for pair in corners[1..].windows(2) {
                let triangle = [corners[0], pair[0], pair[1]].map(|corner| corner.as_vec3());
                if let Some(triangle) = SphericalTriangle::new(triangle) {
                    until += triangle.solid_angle();
                    self.left.push((triangle, until));
                }
            }
        }
    }

    /// The visible fraction of the irradiance at `point` from `emitter`, which is the same all over. `None` where more than
    /// `max_blockers` triangles may be in the way, or something with holes in it, where the two are so near that rounding matters, and
    /// where only rays can tell.
    ///
    /// The emitter minus the shadow volume of every blocker, as polygons; each remaining piece by Lambert's formula.
    pub fn fraction(
        &mut self,
        caster: &dyn RayCaster,
        point: &OrientedPoint,
        emitter: &Emitter,
        max_blockers: usize,
    ) -> Option<f64> {
        if !self.begin(point, emitter) {
            return None;
        }
        if self.corners.len() < 3 {
            return Some(0.0);
        }
        let mut polygon = [Vec3::ZERO; MAX_CORNERS];
        let n = self.corners.len();
        polygon.iter_mut().zip(&self.corners).for_each(|(to, from)| *to = (*from + self.eye).as_vec3());
        let mut shaft = Shaft::new(self.eye.as_vec3(), &polygon[..n]);
        shaft.cut(self.eye.as_vec3(), point.normal);
        shaft.cut(offset_origin(emitter.corners[0], emitter.normal), emitter.normal);
        let all = self.form_factor();
        if all == 0.0 {
            return Some(0.0);
        }
        let mut blockers = std::mem::take(&mut self.blockers);
        let is_told = collect(caster, &shaft, max_blockers, &mut blockers);
        for triangle in &blockers {
            if !is_told || self.pieces.is_empty() || self.pieces.len() > MAX_PIECES {
                break;
            }
            self.cut_out(triangle.map(|corner| corner.as_dvec3() - self.eye));
        }
        let is_whole = blockers.is_empty();
        self.blockers = blockers;
        let fraction = || if is_whole { 1.0 } else { (self.form_factor() / all).clamp(0.0, 1.0) };
        (is_told && self.pieces.len() <= MAX_PIECES).then(fraction)
    }

    /// All of a triangle or rectangle above the horizon, seen from just off the surface. `false` where the two are so near that this
    /// moves them too much.
    fn begin(&mut self, point: &OrientedPoint, emitter: &Emitter) -> bool {
        let OrientedPoint { position, normal, .. } = *point;
        let origin = offset_origin(position, normal);
        let corners = emitter.corners.map(|corner| offset_origin(corner, emitter.normal));
        if !is_far_off((position, origin, normal), emitter, &corners) {
            return false;
        }
        (self.eye, self.normal) = (origin.as_dvec3(), normal.as_dvec3());
        let facing = emitter.normal.as_dvec3();
        self.plane = (facing, facing.dot(corners[0].as_dvec3() - self.eye));
        self.rest.clear();
        self.rest.extend(corners.iter().map(|corner| corner.as_dvec3() - self.eye));
        self.outside.clear();
        self.inside.clear();
        split(&self.rest, (self.normal, 0.0), &mut self.inside, &mut self.outside);
        self.corners.clone_from(&self.inside);
        self.pieces.clear();
        self.pieces.push(0..self.corners.len());
        true
    }

    fn form_factor(&self) -> f64 {
        let form_factor_of = |piece: &Range<usize>| raised_form_factor(self.normal, &self.corners[piece.clone()]);
        self.pieces.iter().map(form_factor_of).sum::<f64>().abs()
    }

    fn area(&self) -> f64 {
        self.pieces.iter().map(|piece| self.area_of(piece)).sum()
    }

    fn area_of(&self, piece: &Range<usize>) -> f64 {
        let [first, rest @ ..] = &self.corners[piece.clone()] else { return 0.0 };
        0.5 * rest.windows(2).map(|pair| (pair[0] - first).cross(pair[1] - first)).sum::<DVec3>().length()
    }

    /// Removes what is behind a triangle.
    fn cut_out(&mut self, triangle: [DVec3; 3]) {
        let Some(shadow) = shadow_volume(triangle) else { return };
        if shadow.iter().any(|&plane| self.corners.iter().all(|&corner| height(corner, plane) <= 0.0)) {
            return;
        }
        let (corners, pieces) = std::mem::take(&mut self.before);
        let (corners, pieces) =
            (std::mem::replace(&mut self.corners, corners), std::mem::replace(&mut self.pieces, pieces));
        self.corners.clear();
        self.pieces.clear();
        for piece in &pieces {
            self.cut_piece(&corners[piece.clone()], &shadow);
        }
        self.before = (corners, pieces);
    }

    /// Keeps what of a piece is outside of `shadow`.
    fn cut_piece(&mut self, piece: &[DVec3], shadow: &[(DVec3, f64); 4]) {
        let (n_corners, n_pieces) = (self.corners.len(), self.pieces.len());
        self.rest.clear();
        self.rest.extend_from_slice(piece);
        for &plane in shadow {
            self.inside.clear();
            self.outside.clear();
            split(&self.rest, plane, &mut self.inside, &mut self.outside);
            if self.inside.len() < 3 {
                // Out of the shadow after all: it stays whole.
                self.corners.truncate(n_corners);
                self.pieces.truncate(n_pieces);
                self.push_piece_of(piece);
                return;
            }
            if self.outside.len() >= 3 {
                let start = self.corners.len();
                self.corners.extend_from_slice(&self.outside);
                self.pieces.push(start..self.corners.len());
            }
            std::mem::swap(&mut self.rest, &mut self.inside);
        }
    }

    fn push_piece_of(&mut self, corners: &[DVec3]) {
        let start = self.corners.len();
        self.corners.extend_from_slice(corners);
        self.pieces.push(start..self.corners.len());
    }
}

/// Replaces `blockers` by what may be in a shaft; `false` where that cannot be told, has holes, or is more than `limit`.
fn collect(caster: &dyn RayCaster, shaft: &Shaft, limit: usize, blockers: &mut Vec<[Vec3; 3]>) -> bool {
    blockers.clear();
    let mut is_told = true;
    let mut push = |blocker: &Blocker| {
        is_told = !blocker.is_masked && blockers.len() < limit;
        if !is_told {
            return ControlFlow::Break(());
        }
        blockers.push(blocker.corners);
        ControlFlow::Continue(())
    };
    let is_able = caster.visit_blockers(shaft, &mut push);
    is_able && is_told
}

/// Whether point and emitter are still on the right sides of each other, and about as far as before, after both were moved off their
/// surfaces; `origin` and `corners` are what was moved.
fn is_far_off((position, origin, normal): (Vec3, Vec3, Vec3), emitter: &Emitter, corners: &[Vec3]) -> bool {
    let rises = |from: Vec3, to: &[Vec3]| to.iter().map(|&c| (c - from).dot(normal)).fold(f32::NEG_INFINITY, f32::max);
    let before = ((position - emitter.corners[0]).dot(emitter.normal), rises(position, &emitter.corners));
    let after = ((origin - corners[0]).dot(emitter.normal), rises(origin, corners));
    after.0 > NEAR * before.0 && after.1 > NEAR * before.1
}

/// Half-spaces, normal and offset, whose intersection is what a triangle hides from the origin. `None` seen edge-on.
fn shadow_volume([a, b, c]: [DVec3; 3]) -> Option<[(DVec3, f64); 4]> {
    let normal = (b - a).cross(c - a);
    let distance = normal.dot(a);
    if distance == 0.0 {
        return None;
    }
    let sign = distance.signum();
    let side = |from: DVec3, to: DVec3| (sign * from.cross(to), 0.0);
    Some([(sign * normal, -sign * distance), side(a, b), side(b, c), side(c, a)])
}

fn height(point: DVec3, (normal, offset): (DVec3, f64)) -> f64 {
    normal.dot(point) + offset
}

/// Splits a convex polygon by a plane. What only touches the plane has nothing on its other side.
fn split(polygon: &[DVec3], plane: (DVec3, f64), inside: &mut Vec<DVec3>, outside: &mut Vec<DVec3>) {
    let Some(&last) = polygon.last() else { return };
    let (mut from, mut from_height) = (last, height(last, plane));
    let (mut is_inside, mut is_outside) = (false, false);
    for &to in polygon {
        let to_height = height(to, plane);
        if from_height * to_height < 0.0 {
            let on_plane = from + (to - from) * (from_height / (from_height - to_height));
            inside.push(on_plane);
            outside.push(on_plane);
        }
        if to_height >= 0.0 {
            inside.push(to);
        }
        if to_height <= 0.0 {
            outside.push(to);
        }
        (is_inside, is_outside) = (is_inside | (to_height > 0.0), is_outside | (to_height < 0.0));
        (from, from_height) = (to, to_height);
    }
    if !is_inside {
        inside.clear();
    }
    if !is_outside {
        outside.clear();
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use hplt_geom::{Hit, Ray, RegionId};

    use super::*;
    use crate::emitters::Corners;
    use crate::emitters::tests::triangle_light;

    const LIMIT: usize = 40;

    /// Casts no rays: visits triangles of a list.
    struct Listed<'a>(&'a [Blocker]);

    impl RayCaster for Listed<'_> {
        fn trace_nearest(&self, _: &[Ray], _: &mut [Hit]) {
            unreachable!("no ray is cast");
        }

        fn trace_occluded(&self, _: &[Ray], _: &mut [bool]) {
            unreachable!("no ray is cast");
        }

        fn visit_blockers(&self, _: &Shaft, visit: &mut dyn FnMut(&Blocker) -> ControlFlow<()>) -> bool {
            let _ = self.0.iter().try_for_each(visit);
            true
        }
    }

    /// Half of a square of side 2 at height 1, looking down.
    fn lamp() -> Emitter {
        triangle_light([Vec3::new(-1.0, -1.0, 1.0), Vec3::new(-1.0, 1.0, 1.0), Vec3::new(1.0, -1.0, 1.0)], 1.0)
    }

    fn opaque(corners: [Vec3; 3]) -> Blocker {
        Blocker { corners, is_masked: false }
    }

    fn fraction(blockers: &[Blocker], normal: Vec3) -> Option<f64> {
        let point = OrientedPoint::new(Vec3::ZERO, normal, RegionId(0));
        Visible::default().fraction(&Listed(blockers), &point, &lamp(), LIMIT)
    }

    /// A triangle at half the height and as large as a square of that side, over or beside the middle of the lamp.
    fn plate(x: [f32; 2], y: [f32; 2]) -> [Blocker; 2] {
        let at = |i: usize, k: usize| Vec3::new(x[i], y[k], 0.5);
        [opaque([at(0, 0), at(1, 0), at(1, 1)]), opaque([at(0, 0), at(1, 1), at(0, 1)])]
    }

    #[test]
    fn what_is_not_in_the_way_hides_nothing() {
        assert_eq!(fraction(&[], Vec3::Z), Some(1.0));
        let beside = plate([3.0, 4.0], [3.0, 4.0]);
        let behind = [opaque([Vec3::new(-9.0, -9.0, 2.0), Vec3::new(9.0, -9.0, 2.0), Vec3::new(0.0, 9.0, 2.0)])];
        let below = [opaque([Vec3::new(-9.0, -9.0, -1.0), Vec3::new(9.0, -9.0, -1.0), Vec3::new(0.0, 9.0, -1.0)])];
        // In the lamp's own plane, as its other half is.
        let other_half = [opaque([Vec3::new(1.0, 1.0, 1.0), Vec3::new(-1.0, 1.0, 1.0), Vec3::new(1.0, -1.0, 1.0)])];
        for blockers in [&beside[..], &behind, &below, &other_half] {
            let found = fraction(blockers, Vec3::Z).unwrap();
            assert!((found - 1.0).abs() < 1e-12, "{found} {blockers:?}");
        }
    }

    /// By symmetry about the diagonal: the lamp is the triangle x + y <= 0 of its square, and what a plate hides is the same whichever
    /// way it is cut into triangles, wound, and listed.
    #[test]
    fn plates_hide_what_they_cover() {
        let whole = plate([-0.51, 0.51], [-0.51, 0.51]);
        assert_eq!(fraction(&whole, Vec3::Z), Some(0.0));
        // One of the two halves x < y and y < x.
        let half = [opaque([Vec3::new(-0.5, -0.5, 0.5), Vec3::new(0.6, 0.6, 0.5), Vec3::new(-0.6, 0.6, 0.5)])];
        assert!((fraction(&half, Vec3::Z).unwrap() - 0.5).abs() < 1e-6);
        let strip = plate([-0.25, 0.1], [-2.0, 2.0]);
        let turned = [strip[1], strip[0], strip[0]].map(|b| opaque([b.corners[1], b.corners[0], b.corners[2]]));
        let (a, b) = (fraction(&strip, Vec3::Z).unwrap(), fraction(&turned, Vec3::Z).unwrap());
        assert!((a - b).abs() < 1e-12 && 0.3 < a && a < 0.8, "{a} {b}");
    }

    /// What two plates leave adds up with what they hide, for tilted receivers that see a part of the lamp only, too.
    #[test]
    fn a_plate_and_its_complement_hide_everything_between_them() {
        for normal in [Vec3::Z, Vec3::new(0.5, 0.3, 0.2).normalize(), Vec3::new(-0.9, 0.1, -0.1).normalize()] {
            let left = fraction(&plate([-2.0, -0.2], [-2.0, 2.0]), normal).unwrap();
            let right = fraction(&plate([-0.2, 2.0], [-2.0, 2.0]), normal).unwrap();
            assert!((left + right - 1.0).abs() < 1e-9, "{left} {right}");
        }
    }

    /// Seen edge-on, it brings nothing, and there is nothing to take a fraction of.
    #[test]
    fn a_lamp_that_brings_nothing_is_no_nan() {
        let beside = OrientedPoint::new(Vec3::new(5.0, 0.0, 0.9), Vec3::Z, RegionId(0));
        let corners = Corners::triangle([Vec3::Z, Vec3::Z + Vec3::X, Vec3::Z + 2.0 * Vec3::X]);
        let flat = Emitter { corners, ..lamp() };
        let found = Visible::default().fraction(&Listed(&plate([-0.5, 0.5], [-0.5, 0.5])), &beside, &flat, LIMIT);
        assert_eq!(found, Some(0.0));
    }

    #[test]
    fn a_lamp_as_near_as_rounding_is_left_to_rays() {
        let at = |z: f32| OrientedPoint::new(Vec3::new(-0.5, -0.5, z), Vec3::Z, RegionId(0));
        let fraction = |z: f32| Visible::default().fraction(&Listed(&[]), &at(z), &lamp(), LIMIT);
        assert_eq!((fraction(0.99), fraction(1.0 - 3e-5)), (Some(1.0), None));
    }

    #[test]
    fn holes_and_crowds_are_left_to_rays() {
        let holed = [Blocker { is_masked: true, ..plate([-0.1, 0.1], [-0.1, 0.1])[0] }];
        assert_eq!(fraction(&holed, Vec3::Z), None);
        let strips = |n: usize| -> Vec<Blocker> {
            let x = |i: usize| -0.5 + i as f32 / n as f32;
            (0..n).flat_map(|i| plate([x(i), x(i) + 0.1 / n as f32], [-2.0, 2.0])).collect()
        };
        assert!(fraction(&strips(8), Vec3::Z).is_some());
        assert_eq!(fraction(&strips(LIMIT), Vec3::Z), None);
    }
}
