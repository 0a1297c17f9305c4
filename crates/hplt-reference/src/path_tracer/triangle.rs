//! Where a ray crosses a triangle, in `f64`.

use hplt_geom::glam::{DVec3, Vec3};

/// A ray, sheared so that it runs along its own longest axis: the watertight edge test of Woop, Benthin & Wald (2013) in
/// `f64`, where the edge functions of two triangles that share an edge are exact negatives of each other.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ShearedRay {
    origin: DVec3,
    axis: usize,
    /// Components of the direction along the other two axes, over the one along `axis`; and the latter's inverse.
    shear: [f64; 3],
}

/// A crossing: distance, and the weights of the second and third corner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Crossing {
    pub(crate) t: f64,
    pub(crate) u: f64,
    pub(crate) v: f64,
    pub(crate) is_front: bool,
}

impl ShearedRay {
    pub(crate) fn new(origin: DVec3, direction: DVec3) -> Self {
        let size = direction.abs();
        let axis = if size.x > size.y && size.x > size.z {
            0
        } else if size.y > size.z {
            1
        } else {
            2
        };
        let inverse = 1.0 / direction[axis];
        let shear = [direction[(axis + 1) % 3] * inverse, direction[(axis + 2) % 3] * inverse, inverse];
        Self { origin, axis, shear }
    }

    /// The crossing with a triangle at `t > 0`, edges included.
    #[inline]
    pub(crate) fn cross(&self, corners: &[Vec3; 3]) -> Option<Crossing> {
        match self.axis {
            0 => self.cross_along::<1, 2, 0>(corners),
            1 => self.cross_along::<2, 0, 1>(corners),
            _ => self.cross_along::<0, 1, 2>(corners),
        }
    }

    #[inline]
    fn cross_along<const X: usize, const Y: usize, const Z: usize>(&self, corners: &[Vec3; 3]) -> Option<Crossing> {
        let origin = self.origin.to_array();
        let [shear_x, shear_y, inverse] = self.shear;
        let sheared = |p: &Vec3| {
            let p = p.to_array().map(f64::from);
            let height = p[Z] - origin[Z];
            (p[X] - origin[X] - shear_x * height, p[Y] - origin[Y] - shear_y * height, height)
        };
        let [(ax, ay, az), (bx, by, bz), (cx, cy, cz)] = [&corners[0], &corners[1], &corners[2]].map(sheared);
        let a = cx * by - cy * bx;
        let b = ax * cy - ay * cx;
        let c = bx * ay - by * ax;
        if (a < 0.0 || b < 0.0 || c < 0.0) && (a > 0.0 || b > 0.0 || c > 0.0) {
            return None;
        }
        let sum = a + b + c;
        if sum == 0.0 {
            return None;
        }
        let t = (a * az + b * bz + c * cz) * inverse / sum;
        // A cyclic choice of axes keeps the winding; seen along a negative axis it turns round.
        (t > 0.0).then(|| Crossing { t, u: b / sum, v: c / sum, is_front: (sum > 0.0) == (inverse > 0.0) })
    }
}

/// The point of a triangle nearest to `p`, as weights of the second and third corner (Ericson 2005, section 5.1.5).
pub(super) fn nearest_weights(p: DVec3, [a, b, c]: [DVec3; 3]) -> (f64, f64) {
    let (ab, ac) = (b - a, c - a);
    let edge = |from: DVec3, along: DVec3| ((p - from).dot(along) / along.length_squared().max(1e-300)).clamp(0.0, 1.0);
    let normal = ab.cross(ac);
    let doubled = normal.length_squared();
    let u = (p - a).cross(ac).dot(normal) / doubled;
    let v = ab.cross(p - a).dot(normal) / doubled;
    if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
        return (u, v);
    }
    let along_bc = edge(b, c - b);
    let candidates = [(edge(a, ab), 0.0), (0.0, edge(a, ac)), (1.0 - along_bc, along_bc)];
    let distance = |(u, v): (f64, f64)| (a + ab * u + ac * v).distance_squared(p);
    candidates.into_iter().min_by(|&x, &y| distance(x).total_cmp(&distance(y))).unwrap_or((0.0, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: [Vec3; 3] = [Vec3::new(0.0, 0.0, 1.0), Vec3::new(1.0, 0.0, 1.0), Vec3::new(0.0, 1.0, 1.0)];

    #[test]
    fn a_crossing_has_distance_weights_and_side() {
        for axis in 0..3 {
            let turn = |p: DVec3| DVec3::from_array(std::array::from_fn(|i| p[(i + axis) % 3]));
            let corners = CORNERS.map(|p| turn(p.as_dvec3()).as_vec3());
            let from_below = ShearedRay::new(turn(DVec3::new(0.25, 0.5, 0.0)), turn(DVec3::Z * 0.5));
            let hit = from_below.cross(&corners).unwrap();
            assert_eq!((hit.t, hit.u, hit.v, hit.is_front), (2.0, 0.25, 0.5, false));
            let from_above = ShearedRay::new(turn(DVec3::new(0.25, 0.5, 3.0)), turn(-DVec3::Z));
            assert!(from_above.cross(&corners).unwrap().is_front);
            assert!(ShearedRay::new(turn(DVec3::new(0.6, 0.6, 0.0)), turn(DVec3::Z)).cross(&corners).is_none());
            assert!(ShearedRay::new(turn(DVec3::new(0.25, 0.5, 2.0)), turn(DVec3::Z)).cross(&corners).is_none());
        }
    }

    #[test]
    fn edges_and_corners_belong_to_the_triangle() {
        for target in [[0.0, 0.0], [1.0, 0.0], [0.5, 0.5], [0.0, 0.3]] {
            let ray = ShearedRay::new(DVec3::new(target[0], target[1], 0.0), DVec3::Z);
            assert!(ray.cross(&CORNERS).is_some(), "{target:?}");
        }
    }

    #[test]
    fn the_nearest_point_is_inside_or_on_the_border() {
        let corners = CORNERS.map(|p| p.as_dvec3());
        assert_eq!(nearest_weights(DVec3::new(0.25, 0.25, 7.0), corners), (0.25, 0.25));
        assert_eq!(nearest_weights(DVec3::new(-1.0, -1.0, 1.0), corners), (0.0, 0.0));
        assert_eq!(nearest_weights(DVec3::new(1.0, 1.0, 1.0), corners), (0.5, 0.5));
        assert_eq!(nearest_weights(DVec3::new(0.5, -3.0, 0.0), corners), (0.5, 0.0));
    }
}
