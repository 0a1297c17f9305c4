//! Error and run time on the standard scenes.

mod answers;
mod child;
mod lit;
mod machine;
mod measure;
mod scenes;
mod table;
mod truth;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::shell::root;
use child::Hplt;
use machine::Machine;
use measure::{Bench, Effort};
use scenes::{CASES, Case};
use table::Report;

/// What to measure.
#[derive(clap::Args)]
pub struct Options {
    /// Fewer points, a looser reference, one run. On two free cores the solve of Sponza still takes minutes; --only cornell
    /// --only dragon leaves it out.
    #[arg(long)]
    quick: bool,
    /// Only these scenes; may be repeated.
    #[arg(long, value_name = "SCENE", value_parser = CASES.map(|case| case.id))]
    only: Vec<String>,
    /// Folder with scene files [default: HPLT_SCENES, else ../shared/scenes]; where one is missing, a procedural scene
    /// takes its place.
    #[arg(long, value_name = "DIR")]
    scenes: Option<PathBuf>,
    /// Random points per scene [default: 2000; quick: 200].
    #[arg(long, value_name = "N")]
    points: Option<usize>,
    /// Standard error of the reference at each point, relative [default: by scene].
    #[arg(long, value_name = "FRACTION")]
    reference_error: Option<f64>,
    /// Runs of the solver [default: 3; quick: 1].
    #[arg(long, value_name = "N")]
    runs: Option<usize>,
    /// Leave the original variant out [default: measured unless quick].
    #[arg(long)]
    no_slides: bool,
    /// Measure this binary instead of building one.
    #[arg(long, value_name = "FILE")]
    binary: Option<PathBuf>,
}

/// Measures, prints the tables, and writes them to `target/bench/report.md` and `report.json`.
///
/// # Errors
/// When something does not build, run or write.
pub fn run(options: &Options) -> Result<()> {
    let machine = Machine::look();
    let mut warnings: Vec<String> = machine.warning().into_iter().collect();
    let hplt = match &options.binary {
        Some(path) => {
            warnings.push("a given binary was measured, which may be of another commit".into());
            Hplt::at(path.canonicalize().with_context(|| format!("cannot find {}", path.display()))?)
        }
        None => Hplt::build()?,
    };
    let folder = root().join("target").join("bench");
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let bench = Bench { hplt: &hplt, folder: &folder, effort: options.effort()? };
    let scenes = scenes::folder(options.scenes.as_deref());
    let cases: Vec<&Case> =
        CASES.iter().filter(|case| options.only.is_empty() || options.only.iter().any(|id| id == case.id)).collect();
    let mut rows = Vec::new();
    for case in &cases {
        let row = bench.row(case, &case.source(&scenes)).with_context(|| format!("cannot measure {}", case.title))?;
        warnings.extend(row.warnings.iter().map(|w| format!("{}: {w}", row.title)));
        rows.push(row);
    }
    let report = Report { machine, mode: options.mode(), rows, warnings };
    let published: Vec<_> = cases.iter().map(|case| &case.published).collect();
    finish(&folder, &report, &report.markdown(&published))
}

fn finish(folder: &Path, report: &Report, text: &str) -> Result<()> {
    println!("{text}");
    for (name, content) in
        [("report.md", text.to_owned()), ("report.json", format!("{}\n", serde_json::to_string_pretty(report)?))]
    {
        let path = folder.join(name);
        std::fs::write(&path, content).with_context(|| format!("cannot write {}", path.display()))?;
        eprintln!("wrote {}", path.display());
    }
    Ok(())
}

impl Options {
    fn effort(&self) -> Result<Effort> {
        let quick = |quick, full| if self.quick { quick } else { full };
        if let Some(error) = self.reference_error.filter(|e| !(*e > 0.0 && *e < 1.0)) {
            bail!("--reference-error {error}; expected a fraction between 0 and 1, such as 0.003");
        }
        Ok(Effort {
            is_quick: self.quick,
            n_points: self.points.unwrap_or(quick(200, 2000)),
            reference_error: self.reference_error,
            n_runs: self.runs.unwrap_or(quick(1, 3)),
            with_slides: !self.quick && !self.no_slides,
        })
    }

    fn mode(&self) -> String {
        if self.quick { "quick: few points, a loose reference" } else { "full" }.into()
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        options: Options,
    }

    fn effort(line: &[&str]) -> Result<Effort> {
        Line::try_parse_from(std::iter::once(&"bench").chain(line))?.options.effort()
    }

    #[test]
    fn quick_is_less_work_and_single_values_win_over_it() {
        let (full, quick) = (effort(&[]).unwrap(), effort(&["--quick"]).unwrap());
        assert!(full.n_points == 2000 && full.n_runs == 3 && full.with_slides && !full.is_quick);
        assert!(quick.n_points < full.n_points && quick.n_runs == 1 && quick.is_quick);
        assert!(CASES.iter().all(|case| case.quick_reference_error > case.reference_error));
        let mixed = effort(&["--quick", "--points", "99", "--runs", "2", "--reference-error", "0.02"]).unwrap();
        assert_eq!((mixed.n_points, mixed.n_runs, mixed.reference_error), (99, 2, Some(0.02)));
    }

    #[test]
    fn unknown_scenes_and_errors_out_of_range_are_refused() {
        assert!(effort(&["--only", "castle"]).is_err());
        assert!(effort(&["--only", "sponza", "--only", "cornell"]).is_ok());
        for error in ["0", "1", "nan"] {
            assert!(effort(&["--reference-error", error]).is_err(), "{error}");
        }
    }
}
