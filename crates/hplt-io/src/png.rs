use std::io::{BufWriter, Cursor};
use std::path::Path;

use hplt_geom::{Image, Rgb, parallel};

use crate::files::{any_content, read_regular};
use crate::{Error, Limits, srgb, write_atomically};

/// How radiance becomes eight bits.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PngOptions {
    /// Radiance is multiplied by `2^exposure_ev`.
    pub exposure_ev: f32,
    /// Applied after the exposure.
    pub tone_map: ToneMap,
}

/// Curves that bring radiance into `[0, 1]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ToneMap {
    /// Values above 1 are cut off.
    #[default]
    None,
    /// `x/(1+x)` per channel.
    Reinhard,
    /// The rational fit of the ACES curve by Narkowicz (2016), per channel.
    Aces,
}

impl ToneMap {
    /// The curve's name, as it stands in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Reinhard => "reinhard",
            Self::Aces => "aces",
        }
    }

    /// The curve at `x >= 0`; in `[0, 1]`.
    pub fn apply(self, x: f32) -> f32 {
        let y = match self {
            Self::None => x,
            // The limits for infinite values, where the quotients are not defined.
            _ if x > 1e18 => 1.0,
            Self::Reinhard => x / (1.0 + x),
            Self::Aces => x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14),
        };
        y.clamp(0.0, 1.0)
    }
}

/// Writes linear radiance as an sRGB picture of 8 bits a channel. Exposure, tone map and `metadata` go into text chunks.
/// Values that are not finite and negative values become black.
///
/// # Errors
/// [`Error::Write`] when the file cannot be written, and when the picture is empty.
pub fn write_png(path: &Path, image: &Image, options: &PngOptions, metadata: &[(String, String)]) -> Result<(), Error> {
    let scale = options.exposure_ev.exp2();
    let rows: Vec<_> = image.pixels().chunks(image.width().max(1)).collect();
    let encoded = |row: &[Rgb]| row.iter().flat_map(|&pixel| encoded(pixel * scale, options.tone_map)).collect();
    let rows: Vec<Vec<u8>> = parallel::map(rows.len(), || (), |(), y| encoded(rows[y]));
    let bytes = rows.concat();
    write_atomically(path, |file| {
        let size = |n: usize| u32::try_from(n).map_err(std::io::Error::other);
        let mut encoder = png::Encoder::new(BufWriter::new(file), size(image.width())?, size(image.height())?);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        encoder.add_itxt_chunk("hplt.exposure_ev".into(), options.exposure_ev.to_string())?;
        encoder.add_itxt_chunk("hplt.tone_map".into(), options.tone_map.name().into())?;
        for (key, value) in metadata {
            encoder.add_itxt_chunk(latin_keyword(key), value.clone())?;
        }
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&bytes)?;
        writer.finish()?;
        Ok(())
    })
}

/// Reads a PNG file as linear RGB; alpha is ignored.
///
/// # Errors
/// When the file cannot be read, is not a PNG, or exceeds `limits`.
pub fn read_png(path: &Path, limits: &Limits) -> Result<Image, Error> {
    let bytes = read_regular(path, limits.file_bytes, any_content)?;
    decode(&bytes, limits).map_err(|e| e.in_file(path))
}

fn decode(bytes: &[u8], limits: &Limits) -> Result<Image, Error> {
    let bad = |e: png::DecodingError| Error::invalid("", "IMAGE_DATA_INVALID", e.to_string());
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    decoder.set_ignore_text_chunk(true);
    let mut reader = decoder.read_info().map_err(bad)?;
    let (width, height) = (reader.info().width, reader.info().height);
    if u64::from(width.max(height)) > limits.image_size {
        return Err(Error::limit("", "LIMIT_IMAGE", "pixels a side", width.max(height).into(), limits.image_size));
    }
    let size = reader.output_buffer_size().ok_or_else(|| Error::invalid("", "IMAGE_DATA_INVALID", "too large"))?;
    let mut buffer = vec![0; size];
    let info = reader.next_frame(&mut buffer).map_err(bad)?;
    let samples = info.color_type.samples();
    let pixels = buffer[..info.buffer_size()]
        .chunks_exact(samples)
        .map(|p| {
            let [r, g, b] = if samples < 3 { [p[0]; 3] } else { [p[0], p[1], p[2]] };
            Rgb::new(srgb::linear_from_srgb(r), srgb::linear_from_srgb(g), srgb::linear_from_srgb(b))
        })
        .collect();
    Ok(Image::from_pixels(width as usize, height as usize, pixels))
}

fn encoded(pixel: Rgb, tone_map: ToneMap) -> [u8; 3] {
    pixel.to_array().map(|x| if x > 0.0 { srgb::encode(tone_map.apply(x)) } else { 0 })
}

/// A keyword that the format accepts: 1 to 79 printable Latin characters.
fn latin_keyword(key: &str) -> String {
    let key: String = key.chars().map(|c| if c.is_ascii_graphic() { c } else { '_' }).take(79).collect();
    if key.is_empty() { "_".into() } else { key }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_returns_within_half_a_code_value() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let image = Image::from_pixels(
            2,
            2,
            vec![
                Rgb::new(0.0, 0.5, 1.0),
                Rgb::splat(0.18),
                Rgb::new(f32::NAN, -1.0, f32::INFINITY),
                Rgb::new(2.0, 0.001, 0.25),
            ],
        );
        let options = PngOptions { exposure_ev: -1.0, tone_map: ToneMap::None };
        write_png(&path, &image, &options, &[("hplt.seed".into(), "7 é".into())]).unwrap();
        let read = read_png(&path, &Limits::default()).unwrap();
        for (i, (written, read)) in image.pixels().iter().zip(read.pixels()).enumerate() {
            for channel in 0..3 {
                let expected = if i == 2 { [0.0, 0.0, 1.0][channel] } else { 0.5 * written[channel] };
                let step = 0.012 * expected.max(0.02);
                assert!((read[channel] - expected).abs() < step, "{i} {channel} {}", read[channel]);
            }
        }
        let reader = png::Decoder::new(Cursor::new(std::fs::read(&path).unwrap())).read_info().unwrap();
        let texts: Vec<_> =
            reader.info().utf8_text.iter().map(|t| (t.keyword.clone(), t.get_text().unwrap())).collect();
        assert!(texts.contains(&("hplt.exposure_ev".into(), "-1".into())), "{texts:?}");
        assert!(texts.contains(&("hplt.seed".into(), "7 é".into())), "{texts:?}");
    }

    #[test]
    fn tone_maps_stay_in_range_and_rise() {
        for map in [ToneMap::None, ToneMap::Reinhard, ToneMap::Aces] {
            let mut last = 0.0;
            for x in [0.0, 0.01, 0.18, 0.5, 1.0, 4.0, 1e6, f32::INFINITY] {
                let y = map.apply(x);
                assert!((last..=1.0).contains(&y), "{map:?} {x} {y}");
                last = y;
            }
        }
    }

    #[test]
    fn a_large_or_broken_picture_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        write_png(&path, &Image::new(20, 1), &PngOptions::default(), &[]).unwrap();
        let limits = Limits { image_size: 10, ..Limits::default() };
        assert_eq!(read_png(&path, &limits).unwrap_err().code(), "LIMIT_IMAGE");
        let bytes = std::fs::read(&path).unwrap();
        for n in 0..bytes.len() - 12 {
            assert!(decode(&bytes[..n], &Limits::default()).is_err(), "{n}");
        }
    }
}
