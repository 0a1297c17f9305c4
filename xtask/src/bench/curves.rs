//! Error against time: every variant at several budgets, and the path tracer at the same points.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;

use super::answers::{RunAnswer, StandardError};
use super::cells::{csv, figures, percent, signed_percent, table};
use super::child::{Answer, NOT_CONVERGED};
use super::engines::{ENGINES, Engine};
use super::measure::{Bench, compare, shown, strings};
use super::plot;
use super::scenes::{Case, Source};
use super::stats::median;
use super::truth::Truth;

/// A path tracer with as many paths per point as given.
const PATHS: [u32; 5] = [256, 512, 1024, 2048, 4096];
/// Its seed: another than that of the reference, whose own noise it would share.
const PATHS_SEED: &str = "1";
/// A budget is run again while all its runs took less than this, seconds, and at most three times.
const REPEAT_SECONDS: f64 = 4.0;

/// Levels, rays per gather, rays of the final gather.
type Budget = [u32; 3];

const LINKS: [Budget; 6] = [[1, 32, 64], [2, 64, 64], [3, 128, 128], [3, 128, 512], [4, 128, 1024], [5, 256, 4096]];
const V1: [Budget; 5] = [[1, 32, 64], [2, 32, 128], [2, 64, 256], [3, 128, 512], [4, 256, 1024]];
const V3: [Budget; 5] = [[1, 32, 64], [2, 64, 128], [3, 128, 256], [4, 128, 512], [5, 256, 1024]];
/// Where the functions of a level are many.
const V1_LARGE: [Budget; 5] = [[1, 8, 64], [1, 16, 128], [1, 32, 256], [1, 64, 512], [2, 32, 1024]];
const V3_LARGE: [Budget; 5] = [[1, 16, 64], [1, 64, 128], [2, 64, 256], [2, 128, 512], [3, 256, 1024]];

/// All curves of one scene.
#[derive(Debug, Serialize)]
pub struct SceneCurves {
    /// Short name.
    pub id: String,
    /// Name in the picture.
    pub title: String,
    /// Points that are lit in each run.
    pub n_points: usize,
    /// How sure the reference is.
    pub reference: StandardError,
    /// One per method.
    pub curves: Vec<Curve>,
}

/// One method at several budgets.
#[derive(Debug, Serialize)]
pub struct Curve {
    /// Name in the legend.
    pub title: String,
    /// In the order of their budgets.
    pub points: Vec<CurvePoint>,
    /// Budgets that had not ended within the time limit.
    pub left_out: Vec<String>,
}

/// One budget.
#[derive(Debug, Clone, Serialize)]
pub struct CurvePoint {
    /// The flags that differ.
    pub budget: String,
    /// Median seconds from the start of the process to its end, without the solver's own error estimate.
    pub seconds: f64,
    /// Median seconds on processors, all threads together, less the share that the error estimate has of the wall-clock time.
    pub processor_seconds: Option<f64>,
    /// Runs.
    pub runs: usize,
    /// Mean relative error.
    pub mean: f64,
    /// Median relative error.
    pub median: f64,
    /// Its 95th percentile.
    pub p95: f64,
    /// Mean where there is light.
    pub lit_mean: f64,
    /// Relative error of the sum.
    pub bias: f64,
}

/// Measures all curves of a scene.
///
/// # Errors
/// When a command fails.
pub fn measure(bench: &Bench<'_>, case: &Case, source: &Source) -> Result<SceneCurves> {
    let truth = bench.truth(case, source)?;
    let mut curves = Vec::new();
    for engine in ENGINES.iter().filter(|e| e.id != "preview") {
        curves.push(engine_curve(bench, (case, source), engine, &truth)?);
    }
    curves.push(path_tracer_curve(bench, source, &truth)?);
    Ok(SceneCurves {
        id: source.id.clone(),
        title: source.title.clone(),
        n_points: truth.n_points,
        reference: truth.standard_error,
        curves,
    })
}

/// Which time the pictures show; the data have both.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Clock {
    /// Of the process, from start to end.
    Wall,
    /// Of all its threads on processors: the better one where the machine has other work.
    Processor,
}

impl Clock {
    /// The time of a point.
    pub fn of(self, point: &CurvePoint) -> f64 {
        match self {
            Self::Wall => point.seconds,
            Self::Processor => point.processor_seconds.unwrap_or(point.seconds),
        }
    }
}

/// Writes the pictures and the data of all scenes, and returns them as a table.
///
/// # Errors
/// When a file cannot be written.
pub fn write(folder: &Path, scenes: &[SceneCurves], clock: Clock) -> Result<String> {
    for scene in scenes {
        let path = folder.join(format!("curve-{}.svg", scene.id));
        plot::write(&path, scene, clock).with_context(|| format!("cannot draw {}", path.display()))?;
    }
    std::fs::write(folder.join("curves.json"), format!("{}\n", serde_json::to_string_pretty(scenes)?))?;
    std::fs::write(folder.join("curves.csv"), csv(&CSV_HEAD, &rows(scenes, csv_row)))?;
    let mut text = format!("# Error against time\n\n{}\n{NOTE}\n", table(&HEAD, &rows(scenes, row)));
    for (scene, curve) in scenes.iter().flat_map(|s| s.curves.iter().map(move |c| (s, c))) {
        for budget in &curve.left_out {
            let _ = write!(
                text,
                "\nLeft out, not done within the time limit: {}, {}, {budget}.\n",
                scene.title, curve.title
            );
        }
    }
    Ok(text)
}

fn engine_curve(bench: &Bench<'_>, (case, source): (&Case, &Source), engine: &Engine, truth: &Truth) -> Result<Curve> {
    let mut curve = Curve { title: engine.title.into(), points: Vec::new(), left_out: Vec::new() };
    for [levels, rays, gather_rays] in budgets(engine, case) {
        let [levels, rays, gather_rays] = [levels, rays, gather_rays].map(|n| n.to_string());
        let budget = ["--levels", &levels, "--rays", &rays];
        let mut command = strings(&["points", &source.argument, "--final-gather", &gather_rays]);
        command.extend(engine.flags_at(case, &budget));
        let shown = format!("{} --final-gather {gather_rays}", budget.join(" "));
        match run(bench, source, command, &shown, truth)? {
            Some(point) => curve.points.push(point),
            None => curve.left_out.push(shown),
        }
    }
    curve.title = engine.title.split(", production").next().unwrap_or_default().into();
    Ok(curve)
}

fn budgets(engine: &Engine, case: &Case) -> Vec<Budget> {
    let budgets: &[Budget] = match (engine.id, case.has_many_functions) {
        ("v1", false) => &V1,
        ("v1", true) => &V1_LARGE,
        ("v3", false) => &V3,
        ("v3", true) => &V3_LARGE,
        _ => &LINKS,
    };
    budgets.to_vec()
}

fn path_tracer_curve(bench: &Bench<'_>, source: &Source, truth: &Truth) -> Result<Curve> {
    let mut curve = Curve { title: "path tracer".into(), points: Vec::new(), left_out: Vec::new() };
    for paths in PATHS {
        let budget = format!("--paths {paths}");
        // An error that no number of paths reaches, so that all of them are traced.
        let mut command = strings(&["reference", &source.argument, "--seed", PATHS_SEED, "--error", "1e-9"]);
        command.extend(["--paths".into(), paths.to_string()]);
        match run(bench, source, command, &budget, truth)? {
            Some(point) => curve.points.push(point),
            None => curve.left_out.push(budget),
        }
    }
    Ok(curve)
}

/// Runs a command that writes the light at the points; `None` where it was cut short.
fn run(
    bench: &Bench<'_>,
    source: &Source,
    mut command: Vec<String>,
    budget: &str,
    truth: &Truth,
) -> Result<Option<CurvePoint>> {
    let out = bench.folder.join(format!("{}-curve.csv", source.id));
    command.extend(strings(&["--force", "--at"]));
    command.extend([shown(&truth.points), "--out".into(), shown(&out)]);
    command.extend(["--max-time".into(), format!("{}s", bench.effort.limit_seconds)]);
    let (mut seconds, mut processor) = (Vec::new(), Vec::new());
    while seconds.is_empty() || (seconds.len() < 3 && seconds.iter().sum::<f64>() < REPEAT_SECONDS) {
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
    }
    let (all, lit) = compare(bench.hplt, &out, truth)?;
    Ok(Some(CurvePoint {
        budget: budget.into(),
        seconds: median(&seconds),
        processor_seconds: (!processor.is_empty()).then(|| median(&processor)),
        runs: seconds.len(),
        mean: all.mean,
        median: all.median,
        p95: all.p95,
        lit_mean: lit.mean,
        bias: all.bias,
    }))
}

/// The part of the whole process that is not the error estimate, which no other method here makes.
fn lighting_share(process: &Answer, answer: &RunAnswer) -> f64 {
    (1.0 - answer.seconds_of("error estimate") / process.wall_seconds).clamp(0.0, 1.0)
}

const HEAD: [&str; 9] =
    ["scene", "method", "budget", "time", "processor time", "mean error", "median", "mean where lit", "bias"];
const NOTE: &str = "Time is that of the whole process, from reading the scene to the written table, without the solver's own error estimate. All \
methods light the same points; ours read their solution by a final gather. The error of the reference is in all figures.";

fn row(scene: &SceneCurves, curve: &Curve, point: &CurvePoint) -> Vec<String> {
    let seconds = |s: f64| format!("{} s", figures(s));
    let mut cells = vec![scene.title.clone(), curve.title.clone(), format!("`{}`", point.budget)];
    cells.push(format!(
        "{}{}",
        seconds(point.seconds),
        if point.runs > 1 { format!(" ({} runs)", point.runs) } else { String::new() }
    ));
    cells.push(point.processor_seconds.map_or("unknown".into(), seconds));
    cells.extend([point.mean, point.median, point.lit_mean].map(percent));
    cells.push(signed_percent(point.bias));
    cells
}

const CSV_HEAD: [&str; 13] = [
    "scene",
    "points",
    "reference_se_mean",
    "method",
    "budget",
    "seconds",
    "processor_seconds",
    "runs",
    "mean_error",
    "median_error",
    "p95_error",
    "lit_mean_error",
    "bias",
];

fn csv_row(scene: &SceneCurves, curve: &Curve, point: &CurvePoint) -> Vec<String> {
    let mut cells = vec![scene.id.clone(), scene.n_points.to_string(), scene.reference.mean.to_string()];
    cells.extend([curve.title.clone(), point.budget.clone(), point.seconds.to_string()]);
    cells.push(point.processor_seconds.map(|s| s.to_string()).unwrap_or_default());
    cells.push(point.runs.to_string());
    cells.extend([point.mean, point.median, point.p95, point.lit_mean, point.bias].map(|x| x.to_string()));
    cells
}

fn rows(scenes: &[SceneCurves], of: fn(&SceneCurves, &Curve, &CurvePoint) -> Vec<String>) -> Vec<Vec<String>> {
    let curves = scenes.iter().flat_map(|s| s.curves.iter().map(move |c| (s, c)));
    curves.flat_map(|(s, c)| c.points.iter().map(move |p| of(s, c, p))).collect()
}

#[cfg(test)]
pub mod tests {
    use super::super::scenes::CASES;
    use super::*;

    /// Two methods at two budgets.
    pub fn scene() -> SceneCurves {
        let point = |seconds, mean| CurvePoint {
            budget: "--levels 2".into(),
            seconds,
            processor_seconds: None,
            runs: 1,
            mean,
            median: mean,
            p95: mean,
            lit_mean: mean,
            bias: 0.0,
        };
        let curve = |title: &str, points| Curve { title: title.into(), points, left_out: vec!["--levels 9".into()] };
        SceneCurves {
            id: "cornell".into(),
            title: "Cornell & co".into(),
            n_points: 2000,
            reference: StandardError { mean: 0.002, max: 0.01, target: 0.003, points_above_target: 3 },
            curves: vec![
                curve("links", vec![point(0.5, 0.02), point(8.0, 0.004)]),
                curve("path tracer", vec![point(1.0, 0.08), point(30.0, 0.01)]),
            ],
        }
    }

    #[test]
    fn every_method_has_five_budgets_or_more_and_each_does_more_than_the_last() {
        for (engine, case) in ENGINES.iter().flat_map(|e| CASES.iter().map(move |c| (e, c))) {
            let budgets = budgets(engine, case);
            assert!(budgets.len() >= 5);
            for pair in budgets.windows(2) {
                assert!((0..3).any(|i| pair[1][i] > pair[0][i]) && pair[1][2] >= pair[0][2], "{pair:?}");
            }
        }
        assert!(PATHS.len() >= 5);
    }

    #[test]
    fn tables_and_data_have_a_line_for_every_budget() {
        let folder = std::env::temp_dir().join(format!("hplt-curves-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let text = write(&folder, &[scene()], Clock::Wall).unwrap();
        let csv = std::fs::read_to_string(folder.join("curves.csv")).unwrap();
        let json = std::fs::read_to_string(folder.join("curves.json")).unwrap();
        let svg = std::fs::read_to_string(folder.join("curve-cornell.svg")).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!((csv.lines().count(), text.matches("`--levels 2`").count()), (5, 4));
        assert!(csv.lines().all(|l| l.matches(',').count() == CSV_HEAD.len() - 1), "{csv}");
        assert!(text.contains("not done within the time limit: Cornell & co, links, --levels 9"));
        assert!(json.contains("\"seconds\": 30.0") && svg.starts_with("<svg"));
    }
}
