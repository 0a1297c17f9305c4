use std::ops::AddAssign;

use hplt_basis::Coverage;
use hplt_geom::Rgb;

/// What a splatting display drew.
#[derive(Debug, Clone, PartialEq)]
pub struct Splatted {
    /// The irradiance at every sample of the G-buffer, W/m²; zero for background.
    pub irradiance: Vec<Rgb>,
    /// What it took.
    pub report: SplatReport,
}

/// What a splatting display took. Functions are counted per level and function, whether they carry a value or only
/// share out weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SplatReport {
    /// Functions given.
    pub functions: u64,
    /// Functions whose support is on the picture.
    pub visible: u64,
    /// Pairs of function and tile of pixels, after tiles that a support cannot reach are taken out.
    pub tiles: u64,
    /// Weights evaluated: pairs of function and sample within the rectangle around a support.
    pub weights: u64,
    /// Weights that were positive: blending operations.
    pub covered: u64,
    /// Samples that meet a surface.
    pub surface_samples: u64,
    /// How the samples were answered.
    pub coverage: Coverage,
}

impl SplatReport {
    /// Weights evaluated per surface sample.
    pub fn weights_per_sample(&self) -> f64 {
        self.weights as f64 / self.surface_samples.max(1) as f64
    }

    /// Blending operations per surface sample: how often a sample is written on average.
    pub fn overdraw(&self) -> f64 {
        self.covered as f64 / self.surface_samples.max(1) as f64
    }
}

impl AddAssign for SplatReport {
    fn add_assign(&mut self, other: Self) {
        self.functions += other.functions;
        self.visible += other.visible;
        self.tiles += other.tiles;
        self.weights += other.weights;
        self.covered += other.covered;
        self.surface_samples += other.surface_samples;
        self.coverage += other.coverage;
    }
}
