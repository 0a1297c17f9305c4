//! Pictures that materials use: PNG and JPEG, decoded to eight bits a channel within a common budget.

use hplt_geom::{Rgb, Texture};

use crate::{Error, Limits};

/// A picture and what can be said about it without a look-up.
#[derive(Debug, Clone)]
pub(crate) struct Decoded {
    pub(crate) texture: Texture,
    /// The largest linear value of each channel.
    pub(crate) brightest: Rgb,
    /// The mean linear value.
    pub(crate) mean: Rgb,
    /// The smallest alpha, 0 to 1.
    #[cfg_attr(not(feature = "gltf"), allow(dead_code, reason = "other formats have no cut-outs"))]
    pub(crate) least_alpha: f32,
}

/// What all pictures of a scene take together.
#[derive(Debug, Default)]
pub(crate) struct TextureBudget {
    pub(crate) n_images: u64,
    pub(crate) bytes: u64,
}

/// Decodes the picture in `bytes`; what it takes is added to `budget` before anything is allocated.
#[cfg(feature = "textures")]
pub(crate) fn decode(bytes: &[u8], limits: &Limits, budget: &mut TextureBudget) -> Result<Decoded, Error> {
    use std::io::Cursor;

    use image::{DynamicImage, ImageDecoder, ImageFormat};

    let bad = |message: String| Error::invalid("", "IMAGE_DATA_INVALID", crate::sanitized(&message));
    let format = image::guess_format(bytes).ok().filter(|f| matches!(f, ImageFormat::Png | ImageFormat::Jpeg));
    let format =
        format.ok_or_else(|| Error::invalid("", "IMAGE_UNRECOGNIZED_FORMAT", "is neither a PNG nor a JPEG file"))?;
    let mut reader = image::ImageReader::with_format(Cursor::new(bytes), format);
    let mut codec_limits = image::Limits::default();
    codec_limits.max_alloc = Some(limits.texture_bytes.saturating_mul(2));
    reader.limits(codec_limits);
    let decoder = reader.into_decoder().map_err(|e| bad(e.to_string()))?;
    let (width, height) = decoder.dimensions();
    check_size(width, height, format == ImageFormat::Png, bytes.len() as u64, limits)?;
    budget.n_images += 1;
    budget.bytes += 4 * u64::from(width) * u64::from(height);
    if budget.n_images > limits.images {
        return Err(Error::limit("", "LIMIT_IMAGE", "images", budget.n_images, limits.images));
    }
    if budget.bytes > limits.texture_bytes {
        return Err(Error::limit("", "LIMIT_IMAGE", "bytes of textures", budget.bytes, limits.texture_bytes));
    }
    let image = DynamicImage::from_decoder(decoder).map_err(|e| bad(e.to_string()))?.into_rgba8();
    let texels: Vec<[u8; 4]> = image.into_raw().as_chunks().0.to_vec();
    summarize(width, height, texels).ok_or_else(|| bad("is empty".into()))
}

/// Pictures are not decoded by this build.
#[cfg(not(feature = "textures"))]
pub(crate) fn decode(_: &[u8], _: &Limits, _: &mut TextureBudget) -> Result<Decoded, Error> {
    Err(Error::invalid("", "FEATURE_MISSING", "this program was built without the feature \"textures\""))
}

/// Refuses sides that are too long and files that are too short for what they declare: a deflate stream expands at most
/// 1032 times, and 4096 pixels a byte are beyond the flattest JPEG.
#[cfg(feature = "textures")]
fn check_size(width: u32, height: u32, is_png: bool, n_bytes: u64, limits: &Limits) -> Result<(), Error> {
    let side = u64::from(width.max(height));
    if side > limits.image_size {
        return Err(Error::limit("", "LIMIT_IMAGE", "pixels a side", side, limits.image_size));
    }
    let pixels_a_byte = if is_png { 8 * 1032 } else { 4096 };
    if u64::from(width) * u64::from(height) > n_bytes * pixels_a_byte {
        let message = format!("{n_bytes} bytes are too few for {width} x {height} pixels");
        return Err(Error::invalid("", "IMAGE_DATA_INVALID", message));
    }
    Ok(())
}

#[cfg(feature = "textures")]
fn summarize(width: u32, height: u32, texels: Vec<[u8; 4]>) -> Option<Decoded> {
    let table: [f32; 256] = std::array::from_fn(|code| crate::srgb::linear_from_srgb(code as u8));
    let mut largest = [0u8; 3];
    let mut least_alpha = u8::MAX;
    let mut sum = [0f64; 3];
    for &[r, g, b, a] in &texels {
        for (channel, code) in [r, g, b].into_iter().enumerate() {
            largest[channel] = largest[channel].max(code);
            sum[channel] += f64::from(table[code as usize]);
        }
        least_alpha = least_alpha.min(a);
    }
    let n = texels.len() as f64;
    Some(Decoded {
        texture: Texture::from_rgba8(width, height, texels)?,
        brightest: Rgb::from(largest.map(|code| table[code as usize])),
        mean: Rgb::from(sum.map(|s| (s / n) as f32)),
        least_alpha: f32::from(least_alpha) / 255.0,
    })
}

#[cfg(all(test, feature = "textures"))]
mod tests {
    use super::*;

    fn png(width: u32, height: u32, pixels: &[u8]) -> Vec<u8> {
        use image::ImageEncoder;
        let mut bytes = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
        encoder.write_image(pixels, width, height, image::ExtendedColorType::Rgba8).unwrap();
        bytes
    }

    #[test]
    fn a_picture_is_decoded_and_summarised() {
        let bytes = png(2, 1, &[0, 255, 188, 255, 0, 0, 188, 51]);
        let mut budget = TextureBudget::default();
        let decoded = decode(&bytes, &Limits::default(), &mut budget).unwrap();
        assert_eq!(decoded.texture.size(), (2, 1));
        assert_eq!(decoded.brightest, Rgb::new(0.0, 1.0, crate::srgb::linear_from_srgb(188)));
        assert!((decoded.mean - Rgb::new(0.0, 0.5, crate::srgb::linear_from_srgb(188))).length() < 1e-6);
        assert!((decoded.least_alpha - 0.2).abs() < 1e-6);
        assert_eq!((budget.n_images, budget.bytes), (1, 8));
    }

    #[test]
    fn budgets_are_shared_between_pictures() {
        let bytes = png(2, 2, &[9; 16]);
        let limits = Limits { texture_bytes: 20, ..Limits::default() };
        let mut budget = TextureBudget::default();
        decode(&bytes, &limits, &mut budget).unwrap();
        assert_eq!(decode(&bytes, &limits, &mut budget).unwrap_err().code(), "LIMIT_IMAGE");
        let limits = Limits { images: 0, ..Limits::default() };
        assert_eq!(decode(&bytes, &limits, &mut TextureBudget::default()).unwrap_err().code(), "LIMIT_IMAGE");
    }

    #[test]
    fn sizes_are_checked_before_anything_is_allocated() {
        let whole = png(2, 2, &[9; 16]);
        let with_size = |width: u32, height: u32| {
            let mut bytes = whole.clone();
            bytes[16..20].copy_from_slice(&width.to_be_bytes());
            bytes[20..24].copy_from_slice(&height.to_be_bytes());
            let crc = crc(&bytes[12..29]);
            bytes[29..33].copy_from_slice(&crc.to_be_bytes());
            decode(&bytes, &Limits::default(), &mut TextureBudget::default()).unwrap_err().code()
        };
        assert_eq!(with_size(1_000_000_000, 1), "LIMIT_IMAGE");
        assert_eq!(with_size(10_000, 10_000), "IMAGE_DATA_INVALID");
        assert_eq!(with_size(0, 0), "IMAGE_DATA_INVALID");
        for n in 0..whole.len() - 12 {
            assert!(decode(&whole[..n], &Limits::default(), &mut TextureBudget::default()).is_err(), "{n}");
        }
    }

    fn crc(bytes: &[u8]) -> u32 {
        let step = |crc: u32, byte: &u8| {
            (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
        };
        !bytes.iter().fold(u32::MAX, step)
    }
}
