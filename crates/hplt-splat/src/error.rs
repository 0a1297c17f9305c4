use hplt_geom::Interrupted;

/// What can go wrong in a display.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An option is out of range.
    #[error("{name}: {value} is out of range; expected {expected}")]
    Option {
        /// Which option.
        name: &'static str,
        /// The value found.
        value: u64,
        /// The range, in words.
        expected: &'static str,
    },
    /// The caller cancelled.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
}
