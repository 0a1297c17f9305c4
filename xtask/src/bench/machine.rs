//! On what, when and of what was measured.

use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::shell::{output, root};

/// Tasks that wait for a processor above which times mean little, before the first measurement.
const QUIET_LOAD: f64 = 0.7;

/// The circumstances of a measurement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// Year-month-day, UTC.
    pub date: String,
    /// Of the checkout; marked when files differ from it.
    pub commit: String,
    /// Processors that may be used.
    pub cores: usize,
    /// Their model.
    pub cpu: String,
    /// Tasks running or waiting, mean over the last minute, when started.
    pub load: Option<f64>,
}

impl Machine {
    /// This machine, now.
    pub fn look() -> Self {
        let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let load = std::fs::read_to_string("/proc/loadavg").ok();
        let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
        Self {
            date: date(seconds / 86_400),
            commit: commit(),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            cpu: cpu_model(&cpuinfo).unwrap_or_else(|| format!("unknown {} processor", std::env::consts::ARCH)),
            load: load.as_deref().and_then(first_number),
        }
    }

    /// Why times are not to be trusted; `None` on a quiet machine.
    pub fn warning(&self) -> Option<String> {
        let load = self.load.filter(|load| *load > QUIET_LOAD)?;
        Some(format!(
            "the machine was busy when this started (load {load:.1} on {} cores): times are too long",
            self.cores
        ))
    }
}

fn commit() -> String {
    let git = |arguments: &[&str]| output(Command::new("git").args(arguments).current_dir(root()));
    let Ok(hash) = git(&["rev-parse", "--short=10", "HEAD"]) else { return "unknown".into() };
    let changes = git(&["status", "--porcelain", "--untracked-files=no"]).unwrap_or_default();
    format!("{}{}", hash.trim(), if changes.trim().is_empty() { "" } else { " with local changes" })
}

fn cpu_model(cpuinfo: &str) -> Option<String> {
    let line = cpuinfo.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

fn first_number(text: &str) -> Option<f64> {
    text.split_whitespace().next()?.parse().ok()
}

/// The Gregorian date of a day counted from 1970-01-01.
fn date(mut day: u64) -> String {
    let is_leap = |year: u64| (year.is_multiple_of(4) && !year.is_multiple_of(100)) || year.is_multiple_of(400);
    let mut year = 1970;
    while day >= 365 + u64::from(is_leap(year)) {
        day -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let lengths = [31, 28 + u64::from(is_leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let mut month = 0;
    while day >= lengths[month] {
        day -= lengths[month];
        month += 1;
    }
    format!("{year}-{:02}-{:02}", month + 1, day + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_become_dates() {
        let days =
            [(0, "1970-01-01"), (58, "1970-02-28"), (59, "1970-03-01"), (11_016, "2000-02-29"), (20_453, "2025-12-31")];
        for (day, expected) in days {
            assert_eq!(date(day), expected);
        }
    }

    #[test]
    fn a_busy_machine_is_warned_about() {
        let machine = |load| Machine { load, ..Machine::look() };
        assert!(machine(Some(2.5)).warning().is_some_and(|w| w.contains("2.5")));
        assert!(machine(Some(0.1)).warning().is_none() && machine(None).warning().is_none());
    }

    #[test]
    fn the_processor_is_named() {
        assert_eq!(cpu_model("processor\t: 0\nmodel name\t: Some CPU @ 2 GHz\n").as_deref(), Some("Some CPU @ 2 GHz"));
        assert_eq!(cpu_model("Hardware: other"), None);
        assert_eq!(first_number("2.50 3.67 5.36 3/101 20841"), Some(2.5));
    }
}
