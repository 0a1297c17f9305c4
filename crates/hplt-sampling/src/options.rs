use hplt_geom::{OrientedPoint, Scene};

use crate::Error;
use crate::report::Warning;

/// Points per area over `1/r²` in the densest packing of discs of diameter `r`: `2/√3`.
const HEXAGONAL: f64 = 1.154_700_538_379_251_5;
/// The same for a maximal random set on a plane, edges not counted.
const RANDOM: f64 = 0.7;
/// Radii below this, scene units, are not resolved by rays: it is the height that they start at.
const MIN_RADIUS: f64 = 1.0 / 65_536.0;
/// Ids of candidates must fit 32 bits with room to spare.
const MAX_POINTS: u64 = 1 << 28;
const MIN_CANDIDATES: usize = 4096;
/// Candidates per expected point on levels that are not the finest.
const CANDIDATES_PER_COARSE_POINT: usize = 16;

/// A Poisson radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Radius {
    /// As a fraction of the diagonal of the box around the scene.
    Fraction(f64),
    /// In world units.
    World(f64),
}

/// How to place points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HierarchyOptions {
    /// Everything random follows from it.
    pub seed: u64,
    /// Levels, coarsest first; radii halve from one to the next. 1 to 30.
    pub n_levels: usize,
    /// The Poisson radius of the coarsest level.
    pub coarsest_radius: Radius,
    /// The memory guard: levels that could take the number of points above this are not made.
    pub max_points: u64,
    /// Reachable candidates per expected point of the finest level, before gaps are looked for.
    pub candidates_per_point: f64,
    /// The share of fresh random points that may lie outside all functions of the finest level (support `2r`); candidates
    /// are added until it is met, or as long as they help.
    pub max_uncovered: f64,
}

impl HierarchyOptions {
    /// The published parameters: 6 levels from 8.5 % of the diagonal. A hundredth may be left uncovered, which is in slivers:
    /// where surfaces are plain, candidates for the points alone leave far less.
    pub fn slides() -> Self {
        Self {
            seed: 0,
            n_levels: 6,
            coarsest_radius: Radius::Fraction(0.085),
            max_points: 20_000_000,
            candidates_per_point: 5.0,
            max_uncovered: 0.01,
        }
    }

    /// One level less: a quarter of the points.
    pub fn preview() -> Self {
        Self { n_levels: 5, ..Self::production() }
    }

    /// As [`HierarchyOptions::slides`], with a ten-thousandth left uncovered at most.
    pub fn production() -> Self {
        Self { max_uncovered: 1e-4, ..Self::slides() }
    }

    /// Whether slivers between functions may be left without one.
    pub(crate) fn accepts_slivers(&self) -> bool {
        self.max_uncovered >= 1e-3
    }

    pub(crate) fn check(&self) -> Result<(), Error> {
        if !(1..=30).contains(&self.n_levels) {
            return Err(Error::Levels(self.n_levels));
        }
        let (Radius::Fraction(radius) | Radius::World(radius)) = self.coarsest_radius;
        if !(radius.is_finite() && radius > 0.0) {
            return Err(Error::Radius(radius));
        }
        Ok(())
    }
}

impl Default for HierarchyOptions {
    fn default() -> Self {
        Self::slides()
    }
}

/// The levels that will be made.
#[derive(Debug, Clone)]
pub(crate) struct LevelPlan {
    /// Scene units, coarsest first.
    pub radii: Vec<f32>,
    pub n_candidates: usize,
    pub warnings: Vec<Warning>,
    area: f64,
    accepts_slivers: bool,
}

impl LevelPlan {
    /// Decides about radii and candidates from `area`, that of all sides (scene units squared), and the share of it that
    /// light reaches.
    pub(crate) fn make(scene: &Scene, options: &HierarchyOptions, area: f64, lit_share: f64) -> Result<Self, Error> {
        let area = area * lit_share;
        let mut warnings = Vec::new();
        let asked = match options.coarsest_radius {
            Radius::Fraction(fraction) => fraction * f64::from(scene.diagonal()),
            Radius::World(radius) => radius / scene.frame().scale(),
        };
        let world = |radius: f64| radius * scene.frame().scale();
        // A few points on every scene, however large the radius.
        let cap = f64::from(scene.diagonal()).min(if area > 0.0 { (area / 4.0).sqrt() } else { f64::INFINITY });
        let coarsest = asked.min(cap);
        if coarsest < asked {
            warnings.push(Warning::RadiusCapped { asked: world(asked), used: world(coarsest) });
        }
        let limit = options.max_points.min(MAX_POINTS);
        let (mut radii, mut total) = (Vec::new(), 0.0);
        for level in 0..options.n_levels {
            let radius = coarsest / (1u64 << level) as f64;
            total += HEXAGONAL * area / (radius * radius);
            if total > limit as f64 || (level > 0 && radius < MIN_RADIUS) {
                if level == 0 {
                    return Err(too_many(total, world(radius), limit));
                }
                let (asked, made) = (options.n_levels, level);
                warnings.push(Warning::FewerLevels { asked, made, radius: world(radius) });
                break;
            }
            radii.push(radius.max(MIN_RADIUS) as f32);
        }
        let accepts_slivers = options.accepts_slivers();
        let mut plan = Self { radii, n_candidates: 0, warnings, area, accepts_slivers };
        let finest = plan.radii.last().map_or(0, |&r| plan.expected(r)) as f64;
        plan.n_candidates = ((finest * options.candidates_per_point.clamp(1.0, 1e3)) as usize).max(MIN_CANDIDATES);
        Ok(plan)
    }

    /// Candidates that a level of this radius needs, where a finer one decides how many there are; `None` for all.
    pub(crate) fn n_needed(&self, radius: f32) -> Option<usize> {
        self.accepts_slivers.then(|| (CANDIDATES_PER_COARSE_POINT * self.expected(radius)).max(MIN_CANDIDATES))
    }

    /// The number of points that a level of this radius will have, about.
    pub(crate) fn expected(&self, radius: f32) -> usize {
        (RANDOM * self.area / f64::from(radius).powi(2)) as usize
    }
}

fn too_many(estimate: f64, radius: f64, limit: u64) -> Error {
    // Saturates, which is what a message wants.
    let estimate = estimate as u64;
    Error::TooManyPoints { estimate, bytes: estimate.saturating_mul(size_of::<OrientedPoint>() as u64), radius, limit }
}
