use hplt_geom::{Rgb, parallel};

use crate::facet::SAME_NORMAL;
use crate::{Arriving, GBuffer};

/// Share of the larger of two albedos or emissions by which neighbours differ that one sample a pixel shows as steps.
const COLOUR_STEP: f32 = 0.1;
/// The same of irradiances. Light that changes by less from pixel to pixel changes gradually, and the middle of a pixel tells its mean.
const LIGHT_STEP: f32 = 0.25;

/// The pixels of a picture that one sample is not enough for, by what the samples of their neighbours see.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Edges {
    /// Next to it is another piece of surface, by depth or normal, or background.
    pub of_surface: Vec<bool>,
    /// Albedo or emission is another next to it.
    pub of_colour: Vec<bool>,
}

impl Edges {
    /// The edges between the pixels of `gbuffer`, by the first sample of each.
    pub fn of(gbuffer: &GBuffer) -> Self {
        let first = |pixel: usize| gbuffer.samples_of(pixel).start;
        let is_other_surface = |a: usize, b: usize| {
            let (a, b) = (first(a), first(b));
            match (gbuffer.is_background(a), gbuffer.is_background(b)) {
                (false, false) => !gbuffer.facet(a).continues_at(&gbuffer.facet(b), SAME_NORMAL),
                (a, b) => a != b,
            }
        };
        let is_other_colour = |a: usize, b: usize| {
            let (a, b) = (first(a), first(b));
            [gbuffer.albedos(), gbuffer.emitted()].iter().any(|colour| differ(colour[a], colour[b], COLOUR_STEP))
        };
        Self { of_surface: between(gbuffer, is_other_surface), of_colour: between(gbuffer, is_other_colour) }
    }
}

/// The pixels next to which the light on the same surface is another, such as at the rim of a shadow. `light` is that of the first sample of
/// each pixel, where it is known; pixels that `edges` tells from their surface are none of these.
pub fn uneven(gbuffer: &GBuffer, edges: &Edges, light: &[Arriving]) -> Vec<bool> {
    between(gbuffer, |a, b| {
        !edges.of_surface[a] && !edges.of_surface[b] && differ(light[a].total(), light[b].total(), LIGHT_STEP)
    })
}

/// The pixels of `mask`, and those next to them.
pub fn widened(gbuffer: &GBuffer, mask: &[bool]) -> Vec<bool> {
    let rim = between(gbuffer, |a, b| mask[a] != mask[b]);
    mask.iter().zip(rim).map(|(&inside, rim)| inside || rim).collect()
}

fn differ(a: Rgb, b: Rgb, step: f32) -> bool {
    (a - b).abs().max_element() > step * a.max(b).max_element()
}

/// The pixels that differ from one of their four neighbours.
fn between(gbuffer: &GBuffer, differ: impl Fn(usize, usize) -> bool + Sync + Send) -> Vec<bool> {
    let (width, height) = (gbuffer.width(), gbuffer.height());
    let differences = |y: usize| -> Vec<[bool; 2]> {
        let row = y * width..(y + 1) * width;
        let from_right = |pixel: usize| pixel % width + 1 < width && differ(pixel, pixel + 1);
        let from_below = |pixel: usize| y + 1 < height && differ(pixel, pixel + width);
        row.map(|pixel| [from_right(pixel), from_below(pixel)]).collect()
    };
    let differences = parallel::map(height, || (), |(), y| differences(y)).concat();
    let mut is_edge = vec![false; gbuffer.n_pixels()];
    for (pixel, differs) in differences.into_iter().enumerate() {
        for (other, _) in [pixel + 1, pixel + width].into_iter().zip(differs).filter(|(_, differs)| *differs) {
            is_edge[pixel] = true;
            is_edge[other] = true;
        }
    }
    is_edge
}
