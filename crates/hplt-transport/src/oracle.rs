use hplt_geom::Rgb;

use crate::Error;

/// What an oracle decides on: one gathered function.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detail {
    /// The level of the function.
    pub level: usize,
    /// What this bounce's gather added to what the coarser level said; at level 0 the gathered value itself. W/m².
    pub detail: Rgb,
    /// The standard error of the gather, from replicate groups of its own rays. W/m².
    pub noise: Rgb,
    /// The irradiance so far: direct, earlier bounces and this one. W/m².
    pub total: Rgb,
    /// The mean irradiance of the region so far. W/m².
    pub mean: Rgb,
}

/// Decides where the children of a function are gathered too.
pub trait Oracle: Sync {
    /// Whether to refine.
    fn refine(&self, detail: &Detail) -> bool;
}

/// Refines where in some channel `|detail| > max(absolute, relative·(total + 5 % of the mean), noise·σ)`.
///
/// `absolute` alone is the published criterion (Zollhöfer 2010).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Threshold {
    /// In W/m².
    pub absolute: f32,
    /// As a fraction of the irradiance.
    pub relative: f32,
    /// In standard errors of the gather.
    pub noise: f32,
}

impl Threshold {
    pub(crate) fn check(&self) -> Result<(), Error> {
        let Self { absolute, relative, noise } = *self;
        for (name, value) in
            [("threshold.absolute", absolute), ("threshold.relative", relative), ("threshold.noise", noise)]
        {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(Error::Option { name, value: value.into(), expected: "a finite number, 0 or more" });
            }
        }
        Ok(())
    }
}

impl Oracle for Threshold {
    fn refine(&self, d: &Detail) -> bool {
        const FLOOR: f32 = 0.05;
        let reference = (d.total.abs() + FLOOR * d.mean).max_element();
        (0..3).any(|c| {
            let threshold = self.absolute.max(self.relative * reference).max(self.noise * d.noise[c]);
            d.detail[c].abs() > threshold
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_part_of_the_threshold_can_veto() {
        let detail = Detail {
            level: 1,
            detail: Rgb::new(0.0, -0.1, 0.0),
            noise: Rgb::splat(0.06),
            total: Rgb::ONE,
            mean: Rgb::ONE,
        };
        let refine = |absolute, relative, noise| Threshold { absolute, relative, noise }.refine(&detail);
        assert!(refine(0.09, 0.09, 1.5));
        assert!(!refine(0.11, 0.0, 0.0));
        assert!(!refine(0.0, 0.11, 0.0));
        assert!(!refine(0.0, 0.0, 2.0));
    }
}
