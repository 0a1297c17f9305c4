use hplt_basis::{MIN_WEIGHT_SUM, ShepardBasis};
use hplt_geom::{Interrupted, Progress, RegionId, Rgb};

use crate::flatten::{CLOSED, CutLevel, Flattened};
use crate::splat::reconstructed;
use crate::tiles::{Bins, Tile, for_each_tile};
use crate::{GBuffer, Splatted};

/// Splats a flattened field: leaves and masks, coarse to fine, each level blended over what the coarser ones leave open.
///
/// Samples that the cut leaves open, because a level does not cover them, are answered as [`ExactShepard`](hplt_basis::ExactShepard)
/// answers for the values of the finest level.
///
/// # Errors
/// When interrupted.
pub fn splat_flattened(
    basis: &ShepardBasis,
    field: &Flattened,
    gbuffer: &GBuffer,
    progress: &dyn Progress,
) -> Result<Splatted, Interrupted> {
    let levels = field.levels.iter().enumerate().filter(|(_, cut)| !cut.functions.is_empty());
    let bins: Vec<Bins<'_>> =
        levels.map(|(level, cut)| Bins::new(basis, level, &cut.functions, gbuffer.projection())).collect();
    for_each_tile(gbuffer, &bins, progress, Vec::new, |blends: &mut Vec<Blend>, tile| {
        blends.clear();
        blends.resize(tile.queries.len(), Blend::default());
        for bins in &bins {
            draw(tile, bins, &field.levels[bins.level], field.values.level(bins.level), blends);
            blends.iter_mut().for_each(Blend::finish_level);
        }
        let values = (0..blends.len()).map(|i| {
            let Blend { value, open, .. } = blends[i];
            if open < CLOSED || tile.queries[i].region == RegionId::DARK {
                return value;
            }
            value + reconstructed(basis, &field.values, tile, i) * open
        });
        values.collect()
    })
}

fn draw(tile: &mut Tile, bins: &Bins<'_>, cut: &CutLevel, values: &[Rgb], blends: &mut [Blend]) {
    tile.draw(bins, |sample, i, weight| {
        let blend = &mut blends[sample];
        if cut.is_leaf[i] {
            blend.leaf_value += values[cut.functions[i] as usize] * weight;
            blend.leaf_weight += weight;
        } else {
            blend.mask_weight += weight;
        }
    });
}

/// What has been drawn at one sample.
#[derive(Debug, Clone, Copy)]
struct Blend {
    /// The levels that are finished.
    value: Rgb,
    /// The share `T` that finer levels still have.
    open: f32,
    /// `Σ w v` and `Σ w` over the leaves, `Σ w` over the masks of the level that is being drawn.
    leaf_value: Rgb,
    leaf_weight: f32,
    mask_weight: f32,
}

impl Default for Blend {
    fn default() -> Self {
        Self { value: Rgb::ZERO, open: 1.0, leaf_value: Rgb::ZERO, leaf_weight: 0.0, mask_weight: 0.0 }
    }
}

impl Blend {
    fn finish_level(&mut self) {
        let weight = self.leaf_weight + self.mask_weight;
        // Without a leaf, everything here is refined (or uncovered) and finer levels have all of it.
        if self.leaf_weight > 0.0 && weight >= MIN_WEIGHT_SUM {
            self.value += self.leaf_value * (self.open / weight);
            self.open *= self.mask_weight / weight;
        }
        *self = Self { value: self.value, open: self.open, ..Self::default() };
    }
}
