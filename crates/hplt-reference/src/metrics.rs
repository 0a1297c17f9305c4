//! How wrong an irradiance at points or an image is, against a reference.
//!
//! With `Y` the Rec. 709 luminance of a linear RGB value, `t` the test and `r` the reference:
//!
//! ```text
//! floor  = 0.01 · mean_i Y(r_i)
//! e_i    = |Y(t_i) - Y(r_i)| / max(Y(r_i), floor)          relative error of one point
//! bias   = Σ_i (Y(t_i) - Y(r_i)) / Σ_i Y(r_i)              signed: brighter is positive
//! chroma = mean_i max_c |t_ic - r_ic| / max(Y(r_i), floor)  sees colour errors of equal luminance
//! ```
//!
//! All sums are in `f64`, in index order.

use hplt_geom::{Image, Rgb};

use crate::Error;

/// The part of the mean reference luminance that stands below every relative error.
pub const RELATIVE_FLOOR: f64 = 0.01;

/// The error of an irradiance at points; definitions in the [module](self) text. 0.01 is one per cent.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct IrradianceError {
    /// Mean of `e`.
    pub mean: f64,
    /// Median of `e`: the lower one of two middle values.
    pub median: f64,
    /// 95th percentile of `e`: the smallest value that at least 95 % of all `e` do not exceed.
    pub p95: f64,
    /// Root of the mean of `e²`.
    pub rms: f64,
    /// Largest `e`.
    pub max: f64,
    /// Relative error of the summed luminance; positive when the test is brighter.
    pub bias: f64,
    /// Mean of the largest channel error over the floored reference luminance.
    pub chroma: f64,
    /// Mean luminance of the reference, W/m².
    pub mean_reference: f64,
    /// Number of points.
    pub n: usize,
}

/// The error of an image. Definitions at the fields.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImageError {
    /// Root of the mean squared difference over pixels and channels, W m⁻² sr⁻¹.
    pub rmse: f64,
    /// `mean (t - r)² / (r² + ε²)` over pixels and channels, with `ε` = 1 % of the mean reference luminance.
    pub rel_mse: f64,
    /// As [`rel_mse`](Self::rel_mse), without the 0.1 % of pixels (at least one, when there are 1000 or more) with the largest contributions:
    /// a few fireflies or edge pixels do not hide the rest.
    pub rel_mse_trimmed: f64,
    /// Relative error of the summed luminance; positive when the test is brighter.
    pub bias: f64,
    /// Number of pixels.
    pub n: usize,
}

/// The error of `test` against `reference`, point by point.
///
/// # Errors
/// When the slices differ in length or are empty, when a value is not finite, or when the reference is black.
pub fn irradiance_error(test: &[Rgb], reference: &[Rgb]) -> Result<IrradianceError, Error> {
    let mean_reference = check(test, reference)?;
    let floor = RELATIVE_FLOOR * mean_reference;
    let n = test.len();
    let mut errors = Vec::with_capacity(n);
    let (mut difference, mut chroma) = (0.0, 0.0);
    for (&t, &r) in test.iter().zip(reference) {
        let signed = luminance(t) - luminance(r);
        let scale = luminance(r).max(floor);
        errors.push(signed.abs() / scale);
        difference += signed;
        chroma += (t.as_dvec3() - r.as_dvec3()).abs().max_element() / scale;
    }
    let count = n as f64;
    let mean = errors.iter().sum::<f64>() / count;
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / count).sqrt();
    errors.sort_by(f64::total_cmp);
    Ok(IrradianceError {
        mean,
        median: quantile(&errors, 0.5),
        p95: quantile(&errors, 0.95),
        rms,
        max: errors[n - 1],
        bias: difference / (mean_reference * count),
        chroma: chroma / count,
        mean_reference,
        n,
    })
}

/// The error of the picture `test` against `reference`.
///
/// # Errors
/// When the pictures differ in size or are empty, when a pixel is not finite, or when the reference is black.
pub fn image_error(test: &Image, reference: &Image) -> Result<ImageError, Error> {
    if (test.width(), test.height()) != (reference.width(), reference.height()) {
        return Err(Error::LengthMismatch { test: test.pixels().len(), reference: reference.pixels().len() });
    }
    let mean_reference = check(test.pixels(), reference.pixels())?;
    let epsilon = RELATIVE_FLOOR * mean_reference;
    let n = test.pixels().len();
    let mut relative = Vec::with_capacity(n);
    let (mut squares, mut difference) = (0.0, 0.0);
    for (t, r) in test.pixels().iter().zip(reference.pixels()) {
        let (d, r3) = (t.as_dvec3() - r.as_dvec3(), r.as_dvec3());
        squares += (d * d).element_sum() / 3.0;
        relative.push((d * d / (r3 * r3 + epsilon * epsilon)).element_sum() / 3.0);
        difference += luminance(*t) - luminance(*r);
    }
    let count = n as f64;
    let rel_mse = relative.iter().sum::<f64>() / count;
    relative.sort_by(f64::total_cmp);
    let kept = &relative[..n - n / 1000];
    Ok(ImageError {
        rmse: (squares / count).sqrt(),
        rel_mse,
        rel_mse_trimmed: kept.iter().sum::<f64>() / kept.len() as f64,
        bias: difference / (mean_reference * count),
        n,
    })
}

/// Rec. 709 luminance in `f64`.
pub fn luminance(rgb: Rgb) -> f64 {
    0.2126 * f64::from(rgb.x) + 0.7152 * f64::from(rgb.y) + 0.0722 * f64::from(rgb.z)
}

/// Mean luminance of the reference, once everything else is known to be in order.
fn check(test: &[Rgb], reference: &[Rgb]) -> Result<f64, Error> {
    if test.len() != reference.len() {
        return Err(Error::LengthMismatch { test: test.len(), reference: reference.len() });
    }
    if test.is_empty() {
        return Err(Error::TooFew { what: "points", found: 0, expected: 1 });
    }
    for (what, values) in [("test value", test), ("reference value", reference)] {
        if let Some(index) = values.iter().position(|v| !v.is_finite()) {
            let value = values[index].to_array().into_iter().find(|c| !c.is_finite()).unwrap_or(f32::NAN);
            return Err(Error::NotFinite { what, index, value: value.into() });
        }
    }
    let mean = reference.iter().map(|&r| luminance(r)).sum::<f64>() / reference.len() as f64;
    if mean > 0.0 { Ok(mean) } else { Err(Error::BlackReference) }
}

/// The smallest of the sorted values that at least the fraction `q` of them does not exceed.
fn quantile(sorted: &[f64], q: f64) -> f64 {
    let rank = (q * sorted.len() as f64).ceil() as usize;
    sorted[rank.clamp(1, sorted.len()) - 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn greys(values: &[f32]) -> Vec<Rgb> {
        values.iter().map(|&v| Rgb::splat(v)).collect()
    }

    #[test]
    fn equal_values_have_no_error_and_different_ones_have_the_expected_one() {
        let reference = greys(&[1.0, 2.0, 4.0, 1.0]);
        let same = irradiance_error(&reference, &reference).unwrap();
        assert_eq!((same.mean, same.p95, same.rms, same.bias, same.chroma), (0.0, 0.0, 0.0, 0.0, 0.0));
        let test = greys(&[1.1, 1.8, 4.0, 1.0]);
        let error = irradiance_error(&test, &reference).unwrap();
        assert!((error.mean - 0.05).abs() < 1e-6, "{error:?}");
        assert!((error.rms - (0.02f64 / 4.0).sqrt()).abs() < 1e-6);
        assert!((error.bias + 0.1 / 8.0).abs() < 1e-6);
        assert!((error.max - 0.1).abs() < 1e-6 && error.median < 1e-6 && (error.p95 - 0.1).abs() < 1e-6);
    }

    #[test]
    fn dark_reference_points_are_measured_against_the_floor() {
        let error = irradiance_error(&greys(&[0.1, 1.0]), &greys(&[0.0, 1.0])).unwrap();
        assert!((error.max - 0.1 / 0.005).abs() < 1e-4, "{error:?}");
    }

    #[test]
    fn a_colour_error_of_equal_luminance_shows_in_chroma_alone() {
        let green_for_red = Rgb::new(0.0, 0.2126 / 0.7152, 0.0);
        let error = irradiance_error(&[green_for_red], &[Rgb::X]).unwrap();
        assert!(error.mean < 1e-6 && error.chroma > 1.0, "{error:?}");
    }

    #[test]
    fn a_swap_of_two_channels_or_a_factor_pi_fails() {
        let reference = vec![Rgb::new(3.0, 2.0, 1.0); 10];
        let swapped = vec![Rgb::new(1.0, 2.0, 3.0); 10];
        assert!(irradiance_error(&swapped, &reference).unwrap().mean > 0.1);
        let scaled: Vec<Rgb> = reference.iter().map(|r| *r * std::f32::consts::PI).collect();
        assert!((irradiance_error(&scaled, &reference).unwrap().bias - 2.14159).abs() < 1e-4);
    }

    #[test]
    fn bad_input_is_an_error() {
        let one = greys(&[1.0]);
        assert!(matches!(irradiance_error(&[], &[]), Err(Error::TooFew { .. })));
        assert!(matches!(irradiance_error(&one, &greys(&[1.0, 2.0])), Err(Error::LengthMismatch { .. })));
        assert!(matches!(irradiance_error(&one, &greys(&[0.0])), Err(Error::BlackReference)));
        assert!(matches!(irradiance_error(&greys(&[f32::NAN]), &one), Err(Error::NotFinite { .. })));
    }

    #[test]
    fn images_are_measured_per_pixel_and_channel() {
        let reference = Image::from_pixels(2, 1, greys(&[1.0, 2.0]));
        assert_eq!(image_error(&reference, &reference).unwrap().rmse, 0.0);
        let test = Image::from_pixels(2, 1, greys(&[1.1, 2.0]));
        let error = image_error(&test, &reference).unwrap();
        assert!((error.rmse - (0.01f64 / 2.0).sqrt()).abs() < 1e-6, "{error:?}");
        assert!((error.rel_mse - 0.005).abs() < 1e-5 && (error.bias - 0.1 / 3.0).abs() < 1e-6);
        assert!(image_error(&Image::from_pixels(1, 2, greys(&[1.0, 2.0])), &reference).is_err());
    }

    #[test]
    fn one_firefly_among_many_pixels_is_trimmed_away() {
        let reference = Image::from_pixels(50, 40, vec![Rgb::ONE; 2000]);
        let mut test = reference.clone();
        test.pixels_mut()[77] = Rgb::splat(1e3);
        let error = image_error(&test, &reference).unwrap();
        assert!(error.rel_mse > 100.0 && error.rel_mse_trimmed == 0.0, "{error:?}");
    }
}
