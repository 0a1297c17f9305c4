//! What is measured of one scene.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Serialize;

use super::answers::{Figures, RunAnswer, StandardError};
use super::child::{Hplt, NOT_CONVERGED};
use super::lit::LitError;
use super::scenes::{Case, Source};
use super::truth::{self, Truth};

/// Rays of a final gather.
pub const GATHER_RAYS: u32 = 4096;

/// How much work to do.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Whether the quick values of a case are meant.
    pub is_quick: bool,
    /// Points per scene.
    pub n_points: usize,
    /// Standard error of the reference, in place of the one of the case.
    pub reference_error: Option<f64>,
    /// Runs of the solver.
    pub n_runs: usize,
    /// Whether the original variant is measured too.
    pub with_slides: bool,
}

/// All figures of one scene.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Name in tables.
    pub title: String,
    /// On the command line.
    pub scene: String,
    /// Whether it takes the place of a file that is not there.
    pub is_stand_in: bool,
    /// Triangles that are lit.
    pub triangles: u64,
    /// Points per level, coarsest first.
    pub points_per_level: Vec<u64>,
    /// Points at which errors are measured.
    pub n_points: usize,
    /// How sure the reference is.
    pub reference: StandardError,
    /// The optimised variant.
    pub production: Production,
    /// The original variant.
    pub slides: Option<Slides>,
    /// What the commands warned about.
    pub warnings: Vec<String>,
}

/// Error of irradiance read from a solution.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Measured {
    /// Over all points.
    pub all: Figures,
    /// Over those where there is light.
    pub lit: LitError,
}

/// Links, `--preset production`.
#[derive(Debug, Serialize)]
pub struct Production {
    /// Interpolated.
    pub interpolated: Measured,
    /// Through a final gather.
    pub gathered: Measured,
    /// Seconds of every run, all stages but writing and the error estimate.
    pub runs: Vec<f64>,
    /// Median seconds of the stages.
    pub stages: StageSeconds,
    /// Seconds to interpolate at all points.
    pub interpolation_seconds: f64,
    /// Seconds to gather at all points.
    pub gather_seconds: f64,
    /// Bounces, or sweeps.
    pub rounds: String,
    /// Why they ended.
    pub stop: String,
    /// Gathers.
    pub integrals: u64,
    /// Rays.
    pub rays: u64,
    /// Rays over the time of the bounces.
    pub rays_per_second: f64,
    /// Rays that left the scene.
    pub escaped: u64,
    /// Hits that nothing answered.
    pub uncovered: u64,
    /// Largest resident memory of the solver, bytes.
    pub peak_memory: Option<u64>,
    /// Median seconds on processors of the solver: all threads, all stages, writing and the error estimate too.
    pub processor_seconds: Option<f64>,
}

/// V1, `--preset slides`.
#[derive(Debug, Serialize)]
pub struct Slides {
    /// Interpolated.
    pub interpolated: Measured,
    /// Threshold, W/m².
    pub threshold: String,
    /// Seconds of the bounces, in order.
    pub bounces: Vec<f64>,
    /// Seconds of all bounces.
    pub transport: f64,
    /// Gathers.
    pub integrals: u64,
}

/// Seconds by stage.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct StageSeconds {
    /// Reading the scene.
    pub load: f64,
    /// The ray caster.
    pub bvh: f64,
    /// Points and basis.
    pub hierarchy: f64,
    /// Direct light.
    pub direct: f64,
    /// Bounces, or sweeps.
    pub transport: f64,
}

impl StageSeconds {
    fn of(answer: &RunAnswer) -> Self {
        Self {
            load: answer.seconds_of("load"),
            bvh: answer.seconds_of("bvh"),
            hierarchy: answer.seconds_of("points") + answer.seconds_of("basis"),
            direct: answer.seconds_of("direct light"),
            transport: answer.seconds_of("bounces") + answer.seconds_of("links"),
        }
    }

    fn total(&self) -> f64 {
        self.load + self.bvh + self.hierarchy + self.direct + self.transport
    }
}

/// Where to work and with what.
pub struct Bench<'b> {
    /// The binary.
    pub hplt: &'b Hplt,
    /// Outputs and cached references.
    pub folder: &'b Path,
    /// How much work to do.
    pub effort: Effort,
}

impl Bench<'_> {
    /// Measures one scene.
    ///
    /// # Errors
    /// When a command fails, and when two runs of the solver differ in anything but time.
    pub fn row(&self, case: &Case, source: &Source) -> Result<Row> {
        let solution = self.file(source, "production.hplt");
        let solve = self.solve_command(source, &["--preset", "production"], &solution);
        let (mut answers, mut usages) = (Vec::new(), Vec::new());
        for _ in 0..self.effort.n_runs.max(1) {
            let answer = self.hplt.ask(&solve, Some(NOT_CONVERGED))?;
            answers.push(RunAnswer::parse(&answer.document)?);
            usages.push(answer.usage);
        }
        check_repeatable(&source.title, &answers)?;
        let solved = answers[0].clone();
        let usual = if self.effort.is_quick { case.quick_reference_error } else { case.reference_error };
        let error = self.effort.reference_error.unwrap_or(usual);
        let truth =
            truth::find_or_trace(self.hplt, self.folder, source, &solved.scene_hash, self.effort.n_points, error)?;
        let (interpolated, interpolation_seconds) =
            self.read(source, &truth, (&solution, "production"), "interpolated.csv", None)?;
        let (gathered, gather_seconds) =
            self.read(source, &truth, (&solution, "production"), "gathered.csv", Some(GATHER_RAYS))?;
        let slides = self.effort.with_slides.then(|| self.slides(case, source, &truth)).transpose()?;
        let stages = median_stages(&answers);
        Ok(Row {
            title: source.title.clone(),
            scene: source.argument.clone(),
            is_stand_in: source.is_stand_in,
            triangles: solved.triangles,
            points_per_level: solved.levels.iter().map(|l| l.points).collect(),
            n_points: truth.n_points,
            reference: truth.standard_error,
            production: Production {
                interpolated,
                gathered,
                runs: answers.iter().map(|a| StageSeconds::of(a).total()).collect(),
                stages,
                interpolation_seconds,
                gather_seconds,
                rounds: solved.rounds(),
                stop: solved.stop.clone(),
                integrals: solved.integrals(),
                rays: solved.rays(),
                rays_per_second: if stages.transport > 0.0 { solved.rays() as f64 / stages.transport } else { 0.0 },
                escaped: solved.bounces.iter().map(|b| b.escaped).sum(),
                uncovered: solved.bounces.iter().map(|b| b.uncovered).sum(),
                peak_memory: usages.iter().filter_map(|u| u.peak_memory).max(),
                processor_seconds: median_of(usages.iter().filter_map(|u| u.processor_seconds)),
            },
            slides,
            warnings: solved.warnings,
        })
    }

    /// The original variant, with exactly three bounces as published.
    fn slides(&self, case: &Case, source: &Source, truth: &Truth) -> Result<Slides> {
        let solution = self.file(source, "slides.hplt");
        let flags = ["--preset", "slides", "--threshold", case.slides_threshold];
        let answer = self.hplt.ask(&self.solve_command(source, &flags, &solution), Some(NOT_CONVERGED))?;
        let solved = RunAnswer::parse(&answer.document)?;
        let (interpolated, _) = self.read(source, truth, (&solution, "slides"), "slides.csv", None)?;
        Ok(Slides {
            interpolated,
            threshold: case.slides_threshold.into(),
            bounces: solved.bounces.iter().map(|b| b.seconds).collect(),
            transport: solved.seconds_of("bounces"),
            integrals: solved.integrals(),
        })
    }

    fn solve_command(&self, source: &Source, flags: &[&str], solution: &Path) -> Vec<String> {
        let mut command = strings(&["solve", &source.argument]);
        command.extend(strings(flags));
        command.extend([strings(&["--force", "--output"]), vec![shown(solution)]].concat());
        command
    }

    /// Errors of the irradiance read from a solution, and the seconds that reading took.
    fn read(
        &self,
        source: &Source,
        truth: &Truth,
        (solution, preset): (&Path, &str),
        name: &str,
        gather: Option<u32>,
    ) -> Result<(Measured, f64)> {
        let out = self.file(source, name);
        let mut command = strings(&["points", &source.argument, "--preset", preset, "--force"]);
        command.extend([strings(&["--solution"]), vec![shown(solution)]].concat());
        command.extend(["--at".into(), shown(&truth.points), "--out".into(), shown(&out)]);
        command.extend(gather.into_iter().flat_map(|n| ["--final-gather".into(), n.to_string()]));
        let answer = self.hplt.ask(&command, Some(NOT_CONVERGED))?;
        let read = RunAnswer::parse(&answer.document)?;
        let seconds = read.seconds_of("direct light of points") + read.seconds_of("indirect light of points");
        let compared = self.hplt.ask_briefly(&["compare".into(), shown(&out), shown(&truth.table)])?;
        let lit = LitError::of_files(&out, &truth.table)?;
        Ok((Measured { all: Figures::parse(&compared.document)?, lit }, seconds))
    }

    fn file(&self, source: &Source, name: &str) -> PathBuf {
        self.folder.join(format!("{}-{name}", source.id))
    }
}

/// Same input and seed, same counts: anything else is a bug that times would hide.
fn check_repeatable(title: &str, answers: &[RunAnswer]) -> Result<()> {
    let first = answers.first().context("no run of the solver")?.counts();
    match answers.iter().position(|a| a.counts() != first) {
        Some(i) => bail!("{title}: run {} of the solver differs from the first in its counts", i + 1),
        None => Ok(()),
    }
}

fn median_stages(answers: &[RunAnswer]) -> StageSeconds {
    let stages: Vec<StageSeconds> = answers.iter().map(StageSeconds::of).collect();
    let of = |get: fn(&StageSeconds) -> f64| median(&stages.iter().map(get).collect::<Vec<_>>());
    StageSeconds {
        load: of(|s| s.load),
        bvh: of(|s| s.bvh),
        hierarchy: of(|s| s.hierarchy),
        direct: of(|s| s.direct),
        transport: of(|s| s.transport),
    }
}

fn median_of(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    (!values.is_empty()).then(|| median(&values))
}

/// The middle value, of an even number the mean of the two middle ones; 0 of none.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match (sorted.len(), sorted.len() / 2) {
        (0, _) => 0.0,
        (n, middle) if n % 2 == 1 => sorted[middle],
        (_, middle) => 0.5 * (sorted[middle - 1] + sorted[middle]),
    }
}

/// Owned copies, for a command line.
pub fn strings(parts: &[&str]) -> Vec<String> {
    parts.iter().map(ToString::to_string).collect()
}

/// A path for a command line.
pub fn shown(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::answers::tests::report;
    use super::*;

    #[test]
    fn medians_ignore_one_slow_run() {
        assert_eq!(median(&[9.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0]), 2.5);
        assert_eq!(median(&[]), 0.0);
    }

    #[test]
    fn stages_add_up_to_the_solve_without_writing_and_measuring() {
        let stages = StageSeconds::of(&RunAnswer::parse(&report()).unwrap());
        assert_eq!((stages.hierarchy, stages.total()), (1.0, 3.0));
    }

    #[test]
    fn runs_that_differ_in_a_count_are_refused() {
        let first = RunAnswer::parse(&report()).unwrap();
        let mut other = report();
        other["bounces"][0]["rays"] = json!(30_001);
        let other = RunAnswer::parse(&other).unwrap();
        assert!(check_repeatable("x", &[first.clone(), first.clone()]).is_ok());
        assert!(check_repeatable("x", &[first, other]).is_err());
        assert!(check_repeatable("x", &[]).is_err());
    }
}
