use std::io::{Cursor, Write};
use std::path::Path;

use exr::prelude as codec;
use exr::prelude::{ReadChannels, ReadLayers, WritableImage};
use hplt_geom::{Image, Rgb};

use crate::files::{any_content, read_regular};
use crate::{Error, Limits, write_atomically};

/// The content of an OpenEXR file of one part: channels with dotted layer names (`R`, `direct.R`, `N.X`, `Z`) and text
/// attributes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ExrImage {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// The channels, each with `width × height` samples, row by row from the top left.
    pub channels: Vec<ExrChannel>,
    /// Attributes in the header: key and text.
    pub metadata: Vec<(String, String)>,
}

/// One channel.
#[derive(Debug, Clone, PartialEq)]
pub struct ExrChannel {
    /// Full name, layer included.
    pub name: String,
    /// The samples, with their precision in the file.
    pub samples: ExrSamples,
}

/// Samples and their precision in the file.
#[derive(Debug, Clone, PartialEq)]
pub enum ExrSamples {
    /// 16-bit floating point in the file; values beyond 65504 become infinite.
    Half(Vec<f32>),
    /// 32-bit floating point.
    Float(Vec<f32>),
    /// 32-bit unsigned integers.
    Uint(Vec<u32>),
}

/// Precision of floating-point channels in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExrPrecision {
    /// 16 bits.
    Half,
    /// 32 bits.
    Float,
}

impl ExrImage {
    /// A file without channels.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, ..Self::default() }
    }

    /// Adds `layer.R`, `layer.G` and `layer.B`, or `R`, `G`, `B` when `layer` is empty.
    pub fn push_rgb(&mut self, layer: &str, image: &Image, precision: ExrPrecision) {
        self.push_triple(layer, ["R", "G", "B"], image.pixels(), precision);
    }

    /// Adds `layer.X`, `layer.Y` and `layer.Z` in 32 bits, for positions and normals.
    pub fn push_xyz(&mut self, layer: &str, values: &[glam::Vec3]) {
        self.push_triple(layer, ["X", "Y", "Z"], values, ExrPrecision::Float);
    }

    /// Adds a channel under its full name.
    pub fn push(&mut self, name: impl Into<String>, samples: ExrSamples) {
        self.channels.push(ExrChannel { name: name.into(), samples });
    }

    /// The channels `R`, `G`, `B` of a layer (`""` for those without) as a picture, if they are all there.
    pub fn rgb(&self, layer: &str) -> Option<Image> {
        let [r, g, b] = ["R", "G", "B"].map(|c| self.floats(&full_name(layer, c)));
        let (r, g, b) = (r?, g?, b?);
        let pixels = r.iter().zip(g).zip(b).map(|((&r, &g), &b)| Rgb::new(r, g, b)).collect();
        Some(Image::from_pixels(self.width, self.height, pixels))
    }

    /// The samples of a floating-point channel.
    pub fn floats(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|c| c.name == name).and_then(|c| match &c.samples {
            ExrSamples::Half(samples) | ExrSamples::Float(samples) => Some(&samples[..]),
            ExrSamples::Uint(_) => None,
        })
    }

    fn push_triple(&mut self, layer: &str, names: [&str; 3], values: &[glam::Vec3], precision: ExrPrecision) {
        for (axis, name) in names.into_iter().enumerate() {
            let samples = values.iter().map(|v| v[axis]).collect();
            let samples = match precision {
                ExrPrecision::Half => ExrSamples::Half(samples),
                ExrPrecision::Float => ExrSamples::Float(samples),
            };
            self.push(full_name(layer, name), samples);
        }
    }
}

/// Writes one part, ZIP-compressed without loss, with Rec. 709 chromaticities and the metadata as text attributes. The
/// same content gives the same bytes.
///
/// # Errors
/// [`Error::Write`] when the file cannot be written, when there is no channel, when a channel occurs twice or has not
/// `width × height` samples.
pub fn write_exr(path: &Path, image: &ExrImage) -> Result<(), Error> {
    let bytes = encode(image).map_err(|message| Error::write(path, std::io::Error::other(message)))?;
    write_atomically(path, |file| file.write_all(&bytes))
}

/// Reads all channels of the first part of an OpenEXR file and its text attributes.
///
/// # Errors
/// When the file cannot be read, is not such a file, or exceeds `limits`.
pub fn read_exr(path: &Path, limits: &Limits) -> Result<ExrImage, Error> {
    let bytes = read_regular(path, limits.file_bytes, any_content)?;
    crate::load::guarded(|| decode(&bytes, limits)).map_err(|e| e.in_file(path))
}

fn full_name(layer: &str, channel: &str) -> String {
    if layer.is_empty() { channel.to_owned() } else { format!("{layer}.{channel}") }
}

fn encode(image: &ExrImage) -> Result<Vec<u8>, String> {
    let n = image.width * image.height;
    if n == 0 || image.channels.is_empty() {
        return Err("the picture is empty".into());
    }
    let mut channels = Vec::new();
    for channel in &image.channels {
        let (samples, found) = match &channel.samples {
            ExrSamples::Half(s) => {
                (codec::FlatSamples::F16(s.iter().map(|&x| codec::f16::from_f32(x)).collect()), s.len())
            }
            ExrSamples::Float(s) => (codec::FlatSamples::F32(s.clone()), s.len()),
            ExrSamples::Uint(s) => (codec::FlatSamples::U32(s.clone()), s.len()),
        };
        if found != n {
            return Err(format!("channel {}: {found} samples; expected {n}", channel.name));
        }
        let name = codec::Text::new_or_none(&channel.name).ok_or_else(|| format!("channel name {:?}", channel.name))?;
        channels.push(codec::AnyChannel::new(name, samples));
    }
    channels.sort_by(|a, b| a.name.cmp(&b.name));
    if channels.windows(2).any(|pair| pair[0].name == pair[1].name) {
        return Err("two channels have the same name".into());
    }
    let mut attributes = codec::LayerAttributes::default();
    for (key, value) in &image.metadata {
        let text = |s: &str| codec::Text::new_or_none(s).ok_or_else(|| format!("attribute {key:?} is not Latin text"));
        attributes.other.insert(text(key)?, codec::AttributeValue::Text(text(&ascii(value))?));
    }
    let encoding = codec::Encoding {
        compression: codec::Compression::ZIP16,
        blocks: codec::Blocks::ScanLines,
        line_order: codec::LineOrder::Increasing,
    };
    let layer = codec::Layer::new(
        (image.width, image.height),
        attributes,
        encoding,
        codec::AnyChannels::sort(channels.into_iter().collect()),
    );
    let mut file = codec::Image::from_layer(layer);
    file.attributes.chromaticities = Some(rec_709());
    let mut bytes = Vec::new();
    file.write().to_buffered(Cursor::new(&mut bytes)).map_err(|e| e.to_string())?;
    sort_attributes(&mut bytes).ok_or("the encoder wrote an unknown header")?;
    Ok(bytes)
}

fn rec_709() -> exr::meta::attribute::Chromaticities {
    exr::meta::attribute::Chromaticities {
        red: codec::Vec2(0.64, 0.33),
        green: codec::Vec2(0.30, 0.60),
        blue: codec::Vec2(0.15, 0.06),
        white: codec::Vec2(0.3127, 0.3290),
    }
}

/// Attribute text: the format has no encoding for more than Latin letters.
fn ascii(text: &str) -> String {
    text.chars().map(|c| if c == '\n' || (c.is_ascii() && !c.is_ascii_control()) { c } else { '?' }).collect()
}

/// Sorts the header's attributes by name. The encoder keeps them in a hash map, so their order differs from run to run;
/// the header's length, and with it every offset in the file, stays the same.
fn sort_attributes(bytes: &mut [u8]) -> Option<()> {
    const START: usize = 8; // magic number and version
    let name_end = |from: usize| bytes[from..].iter().position(|&b| b == 0).map(|n| from + n + 1);
    let mut attributes = Vec::new();
    let mut at = START;
    while *bytes.get(at)? != 0 {
        let kind = name_end(at)?;
        let size_at = name_end(kind)?;
        let size = u32::from_le_bytes(bytes.get(size_at..size_at + 4)?.try_into().ok()?) as usize;
        let end = size_at + 4 + size;
        attributes.push(bytes.get(at..end)?.to_vec());
        at = end;
    }
    attributes.sort();
    bytes[START..at].copy_from_slice(&attributes.concat());
    Some(())
}

fn decode(bytes: &[u8], limits: &Limits) -> Result<ExrImage, Error> {
    let bad = |e: exr::error::Error| Error::invalid("", "IMAGE_DATA_INVALID", e.to_string());
    check_size(bytes, limits)?;
    let file = codec::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(bad)?;
    let layer = file.layer_data;
    let mut image = ExrImage::new(layer.size.width(), layer.size.height());
    for channel in layer.channel_data.list {
        let samples = match channel.sample_data {
            codec::FlatSamples::F16(s) => ExrSamples::Half(s.iter().map(|x| x.to_f32()).collect()),
            codec::FlatSamples::F32(s) => ExrSamples::Float(s),
            codec::FlatSamples::U32(s) => ExrSamples::Uint(s),
        };
        let name = channel.name.to_string();
        let found = match &samples {
            ExrSamples::Half(s) | ExrSamples::Float(s) => s.len(),
            ExrSamples::Uint(s) => s.len(),
        };
        if found != image.width * image.height {
            return Err(Error::invalid(format!("channel {name}"), "IMAGE_DATA_INVALID", "it is subsampled"));
        }
        image.channels.push(ExrChannel { name, samples });
    }
    for (key, value) in layer.attributes.other {
        if let codec::AttributeValue::Text(text) = value {
            image.metadata.push((key.to_string(), text.to_string()));
        }
    }
    image.metadata.sort();
    Ok(image)
}

/// Looks at the header alone, before anything of the declared size is allocated.
fn check_size(bytes: &[u8], limits: &Limits) -> Result<(), Error> {
    let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false)
        .map_err(|e| Error::invalid("", "IMAGE_DATA_INVALID", e.to_string()))?;
    let mut total = 0u64;
    for header in &meta.headers {
        let side = header.layer_size.width().max(header.layer_size.height()) as u64;
        if side > limits.image_size {
            return Err(Error::limit("", "LIMIT_IMAGE", "pixels a side", side, limits.image_size));
        }
        let pixels = header.layer_size.area() as u64;
        total = total.saturating_add(pixels.saturating_mul(4 * header.channels.list.len() as u64));
    }
    if total > limits.texture_bytes {
        return Err(Error::limit("", "LIMIT_IMAGE", "bytes of samples", total, limits.texture_bytes));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> ExrImage {
        let picture =
            Image::from_pixels(3, 2, (0..6).map(|i| Rgb::new(i as f32 * 0.1, 1e6, -3.5e-9 * i as f32)).collect());
        let mut image = ExrImage::new(3, 2);
        image.push_rgb("", &picture, ExrPrecision::Half);
        image.push_rgb("irradiance", &picture, ExrPrecision::Float);
        image.push_xyz("N", &[glam::Vec3::Y; 6]);
        image.push("Z", ExrSamples::Float(vec![1.0, 2.0, f32::INFINITY, 4.0, 5.0, 6.0]));
        image.push("id.node", ExrSamples::Uint(vec![0, 1, 2, 3, 4, u32::MAX]));
        for key in ["hplt.seed", "hplt.command", "hplt.unit", "hplt.version", "hplt.residual"] {
            image.metadata.push((key.into(), format!("value of {key}")));
        }
        image.metadata.sort();
        image
    }

    #[test]
    fn channels_precisions_and_attributes_return() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let image = example();
        write_exr(&path, &image).unwrap();
        let read = read_exr(&path, &Limits::default()).unwrap();
        assert_eq!(read.metadata, image.metadata);
        assert_eq!(read.rgb("irradiance"), image.rgb("irradiance"));
        assert_eq!(read.channels.len(), image.channels.len());
        assert_eq!(read.rgb("").unwrap().pixels()[1].x, codec::f16::from_f32(0.1).to_f32());
        assert_eq!(read.rgb("").unwrap().pixels()[0].y, f32::INFINITY);
        assert!(read.rgb("direct").is_none());
        let node = read.channels.iter().find(|c| c.name == "id.node").unwrap();
        assert_eq!(node.samples, ExrSamples::Uint(vec![0, 1, 2, 3, 4, u32::MAX]));
    }

    #[test]
    fn the_file_has_one_part_and_the_same_bytes_every_time() {
        let bytes = encode(&example()).unwrap();
        for _ in 0..20 {
            assert_eq!(encode(&example()).unwrap(), bytes);
        }
        let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(&bytes[..]), true).unwrap();
        assert_eq!(meta.headers.len(), 1);
        assert_eq!(meta.headers[0].compression, codec::Compression::ZIP16);
        assert_eq!(meta.headers[0].shared_attributes.chromaticities, Some(rec_709()));
    }

    #[test]
    fn wrong_channels_are_refused() {
        assert!(encode(&ExrImage::new(2, 2)).is_err());
        let mut image = ExrImage::new(2, 2);
        image.push("Z", ExrSamples::Float(vec![0.0; 3]));
        assert!(encode(&image).unwrap_err().contains("3 samples"));
        image.channels.clear();
        image.push("Z", ExrSamples::Float(vec![0.0; 4]));
        image.push("Z", ExrSamples::Float(vec![0.0; 4]));
        assert!(encode(&image).is_err());
    }

    #[test]
    fn truncated_and_large_files_are_refused() {
        let bytes = encode(&example()).unwrap();
        for n in 0..bytes.len() {
            let result = crate::load::guarded(|| decode(&bytes[..n], &Limits::default()));
            assert_eq!(result.unwrap_err().code(), "IMAGE_DATA_INVALID", "{n}");
        }
        let limits = Limits { image_size: 2, ..Limits::default() };
        assert_eq!(decode(&bytes, &limits).unwrap_err().code(), "LIMIT_IMAGE");
    }
}
