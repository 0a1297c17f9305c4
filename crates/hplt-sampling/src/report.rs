use std::fmt;

/// What [`poisson_hierarchy`](crate::poisson_hierarchy) did.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HierarchyReport {
    /// Points on each level, coarsest first.
    pub points_per_level: Vec<u64>,
    /// The Poisson radius of each level, world units.
    pub radii: Vec<f64>,
    /// Uniform candidates drawn, reachable or not.
    pub candidates: u64,
    /// The area that light reaches, world units squared; both sides of a sheet count where both are reached.
    pub reachable_area: f64,
    /// Its share of the area of all sides that reflect.
    pub reachable_fraction: f64,
    /// The rest.
    pub dark_fraction: f64,
    /// Regions that light reaches.
    pub n_regions: u32,
    /// Rays cast, about.
    pub n_rays: u64,
    /// The share of fresh random points where no function of the finest level, with support `2r`, has a weight.
    pub uncovered_fraction: f64,
    /// Bytes of the result.
    pub memory: usize,
    /// Bytes with the candidates.
    pub peak_memory: usize,
    /// What is not as asked for.
    pub warnings: Vec<Warning>,
}

/// Something that is not as asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Warning {
    /// Finer levels would exceed the limit of points or the resolution of rays.
    FewerLevels {
        /// Levels asked for.
        asked: usize,
        /// Levels made.
        made: usize,
        /// The radius of the first one left out, world units.
        radius: f64,
    },
    /// The coarsest radius is larger than the reachable surface.
    RadiusCapped {
        /// The radius asked for, world units.
        asked: f64,
        /// The radius used.
        used: f64,
    },
    /// No light reaches any surface that reflects.
    NothingReachable,
    /// Gaps are left.
    Uncovered {
        /// The share of fresh random points where no function has a weight.
        fraction: f64,
    },
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FewerLevels { asked, made, radius } => {
                write!(f, "{made} of {asked} levels made: a radius of {radius} m is below the limits")
            }
            Self::RadiusCapped { asked, used } => {
                write!(f, "coarsest radius reduced from {asked} to {used} m, the size of the reachable surface")
            }
            Self::NothingReachable => write!(f, "no light reaches any surface that reflects"),
            Self::Uncovered { fraction } => write!(f, "{fraction:.1e} of the surface is covered by no function"),
        }
    }
}
