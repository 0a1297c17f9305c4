use std::io::Cursor;
use std::path::Path;

use hplt_geom::{Image, Rgb};
use image::ImageDecoder;

use crate::files::{any_content, read_regular};
use crate::{Error, Limits};

/// A Radiance `.hdr` picture as linear RGB.
///
/// # Errors
/// When the file cannot be read, is not such a picture, or exceeds `limits`.
pub fn read_hdr(path: &Path, limits: &Limits) -> Result<Image, Error> {
    let bytes = read_regular(path, limits.file_bytes, any_content)?;
    crate::load::guarded(|| decode(&bytes, limits)).map_err(|e| e.in_file(path))
}

fn decode(bytes: &[u8], limits: &Limits) -> Result<Image, Error> {
    let bad = |e: image::ImageError| Error::invalid("", "IMAGE_DATA_INVALID", e.to_string());
    let decoder = image::codecs::hdr::HdrDecoder::new(Cursor::new(bytes)).map_err(bad)?;
    let (width, height) = decoder.dimensions();
    let side = u64::from(width.max(height));
    if side > limits.image_size {
        return Err(Error::limit("", "LIMIT_IMAGE", "pixels a side", side, limits.image_size));
    }
    let total = usize::try_from(decoder.total_bytes())
        .map_err(|_| Error::invalid("", "IMAGE_DATA_INVALID", "does not fit into memory"))?;
    // A row takes at least four bytes for every 127 pixels and four bytes of its own.
    let at_least = u64::from(height) * (4 + u64::from(width) / 32);
    if at_least > bytes.len() as u64 {
        return Err(Error::invalid("", "IMAGE_DATA_INVALID", format!("is too short for {width} x {height} pixels")));
    }
    let mut buffer = vec![0u8; total];
    decoder.read_image(&mut buffer).map_err(bad)?;
    let floats: Vec<f32> = buffer.chunks_exact(4).map(|c| f32::from_ne_bytes([c[0], c[1], c[2], c[3]])).collect();
    let pixels = floats.chunks_exact(3).map(|p| Rgb::new(p[0], p[1], p[2])).collect();
    Ok(Image::from_pixels(width as usize, height as usize, pixels))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(width: usize, height: usize, pixels: &[[u8; 4]]) -> Vec<u8> {
        let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
        bytes.extend(pixels.iter().flatten());
        bytes
    }

    #[test]
    fn shared_exponents_are_decoded() {
        let bytes = flat(2, 1, &[[128, 64, 32, 129], [0, 0, 0, 0]]);
        let image = decode(&bytes, &Limits::default()).unwrap();
        assert_eq!((image.width(), image.height()), (2, 1));
        assert!((image.pixels()[0] - Rgb::new(1.0, 0.5, 0.25)).abs().max_element() < 1e-2, "{:?}", image.pixels()[0]);
        assert_eq!(image.pixels()[1], Rgb::ZERO);
    }

    #[test]
    fn short_and_large_pictures_are_refused() {
        let code = |bytes: &[u8]| crate::load::guarded(|| decode(bytes, &Limits::default())).unwrap_err().code();
        assert_eq!(code(&flat(16_000, 16_000, &[[1; 4]])), "IMAGE_DATA_INVALID");
        assert_eq!(code(&flat(60_000, 1, &[[1; 4]])), "LIMIT_IMAGE");
        let whole = flat(2, 1, &[[128, 64, 32, 129], [1; 4]]);
        for n in 0..whole.len() - 1 {
            assert_eq!(code(&whole[..n]), "IMAGE_DATA_INVALID", "{n}");
        }
    }
}
