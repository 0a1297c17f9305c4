//! One measured setting: what it took and how wrong it is.

use anyhow::Result;
use serde::{Deserialize, Serialize};

use super::answers::RunAnswer;
use super::child::{Answer, NOT_CONVERGED};
use super::measure::{Bench, compare, shown, strings};
use super::stats::median;
use super::truth::Truth;

/// A setting is run again while all its runs took less than this, seconds.
const REPEAT_SECONDS: f64 = 4.0;
/// And at most so often.
const MOST_RUNS: usize = 3;

/// One setting of one way to light a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// The flags that differ.
    pub budget: String,
    /// The quantity that is varied, where it is a number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// Median seconds from the start of the process to its end, without the solver's own error estimate.
    pub seconds: f64,
    /// Median seconds on processors, all threads together, less the share that the error estimate has of the wall-clock time.
    pub processor_seconds: Option<f64>,
    /// Runs.
    pub runs: usize,
    /// How wrong it is, where that was measured.
    #[serde(flatten)]
    pub errors: Option<Errors>,
    /// Functions of the finest level.
    #[serde(default)]
    pub functions: Option<u64>,
    /// Gather rays.
    #[serde(default)]
    pub rays: Option<u64>,
    /// Sweeps of the solver, or bounces.
    #[serde(default)]
    pub sweeps: Option<u64>,
    /// Largest resident memory, bytes.
    #[serde(default)]
    pub peak_memory: Option<u64>,
}

/// Relative errors of total irradiance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Mean where there is light.
    pub lit_mean: f64,
    /// Relative error of the sum.
    pub bias: f64,
}

/// An entry and the report of its last run.
pub struct Measured {
    /// The figures.
    pub entry: Entry,
    /// All that the command said.
    pub answer: RunAnswer,
}

/// Runs a command that writes the light at the points of the reference, several times where that is quick; `None` where it was cut
/// short. `stem` names its table.
///
/// # Errors
/// When the command fails.
pub fn light(
    bench: &Bench<'_>,
    stem: &str,
    mut command: Vec<String>,
    budget: &str,
    truth: &Truth,
) -> Result<Option<Measured>> {
    let out = bench.folder.join(format!("{stem}-curve.csv"));
    command.extend(strings(&["--force", "--at"]));
    command.extend([shown(&truth.points), "--out".into(), shown(&out)]);
    let Some(mut measured) = run(bench, command, budget)? else { return Ok(None) };
    let (all, lit) = compare(bench.hplt, &out, truth)?;
    measured.entry.errors =
        Some(Errors { mean: all.mean, median: all.median, p95: all.p95, lit_mean: lit.mean, bias: all.bias });
    Ok(Some(measured))
}

/// The same for any command that lights a scene; its error is not measured.
///
/// # Errors
/// When the command fails.
pub fn run(bench: &Bench<'_>, mut command: Vec<String>, budget: &str) -> Result<Option<Measured>> {
    command.extend(["--max-time".into(), format!("{}s", bench.effort.limit_seconds)]);
    let (mut seconds, mut processor, mut peaks) = (Vec::new(), Vec::new(), Vec::new());
    loop {
        let process = bench.hplt.ask(&command, Some(NOT_CONVERGED))?;
        if process.document["error"]["code"] == "TIME_LIMIT" {
            return Ok(None);
        }
        let answer = RunAnswer::parse(&process.document)?;
        if answer.is_cut_short() {
            return Ok(None);
        }
        let share = lighting_share(&process, &answer);
        seconds.push(share * process.wall_seconds);
        processor.extend(process.usage.processor_seconds.map(|s| share * s));
        peaks.extend(process.usage.peak_memory);
        let most_runs = MOST_RUNS.min(bench.effort.n_runs);
        if seconds.len() >= most_runs || seconds.iter().sum::<f64>() >= REPEAT_SECONDS {
            let entry = Entry {
                budget: budget.into(),
                value: None,
                seconds: median(&seconds),
                processor_seconds: (!processor.is_empty()).then(|| median(&processor)),
                runs: seconds.len(),
                errors: None,
                functions: answer.levels.last().map(|level| level.points),
                rays: (!answer.bounces.is_empty()).then(|| answer.rays()),
                sweeps: answer.n_rounds(),
                peak_memory: peaks.into_iter().max(),
            };
            return Ok(Some(Measured { entry, answer }));
        }
    }
}

/// The part of the whole process that is not the error estimate, which no other method here makes.
fn lighting_share(process: &Answer, answer: &RunAnswer) -> f64 {
    (1.0 - answer.seconds_of("error estimate") / process.wall_seconds).clamp(0.0, 1.0)
}

#[cfg(test)]
pub mod tests {
    use serde_json::json;

    use super::super::answers::tests::report;
    use super::super::child::Usage;
    use super::*;

    /// An entry whose errors are all `mean`.
    pub fn entry(seconds: f64, mean: f64) -> Entry {
        Entry {
            budget: "--levels 2".into(),
            value: None,
            seconds,
            processor_seconds: None,
            runs: 1,
            errors: Some(Errors { mean, median: mean, p95: mean, lit_mean: mean, bias: 0.0 }),
            functions: Some(800),
            rays: None,
            sweeps: Some(9),
            peak_memory: None,
        }
    }

    #[test]
    fn the_error_estimate_is_no_part_of_the_time() {
        let answer = RunAnswer::parse(&report()).unwrap();
        let process = Answer { document: report(), usage: Usage::default(), wall_seconds: 4.0 };
        assert_eq!(lighting_share(&process, &answer), 0.875);
    }

    #[test]
    fn entries_come_back_from_json_with_and_without_errors() {
        let whole = entry(1.0, 0.02);
        let text = serde_json::to_value(&whole).unwrap();
        assert_eq!(text["mean"], json!(0.02));
        assert_eq!(serde_json::from_value::<Entry>(text).unwrap(), whole);
        let bare = Entry { errors: None, value: Some(1e6), ..whole };
        let text = serde_json::to_value(&bare).unwrap();
        assert!(text.get("mean").is_none());
        assert_eq!(serde_json::from_value::<Entry>(text).unwrap(), bare);
    }
}
