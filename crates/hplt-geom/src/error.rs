/// What can be wrong with a scene, its surroundings or a BVH. Values are in world space.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A number is NaN or infinite.
    #[error("{place}: {value} is not finite; expected a finite number")]
    NotFinite {
        /// Where, for instance `mesh "floor", vertex 17, position.x`.
        place: String,
        /// The value found.
        value: f64,
    },
    /// A number is finite but outside its range.
    #[error("{place}: {value} is out of range; expected {expected}")]
    OutOfRange {
        /// Where.
        place: String,
        /// The value found.
        value: f64,
        /// The range, in words.
        expected: &'static str,
    },
    /// An index points past the end of what it indexes.
    #[error("{place}: index {index} is out of range; there are {count}")]
    IndexOutOfRange {
        /// Where.
        place: String,
        /// The index found.
        index: u64,
        /// How many things there are.
        count: u64,
    },
    /// Two arrays that must be equally long are not.
    #[error("{place}: {found} entries; expected {expected}")]
    LengthMismatch {
        /// Where.
        place: String,
        /// The length found.
        found: u64,
        /// The length expected.
        expected: u64,
    },
    /// A declared size exceeds a limit.
    #[error("{place}: {value} exceeds the limit of {limit}")]
    Limit {
        /// Where.
        place: String,
        /// The value found.
        value: u64,
        /// The limit.
        limit: u64,
    },
    /// The scene has no surface that could receive light.
    #[error("no surface: the scene has no triangle with an area")]
    NoSurface,
}
