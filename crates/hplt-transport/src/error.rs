use hplt_geom::Interrupted;

/// What can stop a stage.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The caller asked to stop.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
    /// An option is outside its range.
    #[error("option {name}: {value}; expected {expected}")]
    Option {
        /// The field.
        name: &'static str,
        /// The value found.
        value: f64,
        /// The range, in words.
        expected: &'static str,
    },
    /// Light in a closed region of albedo 1 never dies.
    #[error(
        "closed region {region} has albedo 1 everywhere: no finite solution; expected an albedo below 1 or an opening"
    )]
    NoFiniteSolution {
        /// The region.
        region: u32,
    },
    /// Bounce after bounce is brighter than the one before.
    #[error(
        "the last {n_growing} bounces each grew: the transport does not converge; use the absolute variant or exact reconstruction"
    )]
    Diverging {
        /// How many bounces in a row grew.
        n_growing: usize,
    },
    /// Stored links are not such as tracing makes.
    #[error("links of function {row}: {problem}")]
    Links {
        /// The function, by flat index.
        row: usize,
        /// What is wrong, in words.
        problem: &'static str,
    },
    /// A light cannot be multiplied by that.
    #[error("light group \"{group}\": factor {value}; expected finite numbers of 0 or more")]
    Factor {
        /// Name of the group.
        group: String,
        /// The factor.
        value: f32,
    },
    /// A coefficient became NaN or infinite.
    #[error("bounce {bounce}, level {level}, function {function}: irradiance is not finite")]
    NotFinite {
        /// The bounce, counted from 1.
        bounce: usize,
        /// The level.
        level: usize,
        /// The function.
        function: usize,
    },
}
