use std::sync::atomic::{AtomicU64, Ordering};

use hplt_geom::{Interrupted, Progress};

/// Counts finished units of a stage from any thread, for progress alone: no result depends on it.
pub(crate) struct Counter<'a> {
    progress: &'a dyn Progress,
    stage: &'static str,
    done: AtomicU64,
    total: u64,
}

impl<'a> Counter<'a> {
    pub fn new(progress: &'a dyn Progress, stage: &'static str, total: usize) -> Self {
        Self { progress, stage, done: AtomicU64::new(0), total: total as u64 }
    }

    /// Call once per chunk.
    pub fn step(&self) -> Result<(), Interrupted> {
        self.progress.check()?;
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        self.progress.advance(self.stage, done, self.total);
        Ok(())
    }
}
