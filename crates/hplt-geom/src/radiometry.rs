//! Radiometric quantities and the only place where π appears.
//!
//! | name | symbol | meaning | unit |
//! |---|---|---|---|
//! | `exitance` | M | emitted radiant exitance | W m⁻² |
//! | `irradiance` | E | arriving; what the basis stores | W m⁻² |
//! | `radiosity` | B = M + ρE | leaving, all directions | W m⁻² |
//! | `radiance` | L = B/π | leaving, one direction; what images hold | W m⁻² sr⁻¹ |
//! | `albedo` | ρ | diffuse reflectance in [0, 1] | 1 |

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;

/// A spectral triple: linear RGB with Rec. 709 primaries.
pub type Rgb = Vec3;

/// The radiance `L = B/π` of a diffuse surface of radiosity `B`.
pub fn radiance_from_radiosity(radiosity: Rgb) -> Rgb {
    radiosity * FRAC_1_PI
}

/// The exitance `M = πL` of a uniform diffuse emitter of radiance `L`.
pub fn exitance_from_radiance(radiance: Rgb) -> Rgb {
    radiance * PI
}

/// The irradiance `E = πL` under a uniform hemisphere of radiance `L`; also the weight of one cosine-distributed ray.
pub fn irradiance_from_uniform_radiance(radiance: Rgb) -> Rgb {
    radiance * PI
}

/// The radiosity `B = M + ρE`.
pub fn radiosity(exitance: Rgb, albedo: Rgb, irradiance: Rgb) -> Rgb {
    exitance + albedo * irradiance
}

/// Relative luminance, Rec. 709 weights 0.2126, 0.7152, 0.0722.
pub fn luminance(rgb: Rgb) -> f32 {
    rgb.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// The solid angle in steradians of a cone of half-angle `angle` radians: `2π(1 - cos)`, without cancellation.
pub fn cone_solid_angle(angle: f64) -> f64 {
    let half = (0.5 * angle).sin();
    4.0 * std::f64::consts::PI * half * half
}

/// The power `4πI` of a light of radiant intensity `I` in all directions, W.
pub fn power_of_point(intensity: Rgb) -> Rgb {
    intensity * (4.0 * PI)
}

/// The power of a spot light of radiant intensity `I` up to the inner angle, which falls to 0 at the outer one as the square of a
/// linear ramp in the cosine: `2πI ((1 - cosθᵢ) + (cosθᵢ - cosθₒ)/3)`, W.
pub fn power_of_spot(intensity: Rgb, cos_inner: f32, cos_outer: f32) -> Rgb {
    intensity * (2.0 * PI * ((1.0 - cos_inner) + (cos_inner - cos_outer) / 3.0))
}

/// The kernel `cosθ cosθ' / (π d²)`, m⁻²: times the sender's exitance and area it is the irradiance that arrives from a
/// small patch. Zero when either faces away.
pub fn area_kernel(cos_receiver: f32, cos_sender: f32, distance_squared: f32) -> f32 {
    cos_receiver.max(0.0) * cos_sender.max(0.0) * FRAC_1_PI / distance_squared
}

/// The probability density per steradian of cosine-distributed directions: `cosθ/π`.
pub fn cosine_pdf_solid_angle(cos: f32) -> f32 {
    cos.max(0.0) * FRAC_1_PI
}

/// The configuration factor from a surface element to a polygon, in `[0, 1]`: `F = (1/2π) Σ Γᵢ·n` over its edges
/// (Lambert 1760), after clipping to the horizon. A polygon of uniform exitance `M` arrives as `E = M·F`.
///
/// `corners` are relative to the element, in the polygon's own winding: positive when the element sees its front
/// (counter-clockwise) side, negative from behind. At most 8 corners; degenerate polygons give 0.
pub fn polygon_form_factor(normal: glam::DVec3, corners: &[glam::DVec3]) -> f64 {
    debug_assert!(corners.len() <= 8);
    let mut clipped = [glam::DVec3::ZERO; 16];
    let mut n = 0;
    for (i, &a) in corners.iter().enumerate() {
        let b = corners[(i + 1) % corners.len()];
        let (ha, hb) = (a.dot(normal), b.dot(normal));
        if ha >= 0.0 {
            clipped[n] = a;
            n += 1;
        }
        if (ha > 0.0 && hb < 0.0) || (ha < 0.0 && hb > 0.0) {
            clipped[n] = a + (b - a) * (ha / (ha - hb));
            n += 1;
        }
    }
    if n < 3 {
        return 0.0;
    }
    raised_form_factor(normal, &clipped[..n])
}

/// [`polygon_form_factor`] of a polygon of any number of corners that is above the horizon.
pub fn raised_form_factor(normal: glam::DVec3, corners: &[glam::DVec3]) -> f64 {
    let mut sum = 0.0;
    for (i, &a) in corners.iter().enumerate() {
        let b = corners[if i + 1 < corners.len() { i + 1 } else { 0 }];
        let cross = a.cross(b);
        let sine = cross.length();
        if sine > 0.0 {
            sum += sine.atan2(a.dot(b)) * cross.dot(normal) / sine;
        }
    }
    // Front sides are counter-clockwise seen from the element, which makes the sum negative.
    -sum / (2.0 * std::f64::consts::PI)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// Unit square at height 1 above the element: 0.23945647046077354 (verification case A17).
    #[test]
    fn polygon_form_factor_of_the_unit_square() {
        let h = 0.5;
        let square = [DVec3::new(-h, -h, 1.0), DVec3::new(-h, h, 1.0), DVec3::new(h, h, 1.0), DVec3::new(h, -h, 1.0)];
        let factor = polygon_form_factor(DVec3::Z, &square);
        assert!((factor - 0.23945647046077354).abs() < 1e-14, "{factor}");
        // Clipped below the horizon: the half of a square that straddles the horizontal plane (dA-to-rectangle, G12).
        let upright = [
            DVec3::new(1.0, 0.0, -5.0),
            DVec3::new(1.0, 1.0, -5.0),
            DVec3::new(1.0, 1.0, 1.0),
            DVec3::new(1.0, 0.0, 1.0),
        ];
        let factor = polygon_form_factor(DVec3::Z, &upright).abs();
        assert!((factor - 0.055734197).abs() < 1e-8, "{factor}");
    }
}
