use hplt_geom::Interrupted;

/// What can be wrong with a request for points.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A radius is not a positive finite number.
    #[error("coarsest radius: {0} found; expected a positive finite number")]
    Radius(f64),
    /// No level was asked for, or more than there can be.
    #[error("levels: {0} found; expected 1 to 30")]
    Levels(usize),
    /// The memory guard. Nothing has been allocated.
    #[error(
        "{estimate} points estimated at a radius of {radius} m ({bytes} bytes); the limit is {limit}; use a larger \
         coarsest radius or raise the limit"
    )]
    TooManyPoints {
        /// The densest packing of the reachable area at that radius: `1.1547·A/r²`.
        estimate: u64,
        /// Bytes that so many points would take.
        bytes: u64,
        /// The Poisson radius of the level, world space.
        radius: f64,
        /// The limit in the options.
        limit: u64,
    },
    /// The caller cancelled.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
}
