//! Progress on stderr, the clock, and the wish to stop.

use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard};
use std::time::Instant;

use hplt_geom::Progress;
use indicatif::{ProgressBar, ProgressStyle};

use crate::exit::{Exit, Failure};
use crate::sections::ProgressMode;
use crate::values::Seconds;

/// Set by the first signal.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Lets the first SIGINT or SIGTERM stop the run with what is finished, and the second one end it at once.
pub fn listen_for_signals() {
    // A process that may not install handlers still works; it only cannot stop gracefully.
    let _ = ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::SeqCst) {
            std::process::exit(i32::from(Exit::Interrupted as u8));
        }
    });
}

/// Why a run was stopped before its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// A signal.
    Signal,
    /// The time limit.
    TimeLimit,
}

/// Shows progress, tells the time, and says when to stop.
pub struct Reporter {
    mode: Mode,
    started: Instant,
    deadline: Option<f64>,
    /// Milliseconds on the clock at the last line or redraw.
    last: AtomicU64,
    state: Mutex<State>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Bar,
    Plain,
    Json,
    Silent,
}

struct State {
    stage: &'static str,
    stage_started: f64,
    bar: Option<ProgressBar>,
}

impl Reporter {
    /// Starts the clock.
    pub fn start(mode: ProgressMode, is_quiet: bool, max_time: Option<Seconds>) -> Self {
        let mode = match mode {
            _ if is_quiet && mode == ProgressMode::Auto => Mode::Silent,
            ProgressMode::Auto if std::io::stderr().is_terminal() => Mode::Bar,
            ProgressMode::Auto | ProgressMode::None => Mode::Silent,
            ProgressMode::Bar => Mode::Bar,
            ProgressMode::Plain => Mode::Plain,
            ProgressMode::Json => Mode::Json,
        };
        let state = Mutex::new(State { stage: "", stage_started: 0.0, bar: None });
        let deadline = max_time.map(|t| t.0);
        Self { mode, started: Instant::now(), deadline, last: AtomicU64::new(0), state }
    }

    /// Why the work should stop, if it should.
    pub fn stop(&self) -> Option<Stop> {
        if INTERRUPTED.load(Ordering::Relaxed) {
            return Some(Stop::Signal);
        }
        match self.deadline {
            Some(deadline) if self.now() > deadline => Some(Stop::TimeLimit),
            _ => None,
        }
    }

    /// The same failure; an interruption by the time limit is told from one by a signal.
    pub fn why_stopped(&self, failure: Failure) -> Failure {
        if failure.exit == Exit::Interrupted && self.stop() == Some(Stop::TimeLimit) {
            let limit = self.deadline.unwrap_or_default();
            let message = format!("{limit} s were over before there was a result; nothing was written");
            return Failure::new(Exit::NotConverged, "TIME_LIMIT", message);
        }
        failure
    }

    /// Shows progress of work that must be finished even after a stop.
    pub fn to_the_end(&self) -> ToTheEnd<'_> {
        ToTheEnd(self)
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        if let Some(bar) = self.lock().bar.take() {
            bar.finish_and_clear();
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    fn show(&self, stage: &'static str, done: u64, total: u64) {
        let now = self.now();
        let interval = if self.mode == Mode::Bar { 100 } else { 500 };
        let milliseconds = (now * 1e3) as u64;
        let last = self.last.load(Ordering::Relaxed);
        let is_due = milliseconds >= last.saturating_add(interval);
        let mut state = self.lock();
        let is_new = state.stage != stage;
        if !is_due && !is_new {
            return;
        }
        self.last.store(milliseconds, Ordering::Relaxed);
        if is_new {
            state.stage = stage;
            state.stage_started = now;
        }
        let seconds = now - state.stage_started;
        let left = if done > 0 && total > done { seconds * (total - done) as f64 / done as f64 } else { 0.0 };
        match self.mode {
            Mode::Silent => {}
            Mode::Bar => draw(&mut state, stage, done, total),
            Mode::Plain if total > 0 => {
                let percent = 100.0 * done as f64 / total as f64;
                say(&format!("[{now:7.1} s] {stage}: {percent:.0} %, about {left:.0} s left"));
            }
            Mode::Plain => say(&format!("[{now:7.1} s] {stage}: {done}")),
            Mode::Json => {
                let event = serde_json::json!({
                    "event": "progress", "stage": stage, "done": done, "total": total,
                    "seconds": now, "seconds_left": left,
                });
                say(&event.to_string());
            }
        }
    }
}

impl Progress for Reporter {
    fn advance(&self, stage: &'static str, done: u64, total: u64) {
        if self.mode != Mode::Silent {
            self.show(stage, done, total);
        }
    }

    fn is_cancelled(&self) -> bool {
        self.stop().is_some()
    }

    fn now(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }
}

/// Progress of work that is not cancelled any more: what is finished is being written.
pub struct ToTheEnd<'r>(&'r Reporter);

impl Progress for ToTheEnd<'_> {
    fn advance(&self, stage: &'static str, done: u64, total: u64) {
        self.0.advance(stage, done, total);
    }

    fn now(&self) -> f64 {
        self.0.now()
    }
}

/// Writes a line to stderr. That nobody listens is no reason to fail.
pub fn say(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

fn draw(state: &mut State, stage: &'static str, done: u64, total: u64) {
    let bar = state.bar.get_or_insert_with(|| {
        let bar = ProgressBar::new(total);
        if let Ok(style) = ProgressStyle::with_template("{msg:14} [{bar:30}] {percent:>3} %  {elapsed} left {eta}") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar
    });
    if bar.message() != stage {
        bar.reset();
        bar.set_message(stage);
    }
    bar.set_length(total.max(done));
    bar.set_position(done);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_limit_stops_and_names_itself() {
        let reporter = Reporter::start(ProgressMode::None, true, Some(Seconds(1e-9)));
        std::thread::sleep(std::time::Duration::from_millis(2));
        assert_eq!(reporter.stop(), Some(Stop::TimeLimit));
        assert!(reporter.is_cancelled() && !reporter.to_the_end().is_cancelled());
        let failure = reporter.why_stopped(Failure::interrupted());
        assert_eq!((failure.exit, failure.code), (Exit::NotConverged, "TIME_LIMIT"));
    }

    #[test]
    fn without_a_limit_nothing_stops() {
        let reporter = Reporter::start(ProgressMode::None, true, None);
        assert_eq!(reporter.stop(), None);
        assert_eq!(reporter.why_stopped(Failure::usage("x")).code, "USAGE");
    }
}
