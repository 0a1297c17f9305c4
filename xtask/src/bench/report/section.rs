//! A section of the report: curves, what they are drawn over, and the same data as rows.

use serde::{Deserialize, Serialize};

use super::super::answers::StandardError;
use super::super::cells::{count, figures, percent, signed_percent};
use super::super::curves::{Clock, Curve};
use super::super::entry::Entry;
use super::super::machine::Machine;
use super::super::plot::{Axis, Figure, Line};

/// One question and its answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// Names it in links and files.
    pub id: String,
    /// Where it stands among the others.
    pub rank: [usize; 2],
    /// Above it.
    pub title: String,
    /// What is measured and how to read it.
    pub note: String,
    /// On what, when.
    pub machine: Machine,
    /// What [`Entry::value`] is.
    pub varies: Option<String>,
    /// What is drawn.
    pub plots: Vec<Plot>,
    /// How sure the reference is, where there is one.
    pub reference: Option<StandardError>,
    /// The answers.
    pub curves: Vec<Curve>,
    /// What is missing, and why.
    pub remarks: Vec<String>,
}

/// What is drawn over what.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Plot {
    /// To the right.
    pub x: Quantity,
    /// Upwards.
    pub y: Quantity,
}

/// A number of an entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// What the section varies.
    Value,
    /// Time of the clock that was asked for.
    Time,
    /// Wall-clock time, whatever was asked for.
    WallTime,
    /// Mean error.
    Error,
    /// Mean error where there is light.
    LitError,
    /// Sweeps or bounces.
    Sweeps,
    /// Largest resident memory.
    Memory,
}

/// Mean error over time.
pub const ERROR_OVER_TIME: Plot = Plot { x: Quantity::Time, y: Quantity::Error };
/// Mean error where there is light over time.
pub const LIT_ERROR_OVER_TIME: Plot = Plot { x: Quantity::Time, y: Quantity::LitError };
/// Time over what is varied.
pub const TIME_OVER_VALUE: Plot = Plot { x: Quantity::Value, y: Quantity::Time };
/// Wall-clock time over what is varied, for stages, of which no other is known, and for threads.
pub const WALL_TIME_OVER_VALUE: Plot = Plot { x: Quantity::Value, y: Quantity::WallTime };
/// Mean error over what is varied.
pub const ERROR_OVER_VALUE: Plot = Plot { x: Quantity::Value, y: Quantity::Error };

impl Section {
    /// The pictures, without those that would be empty.
    pub fn figures(&self, clock: Clock) -> Vec<Figure> {
        let figures = self.plots.iter().map(|plot| self.figure(*plot, clock));
        figures.filter(|figure| figure.lines.iter().any(|line| !line.points.is_empty())).collect()
    }

    fn figure(&self, plot: Plot, clock: Clock) -> Figure {
        let at = |entry: &Entry| Some((plot.x.of(entry, clock)?, plot.y.of(entry, clock)?));
        let line = |c: &Curve| Line { title: c.title.clone(), points: c.points.iter().filter_map(at).collect() };
        let floor = self.reference.filter(|r| plot.y.is_error() && r.mean > 0.0);
        let lines = self.curves.iter().map(line);
        Figure {
            title: self.title.clone(),
            x: self.axis(plot.x, clock),
            y: self.axis(plot.y, clock),
            // A line that this picture does not show would be a riddle in its legend.
            lines: lines.filter(|line| !line.points.is_empty()).collect(),
            floor: floor.map(|r| (r.mean, ["standard error", "of the reference"].as_slice())),
        }
    }

    fn axis(&self, quantity: Quantity, clock: Clock) -> Axis {
        let title = match quantity {
            Quantity::Value => self.varies.as_deref().unwrap_or_default(),
            Quantity::Time => clock.axis(),
            Quantity::WallTime => "time, s",
            Quantity::Error => "mean relative error of total irradiance",
            Quantity::LitError => "mean relative error where there is light",
            Quantity::Sweeps => "sweeps or bounces",
            Quantity::Memory => "peak memory, MB",
        };
        Axis { title: title.into(), is_percent: quantity.is_error() }
    }

    /// The data as a table: names of the columns that hold anything, and the rows.
    pub fn table(&self) -> (Vec<String>, Vec<Vec<String>>) {
        let columns = columns();
        let rows: Vec<(&Curve, &Entry)> = self.rows().collect();
        let is_used = |c: &&Column| rows.iter().any(|(_, entry)| (c.shown)(entry).is_some());
        let used: Vec<&Column> = columns.iter().filter(is_used).collect();
        let name = |c: &&Column| match c.raw_name {
            "value" => self.varies.clone().unwrap_or_else(|| c.name.to_owned()),
            _ => c.name.to_owned(),
        };
        let head = ["method", "setting"].map(str::to_owned).into_iter().chain(used.iter().map(name)).collect();
        let row = |(curve, entry): &(&Curve, &Entry)| {
            let mut cells = vec![curve.title.clone(), format!("`{}`", entry.budget)];
            cells.extend(used.iter().map(|c| (c.shown)(entry).unwrap_or_default()));
            cells
        };
        (head, rows.iter().map(row).collect())
    }

    /// A line of comma-separated values for each entry; see [`csv_head`].
    pub fn csv_rows(&self) -> Vec<Vec<String>> {
        let columns = columns();
        let row = |(curve, entry): (&Curve, &Entry)| {
            let mut cells = vec![self.id.clone(), self.varies.clone().unwrap_or_default()];
            cells.extend([curve.title.clone(), entry.budget.clone()]);
            cells.extend(columns.iter().map(|c| (c.raw)(entry).map(|x| x.to_string()).unwrap_or_default()));
            cells.extend([self.machine.date.clone(), self.machine.commit.clone(), self.machine.cores.to_string()]);
            cells
        };
        self.rows().map(row).collect()
    }

    /// What had not ended within the time limit.
    pub fn left_out(&self) -> Vec<String> {
        let of = |c: &Curve| {
            let first = c.left_out.first()?;
            let more = match c.left_out.len() - 1 {
                0 => String::new(),
                n => format!(", and {n} that would take longer"),
            };
            Some(format!("Not done within the time limit: {}, `{first}`{more}.", c.title))
        };
        self.curves.iter().filter_map(of).collect()
    }

    fn rows(&self) -> impl Iterator<Item = (&Curve, &Entry)> {
        self.curves.iter().flat_map(|curve| curve.points.iter().map(move |entry| (curve, entry)))
    }
}

impl Quantity {
    fn is_error(self) -> bool {
        matches!(self, Self::Error | Self::LitError)
    }

    fn of(self, entry: &Entry, clock: Clock) -> Option<f64> {
        match self {
            Self::Value => entry.value,
            Self::Time => Some(clock.of(entry)),
            Self::WallTime => Some(entry.seconds),
            Self::Error => Some(entry.errors?.mean),
            Self::LitError => Some(entry.errors?.lit_mean),
            Self::Sweeps => entry.sweeps.map(|n| n as f64),
            Self::Memory => entry.peak_memory.map(|n| n as f64 / 1e6),
        }
    }
}

/// Names of the columns of [`Section::csv_rows`].
pub fn csv_head() -> Vec<&'static str> {
    let own = columns().map(|c| c.raw_name);
    ["section", "varies", "method", "setting"].into_iter().chain(own).chain(["date", "commit", "cores"]).collect()
}

struct Column {
    name: &'static str,
    shown: fn(&Entry) -> Option<String>,
    raw_name: &'static str,
    raw: fn(&Entry) -> Option<f64>,
}

fn columns() -> [Column; 13] {
    let column = |name, shown, raw_name, raw| Column { name, shown, raw_name, raw };
    [
        column("value", |e| e.value.map(number), "value", |e| e.value),
        column("time", |e| Some(brief(e.seconds)), "seconds", |e| Some(e.seconds)),
        column("processor time", |e| e.processor_seconds.map(brief), "processor_seconds", |e| e.processor_seconds),
        column("runs", |e| Some(e.runs.to_string()), "runs", |e| Some(e.runs as f64)),
        column("mean error", |e| e.errors.map(|x| percent(x.mean)), "mean_error", |e| Some(e.errors?.mean)),
        column("median", |e| e.errors.map(|x| percent(x.median)), "median_error", |e| Some(e.errors?.median)),
        column("p95", |e| e.errors.map(|x| percent(x.p95)), "p95_error", |e| Some(e.errors?.p95)),
        column(
            "mean where lit",
            |e| e.errors.map(|x| percent(x.lit_mean)),
            "lit_mean_error",
            |e| Some(e.errors?.lit_mean),
        ),
        column("bias", |e| e.errors.map(|x| signed_percent(x.bias)), "bias", |e| Some(e.errors?.bias)),
        column("functions", |e| e.functions.map(count), "functions", |e| e.functions.map(|n| n as f64)),
        column("rays", |e| e.rays.map(count), "rays", |e| e.rays.map(|n| n as f64)),
        column("sweeps", |e| e.sweeps.map(|n| n.to_string()), "sweeps", |e| e.sweeps.map(|n| n as f64)),
        column(
            "peak memory",
            |e| e.peak_memory.map(|n| format!("{} MB", figures(n as f64 / 1e6))),
            "peak_memory_bytes",
            |e| e.peak_memory.map(|n| n as f64),
        ),
    ]
}

/// `12.3 s`, `0.15 s`, `41.0 ms`
fn brief(seconds: f64) -> String {
    match seconds {
        s if s >= 0.0995 => format!("{} s", figures(s)),
        s => format!("{} ms", figures(1e3 * s)),
    }
}

/// `36`, `17.2k`, `1.05M`, `2.5`
fn number(value: f64) -> String {
    match value.fract().abs() < 1e-6 && value < 1e15 {
        true => count(value as u64),
        false => figures(value),
    }
}

#[cfg(test)]
pub mod tests {
    use super::super::super::entry::tests::entry;
    use super::*;

    /// Two curves over a number, of which one has an entry without an error.
    pub fn section() -> Section {
        let at = |value: f64, seconds, mean| Entry { value: Some(value), ..entry(seconds, mean) };
        let curve = |title: &str, points| Curve { points, ..Curve::empty(title, &["points".into()]) };
        let mut slow = curve("path tracer", vec![Entry { errors: None, ..at(36.0, 3.0, 0.0) }]);
        slow.left_out = ["--levels 8", "--levels 9"].map(str::to_owned).into();
        Section {
            id: "triangles".into(),
            rank: [3, 0],
            title: "Triangles & time".into(),
            note: "Time by triangles.".into(),
            machine: Machine::look(),
            varies: Some("triangles".into()),
            plots: vec![TIME_OVER_VALUE, ERROR_OVER_VALUE],
            reference: Some(StandardError { mean: 0.002, max: 0.01, target: 0.003, points_above_target: 3 }),
            curves: vec![curve("links", vec![at(36.0, 0.5, 0.02), at(1e6, 8.0, 0.004)]), slow],
            remarks: vec!["Radiance is absent".into()],
        }
    }

    #[test]
    fn pictures_show_lines_that_have_the_quantity_and_no_others() {
        let figures = section().figures(Clock::Wall);
        let titles = |i: usize| figures[i].lines.iter().map(|l| l.title.as_str()).collect::<Vec<_>>();
        assert_eq!((titles(0), titles(1)), (vec!["links", "path tracer"], vec!["links"]));
        assert_eq!(figures[0].lines[0].points, [(36.0, 0.5), (1e6, 8.0)]);
        assert!(figures[0].floor.is_none() && figures[1].floor.is_some());
        assert_eq!((figures[0].x.title.as_str(), figures[1].y.is_percent), ("triangles", true));
    }

    #[test]
    fn tables_leave_out_empty_columns_and_have_a_row_for_every_entry() {
        let (head, rows) = section().table();
        assert!(head.contains(&"triangles".into()) && !head.contains(&"peak memory".into()), "{head:?}");
        assert!(rows.len() == 3 && rows.iter().all(|r| r.len() == head.len()));
        assert_eq!(rows[1][2], "1.00M");
        let csv = section().csv_rows();
        assert!(csv.len() == 3 && csv.iter().all(|r| r.len() == csv_head().len()));
    }

    #[test]
    fn short_times_keep_their_figures() {
        assert_eq!([12.34, 0.15, 0.041, 0.00005].map(brief), ["12.3 s", "0.15 s", "41.0 ms", "0.05 ms"]);
        assert_eq!([36.0, 1e6, 2.5].map(number), ["36", "1.00M", "2.50"]);
    }

    #[test]
    fn what_was_left_out_is_said_once_for_each_curve() {
        let said = section().left_out();
        assert_eq!(said.len(), 1);
        assert!(said[0].contains("path tracer, `--levels 8`, and 1 that would take longer"), "{}", said[0]);
    }
}
