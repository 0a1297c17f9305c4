//! Error and run time on the standard scenes.

mod answers;
mod axis;
mod baseline;
mod beside;
mod cells;
mod child;
mod curves;
mod engines;
mod entry;
mod evidence;
mod lit;
mod machine;
mod measure;
mod methods;
mod plot;
mod published;
mod report;
mod scenes;
mod sheet;
mod stats;
mod table;
mod truth;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::shell::root;
use child::Hplt;
use curves::Clock;
use engines::{ENGINES, Engine};
use evidence::MAX_PAIRS;
use machine::Machine;
use measure::{Bench, Effort};
use published::Published;
use report::{Part, Peers, Plan};
use scenes::{CASES, Case, Source};
use table::{Report, Start};

/// What to measure.
#[derive(clap::Args)]
pub struct Options {
    /// Fewer points, coarser settings, a looser reference, one run: under three minutes on two free cores.
    #[arg(long)]
    quick: bool,
    /// Only these scenes; may be repeated.
    #[arg(long, value_name = "SCENE", value_parser = CASES.map(|case| case.id))]
    only: Vec<String>,
    /// Only these ways of lighting them; may be repeated.
    #[arg(long, value_name = "ENGINE", value_parser = ENGINES.map(|engine| engine.id))]
    engine: Vec<String>,
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
    /// Runs of every solver [default: 3; quick: 1]. No further one begins once they have taken two minutes.
    #[arg(long, value_name = "N")]
    runs: Option<usize>,
    /// Seconds after which one run is cut short [default: 900; report: 180; quick: 35].
    #[arg(long, value_name = "SECONDS")]
    limit: Option<u64>,
    /// Draw error against time instead of printing the tables: every variant and the path tracer at five budgets or more.
    #[arg(long, conflicts_with_all = ["baseline", "engine", "runs"])]
    curves: bool,
    /// Write the error-time report instead of printing the tables: curves as above, what each part of a method is worth, and how time
    /// grows with triangles, levels, receivers, albedo and threads: `target/bench/error-time.html`, `.json`, `.csv` and `.md`.
    #[arg(long, conflicts_with_all = ["baseline", "curves", "engine", "runs"])]
    report: bool,
    /// Only these parts of the report; may be repeated. The others stay as the last report has them, and so do scenes that --only leaves
    /// out.
    #[arg(long, value_enum, value_name = "PART", requires = "report")]
    part: Vec<Part>,
    /// Measure the part `peers` too: Mitsuba 3 and Radiance beside ours, where this Python interpreter has their wheels (mitsuba,
    /// pyradiance); see benches/peers [default: python3].
    #[arg(long, value_name = "PYTHON", num_args = 0..=1, default_missing_value = "python3", requires = "report")]
    peers: Option<PathBuf>,
    /// Time in the pictures of curves and report.
    #[arg(long, value_enum, default_value = "wall")]
    clock: Clock,
    /// Compare with this binary instead of printing the tables: both run in turns, and a regression of time or error is a failure.
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
    /// Pairs of runs beside the baseline [default: 8, the fewest that can prove anything].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(8..=MAX_PAIRS as i64), requires = "baseline")]
    pairs: Option<u8>,
    /// Measure this binary instead of building one.
    #[arg(long, value_name = "FILE")]
    binary: Option<PathBuf>,
}

/// Measures, prints the tables, and writes them to `target/bench/report.md`, `report.json` and `report.csv`.
///
/// # Errors
/// When something does not build, run or write, and when a binary is worse than its baseline.
pub fn run(options: &Options) -> Result<()> {
    let effort = options.effort()?;
    let machine = Machine::look();
    let mut warnings: Vec<String> = machine.warning().into_iter().collect();
    let hplt = match &options.binary {
        Some(path) => {
            warnings.push("a given binary was measured, which may be of another commit".into());
            Hplt::found(path)?
        }
        None => Hplt::build()?,
    };
    let folder = root().join("target").join("bench");
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let bench = Bench { hplt: &hplt, folder: &folder, effort };
    let scenes_folder = scenes::folder(options.scenes.as_deref());
    let cases: Vec<(&Case, Source)> =
        options.cases().into_iter().map(|case| (case, case.source(&scenes_folder))).collect();
    if options.part.contains(&Part::Peers) && options.peers.is_none() {
        bail!("--part peers; expected --peers beside it, with the interpreter that has their wheels");
    }
    if options.report {
        return report::measure(&Plan {
            bench: &bench,
            cases: &cases,
            parts: &options.part,
            keeps_others: !(options.part.is_empty() && options.only.is_empty()),
            clock: options.clock,
            peers: options.peers.as_deref().map(Peers::of),
            mode: format!("{}, {} points", options.mode(), bench.effort.n_points),
        });
    }
    if options.curves {
        return draw_curves(&bench, &cases, options.clock);
    }
    match &options.baseline {
        Some(old) => compare(&bench, &Hplt::found(old)?, &cases, usize::from(options.pairs.unwrap_or(8))),
        None => tables(&bench, &cases, options, (machine, warnings)),
    }
}

fn compare(bench: &Bench<'_>, old: &Hplt, cases: &[(&Case, Source)], n_pairs: usize) -> Result<()> {
    let (text, findings) = baseline::findings(bench, old, cases, n_pairs)?;
    println!("{text}");
    write(bench.folder, "baseline.md", &text)?;
    write(bench.folder, "baseline.json", &format!("{}\n", serde_json::to_string_pretty(&findings)?))?;
    baseline::check(&findings)
}

fn draw_curves(bench: &Bench<'_>, cases: &[(&Case, Source)], clock: Clock) -> Result<()> {
    let mut scenes = Vec::new();
    for (case, source) in cases {
        scenes.push(curves::measure(bench, case, source).with_context(|| format!("cannot measure {}", case.title))?);
        // After every scene, since each takes minutes.
        curves::write(bench.folder, &scenes, clock)?;
    }
    let text = curves::write(bench.folder, &scenes, clock)?;
    println!("{text}");
    write(bench.folder, "curves.md", &text)
}

fn tables(
    bench: &Bench<'_>,
    cases: &[(&Case, Source)],
    options: &Options,
    (machine, warnings): (Machine, Vec<String>),
) -> Result<()> {
    let published: Vec<_> = cases.iter().map(|(case, _)| case.published).collect();
    let start = Start::now();
    let mut report = Report { machine, mode: options.mode(), total: start.total(), scenes: Vec::new(), warnings };
    for (case, source) in cases {
        let scene = bench
            .scene(case, source, &options.engines(case))
            .with_context(|| format!("cannot measure {}", case.title))?;
        for engine in &scene.engines {
            report.warnings.extend(engine.warnings.iter().map(|w| format!("{}, {}: {w}", scene.title, engine.title)));
        }
        report.scenes.push(scene);
        report.total = start.total();
        // After every scene, since each may take many minutes.
        write_tables(bench.folder, &report, &published)?;
    }
    println!("{}", report.markdown(&published));
    Ok(())
}

fn write_tables(folder: &Path, report: &Report, published: &[&Published]) -> Result<()> {
    write(folder, "report.md", &report.markdown(published))?;
    write(folder, "report.json", &format!("{}\n", serde_json::to_string_pretty(report)?))?;
    write(folder, "report.csv", &report.csv())
}

fn write(folder: &Path, name: &str, content: &str) -> Result<()> {
    let path = folder.join(name);
    std::fs::write(&path, content).with_context(|| format!("cannot write {}", path.display()))?;
    eprintln!("wrote {}", path.display());
    Ok(())
}

impl Options {
    fn effort(&self) -> Result<Effort> {
        if let Some(error) = self.reference_error.filter(|e| !(*e > 0.0 && *e < 1.0)) {
            bail!("--reference-error {error}; expected a fraction between 0 and 1, such as 0.003");
        }
        let usual = match (self.quick, self.report) {
            (true, _) => Effort::QUICK,
            (false, true) => Effort::REPORT,
            (false, false) => Effort::FULL,
        };
        Ok(Effort {
            n_points: self.points.unwrap_or(usual.n_points),
            reference_error: self.reference_error,
            n_runs: self.runs.unwrap_or(usual.n_runs),
            limit_seconds: self.limit.unwrap_or(usual.limit_seconds),
            ..usual
        })
    }

    fn cases(&self) -> Vec<&'static Case> {
        CASES.iter().filter(|case| self.only.is_empty() || self.only.iter().any(|id| id == case.id)).collect()
    }

    /// Those that were asked for, else all that there is time for.
    fn engines(&self, case: &Case) -> Vec<&'static Engine> {
        let is_wanted = |e: &&Engine| match (self.engine.is_empty(), self.quick) {
            (true, quick) => !(quick && case.quick_leaves_out.contains(&e.id)),
            (false, _) => self.engine.iter().any(|id| id == e.id),
        };
        ENGINES.iter().filter(is_wanted).collect()
    }

    fn mode(&self) -> String {
        match (self.quick, self.report) {
            (true, false) => "quick: few points, coarse settings, a loose reference, V1 on Cornell alone",
            (true, true) => "quick: few points, few budgets, a loose reference",
            (false, _) => "full",
        }
        .into()
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
        assert!(full.n_points == 2000 && full.n_runs == 3 && !full.is_quick);
        assert!(quick.n_points < full.n_points && quick.n_runs == 1 && quick.is_quick);
        assert!(CASES.iter().all(|case| case.quick_reference_error > case.reference_error));
        let mixed = effort(&["--quick", "--points", "99", "--runs", "2", "--reference-error", "0.02"]).unwrap();
        assert_eq!((mixed.n_points, mixed.n_runs, mixed.reference_error), (99, 2, Some(0.02)));
    }

    #[test]
    fn quick_runs_leave_out_what_takes_long_unless_it_is_asked_for() {
        let ids = |line: &[&str], case: &Case| -> Vec<&str> {
            let options = Line::try_parse_from(std::iter::once(&"bench").chain(line)).unwrap().options;
            options.engines(case).iter().map(|e| e.id).collect()
        };
        let [cornell, _, sponza] = &CASES;
        assert_eq!(ids(&[], sponza).len(), ENGINES.len());
        assert_eq!(ids(&["--quick"], cornell).len(), ENGINES.len());
        assert!(!ids(&["--quick"], sponza).contains(&"v1"));
        assert_eq!(ids(&["--quick", "--engine", "v1"], sponza), ["v1"]);
    }

    #[test]
    fn parts_and_peers_belong_to_the_report() {
        let parse = |line: &[&str]| Line::try_parse_from(std::iter::once(&"bench").chain(line));
        assert!(parse(&["--part", "levels"]).is_err() && parse(&["--peers"]).is_err());
        assert!(parse(&["--report", "--curves"]).is_err() && parse(&["--report", "--part", "teapots"]).is_err());
        let options = parse(&["--report", "--part", "levels", "--part", "links", "--peers"]).unwrap().options;
        assert_eq!(options.part, [Part::Levels, Part::Links]);
        assert_eq!(options.peers.as_deref(), Some(Path::new("python3")));
        assert!(options.effort().unwrap().limit_seconds < effort(&[]).unwrap().limit_seconds);
    }

    #[test]
    fn unknown_scenes_and_errors_out_of_range_are_refused() {
        assert!(effort(&["--only", "castle"]).is_err());
        assert!(effort(&["--only", "sponza", "--only", "cornell", "--engine", "v3"]).is_ok());
        assert!(effort(&["--engine", "v9"]).is_err());
        for error in ["0", "1", "nan"] {
            assert!(effort(&["--reference-error", error]).is_err(), "{error}");
        }
    }
}
