use glam::Vec3;
use hplt_geom::{OrientedPoint, RegionId, parallel};

use crate::GBuffer;

/// Least cosine between the normals of samples of one patch.
const SAME_NORMAL: f32 = 0.98;
/// Height over a patch's plane, per distance along it, up to which a sample is on it.
const SAME_PLANE: f32 = 0.1;
/// Pixels per unit of parallel work.
const CHUNK: usize = 256;

/// The samples of a G-buffer, those of a pixel that see the same piece of surface taken together: what changes little within a
/// pixel need be read but once for each.
#[derive(Debug, Clone, PartialEq)]
pub struct Patches {
    /// By sample; [`Patches::NONE`] for background.
    of_sample: Vec<u32>,
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    shading_normals: Vec<Vec3>,
}

/// What one chunk of pixels sees.
#[derive(Default)]
struct Chunk {
    /// Within the chunk.
    of_sample: Vec<u32>,
    patches: Vec<Patch>,
}

/// Sums over the samples of a patch, after its first.
struct Patch {
    first: usize,
    position: Vec3,
    normal: Vec3,
    shading_normal: Vec3,
    n: f32,
}

impl Patches {
    const NONE: u32 = u32::MAX;

    /// The patches of `gbuffer`, in the order of their first samples.
    pub fn of(gbuffer: &GBuffer) -> Self {
        let per_pixel = gbuffer.samples_per_pixel();
        let n_pixels = gbuffer.n_samples() / per_pixel.max(1);
        let chunks = parallel::map(
            n_pixels.div_ceil(CHUNK),
            || (),
            |(), chunk| {
                let pixels = chunk * CHUNK..((chunk + 1) * CHUNK).min(n_pixels);
                let mut found = Chunk::default();
                pixels.for_each(|pixel| found.push_pixel(gbuffer, pixel * per_pixel..(pixel + 1) * per_pixel));
                found
            },
        );
        let mut all = Self {
            of_sample: Vec::with_capacity(gbuffer.n_samples()),
            positions: Vec::new(),
            normals: Vec::new(),
            shading_normals: Vec::new(),
        };
        for chunk in chunks {
            let first = all.positions.len() as u32;
            let moved = |&i: &u32| if i == Self::NONE { i } else { first + i };
            all.of_sample.extend(chunk.of_sample.iter().map(moved));
            all.positions.extend(chunk.patches.iter().map(|p| p.position / p.n));
            all.normals.extend(chunk.patches.iter().map(|p| p.normal.normalize_or_zero()));
            all.shading_normals.extend(chunk.patches.iter().map(|p| p.shading_normal.normalize_or_zero()));
        }
        all
    }

    /// Mean position and unit geometric normal of each, scene space: what to ask the regions at.
    pub fn surface_points(&self) -> Vec<(Vec3, Vec3)> {
        self.positions.iter().copied().zip(self.normals.iter().copied()).collect()
    }

    /// Each as a query, with its *shading* normal, for display; `regions` are theirs.
    pub fn queries(&self, regions: &[RegionId]) -> Vec<OrientedPoint> {
        let all = self.positions.iter().zip(&self.shading_normals).zip(regions);
        all.map(|((&position, &normal), &region)| OrientedPoint::new(position, normal, region)).collect()
    }

    /// What `values` say of each patch, for each sample; `background` where there is none.
    pub fn spread<T: Copy>(&self, values: &[T], background: T) -> Vec<T> {
        self.of_sample.iter().map(|&i| values.get(i as usize).copied().unwrap_or(background)).collect()
    }
}

impl Chunk {
    fn push_pixel(&mut self, gbuffer: &GBuffer, samples: std::ops::Range<usize>) {
        let begin = self.patches.len();
        for sample in samples {
            if gbuffer.is_background(sample) {
                self.of_sample.push(Patches::NONE);
                continue;
            }
            let known = (begin..self.patches.len()).find(|&p| is_on(gbuffer, self.patches[p].first, sample));
            let at = known.unwrap_or(self.patches.len());
            if known.is_none() {
                let zero = Vec3::ZERO;
                self.patches.push(Patch { first: sample, position: zero, normal: zero, shading_normal: zero, n: 0.0 });
            }
            let patch = &mut self.patches[at];
            patch.position += gbuffer.positions()[sample];
            patch.normal += gbuffer.normals()[sample];
            patch.shading_normal += gbuffer.shading_normals()[sample];
            patch.n += 1.0;
            self.of_sample.push(at as u32);
        }
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
