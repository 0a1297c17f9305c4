//! The report as Markdown.

use std::fmt::Write;

use serde::Serialize;

use super::machine::Machine;
use super::measure::{GATHER_RAYS, Measured, Row, median};
use super::scenes::Published;

/// Everything that is printed.
#[derive(Debug, Serialize)]
pub struct Report {
    /// On what.
    pub machine: Machine,
    /// How the command was called, in words.
    pub mode: String,
    /// One per scene.
    pub rows: Vec<Row>,
    /// What is doubtful.
    pub warnings: Vec<String>,
}

impl Report {
    /// The document, with the published figures of each row's counterpart.
    pub fn markdown(&self, published: &[&Published]) -> String {
        let mut out = String::from("# Error and run time\n\n");
        let m = &self.machine;
        let _ = writeln!(out, "{} on {} cores ({}), commit {}, {}.", m.date, m.cores, m.cpu, m.commit, self.mode);
        for warning in &self.warnings {
            let _ = write!(out, "\n**Warning:** {warning}.\n");
        }
        let _ = write!(
            out,
            "\n## Error of total irradiance, `--preset production` (links)\n\n{}\n{ERROR_NOTE}\n",
            table(&ERROR_HEAD, &self.error_rows())
        );
        let columns = |first: &str| -> Vec<String> {
            std::iter::once(first.to_owned()).chain(self.rows.iter().map(|r| r.title.clone())).collect()
        };
        let stages = table(&columns(""), &transposed(&self.rows.iter().map(production_column).collect::<Vec<_>>()));
        let _ = write!(out, "\n## The solve, stage by stage\n\n{stages}\n{STAGE_NOTE}\n");
        if self.rows.iter().any(|r| r.slides.is_some()) {
            let slides = table(&SLIDES_HEAD, &self.slides_rows(published));
            let _ = write!(out, "\n## The original variant, `--preset slides` (V1)\n\n{slides}\n{SLIDES_NOTE}\n");
        }
        out
    }

    fn error_rows(&self) -> Vec<Vec<String>> {
        let of = |row: &Row| {
            let p = &row.production;
            let solve = median(&p.runs);
            let line = |how: String, measured: &Measured, reading: f64| {
                let (e, lit) = (&measured.all, &measured.lit);
                let mut cells = vec![row.title.clone(), how];
                cells.extend([e.mean, e.median, e.p95, e.rms].map(percent));
                cells.push(format!("{:+.2} %", 100.0 * e.bias));
                cells.push(percent(lit.mean));
                cells.push(format!("{} ({} at most)", percent(row.reference.mean), percent(row.reference.max)));
                cells.push(format!("{} ({} dark)", row.n_points, lit.n_dark));
                cells.push(format!("{} + {}", seconds(solve), seconds(reading)));
                cells
            };
            [
                line("interpolated".into(), &p.interpolated, p.interpolation_seconds),
                line(format!("gathered, {GATHER_RAYS} rays"), &p.gathered, p.gather_seconds),
            ]
        };
        self.rows.iter().flat_map(of).collect()
    }

    fn slides_rows(&self, published: &[&Published]) -> Vec<Vec<String>> {
        let mut rows = Vec::new();
        for (row, published) in self.rows.iter().zip(published) {
            let Some(s) = &row.slides else { continue };
            let bounces: Vec<String> = s.bounces.iter().map(|b| figures(*b)).collect();
            rows.push(vec![
                format!("{}, our run", row.title),
                count(row.triangles),
                functions(row),
                format!("{} s", bounces.join(" / ")),
                count(s.integrals),
                seconds(s.transport),
                format!("{} mean, {:+.2} % bias", percent(s.interpolated.all.mean), 100.0 * s.interpolated.all.bias),
            ]);
            rows.push(vec![
                format!("{}, published 2010", published.scene),
                published.triangles.into(),
                published.functions.into(),
                published.bounces.into(),
                published.integrals.into(),
                published.transport.into(),
                "not published".into(),
            ]);
        }
        rows
    }
}

const ERROR_HEAD: [&str; 11] = [
    "scene",
    "read",
    "mean",
    "median",
    "p95",
    "rms",
    "bias",
    "mean where lit",
    "reference SE, mean",
    "points",
    "solve + reading",
];
const ERROR_NOTE: &str = "Relative error of the luminance of total irradiance at random reachable points, corners \
included, against the path tracer, whose own error is in these figures (SE: standard error); the floor is 1 % of the mean. \
Points below the floor are called dark; hardly any light gets there, and an error there says little. \
Reading is the time for all points, direct light included.";
const STAGE_NOTE: &str = "Times are medians; the solve counts all stages but writing the solution and the error estimate. \
Rays \
per second are over the time of transport. Processor time is that of all threads, writing and the error estimate included; it \
hardly depends on what else the machine does. Memory is the largest resident set of the solver.";
const SLIDES_HEAD: [&str; 7] =
    ["scene", "triangles", "functions L0 / L5", "bounces 1 / 2 / 3", "integrals", "transport", "error, interpolated"];
const SLIDES_NOTE: &str = "Three bounces, delta encoding, 1024 rays per gather. The published rows are those of the slides \
of 2010 and no timing that we reproduce: their machine, their rays per gather and their error were not published, and their \
meshes and emitters differ from ours, so that the same absolute threshold does not mean the same work.";

/// Label and value of every figure of a solve.
fn production_column(row: &Row) -> Vec<(&'static str, String)> {
    let p = &row.production;
    let s = &p.stages;
    let spread = |runs: &[f64]| {
        let [least, most] =
            [runs.iter().copied().fold(f64::INFINITY, f64::min), runs.iter().copied().fold(0.0, f64::max)];
        match runs.len() {
            0 | 1 => format!("{} (one run)", seconds(median(runs))),
            n => format!("{} ({} to {}, {n} runs)", seconds(median(runs)), figures(least), seconds(most)),
        }
    };
    let best = p.interpolated.all.mean.min(p.gathered.all.mean);
    vec![
        ("triangles", count(row.triangles)),
        ("points L0 / finest", functions(row)),
        ("load", seconds(s.load)),
        ("BVH", seconds(s.bvh)),
        ("hierarchy", seconds(s.hierarchy)),
        ("direct light", seconds(s.direct)),
        ("transport", seconds(s.transport)),
        ("solve", spread(&p.runs)),
        ("processor time, all in", p.processor_seconds.map_or("unknown".into(), seconds)),
        ("mean error: interpolated / best", format!("{} / {}", percent(p.interpolated.all.mean), percent(best))),
        ("bounces, or sweeps", format!("{} ({})", p.rounds, p.stop)),
        ("integrals", count(p.integrals)),
        ("rays", count(p.rays)),
        ("rays per second", count(p.rays_per_second as u64)),
        ("rays escaped", count(p.escaped)),
        ("hits uncovered", count(p.uncovered)),
        ("peak memory", p.peak_memory.map_or("unknown".into(), |b| format!("{} MB", b / 1_000_000))),
    ]
}

/// From labelled columns to rows that start with their label.
fn transposed(columns: &[Vec<(&'static str, String)>]) -> Vec<Vec<String>> {
    let n = columns.first().map_or(0, Vec::len);
    let row = |i: usize| {
        let values = columns.iter().map(|c| c[i].1.clone());
        std::iter::once(columns[0][i].0.to_owned()).chain(values).collect()
    };
    (0..n).map(row).collect()
}

fn functions(row: &Row) -> String {
    let of = |n: Option<&u64>| n.map_or("0".into(), |&n| count(n));
    format!("{} / {}", of(row.points_per_level.first()), of(row.points_per_level.last()))
}

/// A Markdown table whose columns line up in plain text too.
fn table(head: &[impl AsRef<str>], rows: &[Vec<String>]) -> String {
    let width = |i: usize| {
        let cells = rows.iter().filter_map(|r| r.get(i)).map(|c| c.chars().count());
        cells.chain([head[i].as_ref().chars().count(), 3]).max().unwrap_or(3)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let line = |cells: Vec<&str>| {
        let padded = cells.iter().zip(&widths).map(|(cell, &w)| format!("{cell:<w$}"));
        format!("| {} |\n", padded.collect::<Vec<_>>().join(" | "))
    };
    let rule: Vec<String> = widths.iter().map(|&w| "-".repeat(w)).collect();
    let mut out = line(head.iter().map(AsRef::as_ref).collect());
    out.push_str(&line(rule.iter().map(String::as_str).collect()));
    rows.iter().for_each(|row| out.push_str(&line(row.iter().map(String::as_str).collect())));
    out
}

fn percent(fraction: f64) -> String {
    format!("{:.2} %", 100.0 * fraction)
}

fn seconds(value: f64) -> String {
    format!("{} s", figures(value))
}

/// Two or three figures.
fn figures(value: f64) -> String {
    match value {
        v if v >= 99.5 => format!("{v:.0}"),
        v if v >= 9.95 => format!("{v:.1}"),
        v => format!("{v:.2}"),
    }
}

/// `36`, `17.2k`, `1.05M`
fn count(n: u64) -> String {
    match n {
        0..=9_999 => n.to_string(),
        10_000..=99_949 => format!("{:.1}k", n as f64 / 1e3),
        99_950..=999_499 => format!("{:.0}k", n as f64 / 1e3),
        _ => format!("{:.2}M", n as f64 / 1e6),
    }
}

#[cfg(test)]
mod tests {
    use super::super::answers::{Figures, StandardError};
    use super::super::lit::LitError;
    use super::super::measure::{Production, Slides, StageSeconds};
    use super::super::scenes::CASES;
    use super::*;

    fn figures_of(mean: f64) -> Measured {
        let lit = LitError { mean: 0.9 * mean, n_lit: 1900, n_dark: 100 };
        let all =
            Figures { mean, median: 0.8 * mean, p95: 3.0 * mean, rms: 1.5 * mean, max: 9.0 * mean, bias: -0.1 * mean };
        Measured { all, lit }
    }

    fn row(title: &str, with_slides: bool) -> Row {
        Row {
            title: title.into(),
            scene: "gen:cornell".into(),
            is_stand_in: false,
            triangles: 36,
            points_per_level: vec![218, 900, 167_000],
            n_points: 2000,
            reference: StandardError { mean: 0.0022, max: 0.003, target: 0.003, points_above_target: 0 },
            production: Production {
                interpolated: figures_of(0.0123),
                gathered: figures_of(0.0045),
                runs: vec![8.5, 7.5, 9.5],
                stages: StageSeconds { transport: 4.0, ..StageSeconds::default() },
                interpolation_seconds: 0.25,
                gather_seconds: 3.0,
                rounds: "7 bounces".into(),
                stop: "converged".into(),
                integrals: 12_345,
                rays: 3_000_000,
                rays_per_second: 750_000.0,
                escaped: 11,
                uncovered: 2,
                peak_memory: Some(123_456_789),
                processor_seconds: Some(15.5),
            },
            slides: with_slides.then(|| Slides {
                interpolated: figures_of(0.02),
                threshold: "0.016".into(),
                bounces: vec![12.0, 2.5, 1.25],
                transport: 15.75,
                integrals: 13_000,
            }),
            warnings: vec![],
        }
    }

    fn report(rows: Vec<Row>) -> Report {
        Report { machine: Machine::look(), mode: "quick".into(), rows, warnings: vec!["the sky fell".into()] }
    }

    #[test]
    fn every_table_has_as_many_cells_in_each_row_as_in_its_head() {
        let report = report(vec![row("Cornell", true), row("Other", false)]);
        let text = report.markdown(&[&CASES[0].published, &CASES[1].published]);
        let mut n_tables = 0;
        for block in text.split("\n\n").filter(|b| b.starts_with("| ")) {
            let bars: Vec<usize> =
                block.lines().filter(|l| l.starts_with('|')).map(|l| l.matches('|').count()).collect();
            assert!(bars.len() > 2 && bars.iter().all(|&n| n == bars[0]), "{block}");
            n_tables += 1;
        }
        assert_eq!(n_tables, 3);
    }

    #[test]
    fn no_time_stands_without_its_error() {
        let text = report(vec![row("Cornell", true)]).markdown(&[&CASES[0].published]);
        let line =
            |needle: &str| text.lines().find(|l| l.contains(needle)).unwrap_or_else(|| panic!("{needle}\n{text}"));
        let interpolated = line("interpolated ");
        assert!(interpolated.contains("1.23 %") && interpolated.contains("8.50 s + 0.25 s"), "{interpolated}");
        let gathered = line("gathered, 4096 rays");
        assert!(
            gathered.contains("0.45 %")
                && gathered.contains("-0.04 %")
                && gathered.contains("0.22 %")
                && gathered.contains("0.40 %")
                && gathered.contains("2000 (100 dark)"),
            "{gathered}"
        );
        assert!(line("our run").contains("15.8 s") && line("our run").contains("2.00 % mean"));
        assert!(text.contains("8.50 s (7.50 to 9.50 s, 3 runs)") && text.contains("1.23 % / 0.45 %"));
    }

    #[test]
    fn published_figures_are_called_so_and_only_stand_beside_ours() {
        let text = report(vec![row("Cornell", true)]).markdown(&[&CASES[0].published]);
        assert!(text.lines().any(|l| l.contains("published 2010") && l.contains("21 / 2.9 / 2.4 s")));
        let without = report(vec![row("Cornell", false)]).markdown(&[&CASES[0].published]);
        assert!(!without.contains("2010"));
        assert!(text.contains("**Warning:** the sky fell."));
    }

    #[test]
    fn counts_and_seconds_are_short() {
        assert_eq!([36, 17_234, 262_269, 1_050_000].map(count), ["36", "17.2k", "262k", "1.05M"]);
        assert_eq!([0.456, 12.34, 743.2].map(seconds), ["0.46 s", "12.3 s", "743 s"]);
    }
}
