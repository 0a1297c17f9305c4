//! Maps from the unit square to discs, directions and triangles, each with its density.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};
use std::f64::consts::TAU;

use glam::{DVec3, Mat3, Vec2, Vec3};
use hplt_geom::radiometry::{cone_solid_angle, cosine_pdf_solid_angle};

/// The least cosine that [`cosine_hemisphere`] returns, so that no ray runs along its surface.
pub const MIN_COSINE: f32 = 1e-6;
/// The least solid angle that [`SphericalTriangle`] tells from rounding, sr.
const LEAST_SOLID_ANGLE: f64 = 1e-8;

/// A right-handed orthonormal basis whose third column is the unit vector `normal` (Duff et al., "Building an Orthonormal
/// Basis, Revisited", JCGT 6(1), 2017, listing 3).
pub fn orthonormal_basis(normal: Vec3) -> Mat3 {
    let sign = 1f32.copysign(normal.z);
    let a = -1.0 / (sign + normal.z);
    let b = normal.x * normal.y * a;
    let tangent = Vec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x);
    let bitangent = Vec3::new(b, sign + normal.y * normal.y * a, -normal.y);
    Mat3::from_cols(tangent, bitangent, normal)
}

/// A point of the unit disc, uniform in area, neighbours staying neighbours (Shirley & Chiu, "A Low Distortion Map
/// Between Disk and Square", 1997).
pub fn concentric_disc(u: Vec2) -> Vec2 {
    let p = 2.0 * u - Vec2::ONE;
    if p == Vec2::ZERO {
        return Vec2::ZERO;
    }
    if p.x.abs() > p.y.abs() {
        let (sin, cos) = sin_cos_octant(FRAC_PI_4 * (p.y / p.x));
        p.x * Vec2::new(cos, sin)
    } else {
        let (sin, cos) = sin_cos_octant(FRAC_PI_4 * (p.x / p.y));
        p.y * Vec2::new(sin, cos)
    }
}

/// Sine and cosine for `|x| <= π/4`: the Taylor polynomials, within 1e-7. The same bits on every platform.
fn sin_cos_octant(x: f32) -> (f32, f32) {
    let s = x * x;
    let sin = x * (1.0 - s * (1.0 / 6.0 - s * (1.0 / 120.0 - s * (1.0 / 5_040.0 - s / 362_880.0))));
    let cos = 1.0 - s * (0.5 - s * (1.0 / 24.0 - s * (1.0 / 720.0 - s / 40_320.0)));
    (sin, cos)
}

/// A unit direction about the unit vector `normal`, with the density of [`cosine_hemisphere_pdf_solid_angle`] (Malley's
/// method). Its cosine is at least [`MIN_COSINE`].
pub fn cosine_hemisphere(u: Vec2, normal: Vec3) -> Vec3 {
    cosine_hemisphere_in(u, &orthonormal_basis(normal))
}

/// As [`cosine_hemisphere`], about the third column of `basis`: for many directions about one normal.
#[inline]
pub fn cosine_hemisphere_in(u: Vec2, basis: &Mat3) -> Vec3 {
    let disc = concentric_disc(u);
    let z = (1.0 - disc.length_squared()).max(0.0).sqrt().max(MIN_COSINE);
    *basis * disc.extend(z)
}

/// The density of [`cosine_hemisphere`] per steradian: `cosθ/π`, 0 below the horizon.
pub fn cosine_hemisphere_pdf_solid_angle(cos: f32) -> f32 {
    cosine_pdf_solid_angle(cos)
}

/// A unit direction about the unit vector `normal`, uniform over the hemisphere.
pub fn uniform_hemisphere(u: Vec2, normal: Vec3) -> Vec3 {
    uniform_cone(u, normal, FRAC_PI_2)
}

/// The density of [`uniform_hemisphere`] per steradian: `1/2π`, 0 below the horizon.
pub fn uniform_hemisphere_pdf_solid_angle(cos: f32) -> f32 {
    if cos >= 0.0 { uniform_cone_pdf_solid_angle(FRAC_PI_2) } else { 0.0 }
}

/// A unit direction uniform over the cone of half-angle `angle` (radians, at most π) about the unit vector `axis`.
/// Without cancellation: the offset from the axis keeps its relative accuracy for tiny angles.
pub fn uniform_cone(u: Vec2, axis: Vec3, angle: f32) -> Vec3 {
    let disc = concentric_disc(u);
    let sin_half = (0.5 * angle).sin();
    let height = 2.0 * sin_half * sin_half * disc.length_squared();
    let lateral = disc * (sin_half * (2.0 * (2.0 - height)).max(0.0).sqrt());
    orthonormal_basis(axis) * lateral.extend(1.0 - height)
}

/// The density of [`uniform_cone`] per steradian within the cone; infinite for a cone of angle 0.
pub fn uniform_cone_pdf_solid_angle(angle: f32) -> f32 {
    (1.0 / cone_solid_angle(f64::from(angle))) as f32
}

/// Barycentric weights `(u, v)` of the second and third corner, uniform over a triangle, neighbours staying neighbours
/// (Heitz, "A Low-Distortion Map Between Triangle and Square", 2019).
pub fn uniform_triangle(u: Vec2) -> Vec2 {
    if u.y > u.x {
        let x = 0.5 * u.x;
        Vec2::new(x, u.y - x)
    } else {
        let y = 0.5 * u.y;
        Vec2::new(u.x - y, y)
    }
}

/// Directions uniform over the solid angle of a triangle seen from the origin (Arvo, "Stratified Sampling of Spherical Triangles", 1995).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SphericalTriangle {
    /// Unit directions to the corners.
    corners: [DVec3; 3],
    /// The angle at the first corner.
    alpha: f64,
    cos_alpha: f64,
    solid_angle: f64,
}

impl SphericalTriangle {
    /// The triangle with the given corners. `None` where it is seen edge-on, or is too small to tell.
    pub fn new(corners: [Vec3; 3]) -> Option<Self> {
        let [a, b, c] = corners.map(|p| p.as_dvec3().normalize_or_zero());
        let [ab, bc, ca] = [a.cross(b), b.cross(c), c.cross(a)].map(DVec3::normalize_or_zero);
        let angle = |p: DVec3, q: DVec3| (-p.dot(q)).clamp(-1.0, 1.0).acos();
        let (alpha, beta, gamma) = (angle(ca, ab), angle(ab, bc), angle(bc, ca));
        let solid_angle = alpha + beta + gamma - std::f64::consts::PI;
        let is_seen = solid_angle >= LEAST_SOLID_ANGLE && ![ab, bc, ca].contains(&DVec3::ZERO);
        is_seen.then_some(Self { corners: [a, b, c], alpha, cos_alpha: -ca.dot(ab), solid_angle })
    }

    /// Steradians.
    pub fn solid_angle(&self) -> f64 {
        self.solid_angle
    }

    /// A unit direction; `u` is uniform in the unit square.
    pub fn sample(&self, u: Vec2) -> Vec3 {
        let Self { corners: [a, b, c], alpha, cos_alpha, solid_angle } = *self;
        // The part of it on the side of `a` and `b` whose area is the first number's share ends at `d` on the arc from `a` to `c`.
        let sin_alpha = alpha.sin();
        let (sin, cos) = (f64::from(u.x) * solid_angle - alpha).sin_cos();
        let (p, q) = (cos - cos_alpha, sin + sin_alpha * a.dot(b));
        let below = (q * sin + p * cos) * sin_alpha;
        let cos_ad = if below == 0.0 { 1.0 } else { (((q * cos - p * sin) * cos_alpha - q) / below).clamp(-1.0, 1.0) };
        let from = |start: DVec3, towards: DVec3, cos: f64| {
            let side = (towards - towards.dot(start) * start).normalize_or_zero();
            cos * start + (1.0 - cos * cos).max(0.0).sqrt() * side
        };
        let d = from(a, c, cos_ad);
        from(b, d, 1.0 - f64::from(u.y) * (1.0 - d.dot(b))).as_vec3()
    }
}

/// A rectangle that [`SphericalRectangle`] looks at from many points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    corner: DVec3,
    /// Unit vectors along the edges from the corner, and across.
    axes: [DVec3; 3],
    /// Lengths of the edges.
    size: [f64; 2],
}

impl Rectangle {
    /// From one `corner` the two `edges` go out at right angles. `None` where one has no length.
    pub fn new(corner: Vec3, edges: [Vec3; 2]) -> Option<Self> {
        let [ex, ey] = edges.map(|e| e.as_dvec3());
        let (x, y) = (ex.try_normalize()?, ey.try_normalize()?);
        Some(Self { corner: corner.as_dvec3(), axes: [x, y, x.cross(y)], size: [ex.length(), ey.length()] })
    }
}

/// Points of a rectangle, uniform in the solid angle that an eye sees of it (Ureña, Fajardo & King, "An Area-Preserving Parametrization
/// for Spherical Rectangles", 2013). Angles are those of products of complex numbers, so that there is one inverse function and one root per corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SphericalRectangle {
    /// From and to along the edges, seen from the eye.
    x: [f64; 2],
    y: [f64; 2],
    /// Square of the distance of the eye from the plane.
    z2: f64,
    /// Cosine and sine of the angle at which the solid angle begins to count.
    begin: [f64; 2],
    solid_angle: f64,
}

impl SphericalRectangle {
    /// What is seen of it from `eye`. `None` where it is seen edge-on, or is too small to tell.
    pub fn new(rectangle: &Rectangle, eye: Vec3) -> Option<Self> {
        let Rectangle { corner, axes, size } = rectangle;
        let [x0, y0, z] = axes.map(|axis| (corner - eye.as_dvec3()).dot(axis));
        let [x1, y1] = [x0 + size[0], y0 + size[1]];
        let z2 = z * z;
        // The angle between the planes through the eye and the two sides that meet in a corner.
        let angle = |x: f64, y: f64, sign: f64| [sign * x * y, z.abs() * (x * x + y * y + z2).sqrt()];
        let end = product(angle(x1, y0, 1.0), angle(x1, y1, -1.0));
        let [re, im] = product(angle(x0, y1, 1.0), angle(x0, y0, -1.0));
        let length = (re * re + im * im).sqrt();
        let begin = [re / length, -im / length];
        let [re, im] = product(end, [re, im]);
        let solid_angle = im.atan2(re);
        let solid_angle = if solid_angle < -LEAST_SOLID_ANGLE { solid_angle + TAU } else { solid_angle };
        let seen = Self { x: [x0, x1], y: [y0, y1], z2, begin, solid_angle };
        (solid_angle >= LEAST_SOLID_ANGLE).then_some(seen)
    }

    /// Steradians.
    pub fn solid_angle(&self) -> f64 {
        self.solid_angle
    }

    /// A point of the rectangle, in shares of its edges; `u` is uniform in the unit square.
    pub fn sample(&self, u: Vec2) -> Vec2 {
        let Self { x: [x0, x1], y: [y0, y1], z2, begin, solid_angle } = *self;
        let (sin, cos) = (f64::from(u.x) * solid_angle).sin_cos();
        let [cos, sin] = product(begin, [cos, sin]);
        // Squares of the distances of the eye from the sides at the ends of `y`.
        let to_sides2 = [y0 * y0 + z2, y1 * y1 + z2];
        let [side_y0, side_y1] = [-y0 / to_sides2[0].sqrt(), y1 / to_sides2[1].sqrt()];
        let f = (cos * side_y0 - side_y1) / sin;
        // The plane through the eye across the rectangle that leaves the first number's share on its one side.
        let at_x = ((z2 / (f * f - z2 / to_sides2[0]).max(0.0)).sqrt() * f.signum()).clamp(x0, x1);
        let to_line2 = at_x * at_x + z2;
        let [h0, h1] = [y0, y1].map(|y| y / (y * y + to_line2).sqrt());
        let h = h0 + f64::from(u.y) * (h1 - h0);
        let at_y = (h * (to_line2 / (1.0 - h * h).max(0.0)).sqrt()).clamp(y0, y1);
        Vec2::new(((at_x - x0) / (x1 - x0)) as f32, ((at_y - y0) / (y1 - y0)) as f32)
    }
}

fn product([a, b]: [f64; 2], [c, d]: [f64; 2]) -> [f64; 2] {
    [a * c - b * d, a * d + b * c]
}

/// The density of [`uniform_triangle`] per unit area of a triangle of the given area.
pub fn uniform_triangle_pdf_area(area: f64) -> f64 {
    1.0 / area
}
