use hplt_basis::{Coefficients, Coverage};
use hplt_geom::Rgb;

/// The indirect irradiance on the hierarchy, and how it came about.
#[derive(Debug, Clone)]
pub struct Solution<E> {
    /// Indirect irradiance, W/m².
    pub indirect: Coefficients<E>,
    /// What it took.
    pub report: TransportReport,
}

/// Why the bounces ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopReason {
    /// The light still to come is below the tolerance.
    Converged,
    /// As many bounces as asked for.
    MaxBounces,
    /// The caller interrupted; the bounces finished so far are kept.
    Interrupted,
    /// Nothing emits.
    NoLight,
}

/// What a transport did.
#[derive(Debug, Clone)]
pub struct TransportReport {
    /// One entry per finished bounce.
    pub bounces: Vec<BounceReport>,
    /// Why it ended.
    pub stop: StopReason,
    /// The largest fraction that any gather would pass on of a uniform light: the largest row sum of the operator.
    pub max_row_sum: f32,
    /// Bound on the relative error left by the bounces not computed: the largest ratio, over regions and channels, of
    /// `max|unshot|·q/(1-q)` to the mean irradiance, `q` being the largest row sum of the region. Rigorous for the absolute
    /// encoding, whose rows are convex combinations; an estimate for the delta encoding.
    pub truncation_bound: f32,
}

/// One bounce.
#[derive(Debug, Clone, PartialEq)]
pub struct BounceReport {
    /// Gathers per level.
    pub integrals: Vec<u64>,
    /// Rays traced.
    pub rays: u64,
    /// Rays that left the scene. In a closed scene every one is a leak.
    pub escaped: u64,
    /// How the hits were reconstructed.
    pub coverage: Coverage,
    /// Largest irradiance that this bounce added, per channel, W/m²: the unshot energy of the next one.
    pub unshot: Rgb,
    /// Mean irradiance that this bounce added, weighted by area, W/m².
    pub mean: Rgb,
    /// Seconds on the caller's clock.
    pub seconds: f64,
}

impl TransportReport {
    /// Gathers in all bounces.
    pub fn n_integrals(&self) -> u64 {
        self.bounces.iter().flat_map(|b| &b.integrals).sum()
    }

    /// Rays in all bounces.
    pub fn n_rays(&self) -> u64 {
        self.bounces.iter().map(|b| b.rays).sum()
    }

    /// Rays that left the scene, in all bounces.
    pub fn n_escaped(&self) -> u64 {
        self.bounces.iter().map(|b| b.escaped).sum()
    }

    /// How the hits of all bounces were reconstructed.
    pub fn coverage(&self) -> Coverage {
        let mut sum = Coverage::default();
        self.bounces.iter().for_each(|b| sum += b.coverage);
        sum
    }

    /// Seconds of all bounces.
    pub fn seconds(&self) -> f64 {
        self.bounces.iter().map(|b| b.seconds).sum()
    }

    /// Whether the light still to come is below the tolerance.
    pub fn is_converged(&self) -> bool {
        matches!(self.stop, StopReason::Converged | StopReason::NoLight)
    }
}
