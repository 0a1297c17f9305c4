use std::ops::AddAssign;

/// How queries were answered. Everything but `queries` should be rare.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Coverage {
    /// All queries.
    pub queries: u64,
    /// Answered by a coarser level than asked for.
    pub coarser: u64,
    /// Answered by the nearest function on the same side, no function covering the point.
    pub nearest: u64,
    /// Not answered: zero was returned. Points in dark regions do not count.
    pub uncovered: u64,
}

impl AddAssign for Coverage {
    fn add_assign(&mut self, other: Self) {
        self.queries += other.queries;
        self.coarser += other.coarser;
        self.nearest += other.nearest;
        self.uncovered += other.uncovered;
    }
}
