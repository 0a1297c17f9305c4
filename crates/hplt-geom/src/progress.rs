/// Told how far a long stage has come, and asked whether to go on.
///
/// Implementations must be cheap: stages call both methods about once per chunk of work, from any thread.
pub trait Progress: Sync {
    /// `done` of `total` units of `stage` are finished. `total` may be 0 when it is not known.
    fn advance(&self, stage: &'static str, done: u64, total: u64);

    /// True once the work should stop. Never becomes false again.
    fn is_cancelled(&self) -> bool {
        false
    }

    /// Seconds on the caller's clock, for the timings in reports; 0 where the caller has none. Libraries never read a
    /// clock themselves, and no result depends on this.
    fn now(&self) -> f64 {
        0.0
    }

    /// [`Interrupted`] once the work should stop.
    ///
    /// # Errors
    /// When cancelled.
    fn check(&self) -> Result<(), Interrupted> {
        if self.is_cancelled() { Err(Interrupted) } else { Ok(()) }
    }
}

/// Reports nothing, cancels nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn advance(&self, _stage: &'static str, _done: u64, _total: u64) {}
}

/// The work was cancelled through [`Progress::is_cancelled`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;
