use std::path::Path;

use hplt_geom::{Environment, Image};

use crate::{Error, Limits};

/// The environment in an equirectangular `.exr` or `.hdr` picture of radiance.
///
/// # Errors
/// When the file cannot be read, its kind is unknown to this build, it exceeds `limits`, or a texel is negative or not
/// finite.
pub fn load_environment(path: &Path, limits: &Limits) -> Result<Environment, Error> {
    let image = read_image(path, limits)?;
    Environment::from_map(image).map_err(|e| Error::from(e).in_file(path))
}

/// A picture of linear RGB from an `.exr`, `.hdr` or `.png` file: the channels `R`, `G`, `B` of an EXR.
///
/// # Errors
/// When the file cannot be read, its kind is unknown to this build, or it exceeds `limits`.
pub fn read_image(path: &Path, limits: &Limits) -> Result<Image, Error> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    match extension.as_str() {
        #[cfg(feature = "exr")]
        "exr" => crate::read_exr(path, limits)?.rgb("").ok_or_else(|| {
            Error::invalid("", "IMAGE_CHANNELS", "has no channels R, G and B at the top level").in_file(path)
        }),
        #[cfg(feature = "hdr")]
        "hdr" | "pic" => crate::hdr::read_hdr(path, limits),
        #[cfg(feature = "png")]
        "png" => crate::read_png(path, limits),
        _ => {
            let _ = limits;
            let known: [(&str, bool); 3] =
                [(".exr", cfg!(feature = "exr")), (".hdr", cfg!(feature = "hdr")), (".png", cfg!(feature = "png"))];
            let known: Vec<&str> = known.iter().filter(|(_, built)| *built).map(|(name, _)| *name).collect();
            let message = format!("unknown kind of picture; this program was built to read: {}", known.join(" "));
            Err(Error::invalid("", "FORMAT_UNKNOWN", message).in_file(path))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_kind_of_picture_is_refused_by_name() {
        let error = read_image(Path::new("sky.tiff"), &Limits::default()).unwrap_err();
        assert_eq!((error.code(), error.exit_code()), ("FORMAT_UNKNOWN", 3));
    }

    #[cfg(feature = "exr")]
    #[test]
    fn an_environment_with_a_negative_texel_is_refused() {
        use hplt_geom::Rgb;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sky.exr");
        for (last, expected) in [(2.0, None), (-1.0, Some("VALUE_NOT_IN_RANGE")), (f32::NAN, Some("VALUE_NOT_FINITE"))]
        {
            let map = Image::from_pixels(2, 1, vec![Rgb::ONE, Rgb::new(0.0, last, 0.0)]);
            let mut image = crate::ExrImage::new(2, 1);
            image.push_rgb("", &map, crate::ExrPrecision::Float);
            crate::write_exr(&path, &image).unwrap();
            let result = load_environment(&path, &Limits::default());
            assert_eq!(result.as_ref().err().map(Error::code), expected);
            if let Ok(environment) = result {
                assert_eq!(environment.map(), &map);
            }
        }
    }
}
