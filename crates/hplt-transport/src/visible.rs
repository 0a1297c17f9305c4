//! Exact visibility of emitters: what is left of one when everything in the way is cut out of it.

use std::ops::{ControlFlow, Range};

use glam::{DVec3, Vec3};
use hplt_geom::radiometry::raised_form_factor;
use hplt_geom::{Blocker, RayCaster, Shaft, offset_origin};

use crate::emitters::Emitter;

/// Triangles in the way after which rays are cheaper.
const MAX_BLOCKERS: usize = 64;
/// Pieces after which rays are cheaper.
const MAX_PIECES: usize = 48;

/// What can be seen of a convex polygon, as convex pieces relative to the eye.
#[derive(Debug, Default)]
pub(crate) struct Visible {
    corners: Vec<DVec3>,
    pieces: Vec<Range<usize>>,
    /// Of the step before, while blockers are cut out.
    before: (Vec<DVec3>, Vec<Range<usize>>),
    /// One piece on its way through the planes of a blocker.
    rest: Vec<DVec3>,
    inside: Vec<DVec3>,
    outside: Vec<DVec3>,
}

impl Visible {
    /// The visible fraction of the irradiance from `emitter`, all over alike, at a surface that looks along `normal`; `origin` is just
    /// above it. `None` where too much is in the way, or something with holes in it, or only rays can tell.
    ///
    /// The emitter minus the shadow volume of every blocker, as polygons; each remaining piece by Lambert's formula.
    pub fn fraction(
        &mut self,
        caster: &dyn RayCaster,
        (origin, normal): (Vec3, Vec3),
        emitter: &Emitter,
    ) -> Option<f64> {
        let corners = emitter.corners.map(|corner| offset_origin(corner, emitter.normal));
        let eye = origin.as_dvec3();
        self.begin(corners.map(|corner| corner.as_dvec3() - eye), normal.as_dvec3());
        if self.corners.len() < 3 {
            return Some(0.0);
        }
        let mut polygon = [Vec3::ZERO; 4];
        let n = self.corners.len();
        polygon.iter_mut().zip(&self.corners).for_each(|(to, from)| *to = (*from + eye).as_vec3());
        let mut shaft = Shaft::new(origin, &polygon[..n]);
        shaft.cut(origin, normal);
        shaft.cut(corners[0], emitter.normal);
        let all = self.form_factor(normal);
        let (mut n_blockers, mut is_told) = (0, true);
        let mut cut_out = |blocker: &Blocker| {
            n_blockers += 1;
            is_told = !blocker.is_masked && n_blockers <= MAX_BLOCKERS && self.pieces.len() <= MAX_PIECES;
            if !is_told {
                return ControlFlow::Break(());
            }
            self.cut_out(blocker.corners.map(|corner| corner.as_dvec3() - eye));
            if self.pieces.is_empty() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let is_able = caster.visit_blockers(&shaft, &mut cut_out);
        (is_able && is_told)
            .then(|| if n_blockers == 0 { 1.0 } else { (self.form_factor(normal) / all).clamp(0.0, 1.0) })
    }

    /// All of a triangle above the horizon.
    fn begin(&mut self, triangle: [DVec3; 3], normal: DVec3) {
        self.outside.clear();
        self.inside.clear();
        split(&triangle, (normal, 0.0), &mut self.inside, &mut self.outside);
        self.corners.clone_from(&self.inside);
        self.pieces.clear();
        self.pieces.push(0..self.corners.len());
    }

    fn form_factor(&self, normal: Vec3) -> f64 {
        let normal = normal.as_dvec3();
        self.pieces.iter().map(|piece| raised_form_factor(normal, &self.corners[piece.clone()])).sum::<f64>().abs()
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
