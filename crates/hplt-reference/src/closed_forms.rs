//! Exact answers: form factors, uniform enclosures, mean identities.
//!
//! `M` is emitted exitance, `H` irradiance, `B = M + ρH` radiosity, `F12` the fraction of what surface 1 emits that
//! reaches surface 2. The tables hold values computed with 50 digits, rounded to 15: **test against the tables**, since
//! the formulas lose digits in `f64` where rectangles are far apart or very thin.

use std::f64::consts::PI;

use hplt_geom::glam::DVec3;

/// `(gap over width, F)` of two opposite equal squares.
pub const PARALLEL_SQUARES: [(f64, f64); 7] = [
    (1e-4, 0.999800070977788),
    (1e-3, 0.99800563190758),
    (0.01, 0.980416602925973),
    (0.1, 0.826994522397257),
    (1.0, 0.199824895698387),
    (10.0, 0.0031620568387576),
    (100.0, 3.18288667328292e-5),
];

/// `(W, H, F from W to H)` of two perpendicular rectangles with a common edge of length 1.
pub const PERPENDICULAR_RECTANGLES: [(f64, f64, f64); 5] = [
    (1.0, 1.0, 0.200043776075403),
    (1e-3, 1.0, 0.498592023105068),
    (1e-4, 1e-4, 0.292882187033471),
    (100.0, 100.0, 0.00916511102869478),
    (1.0, 100.0, 0.249992042783317),
];

/// The factor from a point to a unit square one unit above it, its foot under the square's centre.
pub const POINT_UNDER_UNIT_SQUARE: f64 = 0.239456470460774;

/// `(ρ, mean indirect illuminance in lx)` in a cube of 4 m lit by 10 000 lm (CIE 171:2006, case 5.8): area means.
pub const CIE_171_5_8: [(f64, f64); 11] = [
    (0.05, 5.48),
    (0.1, 11.57),
    (0.2, 26.04),
    (0.3, 44.64),
    (0.4, 69.44),
    (0.5, 104.17),
    (0.6, 156.25),
    (0.7, 243.06),
    (0.8, 416.67),
    (0.9, 937.5),
    (0.95, 1979.17),
];

/// Khodulev's cube: 10 m wide, a point light of 50 000 cd at the centre, albedo 2/3.
pub mod khodulev_cube {
    /// Width, m.
    pub const WIDTH: f64 = 10.0;
    /// Luminous intensity of the light, cd.
    pub const INTENSITY: f64 = 50_000.0;
    /// Albedo of all faces.
    pub const ALBEDO: f64 = 2.0 / 3.0;
    /// Mean luminance of the faces, cd/m².
    pub const MEAN_LUMINANCE: f64 = 666.666666666667;
    /// Direct illuminance at the centre of a face, lx.
    pub const DIRECT_AT_FACE_CENTRE: f64 = 2000.0;
}

/// Radiosity in a closed room where everything emits `exitance` and reflects `albedo`: `M/(1-ρ)`.
pub fn furnace_radiosity(exitance: f64, albedo: f64) -> f64 {
    exitance / (1.0 - albedo)
}

/// The same after `n_bounces` reflections: `M(1-ρ^(k+1))/(1-ρ)`.
pub fn furnace_radiosity_after(exitance: f64, albedo: f64, n_bounces: u32) -> f64 {
    exitance * (0..=n_bounces).map(|k| albedo.powi(k as i32)).sum::<f64>()
}

/// Mean irradiance of a closed scene of uniform albedo, whatever its shape and lights: `Φ/((1-ρ)A)`.
pub fn mean_irradiance(emitted_flux: f64, albedo: f64, area: f64) -> f64 {
    emitted_flux / ((1.0 - albedo) * area)
}

/// The part of [`mean_irradiance`] that was reflected at least once: `ρΦ/((1-ρ)A)` (CIE 171:2006, case 5.8).
pub fn mean_indirect_irradiance(emitted_flux: f64, albedo: f64, area: f64) -> f64 {
    albedo * mean_irradiance(emitted_flux, albedo, area)
}

/// Irradiance everywhere inside a sphere, from the area means of exitance and albedo: `H = <M>/(1-<ρ>)`, exact when
/// `M` and `ρ` vary, since the kernel of a sphere is constant.
pub fn integrating_sphere_irradiance(mean_exitance: f64, mean_albedo: f64) -> f64 {
    mean_exitance / (1.0 - mean_albedo)
}

/// Irradiance everywhere inside a spherical cap of uniform albedo under a sky of radiance `sky_radiance`, where the
/// opening takes the fraction `opening` of the full sphere: `H = fπL/(1-ρ(1-f))`. A hemisphere has `f = ½`.
pub fn cap_cavity_irradiance(opening: f64, albedo: f64, sky_radiance: f64) -> f64 {
    opening * PI * sky_radiance / (1.0 - albedo * (1.0 - opening))
}

/// Radiosities `(B1, B2)` of the outside of an inner sphere and the inside of an outer one. `q = (r1/r2)²`:
/// `F12 = 1, F21 = q, F22 = 1-q`.
pub fn concentric_spheres(radii: [f64; 2], exitance: [f64; 2], albedo: [f64; 2]) -> [f64; 2] {
    let q = (radii[0] / radii[1]).powi(2);
    // B2 = M2 + ρ2 (q (M1 + ρ1 B2) + (1-q) B2)
    let b2 = (exitance[1] + albedo[1] * q * exitance[0]) / (1.0 - albedo[1] * (q * albedo[0] + 1.0 - q));
    [exitance[0] + albedo[0] * b2, b2]
}

/// `F12` of two equal opposite rectangles: width and depth over distance.
pub fn parallel_rectangles(x: f64, y: f64) -> f64 {
    let (x2, y2) = (1.0 + x * x, 1.0 + y * y);
    let log = 0.5 * (x2 * y2 / (x2 + y * y)).ln();
    let arcs =
        x * y2.sqrt() * (x / y2.sqrt()).atan() + y * x2.sqrt() * (y / x2.sqrt()).atan() - x * x.atan() - y * y.atan();
    2.0 / (PI * x * y) * (log + arcs)
}

/// `F12` of two perpendicular rectangles with a common edge: `w` is the width of rectangle 1 over the edge, `h` that of
/// rectangle 2.
pub fn perpendicular_rectangles(w: f64, h: f64) -> f64 {
    let (w2, h2) = (w * w, h * h);
    let d = (w2 + h2).sqrt();
    let arcs = w * (1.0 / w).atan() + h * (1.0 / h).atan() - d * (1.0 / d).atan();
    let s = 1.0 + w2 + h2;
    let log = ((1.0 + w2) * (1.0 + h2) / s).ln()
        + w2 * (w2 * s / ((1.0 + w2) * (w2 + h2))).ln()
        + h2 * (h2 * s / ((1.0 + h2) * (w2 + h2))).ln();
    (arcs + 0.25 * log) / (PI * w)
}

/// `F12` of two coaxial discs of radii `r1`, `r2` at `distance`.
pub fn coaxial_discs(r1: f64, r2: f64, distance: f64) -> f64 {
    let (a, b) = (r1 / distance, r2 / distance);
    let s = 1.0 + (1.0 + b * b) / (a * a);
    0.5 * (s - (s * s - 4.0 * (r2 / r1).powi(2)).sqrt())
}

/// `F12` of two opposite strips, infinitely long, at a distance of `gap_over_width`.
pub fn opposite_strips(gap_over_width: f64) -> f64 {
    (1.0 + gap_over_width * gap_over_width).sqrt() - gap_over_width
}

/// `F12` of the two equal, infinitely long sides of a wedge of `angle` radians.
pub fn wedge(angle: f64) -> f64 {
    1.0 - (0.5 * angle).sin()
}

/// The factor from a point to a parallel rectangle with one corner at the foot of the point: width and depth over
/// distance.
pub fn point_to_parallel_rectangle(a: f64, b: f64) -> f64 {
    let (ra, rb) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
    (a / ra * (b / ra).atan() + b / rb * (a / rb).atan()) / (2.0 * PI)
}

/// The factor from a point to a rectangle whose plane is perpendicular to the point's, with one corner at the foot of the
/// point: `x` is the height of the rectangle over its width, `y` the distance over its width.
pub fn point_to_perpendicular_rectangle(x: f64, y: f64) -> f64 {
    let d = (x * x + y * y).sqrt();
    ((1.0 / y).atan() - y / d * (1.0 / d).atan()) / (2.0 * PI)
}

/// The factor from a point of unit normal `normal` to a polygon, after clipping it to the point's horizon (Lambert 1760):
/// `F = 1/2π Σ Γᵢ·n`. Corners relative to the point, in either winding; an emitter of exitance `M` gives `H = MF`.
pub fn point_to_polygon(normal: DVec3, corners: &[DVec3]) -> f64 {
    let mut above = Vec::with_capacity(corners.len() + 2);
    for (i, &a) in corners.iter().enumerate() {
        let b = corners[(i + 1) % corners.len()];
        let (height_a, height_b) = (a.dot(normal), b.dot(normal));
        if height_a >= 0.0 {
            above.push(a);
        }
        if height_a * height_b < 0.0 {
            above.push(a.lerp(b, height_a / (height_a - height_b)));
        }
    }
    let edge = |i: usize| {
        let (a, b) = (above[i], above[(i + 1) % above.len()]);
        a.angle_between(b) * a.cross(b).normalize_or_zero().dot(normal)
    };
    ((0..above.len()).map(edge).sum::<f64>() / (2.0 * PI)).abs()
}

/// Irradiance under the centre of a disc of radiance `radiance` and `radius` at `distance`: `πLR²/(R²+h²)`.
pub fn disc_on_axis_irradiance(radiance: f64, radius: f64, distance: f64) -> f64 {
    PI * radiance * radius * radius / (radius * radius + distance * distance)
}

/// Irradiance from a sphere of radiance `radiance` and `radius` whose centre is `distance` away at `cos_angle` to the
/// normal, all of it above the horizon: `πL(R/d)²cosθ`.
pub fn sphere_irradiance(radiance: f64, radius: f64, distance: f64, cos_angle: f64) -> f64 {
    PI * radiance * (radius / distance).powi(2) * cos_angle
}

/// Irradiance from a sun: a cone of uniform radiance around `cos_angle` to the normal, all above the horizon, that gives
/// `facing` W/m² on a surface that faces it: `facing·cosθ`, whatever the angular radius.
pub fn sun_irradiance(facing: f64, cos_angle: f64) -> f64 {
    facing * cos_angle
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(value: f64, expected: f64, tolerance: f64) {
        assert!((value - expected).abs() <= tolerance * expected.abs(), "{value} instead of {expected}");
    }

    #[test]
    fn rectangles_have_the_tabulated_factors() {
        for (gap, factor) in PARALLEL_SQUARES {
            close(parallel_rectangles(1.0 / gap, 1.0 / gap), factor, if gap > 50.0 { 1e-7 } else { 1e-10 });
        }
        for (w, h, factor) in PERPENDICULAR_RECTANGLES {
            close(perpendicular_rectangles(w, h), factor, 2e-9);
        }
        close(parallel_rectangles(1.0, 2.0), 0.2858753849, 1e-9);
        close(parallel_rectangles(0.5, 0.5), 0.0685895888, 1e-9);
        close(perpendicular_rectangles(1.0, 2.0), 0.2328526028, 1e-9);
        close(perpendicular_rectangles(2.0, 1.0), 0.1164263014, 1e-9);
        close(perpendicular_rectangles(0.1, 0.1), 0.2818878068, 1e-9);
    }

    #[test]
    fn a_cube_closes_and_reciprocity_holds() {
        close(parallel_rectangles(1.0, 1.0) + 4.0 * perpendicular_rectangles(1.0, 1.0), 1.0, 1e-14);
        close(0.3 * perpendicular_rectangles(0.3, 2.0), 2.0 * perpendicular_rectangles(2.0, 0.3), 1e-13);
    }

    #[test]
    fn discs_strips_and_wedges_have_the_tabulated_factors() {
        close(coaxial_discs(1.0, 1.0, 1.0), 0.381966011250105, 1e-14);
        close(coaxial_discs(0.5, 1.0, 1.0), 0.4688711259, 1e-9);
        close(coaxial_discs(1.0, 2.0, 3.0), 0.2917960675, 1e-9);
        close(opposite_strips(1.0), 2f64.sqrt() - 1.0, 1e-15);
        close(wedge(0.5 * PI), 1.0 - 0.5f64.sqrt(), 1e-15);
    }

    #[test]
    fn points_and_polygons_agree_with_the_tables() {
        close(point_to_parallel_rectangle(1.0, 1.0), 0.138531606, 1e-8);
        close(point_to_parallel_rectangle(2.0, 1.0), 0.1673750099, 1e-9);
        close(4.0 * point_to_parallel_rectangle(0.5, 0.5), POINT_UNDER_UNIT_SQUARE, 1e-14);
        close(point_to_perpendicular_rectangle(1.0, 1.0), 0.055734197, 1e-8);
        close(point_to_perpendicular_rectangle(2.0, 1.0), 0.09506794119, 1e-9);
        let square = |z: f64| [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(x, y)| DVec3::new(x, y, z));
        close(point_to_polygon(DVec3::Z, &square(1.0)), POINT_UNDER_UNIT_SQUARE, 1e-14);
        close(point_to_polygon(DVec3::Z, &square(-1.0)) + 1.0, 1.0, 1e-15);
        // An upright rectangle, half of it below the horizon.
        let upright = [(0.0, -3.0), (1.0, -3.0), (1.0, 1.0), (0.0, 1.0)].map(|(y, z)| DVec3::new(1.0, y, z));
        close(point_to_polygon(DVec3::Z, &upright), point_to_perpendicular_rectangle(1.0, 1.0), 1e-12);
    }

    #[test]
    fn enclosures_have_the_tabulated_radiosities() {
        close(furnace_radiosity(1.0, 0.99), 100.0, 1e-13);
        close(furnace_radiosity_after(1.0, 0.5, 2), 1.75, 1e-15);
        let [b1, b2] = concentric_spheres([1.0, 2.0], [1.0, 0.0], [0.5, 0.5]);
        close(b1, 10.0 / 9.0, 1e-14);
        close(b2, 2.0 / 9.0, 1e-14);
        close(cap_cavity_irradiance(0.5, 0.8, 1.0), 0.833333333333333 * PI, 1e-14);
        close(cap_cavity_irradiance(1e-6, 0.99, 1.0), 9.99901e-5 * PI, 1e-6);
        close(integrating_sphere_irradiance(0.1, 0.9), 1.0, 1e-14);
        close(disc_on_axis_irradiance(20.0, 1.0, 5.0) / sphere_irradiance(20.0, 1.0, 5.0, 1.0), 25.0 / 26.0, 1e-14);
        close(sphere_irradiance(20.0, 1.0, 5.0, 1.0) * 0.5 / PI, 0.4, 1e-14);
        close(sun_irradiance(10.0, 0.5), 5.0, 1e-15);
    }

    #[test]
    fn mean_identities_give_the_published_illuminances() {
        for (albedo, published) in CIE_171_5_8 {
            assert!((mean_indirect_irradiance(10_000.0, albedo, 96.0) - published).abs() < 5.1e-3, "{albedo}");
        }
        use khodulev_cube::{ALBEDO, DIRECT_AT_FACE_CENTRE, INTENSITY, MEAN_LUMINANCE, WIDTH};
        let mean = mean_irradiance(4.0 * PI * INTENSITY, ALBEDO, 6.0 * WIDTH * WIDTH);
        close(ALBEDO * mean / PI, MEAN_LUMINANCE, 1e-14);
        close(INTENSITY / (0.25 * WIDTH * WIDTH), DIRECT_AT_FACE_CENTRE, 1e-14);
    }

    #[test]
    fn a_wrong_constant_is_seen() {
        let wrong = 1.01 * PARALLEL_SQUARES[4].1;
        assert!((parallel_rectangles(1.0, 1.0) - wrong).abs() > 1e-3);
    }
}
