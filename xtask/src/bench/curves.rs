//! Error against time: every variant at several budgets, and the path tracer at the same points.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use super::answers::StandardError;
use super::cells::{csv, figures, percent, signed_percent, table};
use super::entry::{Entry, light};
use super::measure::Bench;
use super::methods::{Method, variants};
use super::plot::{Axis, Figure, Line, Paper, svg};
use super::scenes::{Case, Source};
use super::truth::Truth;

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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Name in the legend.
    pub title: String,
    /// The command line of the first budget, without the points and without the table to write.
    #[serde(default)]
    pub command: String,
    /// In the order of their budgets.
    pub points: Vec<Entry>,
    /// Budgets that had not ended within the time limit.
    pub left_out: Vec<String>,
}

/// Measures all curves of a scene.
///
/// # Errors
/// When a command fails.
pub fn measure(bench: &Bench<'_>, case: &Case, source: &Source) -> Result<SceneCurves> {
    let truth = bench.truth(case, source)?;
    let methods = variants(case, source);
    let curves = methods.iter().map(|method| curve(bench, source, method, &truth)).collect::<Result<_>>()?;
    Ok(SceneCurves {
        id: source.id.clone(),
        title: source.title.clone(),
        n_points: truth.n_points,
        reference: truth.standard_error,
        curves,
    })
}

/// Which time the pictures show; the data have both.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// Of the process, from start to end.
    Wall,
    /// Of all its threads on processors: the better one where the machine has other work.
    Processor,
}

impl Clock {
    /// The time of an entry.
    pub fn of(self, entry: &Entry) -> f64 {
        match self {
            Self::Wall => entry.seconds,
            Self::Processor => entry.processor_seconds.unwrap_or(entry.seconds),
        }
    }

    /// What an axis of it is called.
    pub fn axis(self) -> &'static str {
        match self {
            Self::Wall => "time of the whole process, s",
            Self::Processor => "processor time of the whole process, all threads, s",
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
        let title = format!("{}: error against time, {} points", scene.title, scene.n_points);
        let picture = svg(&figure(&title, &scene.curves, clock, &scene.reference), Paper::White)?;
        std::fs::write(&path, picture).with_context(|| format!("cannot write {}", path.display()))?;
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

/// One method at all its budgets. Where one had not ended in time, those that take longer are left out with it.
///
/// # Errors
/// When a command fails.
pub fn curve(bench: &Bench<'_>, source: &Source, method: &Method, truth: &Truth) -> Result<Curve> {
    let mut curve = Curve::empty(&method.title, method.settings.first().map_or(&[], |first| &first.command));
    for setting in &method.settings {
        let measured = match curve.left_out.is_empty() {
            true => light(bench, &source.id, setting.command.clone(), &setting.shown, truth)
                .with_context(|| format!("{}, {}", method.title, setting.shown))?,
            false => None,
        };
        match measured {
            Some(measured) => curve.points.push(Entry { value: setting.value, ..measured.entry }),
            None => curve.left_out.push(setting.shown.clone()),
        }
    }
    Ok(curve)
}

impl Curve {
    /// Of a command of `hplt`, without entries.
    pub fn empty(title: &str, command: &[String]) -> Self {
        let command = if command.is_empty() { String::new() } else { format!("hplt {}", command.join(" ")) };
        Self { title: title.into(), command, points: Vec::new(), left_out: Vec::new() }
    }
}

/// Error against time as a picture.
pub fn figure(title: &str, curves: &[Curve], clock: Clock, reference: &StandardError) -> Figure {
    let points = |curve: &Curve| {
        let of = |entry: &Entry| Some((clock.of(entry), entry.errors?.mean));
        Line { title: curve.title.clone(), points: curve.points.iter().filter_map(of).collect() }
    };
    Figure {
        title: title.into(),
        x: Axis { title: clock.axis().into(), is_percent: false },
        y: Axis { title: "mean relative error of total irradiance".into(), is_percent: true },
        lines: curves.iter().map(points).collect(),
        floor: Some((reference.mean, &["standard error", "of the reference"])),
    }
}

const HEAD: [&str; 9] =
    ["scene", "method", "budget", "time", "processor time", "mean error", "median", "mean where lit", "bias"];
const NOTE: &str = "Time is that of the whole process, from reading the scene to the written table, without the solver's own error estimate. All \
methods light the same points; ours read their solution by a final gather. The error of the reference is in all figures.";

fn row(scene: &SceneCurves, curve: &Curve, point: &Entry) -> Vec<String> {
    let seconds = |s: f64| format!("{} s", figures(s));
    let mut cells = vec![scene.title.clone(), curve.title.clone(), format!("`{}`", point.budget)];
    cells.push(format!(
        "{}{}",
        seconds(point.seconds),
        if point.runs > 1 { format!(" ({} runs)", point.runs) } else { String::new() }
    ));
    cells.push(point.processor_seconds.map_or("unknown".into(), seconds));
    match point.errors {
        Some(e) => cells.extend([percent(e.mean), percent(e.median), percent(e.lit_mean), signed_percent(e.bias)]),
        None => cells.extend([const { String::new() }; 4]),
    }
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

fn csv_row(scene: &SceneCurves, curve: &Curve, point: &Entry) -> Vec<String> {
    let mut cells = vec![scene.id.clone(), scene.n_points.to_string(), scene.reference.mean.to_string()];
    cells.extend([curve.title.clone(), point.budget.clone(), point.seconds.to_string()]);
    cells.push(point.processor_seconds.map(|s| s.to_string()).unwrap_or_default());
    cells.push(point.runs.to_string());
    let errors = point.errors.map(|e| [e.mean, e.median, e.p95, e.lit_mean, e.bias].map(|x| x.to_string()));
    cells.extend(errors.unwrap_or_default());
    cells
}

fn rows(scenes: &[SceneCurves], of: fn(&SceneCurves, &Curve, &Entry) -> Vec<String>) -> Vec<Vec<String>> {
    let curves = scenes.iter().flat_map(|s| s.curves.iter().map(move |c| (s, c)));
    curves.flat_map(|(s, c)| c.points.iter().map(move |p| of(s, c, p))).collect()
}

#[cfg(test)]
pub mod tests {
    use super::super::entry::tests::entry;
    use super::*;

    /// Two methods at two budgets.
    pub fn scene() -> SceneCurves {
        let curve = |title: &str, points| Curve {
            points,
            left_out: vec!["--levels 9".into()],
            ..Curve::empty(title, &["points".into()])
        };
        SceneCurves {
            id: "cornell".into(),
            title: "Cornell & co".into(),
            n_points: 2000,
            reference: StandardError { mean: 0.002, max: 0.01, target: 0.003, points_above_target: 3 },
            curves: vec![
                curve("links", vec![entry(0.5, 0.02), entry(8.0, 0.004)]),
                curve("path tracer", vec![entry(1.0, 0.08), entry(30.0, 0.01)]),
            ],
        }
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
