//! `hplt relight`

use std::path::Path;

use hplt_geom::{PointHierarchy, Progress, Rgb};
use hplt_io::{Limits, SectionData, SolutionFile, linear_from_srgb, read_solution, write_solution};
use hplt_transport::{GroupLight, Relighting, Relit, SolveOptions, SolveReport, SolveStop, System, weighted_sum};
use serde_json::{Value, json};

use crate::args::RelightArgs;
use crate::estimate::available_threads;
use crate::exit::{Exit, Failure};
use crate::kept::Kept;
use crate::outputs::{check_outputs, to_stdout};
use crate::progress::{Reporter, listen_for_signals, say};
use crate::sections::ProgressMode;
use crate::session::Ended;
use crate::solution::{check_version, flat, number, read_hierarchy};
use crate::values::{human_bytes, human_count, human_percent};

/// What a group of lights is multiplied by.
#[derive(Debug, Clone, PartialEq)]
pub struct LightChange {
    group: String,
    factor: Rgb,
}

impl LightChange {
    /// `group=factor`, `group=r,g,b`, `group=#rgb` or `group=#rrggbb`. The last `=` counts: names may hold some.
    ///
    /// # Errors
    /// In words, when the text has another form, or a factor is negative or not finite.
    pub fn parse(text: &str) -> Result<Self, String> {
        const FORM: &str = "GROUP=FACTOR, GROUP=R,G,B (finite numbers of 0 or more) or GROUP=#RRGGBB";
        let bad = || format!("\"{text}\"; expected {FORM}");
        let (group, value) = text.rsplit_once('=').ok_or_else(bad)?;
        let factor = match value.trim().strip_prefix('#') {
            Some(digits) => colour(digits),
            None => numbers(value),
        };
        let factor = factor.filter(|f| f.is_finite() && f.min_element() >= 0.0).ok_or_else(bad)?;
        match group.trim() {
            "" => Err(bad()),
            group => Ok(Self { group: group.to_owned(), factor }),
        }
    }
}

/// One number for all channels, or three.
fn numbers(text: &str) -> Option<Rgb> {
    let numbers: Option<Vec<f32>> = text.split(',').map(|x| x.trim().parse().ok()).collect();
    match numbers?[..] {
        [all] => Some(Rgb::splat(all)),
        [r, g, b] => Some(Rgb::new(r, g, b)),
        _ => None,
    }
}

fn colour(digits: &str) -> Option<Rgb> {
    let code = |text: &str| u8::from_str_radix(text, 16).ok();
    if !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
        return None;
    }
    let codes = match digits.len() {
        3 => [0, 1, 2].map(|i| code(&digits[i..=i]).map(|c| 17 * c)),
        6 => [0, 2, 4].map(|i| code(&digits[i..i + 2])),
        _ => return None,
    };
    let [r, g, b] = codes.map(|c| c.map(linear_from_srgb));
    Some(Rgb::new(r?, g?, b?))
}

/// Changes the lights of a kept solution.
///
/// # Errors
/// With what stopped it.
pub fn run(args: &RelightArgs) -> Result<Ended, Failure> {
    if args.threads == Some(0) {
        return Err(Failure::usage("--threads 0; expected 1 or more"));
    }
    let outputs: Vec<&Path> = args.output.iter().map(|p| p.as_path()).collect();
    check_outputs(&outputs, &[&args.solution], args.output_flags.force)?;
    listen_for_signals();
    let reporter = Reporter::start(ProgressMode::Auto, args.output_flags.quiet, None);
    let threads = args.threads.unwrap_or_else(available_threads);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Failure::new(Exit::Memory, "THREADS", format!("{threads} threads cannot be started: {e}")))?;
    let ended = pool.install(|| work(args, &reporter));
    reporter.finish();
    ended
}

/// A solution that can be relit, as its file holds it.
struct Base {
    file: SolutionFile,
    hierarchy: PointHierarchy,
    kept: Kept,
    tolerance: f32,
}

/// Seconds of the parts of the work.
#[derive(Default)]
struct Seconds {
    read: f64,
    prepare: f64,
    solve: f64,
    write: f64,
}

fn work(args: &RelightArgs, reporter: &Reporter) -> Result<Ended, Failure> {
    let mut seconds = Seconds::default();
    let base = timed(reporter, &mut seconds.read, || read(&args.solution))?;
    if args.list {
        return list(args, &base);
    }
    let factors = factors(&args.set, &base.kept.groups)?;
    let Base { file, hierarchy, mut kept, tolerance } = base;
    if args.from_scratch {
        if kept.links.is_none() {
            return Err(Failure::usage("--from-scratch needs links; this solution keeps none"));
        }
        kept.groups.iter_mut().for_each(|group| group.solved = None);
    }
    let solve = SolveOptions { tolerance: args.tolerance.map_or(tolerance, |t| t.0 as f32), ..SolveOptions::default() };
    let names: Vec<String> = kept.groups.iter().map(|g| g.name.clone()).collect();
    let n_links = kept.links.as_ref().map_or(0, |l| l.n_entries());
    let relit = relight(kept, &hierarchy, (&factors, &solve), reporter, &mut seconds)?;
    let outcome = Outcome::of(&relit, &solve);
    let new = relit_file(file, &hierarchy, &relit, &factors, &outcome);
    if let Some(path) = &args.output {
        timed(reporter, &mut seconds.write, || write_solution(path, &new))?;
    }
    let n = hierarchy.n_points();
    if !args.output_flags.quiet {
        print(args, &relit, (n, n_links), &outcome, &seconds);
    }
    let groups = names.iter().zip(&factors).map(|(name, f)| json!({ "name": name, "factor": f.to_array() }));
    let report = json!({
        "command": "relight", "version": env!("CARGO_PKG_VERSION"),
        "solution": hplt_io::sanitized(&args.solution.to_string_lossy()),
        "light_groups": groups.collect::<Vec<Value>>(),
        "functions": n, "links": n_links, "tolerance": solve.tolerance,
        "method": outcome.method(), "sweeps": relit.solve.as_ref().map_or(0, |s| s.sweeps),
        "residuals": relit.solve.as_ref().map(|s| s.residual_history.clone()),
        "bound": relit.bound, "converged": outcome.is_converged, "stop": outcome.stop,
        "seconds": {
            "read": seconds.read, "prepare": seconds.prepare, "solve": seconds.solve, "write": seconds.write,
        },
        "outputs": args.output.iter().map(|p| hplt_io::sanitized(&p.to_string_lossy())).collect::<Vec<_>>(),
    });
    Ok(Ended { exit: outcome.exit, report })
}

fn timed<T>(reporter: &Reporter, seconds: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = reporter.now();
    let result = work();
    *seconds += reporter.now() - start;
    result
}

fn read(path: &Path) -> Result<Base, Failure> {
    let shown = hplt_io::sanitized(&path.to_string_lossy());
    let refuse = |what: String| Failure::new(Exit::Solution, "SOLUTION_MISMATCH", format!("{shown}: {what}"));
    let mut file = read_solution(path, &Limits::default())?;
    check_version(&file).map_err(&refuse)?;
    if file.value("hplt.light_factor0").is_some() {
        let what = "its lights are changed already; relight the solution of hplt solve that it was made of";
        return Err(refuse(what.into()));
    }
    let (hierarchy, _) = read_hierarchy(&file, &refuse)?;
    let kept = Kept::take_from(&mut file, &hierarchy, &refuse)?;
    if kept.groups.is_empty() {
        let what = "keeps no light by group; solve again with --keep-links or --all-groups";
        return Err(Failure::new(Exit::Solution, "SOLUTION_NOT_KEPT", format!("{shown}: {what}")));
    }
    if kept.links.is_none() && kept.groups.iter().any(|g| g.solved.is_none()) {
        return Err(refuse("has neither links nor a solution of every group of lights".into()));
    }
    let tolerance: f32 = number(&file, "hplt.solve_tolerance").map_err(&refuse)?;
    if !(tolerance >= 0.0 && tolerance.is_finite()) {
        return Err(refuse(format!("hplt.solve_tolerance is {tolerance}; expected a finite number of 0 or more")));
    }
    Ok(Base { file, hierarchy, kept, tolerance })
}

/// One factor per group: 1 unless it is set.
fn factors(set: &[LightChange], groups: &[GroupLight]) -> Result<Vec<Rgb>, Failure> {
    let mut factors = vec![Rgb::ONE; groups.len()];
    for (i, change) in set.iter().enumerate() {
        let name = hplt_io::sanitized(&change.group);
        if set[..i].iter().any(|other| other.group == change.group) {
            return Err(Failure::usage(format!("--set {name}: given twice")));
        }
        let mut is_known = false;
        for (_, factor) in groups.iter().zip(&mut factors).filter(|(group, _)| group.name == change.group) {
            (*factor, is_known) = (change.factor, true);
        }
        if !is_known {
            let known: Vec<String> = groups.iter().map(|g| format!("\"{}\"", hplt_io::sanitized(&g.name))).collect();
            let message = format!("--set {name}: no such group of lights; expected one of {}", known.join(", "));
            return Err(Failure::usage(message));
        }
    }
    Ok(factors)
}

/// By a solve where there are links, else as a weighted sum.
fn relight(
    kept: Kept,
    hierarchy: &PointHierarchy,
    (factors, solve): (&[Rgb], &SolveOptions),
    reporter: &Reporter,
    seconds: &mut Seconds,
) -> Result<Relit, Failure> {
    let system = System::of(hierarchy);
    let Kept { links, barrier, groups } = kept;
    let Some(links) = links else {
        let sum = timed(reporter, &mut seconds.solve, || weighted_sum(&system, &groups, factors))?;
        return sum.ok_or_else(|| Failure::new(Exit::Bug, "RELIGHT", "a group of lights is not solved"));
    };
    let relighting =
        timed(reporter, &mut seconds.prepare, || Relighting::with_barrier(links, &barrier, system, groups, reporter));
    let relighting = relighting.map_err(|error| match error {
        hplt_transport::Error::Links { .. } => Failure::new(Exit::Solution, "SOLUTION_MISMATCH", error.to_string()),
        other => other.into(),
    })?;
    Ok(timed(reporter, &mut seconds.solve, || relighting.relight(factors, solve, reporter))?)
}

/// How a change of light ended.
struct Outcome {
    exit: Exit,
    is_converged: bool,
    stop: &'static str,
    is_solved: bool,
}

impl Outcome {
    fn of(relit: &Relit, options: &SolveOptions) -> Self {
        let is_dark = relit.bound == 0.0;
        let (exit, is_converged, stop) = match relit.solve.as_ref().map(|s: &SolveReport| s.stop) {
            Some(SolveStop::NoLight) => (Exit::Ok, true, "no-light"),
            None if is_dark => (Exit::Ok, true, "no-light"),
            Some(SolveStop::Converged) => (Exit::Ok, true, "converged"),
            // Rounding and the errors of the groups add up.
            None if relit.bound <= 2.0 * options.tolerance => (Exit::Ok, true, "converged"),
            Some(SolveStop::Interrupted) => (Exit::Interrupted, false, "interrupted"),
            Some(SolveStop::MaxSweeps | SolveStop::Rounding) | None => (Exit::NotConverged, false, "max-bounces"),
        };
        Self { exit, is_converged, stop, is_solved: relit.solve.is_some() }
    }

    fn method(&self) -> &'static str {
        if self.is_solved { "solve" } else { "sum" }
    }
}

/// The file of the relit solution: all of `file` but what it keeps, with the new light.
fn relit_file(
    mut file: SolutionFile,
    hierarchy: &PointHierarchy,
    relit: &Relit,
    factors: &[Rgb],
    outcome: &Outcome,
) -> SolutionFile {
    let dropped = ["hplt.command", "hplt.converged", "hplt.stop", "hplt.truncation_bound", "hplt.error_mean"];
    let is_dropped = |key: &str| {
        dropped.contains(&key) || ["hplt.error_bound", "hplt.error_p95"].contains(&key) || key == "hplt.solve_tolerance"
    };
    file.metadata.retain(|(key, _)| !is_dropped(key));
    let mut push = |key: String, value: String| file.metadata.push((key, value));
    push("hplt.command".into(), "relight".into());
    push("hplt.converged".into(), outcome.is_converged.to_string());
    push("hplt.stop".into(), outcome.stop.into());
    push("hplt.truncation_bound".into(), relit.bound.to_string());
    for (k, factor) in factors.iter().enumerate() {
        push(format!("hplt.light_factor{k}"), factor.to_array().map(|x| x.to_string()).join(","));
    }
    file.sections.retain(|s| s.name.starts_with("level"));
    let mut first = 0;
    for (l, level) in hierarchy.levels.iter().enumerate() {
        let range = first..first + level.points.len();
        first = range.end;
        for (what, light) in [("direct", &relit.direct), ("indirect", &relit.indirect)] {
            let name = format!("level{l}.{what}");
            let data = SectionData::F32(flat(light[range.clone()].iter().copied()));
            file.sections.iter_mut().filter(|s| s.name == name).for_each(|s| s.data = data.clone());
        }
    }
    file
}

fn print(args: &RelightArgs, relit: &Relit, (n, n_links): (usize, usize), outcome: &Outcome, seconds: &Seconds) {
    let text = match &relit.solve {
        Some(solve) => format!("{} links, {} sweeps ({})", human_count(n_links as u64), solve.sweeps, outcome.stop),
        None => format!("a weighted sum of solved groups ({})", outcome.stop),
    };
    say(&format!("read      {:<64} {:>7.3} s", format!("{} functions", human_count(n as u64)), seconds.read));
    if seconds.prepare > 0.0 {
        say(&format!("prepare   {:<64} {:>7.3} s", "what depends on the links alone", seconds.prepare));
    }
    say(&format!("solve     {text:<64} {:>7.3} s", seconds.solve));
    let bound = if relit.bound.is_finite() { human_percent(relit.bound.into()) } else { "without bound".into() };
    say(&format!("error     bounces left out: {bound} at most"));
    if let Some(path) = &args.output {
        let shown = hplt_io::sanitized(&path.to_string_lossy());
        say(&format!("wrote     {shown:<64} {:>7.3} s", seconds.write));
    }
}

fn list(args: &RelightArgs, base: &Base) -> Result<Ended, Failure> {
    let rows = base.kept.groups.iter().map(|g| json!({ "name": g.name, "is_solved": g.solved.is_some() }));
    let (links, groups) = (base.kept.bytes_of_links(), base.kept.bytes_of_groups());
    let report = json!({
        "command": "relight", "version": env!("CARGO_PKG_VERSION"),
        "light_groups": rows.collect::<Vec<Value>>(), "has_links": base.kept.links.is_some(),
        "functions": base.hierarchy.n_points(), "links_bytes": links, "groups_bytes": groups,
    });
    if !args.output_flags.json {
        to_stdout(|out| {
            for group in &base.kept.groups {
                writeln!(out, "{}", hplt_io::sanitized(&group.name))?;
            }
            Ok(())
        })?;
        if args.output_flags.verbose {
            say(&format!("links {}, light by group {}", human_bytes(links), human_bytes(groups)));
        }
    }
    Ok(Ended::ok(report))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_read_from_flags() {
        let parse = |text: &str| LightChange::parse(text).unwrap();
        assert_eq!(parse("sun=3"), LightChange { group: "sun".into(), factor: Rgb::splat(3.0) });
        assert_eq!(parse("a=b = 0,0.5, 2"), LightChange { group: "a=b".into(), factor: Rgb::new(0.0, 0.5, 2.0) });
        assert_eq!(parse("x=#fff").factor, Rgb::ONE);
        assert_eq!(parse("x=#ff0000").factor, Rgb::X);
        assert!((parse("x=#bcBC00").factor - Rgb::new(0.502_886_5, 0.502_886_5, 0.0)).length() < 1e-6);
        for text in
            ["", "sun", "=1", "sun=", "sun=-1", "sun=nan", "sun=inf", "sun=1,2", "sun=#12", "sun=#ggg", "sun=1e40"]
        {
            assert!(LightChange::parse(text).is_err(), "{text}");
        }
    }
}
