use glam::Vec3;
use hplt_geom::parallel;

use crate::GBuffer;
use crate::facet::SAME_NORMAL;

/// Pixels per unit of parallel work.
const CHUNK: usize = 256;

/// The samples of a G-buffer, those of a pixel that see the same piece of surface taken together: what changes little within a
/// pixel need be read but once for each.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Patches {
    /// By sample; [`Patches::NONE`] for background.
    of_sample: Vec<u32>,
    /// The sample in the middle of each.
    middles: Vec<u32>,
    /// The pixel of each.
    pixels: Vec<u32>,
}

impl Patches {
    const NONE: u32 = u32::MAX;

    /// The patches of `gbuffer`, pixel by pixel.
    pub fn of(gbuffer: &GBuffer) -> Self {
        let n_pixels = gbuffer.n_pixels();
        let chunks = parallel::map(
            n_pixels.div_ceil(CHUNK),
            || (),
            |(), chunk| {
                let mut found = Self::default();
                for pixel in chunk * CHUNK..((chunk + 1) * CHUNK).min(n_pixels) {
                    found.push_pixel(gbuffer, pixel);
                }
                found
            },
        );
        let of_sample = Vec::with_capacity(gbuffer.n_samples());
        let mut all = Self { of_sample, ..Self::default() };
        for chunk in chunks {
            let first = all.middles.len() as u32;
            let moved = |&i: &u32| if i == Self::NONE { i } else { first + i };
            all.of_sample.extend(chunk.of_sample.iter().map(moved));
            all.middles.extend(chunk.middles);
            all.pixels.extend(chunk.pixels);
        }
        all
    }

    fn push_pixel(&mut self, gbuffer: &GBuffer, pixel: usize) {
        let samples = gbuffer.samples_of(pixel);
        let (first_patch, first_sample) = (self.middles.len(), self.of_sample.len());
        // For now the first sample of each.
        for sample in samples.clone() {
            let is_same =
                |&p: &usize| gbuffer.facet(self.middles[p] as usize).continues_at(&gbuffer.facet(sample), SAME_NORMAL);
            let patch = match (first_patch..self.middles.len()).find(is_same) {
                _ if gbuffer.is_background(sample) => Self::NONE,
                Some(known) => known as u32,
                None => {
                    self.middles.push(sample as u32);
                    self.pixels.push(pixel as u32);
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

    /// How many there are.
    pub fn len(&self) -> usize {
        self.middles.len()
    }

    /// Whether nothing but background is seen.
    pub fn is_empty(&self) -> bool {
        self.middles.is_empty()
    }

    /// The pixel of a patch.
    pub fn pixel(&self, patch: usize) -> usize {
        self.pixels[patch] as usize
    }

    /// Whether a patch of `gbuffer` is on the surface that the first sample of its pixel sees in `other`, a coarser picture.
    pub fn continues(&self, patch: usize, gbuffer: &GBuffer, other: &GBuffer) -> bool {
        let first = other.samples_of(self.pixel(patch)).start;
        let middle = gbuffer.facet(self.middles[patch] as usize);
        !other.is_background(first) && other.facet(first).continues_at(&middle, SAME_NORMAL)
    }

    /// The sample in the middle of a patch.
    pub fn middle(&self, patch: usize) -> usize {
        self.middles[patch] as usize
    }

    /// What `values` say of each patch, for each sample; `background` where there is none.
    pub fn spread<T: Copy>(&self, values: &[T], background: T) -> Vec<T> {
        self.of_sample.iter().map(|&i| values.get(i as usize).copied().unwrap_or(background)).collect()
    }
}

/// The sample nearest to the mean of some, which need not be on any surface itself.
fn middle(gbuffer: &GBuffer, samples: impl Iterator<Item = usize> + Clone) -> usize {
    let positions = gbuffer.positions();
    let (sum, n) = samples.clone().fold((Vec3::ZERO, 0.0), |(sum, n), s| (sum + positions[s], n + 1.0));
    let distance = |s: &usize| positions[*s].distance_squared(sum / n);
    samples.min_by(|a, b| distance(a).total_cmp(&distance(b))).expect("a patch has samples")
}
