use hplt_geom::glam::DVec3;

use crate::SparseRows;

/// A transport operator `G` on flat indices of unknowns: what the solver applies, one RGB channel beside the other.
///
/// Entries are not negative. Values are `f64`: at albedo 0.9999 a residual in `f32` would be all rounding.
pub trait LinearOperator: Sync {
    /// How many unknowns there are.
    fn len(&self) -> usize;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// `out = G x`, the same bits at any thread count.
    fn apply(&self, x: &[DVec3], out: &mut [DVec3]);

    /// As [`apply`](Self::apply), to about single precision, which may be faster: for steps whose outcome an exact product checks.
    /// Only the rows that `is_wanted` marks count; others may be anything finite.
    fn apply_roughly(&self, x: &[DVec3], is_wanted: &[bool], out: &mut [DVec3]) {
        let _ = is_wanted;
        self.apply(x, out);
    }

    /// `G 1`: the fraction of a uniform light that each unknown receives again.
    fn row_sums(&self) -> Vec<DVec3> {
        let mut sums = vec![DVec3::ZERO; self.len()];
        self.apply(&vec![DVec3::ONE; self.len()], &mut sums);
        sums
    }

    /// The largest error of [`apply`](Self::apply) by rounding, relative to `G|x|`. For `f64` sums of at most 2¹² terms.
    fn rounding(&self) -> f64 {
        4096.0 * f64::EPSILON
    }

    /// The rows, for methods that read entries; without them, those methods fall back to bounces.
    fn rows(&self) -> Option<&SparseRows> {
        None
    }
}
