//! What is measured of one scene.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Serialize;

use super::answers::{Figures, RunAnswer, SolveSettings};
use super::child::{Answer, Hplt, NOT_CONVERGED};
use super::engines::Engine;
use super::lit::LitError;
use super::scenes::{Case, Source};
use super::stats::{Spread, median};
use super::truth::{self, Truth, Wanted};

/// How much work to do.
#[derive(Debug, Clone)]
pub struct Effort {
    /// Whether the quick values of cases and engines are meant.
    pub is_quick: bool,
    /// Points per scene.
    pub n_points: usize,
    /// Standard error of the reference, in place of the one of the case.
    pub reference_error: Option<f64>,
    /// Runs of every solver, if they fit `repeat_seconds`.
    pub n_runs: usize,
    /// No run begins once the runs of a solver have taken this long.
    pub repeat_seconds: f64,
    /// Seconds after which one run is cut short.
    pub limit_seconds: u64,
    /// Rays of the final gather.
    pub gather_rays: u32,
}

impl Effort {
    /// For the tables.
    pub const FULL: Self = Self {
        is_quick: false,
        n_points: 2000,
        reference_error: None,
        n_runs: 3,
        repeat_seconds: 120.0,
        limit_seconds: 900,
        gather_rays: 4096,
    };
    /// For the report, which has many runs: none may take so long that the others are never reached.
    pub const REPORT: Self = Self { limit_seconds: 180, ..Self::FULL };
    /// In under three minutes.
    pub const QUICK: Self = Self {
        is_quick: true,
        n_points: 200,
        reference_error: None,
        n_runs: 1,
        repeat_seconds: 0.0,
        limit_seconds: 35,
        gather_rays: 1024,
    };
}

/// All figures of one scene.
#[derive(Debug, Serialize)]
pub struct SceneReport {
    /// Short name.
    pub id: String,
    /// Name in tables.
    pub title: String,
    /// Whether it takes the place of a file that is not there.
    pub is_stand_in: bool,
    /// Whether no ray can leave it, so that one that does has leaked.
    pub is_closed: bool,
    /// Triangles that are lit.
    pub triangles: u64,
    /// Points at which errors are measured.
    pub n_points: usize,
    /// How sure the reference is.
    pub reference: super::answers::StandardError,
    /// One per way of lighting it.
    pub engines: Vec<EngineReport>,
    /// Ways of lighting it that had no result in time.
    pub unfinished: Vec<Unfinished>,
}

/// A way of lighting a scene that had no result when its time was over.
#[derive(Debug, Clone, Serialize)]
pub struct Unfinished {
    /// Short name.
    pub id: &'static str,
    /// Name in tables.
    pub title: &'static str,
    /// On the command line.
    pub flags: String,
    /// Its time.
    pub limit_seconds: u64,
    /// Largest resident memory until then, bytes.
    pub peak_memory: Option<u64>,
}

/// All figures of one way to light a scene.
#[derive(Debug, Serialize)]
pub struct EngineReport {
    /// Short name.
    pub id: &'static str,
    /// Name in tables.
    pub title: &'static str,
    /// On the command line.
    pub flags: String,
    /// Effective values.
    pub settings: SolveSettings,
    /// Points per level, coarsest first.
    pub points_per_level: Vec<u64>,
    /// Seconds from the start of the process to its end, writing and its own error estimate included.
    pub completion: Spread,
    /// Seconds of all stages but writing and the error estimate.
    pub solve: Spread,
    /// Median seconds of the stages.
    pub stages: StageSeconds,
    /// Median seconds on processors, of the whole process, all threads together.
    pub processor_seconds: Option<f64>,
    /// Largest resident memory of the process, bytes.
    pub peak_memory: Option<u64>,
    /// Median seconds of each bounce.
    pub bounces: Vec<f64>,
    /// Bounces, or sweeps.
    pub rounds: String,
    /// Why they ended.
    pub stop: String,
    /// The time limit, where it ended them.
    pub cut_short_after: Option<u64>,
    /// Gathers.
    pub integrals: u64,
    /// Rays.
    pub rays: u64,
    /// Rays over the median time of transport.
    pub rays_per_second: f64,
    /// Rays that left the scene.
    pub escaped: u64,
    /// Hits that nothing answered.
    pub uncovered: u64,
    /// Interpolated.
    pub interpolated: Reading,
    /// Through a final gather; `None` where that took longer than the time limit.
    pub gathered: Option<Reading>,
    /// What the command warned about.
    pub warnings: Vec<String>,
}

/// Irradiance read from a solution.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Reading {
    /// Rays of the final gather; `None`: interpolated.
    pub gather_rays: Option<u32>,
    /// Error over all points.
    pub all: Figures,
    /// Error over those where there is light.
    pub lit: LitError,
    /// Seconds for all points, direct light included.
    pub seconds: f64,
}

/// Seconds by stage.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct StageSeconds {
    /// Reading the scene.
    pub load: f64,
    /// The ray caster.
    pub bvh: f64,
    /// Points and basis; of links the coarsest level alone.
    pub hierarchy: f64,
    /// Direct light.
    pub direct: f64,
    /// Bounces, or links: finer levels, rays and sweeps.
    pub transport: f64,
}

impl StageSeconds {
    fn of(answer: &RunAnswer) -> Self {
        Self {
            load: answer.seconds_of("load"),
            bvh: answer.seconds_of("bvh"),
            hierarchy: answer.seconds_of("points") + answer.seconds_of("basis"),
            direct: answer.seconds_of("lights") + answer.seconds_of("direct light"),
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

/// The runs of one solver.
struct Runs {
    answers: Vec<RunAnswer>,
    processes: Vec<Answer>,
}

impl Bench<'_> {
    /// Measures one scene with every engine.
    ///
    /// # Errors
    /// When a command fails, and when two runs of a solver differ in anything but time.
    pub fn scene(&self, case: &Case, source: &Source, engines: &[&Engine]) -> Result<SceneReport> {
        let truth = self.truth(case, source)?;
        let (mut reports, mut unfinished) = (Vec::new(), Vec::new());
        for engine in engines {
            match self.engine(case, source, engine, &truth).with_context(|| engine.title.to_owned())? {
                Ok(report) => reports.push(report),
                Err(report) => unfinished.push(report),
            }
        }
        Ok(SceneReport {
            id: source.id.clone(),
            title: source.title.clone(),
            is_stand_in: source.is_stand_in,
            is_closed: case.is_closed,
            triangles: truth.triangles,
            n_points: truth.n_points,
            reference: truth.standard_error,
            engines: reports,
            unfinished,
        })
    }

    /// The reference of a scene. Asks for its hash first, which also brings its files into memory.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn truth(&self, case: &Case, source: &Source) -> Result<Truth> {
        let quick = self.effort.is_quick;
        let usual = if quick { case.quick_reference_error } else { case.reference_error };
        let wanted = Wanted {
            n_points: self.effort.n_points,
            error: self.effort.reference_error.unwrap_or(usual),
            most_paths: quick.then_some(case.quick_reference_paths),
        };
        let hash = truth::scene_hash(self.hplt, source)?;
        truth::find_or_trace(self.hplt, self.folder, source, &hash, &wanted)
    }

    /// A reference that takes seconds.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn short_truth(&self, source: &Source) -> Result<Truth> {
        let wanted = Wanted { n_points: 200, error: 0.01, most_paths: Some(8192) };
        let hash = truth::scene_hash(self.hplt, source)?;
        truth::find_or_trace(self.hplt, self.folder, source, &hash, &wanted)
    }

    fn engine(
        &self,
        case: &Case,
        source: &Source,
        engine: &Engine,
        truth: &Truth,
    ) -> Result<Result<EngineReport, Unfinished>> {
        let flags = engine.flags(case, self.effort.is_quick);
        let solution = self.file(source, &format!("{}.hplt", engine.id));
        let Runs { answers, processes } = self.solve(source, &flags, &solution)?;
        let unfinished = || Unfinished {
            id: engine.id,
            title: engine.title,
            flags: flags.join(" "),
            limit_seconds: self.effort.limit_seconds,
            peak_memory: processes.iter().filter_map(|p| p.usage.peak_memory).max(),
        };
        let Some(solved) = answers.first() else { return Ok(Err(unfinished())) };
        let read = |gather| self.read(source, truth, (&solution, engine.id), &flags, gather);
        let Some(interpolated) = read(None)? else { return Ok(Err(unfinished())) };
        let gathered = read(Some(self.effort.gather_rays))?;
        let stages = median_stages(&answers);
        let processor: Vec<f64> = processes.iter().filter_map(|p| p.usage.processor_seconds).collect();
        let seconds = |of: &dyn Fn(&RunAnswer) -> f64| Spread::of(&answers.iter().map(of).collect::<Vec<_>>());
        Ok(Ok(EngineReport {
            id: engine.id,
            title: engine.title,
            flags: flags.join(" "),
            settings: solved.settings.solve.clone(),
            points_per_level: solved.levels.iter().map(|l| l.points).collect(),
            completion: Spread::of(&processes.iter().map(|p| p.wall_seconds).collect::<Vec<_>>()),
            solve: seconds(&|a| StageSeconds::of(a).total()),
            stages,
            processor_seconds: (!processor.is_empty()).then(|| median(&processor)),
            peak_memory: processes.iter().filter_map(|p| p.usage.peak_memory).max(),
            bounces: (0..solved.bounces.len()).map(|i| seconds(&|a| a.bounces[i].seconds).median).collect(),
            rounds: solved.rounds(),
            stop: solved.stop.clone(),
            cut_short_after: solved.is_cut_short().then_some(self.effort.limit_seconds),
            integrals: solved.integrals(),
            rays: solved.rays(),
            rays_per_second: if stages.transport > 0.0 { solved.rays() as f64 / stages.transport } else { 0.0 },
            escaped: solved.bounces.iter().map(|b| b.escaped).sum(),
            uncovered: solved.bounces.iter().map(|b| b.uncovered).sum(),
            interpolated,
            gathered,
            warnings: solved.warnings.clone(),
        }))
    }

    /// Solves as often as there is time for, at least once. Without an answer where the first had no result in time.
    fn solve(&self, source: &Source, flags: &[String], solution: &Path) -> Result<Runs> {
        let mut command = strings(&["solve", &source.argument, "--force", "--output"]);
        command.extend([shown(solution), "--max-time".into(), format!("{}s", self.effort.limit_seconds)]);
        command.extend_from_slice(flags);
        let mut runs = Runs { answers: Vec::new(), processes: Vec::new() };
        let mut spent = 0.0;
        while runs.answers.is_empty() || (runs.answers.len() < self.effort.n_runs && spent < self.effort.repeat_seconds)
        {
            let process = self.hplt.ask(&command, Some(NOT_CONVERGED))?;
            if process.document["error"]["code"] == "TIME_LIMIT" {
                runs.processes.push(process);
                return Ok(runs);
            }
            let answer = RunAnswer::parse(&process.document)?;
            spent += process.wall_seconds;
            let is_cut_short = answer.is_cut_short();
            runs.answers.push(answer);
            runs.processes.push(process);
            if is_cut_short {
                // What it got done depends on the clock: nothing to compare, and too long to do again.
                return Ok(runs);
            }
        }
        check_repeatable(&source.title, &runs.answers)?;
        Ok(runs)
    }

    /// Errors of the irradiance read from a solution, and the seconds that reading took; `None` beyond the time limit.
    fn read(
        &self,
        source: &Source,
        truth: &Truth,
        (solution, engine): (&Path, &str),
        flags: &[String],
        gather_rays: Option<u32>,
    ) -> Result<Option<Reading>> {
        let how = if gather_rays.is_some() { "gathered" } else { "interpolated" };
        let out = self.file(source, &format!("{engine}-{how}.csv"));
        let mut command = strings(&["points", &source.argument, "--force", "--solution"]);
        command.push(shown(solution));
        command.extend(["--at".into(), shown(&truth.points), "--out".into(), shown(&out)]);
        command.extend(["--max-time".into(), format!("{}s", self.effort.limit_seconds)]);
        command.extend(gather_rays.into_iter().flat_map(|n| ["--final-gather".into(), n.to_string()]));
        command.extend_from_slice(flags);
        let answer = self.hplt.ask(&command, Some(NOT_CONVERGED))?;
        if answer.document["error"]["code"] == "TIME_LIMIT" {
            return Ok(None);
        }
        let read = RunAnswer::parse(&answer.document)?;
        // The report of a solution that was itself cut short says so too.
        if read.is_cut_short() && answer.wall_seconds >= self.effort.limit_seconds as f64 {
            return Ok(None);
        }
        let seconds = read.seconds_of("direct light of points") + read.seconds_of("indirect light of points");
        let (all, lit) = compare(self.hplt, &out, truth)?;
        Ok(Some(Reading { gather_rays, all, lit, seconds }))
    }

    fn file(&self, source: &Source, name: &str) -> PathBuf {
        self.folder.join(format!("{}-{name}", source.id))
    }
}

/// Errors of a table against the reference.
///
/// # Errors
/// When the two do not belong together.
pub fn compare(hplt: &Hplt, table: &Path, truth: &Truth) -> Result<(Figures, LitError)> {
    let compared = hplt.ask_briefly(&["compare".into(), shown(table), shown(&truth.table)])?;
    Ok((Figures::parse(&compared.document)?, LitError::of_files(table, &truth.table)?))
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
