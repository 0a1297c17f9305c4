use glam::Vec3;
use hplt_geom::{OrientedPoint, RegionId, Rgb, parallel};

use crate::GBuffer;

/// Least cosine between the normals of samples of one patch.
const SAME_NORMAL: f32 = 0.98;
/// Height over a patch's plane, per distance along it, up to which a sample is on it.
const SAME_PLANE: f32 = 0.1;
/// Pixels per unit of parallel work.
const CHUNK: usize = 256;

/// The samples of a G-buffer, those of a pixel that see the same piece of surface taken together: what changes little within a
/// pixel need be read but once for each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Patches {
    /// By sample; [`Patches::NONE`] for background.
    of_sample: Vec<u32>,
    /// The sample in the middle of each.
    middles: Vec<u32>,
}

impl Patches {
    const NONE: u32 = u32::MAX;

    /// The patches of `gbuffer`, pixel by pixel.
    pub fn of(gbuffer: &GBuffer) -> Self {
        let per_pixel = gbuffer.samples_per_pixel();
        let n_pixels = gbuffer.n_samples() / per_pixel.max(1);
        let chunks = parallel::map(
            n_pixels.div_ceil(CHUNK),
            || (),
            |(), chunk| {
                let mut found = Self { of_sample: Vec::new(), middles: Vec::new() };
                for pixel in chunk * CHUNK..((chunk + 1) * CHUNK).min(n_pixels) {
                    found.push_pixel(gbuffer, pixel * per_pixel..(pixel + 1) * per_pixel);
                }
                found
            },
        );
        let mut all = Self { of_sample: Vec::with_capacity(gbuffer.n_samples()), middles: Vec::new() };
        for chunk in chunks {
            let first = all.middles.len() as u32;
            let moved = |&i: &u32| if i == Self::NONE { i } else { first + i };
            all.of_sample.extend(chunk.of_sample.iter().map(moved));
            all.middles.extend(chunk.middles);
        }
        all
    }

    fn push_pixel(&mut self, gbuffer: &GBuffer, samples: std::ops::Range<usize>) {
        let (first_patch, first_sample) = (self.middles.len(), self.of_sample.len());
        // For now the first sample of each.
        for sample in samples.clone() {
            let is_same = |&p: &usize| is_on(gbuffer, self.middles[p] as usize, sample);
            let patch = match (first_patch..self.middles.len()).find(is_same) {
                _ if gbuffer.is_background(sample) => Self::NONE,
                Some(known) => known as u32,
                None => {
                    self.middles.push(sample as u32);
                    self.middles.len() as u32 - 1
                }
            };
            self.of_sample.push(patch);
        }
        for patch in first_patch..self.middles.len() {
            let of_pixel = samples.clone().zip(&self.of_sample[first_sample..]);
            let members = of_pixel.filter(|&(_, &p)| p == patch as u32).map(|(sample, _)| sample);
            self.middles[patch] = middle(gbuffer, members) as u32;
        }
    }

    /// Position and unit geometric normal of each, scene space: what to ask the regions at.
    pub fn surface_points(&self, gbuffer: &GBuffer) -> Vec<(Vec3, Vec3)> {
        self.middles.iter().map(|&s| (gbuffer.positions()[s as usize], gbuffer.normals()[s as usize])).collect()
    }

    /// Each as a query, with its *shading* normal, for display. The regions of the samples should have been set.
    pub fn queries(&self, gbuffer: &GBuffer) -> Vec<OrientedPoint> {
        self.middles.iter().map(|&s| gbuffer.query(s as usize)).collect()
    }

    /// Gives the samples of `gbuffer` the regions of their patches.
    pub fn set_regions(&self, gbuffer: &mut GBuffer, regions: &[RegionId]) {
        let of_samples = self.spread(regions, RegionId::DARK);
        let on_surface = (0..of_samples.len()).filter(|&i| !gbuffer.is_background(i));
        gbuffer.set_regions(on_surface.map(|i| of_samples[i]).collect());
    }

    /// The mean over the samples of each of what `of_samples` says of them.
    pub fn means(&self, of_samples: &[Rgb]) -> Vec<Rgb> {
        let mut sums = vec![(Rgb::ZERO, 0.0f32); self.middles.len()];
        for (&patch, &value) in self.of_sample.iter().zip(of_samples) {
            if let Some((sum, n)) = sums.get_mut(patch as usize) {
                (*sum, *n) = (*sum + value, *n + 1.0);
            }
        }
        sums.into_iter().map(|(sum, n)| sum / n).collect()
    }

    /// What `values` say of each patch, for each sample; `background` where there is none.
    pub fn spread<T: Copy>(&self, values: &[T], background: T) -> Vec<T> {
        self.of_sample.iter().map(|&i| values.get(i as usize).copied().unwrap_or(background)).collect()
    }
}

/// Whether two samples are on one smooth piece of surface.
fn is_on(gbuffer: &GBuffer, first: usize, other: usize) -> bool {
    let (normals, shading) = (gbuffer.normals(), gbuffer.shading_normals());
    let offset = gbuffer.positions()[other] - gbuffer.positions()[first];
    normals[first].dot(normals[other]) >= SAME_NORMAL
        && shading[first].dot(shading[other]) >= SAME_NORMAL
        && offset.dot(normals[first]).abs() <= SAME_PLANE * offset.length()
}

/// The sample nearest to the mean of some, which need not be on any surface itself.
fn middle(gbuffer: &GBuffer, samples: impl Iterator<Item = usize> + Clone) -> usize {
    let positions = gbuffer.positions();
    let (sum, n) = samples.clone().fold((Vec3::ZERO, 0.0), |(sum, n), s| (sum + positions[s], n + 1.0));
    let distance = |s: &usize| positions[*s].distance_squared(sum / n);
    samples.min_by(|a, b| distance(a).total_cmp(&distance(b))).expect("a patch has samples")
}
