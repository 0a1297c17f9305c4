use glam::Vec3;
use hplt_geom::radiometry::{radiance_from_radiosity, radiosity};
use hplt_geom::{Image, Rgb};

use crate::GBuffer;

/// One layer of a picture, ready to be written.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Its name: `direct`, `indirect`, `emission`, `irradiance`, `albedo`, `normal`, `position` or `depth`.
    pub name: &'static str,
    /// What it holds, one value per pixel, row by row from the top left.
    pub values: LayerValues,
}

/// The values of a layer.
#[derive(Debug, Clone, PartialEq)]
pub enum LayerValues {
    /// Three colour channels.
    Color(Image),
    /// Three components of a vector.
    Vector(Vec<Vec3>),
    /// One number.
    Scalar(Vec<f32>),
}

/// The picture: `L = (M + ρ (E_direct + E_indirect))/π` at every sample, the environment where there is no surface, averaged
/// over the samples of each pixel. W m⁻² sr⁻¹.
///
/// `direct` and `indirect` are irradiances at the samples, W/m²: [`queries`](GBuffer::queries) says where.
///
/// # Panics
/// When either has not one value per sample.
pub fn radiance(gbuffer: &GBuffer, direct: &[Rgb], indirect: &[Rgb]) -> Image {
    check(gbuffer, direct, indirect);
    filtered(gbuffer, |i| gbuffer.emitted()[i] + reflected(gbuffer, i, direct[i] + indirect[i]))
}

/// The parts of the picture, in this order:
///
/// | name | values |
/// |---|---|
/// | `direct`, `indirect` | reflected radiance of either kind of light, W m⁻² sr⁻¹ |
/// | `emission` | emitted radiance and the environment, W m⁻² sr⁻¹; `direct + indirect + emission` is [`radiance`] |
/// | `irradiance` | direct and indirect together, W/m² |
/// | `albedo` | |
/// | `normal` | unit shading normal of the nearest surface in the pixel, zero for background |
/// | `position` | its position in world space, zero for background |
/// | `depth` | its distance along the view axis in world units, infinite for background |
///
/// The first five are averages over the samples of each pixel, background counting zero; the others belong to one sample,
/// because an average of two positions lies on neither surface.
///
/// # Panics
/// When `direct` or `indirect` has not one value per sample.
pub fn layers(gbuffer: &GBuffer, direct: &[Rgb], indirect: &[Rgb]) -> Vec<Layer> {
    check(gbuffer, direct, indirect);
    let color = |name, image| Layer { name, values: LayerValues::Color(image) };
    let nearest = nearest_samples(gbuffer);
    let frame = gbuffer.frame();
    let position = |i: usize| match gbuffer.is_background(i) {
        true => Vec3::ZERO,
        false => frame.world_from_scene_point(gbuffer.positions()[i]).as_vec3(),
    };
    let normals = nearest.iter().map(|&i| gbuffer.shading_normals()[i]).collect();
    let positions = nearest.iter().map(|&i| position(i)).collect();
    let depths = nearest.iter().map(|&i| frame.world_from_scene_length(gbuffer.depths()[i]) as f32).collect();
    vec![
        color("direct", filtered(gbuffer, |i| reflected(gbuffer, i, direct[i]))),
        color("indirect", filtered(gbuffer, |i| reflected(gbuffer, i, indirect[i]))),
        color("emission", filtered(gbuffer, |i| gbuffer.emitted()[i])),
        color("irradiance", filtered(gbuffer, |i| direct[i] + indirect[i])),
        color("albedo", filtered(gbuffer, |i| gbuffer.albedos()[i])),
        Layer { name: "normal", values: LayerValues::Vector(normals) },
        Layer { name: "position", values: LayerValues::Vector(positions) },
        Layer { name: "depth", values: LayerValues::Scalar(depths) },
    ]
}

fn check(gbuffer: &GBuffer, direct: &[Rgb], indirect: &[Rgb]) {
    assert_eq!(direct.len(), gbuffer.n_samples(), "direct irradiance per sample");
    assert_eq!(indirect.len(), gbuffer.n_samples(), "indirect irradiance per sample");
}

fn reflected(gbuffer: &GBuffer, sample: usize, irradiance: Rgb) -> Rgb {
    radiance_from_radiosity(radiosity(Rgb::ZERO, gbuffer.albedos()[sample], irradiance))
}

/// The mean of `value` over the samples of each pixel.
fn filtered(gbuffer: &GBuffer, value: impl Fn(usize) -> Rgb) -> Image {
    let pixel = |p: usize| {
        let samples = gbuffer.samples_of(p);
        let n = samples.len() as f32;
        samples.map(&value).sum::<Rgb>() / n
    };
    let pixels = (0..gbuffer.n_pixels()).map(pixel).collect();
    Image::from_pixels(gbuffer.width(), gbuffer.height(), pixels)
}

/// The sample of each pixel with the smallest depth, the first of equals.
fn nearest_samples(gbuffer: &GBuffer) -> Vec<usize> {
    let depth = |i: usize| gbuffer.depths()[i];
    let nearer = |best: usize, i: usize| if depth(i) < depth(best) { i } else { best };
    let nearest = |p: usize| gbuffer.samples_of(p).reduce(nearer).expect("a pixel has samples");
    (0..gbuffer.n_pixels()).map(nearest).collect()
}
