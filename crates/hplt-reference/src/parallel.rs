//! The one place that knows whether work runs in parallel.

use hplt_geom::{Interrupted, Progress};

/// `make(i)` for all `i` below `n`, in order; the same values at any thread count.
#[cfg(feature = "rayon")]
pub(crate) fn map<T: Send>(
    n: usize,
    progress: &dyn Progress,
    make: impl Fn(usize) -> T + Sync,
) -> Result<Vec<T>, Interrupted> {
    use rayon::iter::{IndexedParallelIterator, IntoParallelIterator, ParallelIterator};
    (0..n)
        .into_par_iter()
        .with_max_len(1)
        .map(|i| {
            progress.check()?;
            Ok(make(i))
        })
        .collect()
}

/// `make(i)` for all `i` below `n`, in order.
#[cfg(not(feature = "rayon"))]
pub(crate) fn map<T>(n: usize, progress: &dyn Progress, make: impl Fn(usize) -> T) -> Result<Vec<T>, Interrupted> {
    (0..n)
        .map(|i| {
            progress.check()?;
            Ok(make(i))
        })
        .collect()
}
