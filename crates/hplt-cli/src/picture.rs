//! From a lit scene to a picture, and from a picture to files.

use std::path::Path;

use hplt_geom::radiometry::luminance;
use hplt_geom::{Camera, Image, Rgb};
use hplt_io::{ExrImage, ExrPrecision, ExrSamples, PngOptions, ToneMap, write_exr, write_png};
use hplt_splat::{GBuffer, LayerValues, layers, radiance};

use crate::exit::{Exit, Failure};
use crate::job::{Lit, Run};
use crate::outputs::extension;
use crate::sections::{RenderSection, ToneMapName};
use crate::shading::{Arrived, shade};
use crate::values::Size;

/// A picture with everything that is known per sample.
pub struct Picture {
    gbuffer: GBuffer,
    direct: Vec<Rgb>,
    indirect: Vec<Rgb>,
    /// Radiance, W m⁻² sr⁻¹.
    pub radiance: Image,
}

/// Takes a picture of a lit scene. After an early stop it is a rough one, so that it is over soon.
///
/// # Errors
/// When stopped, and when a pixel is not finite.
pub fn take(run: &mut Run<'_>, lit: &Lit<'_>, camera: &Camera, size: Size) -> Result<Picture, Failure> {
    let (gbuffer, Arrived { direct, indirect }) = shade(run, lit, camera, size)?;
    let radiance = radiance(&gbuffer, &direct, &indirect);
    check_finite(&radiance)?;
    Ok(Picture { gbuffer, direct, indirect, radiance })
}

/// Fails with the place of the first pixel that is not finite.
///
/// # Errors
/// With column and row.
pub fn check_finite(image: &Image) -> Result<(), Failure> {
    match image.pixels().iter().position(|p| !p.is_finite()) {
        Some(i) => {
            let (x, y) = (i % image.width(), i / image.width());
            let message = format!("picture: column {x}, row {y}: {}; expected finite radiance", image.pixels()[i]);
            Err(Failure::new(Exit::NotFinite, "NOT_FINITE", message))
        }
        None => Ok(()),
    }
}

impl Picture {
    /// Writes the picture as PNG or as EXR with all layers, by extension.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path, render: &RenderSection, metadata: &[(String, String)]) -> Result<(), Failure> {
        match extension(path).as_str() {
            "png" => write_tone_mapped(path, &self.radiance, render, metadata),
            _ => Ok(write_exr(path, &self.exr(metadata))?),
        }
    }

    fn exr(&self, metadata: &[(String, String)]) -> ExrImage {
        let mut exr = ExrImage::new(self.radiance.width(), self.radiance.height());
        exr.push_rgb("", &self.radiance, ExrPrecision::Float);
        for layer in layers(&self.gbuffer, &self.direct, &self.indirect) {
            let name = match layer.name {
                "normal" => "N",
                "position" => "P",
                "depth" => "Z",
                other => other,
            };
            match layer.values {
                LayerValues::Color(image) if name == "albedo" => exr.push_rgb(name, &image, ExrPrecision::Half),
                LayerValues::Color(image) => exr.push_rgb(name, &image, ExrPrecision::Float),
                LayerValues::Vector(values) => exr.push_xyz(name, &values),
                LayerValues::Scalar(values) => exr.push(name, ExrSamples::Float(values)),
            }
        }
        exr.metadata = metadata.to_vec();
        exr
    }
}

/// Writes a PNG with the exposure and tone map of the settings.
///
/// # Errors
/// When the file cannot be written.
pub fn write_tone_mapped(
    path: &Path,
    image: &Image,
    render: &RenderSection,
    metadata: &[(String, String)],
) -> Result<(), Failure> {
    let tone_map = match render.tone_map.unwrap_or(ToneMapName::Aces) {
        ToneMapName::None => ToneMap::None,
        ToneMapName::Reinhard => ToneMap::Reinhard,
        ToneMapName::Aces => ToneMap::Aces,
    };
    let exposure_ev = render.exposure.unwrap_or_else(|| automatic_exposure(image));
    Ok(write_png(path, image, &PngOptions { exposure_ev, tone_map }, metadata)?)
}

/// Writes an EXR with radiance alone.
///
/// # Errors
/// When the file cannot be written.
pub fn write_plain_exr(path: &Path, image: &Image, metadata: &[(String, String)]) -> Result<(), Failure> {
    let mut exr = ExrImage::new(image.width(), image.height());
    exr.push_rgb("", image, ExrPrecision::Float);
    exr.metadata = metadata.to_vec();
    Ok(write_exr(path, &exr)?)
}

/// Stops, in tenths, that bring the median luminance of what is not black to 0.18; up to three less where more than a twentieth would be
/// brighter than 1, as where a few sunlit walls stand among dim ones. 0 for a black picture.
fn automatic_exposure(image: &Image) -> f32 {
    let mut values: Vec<f32> = image.pixels().iter().map(|p| luminance(*p)).filter(|&y| y > 0.0).collect();
    if values.is_empty() {
        return 0.0;
    }
    let n = values.len();
    let mut stops_to = |target: f32, rank: usize| {
        let (_, value, _) = values.select_nth_unstable_by(rank, f32::total_cmp);
        (target / *value).log2()
    };
    let (of_median, of_bright) = (stops_to(0.18, n / 2), stops_to(1.0, n * 19 / 20));
    let stops = of_median.min(of_bright.max(of_median - 3.0));
    (stops * 10.0).round() / 10.0
}

/// Checks the extensions of pictures to be written.
///
/// # Errors
/// When one is neither `.png` nor `.exr`.
pub fn check_extensions<'p>(paths: impl IntoIterator<Item = &'p Path>) -> Result<(), Failure> {
    for path in paths {
        if !matches!(extension(path).as_str(), "png" | "exr") {
            let shown = hplt_io::sanitized(&path.to_string_lossy());
            return Err(Failure::usage(format!("{shown}: unknown kind of picture; expected .png or .exr")));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_automatic_exposure_brings_the_median_to_middle_grey() {
        let image = Image::from_pixels(4, 1, [0.0, 0.36, 0.36, 0.72].map(Rgb::splat).to_vec());
        assert_eq!(automatic_exposure(&image), -1.0);
        assert_eq!(automatic_exposure(&Image::new(2, 2)), 0.0);
        // A tenth of the pixels is brighter: brought to 1, by three stops at most.
        let tenth = |bright: f32| {
            let value = |i: u8| Rgb::splat(if i < 90 { 0.18 } else { bright });
            Image::from_pixels(10, 10, (0..100).map(value).collect())
        };
        assert_eq!([0.5, 1.0, 4.0, 46.0].map(|bright| automatic_exposure(&tenth(bright))), [0.0, 0.0, -2.0, -3.0]);
    }

    #[test]
    fn a_pixel_that_is_not_finite_is_named() {
        let mut image = Image::new(3, 2);
        assert!(check_finite(&image).is_ok());
        image.pixels_mut()[4] = Rgb::new(0.0, f32::NAN, 0.0);
        let failure = check_finite(&image).unwrap_err();
        assert!(failure.exit == Exit::NotFinite && failure.message.contains("column 1, row 1"), "{failure}");
    }
}
