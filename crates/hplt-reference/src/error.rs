/// What can be wrong with a comparison, a statistic or a reference run.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Test and reference differ in size.
    #[error("the test has {test} values and the reference {reference}; expected the same number")]
    LengthMismatch {
        /// Values, or pixels, in the test.
        test: usize,
        /// Values, or pixels, in the reference.
        reference: usize,
    },
    /// There is nothing to compare, or too little for a statistic.
    #[error("{what}: {found} values; expected at least {expected}")]
    TooFew {
        /// Of what.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many are needed.
        expected: usize,
    },
    /// A value is NaN or infinite.
    #[error("{what} {index}: {value} is not finite; expected a finite number")]
    NotFinite {
        /// Of what.
        what: &'static str,
        /// Index of the value.
        index: usize,
        /// The value found.
        value: f64,
    },
    /// The reference is black everywhere, so that nothing is relative to it.
    #[error("the reference is black everywhere; expected some light to measure relative to")]
    BlackReference,
    /// An option is out of range.
    #[error("{option}: {value}; expected {expected}")]
    BadOption {
        /// Name of the option.
        option: &'static str,
        /// The value found.
        value: f64,
        /// What is expected, in words.
        expected: &'static str,
    },
    /// The work was cancelled.
    #[error(transparent)]
    Interrupted(#[from] hplt_geom::Interrupted),
}
