//! How time and error grow: with triangles, levels, receivers, albedo and threads.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result};

use super::super::answers::{RunAnswer, StandardError};
use super::super::child::NOT_CONVERGED;
use super::super::curves::{Curve, curve};
use super::super::engines::{ENGINES, Engine};
use super::super::entry::{Entry, Measured, light, run};
use super::super::measure::{Bench, shown, strings};
use super::super::methods::{Method, Setting, path_tracer, variants};
use super::super::scenes::{Case, Source};
use super::super::truth::Truth;
use super::section::{
    ERROR_OVER_TIME, ERROR_OVER_VALUE, Plot, Quantity, Section, TIME_OVER_VALUE, WALL_TIME_OVER_VALUE,
};
use super::{Part, Plan};

const TRIANGLES: [u32; 5] = [1_000, 10_000, 100_000, 1_000_000, 10_000_000];
const LEVELS: [u32; 6] = [1, 2, 3, 4, 5, 6];
const RECEIVERS: [u32; 4] = [1_000, 10_000, 100_000, 1_000_000];
/// More than that is not traced: a path tracer pays for every point.
const MOST_TRACED: u32 = 100_000;
const ALBEDOS: [f64; 7] = [0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.999];
const MOST_BOUNCES: &str = "1000000";

/// Time by triangles: the Cornell box, then a statue in a closed room.
pub fn triangles(plan: &Plan<'_>) -> Result<Section> {
    const NOTE: &str = "The Cornell box (36), then a statue of more and more triangles in a closed room, made and not read from a file. Settings \
        of the preset production; the light at 200 points is interpolated, and its error is that against a short run of the path tracer. The stages are parts of the whole; making the scene and its \
        ray caster grows with triangles, functions and links hardly do.";
    const STAGES: [(&str, &str); 4] = [
        ("load", "making the scene"),
        ("bvh", "ray caster"),
        ("points", "first functions"),
        ("links", "links and solve"),
    ];
    let sizes = if plan.bench.effort.is_quick { &TRIANGLES[..2] } else { &TRIANGLES[..] };
    let made = |name: String, id| Source {
        argument: format!("gen:{name}"),
        id,
        title: name,
        is_stand_in: false,
        has_textures: false,
    };
    let statues = sizes.iter().map(|n| made(format!("statue-room:{n}"), format!("statue-room-{n}")));
    let sources: Vec<Source> = std::iter::once(made("cornell".into(), "cornell".into())).chain(statues).collect();
    let mut section = plan.section(Part::Triangles, None, "Time by triangles", NOTE);
    section.varies = Some("triangles".into());
    section.plots = vec![WALL_TIME_OVER_VALUE, Plot { x: Quantity::Value, y: Quantity::Memory }];
    let mut whole = Curve::empty("whole process", &production(&sources[1].argument, &[]));
    let mut stages = STAGES.map(|(_, title)| Curve::empty(title, &[]));
    for source in &sources {
        let truth = plan.bench.short_truth(source)?;
        let done = if whole.left_out.is_empty() {
            light(plan.bench, &source.id, production(&source.argument, &[]), &source.argument, &truth)?
        } else {
            None
        };
        let Some(Measured { mut entry, answer }) = done else {
            whole.left_out.push(source.argument.clone());
            continue;
        };
        entry.value = Some(answer.triangles as f64);
        for ((stage, _), curve) in STAGES.iter().zip(&mut stages) {
            curve.points.push(stage_of(&entry, answer.seconds_of(stage)));
        }
        whole.points.push(entry);
    }
    section.curves = std::iter::once(whole).chain(stages).collect();
    Ok(section)
}

/// Time and error by levels.
pub fn levels(plan: &Plan<'_>, case: &Case, source: &Source) -> Result<Section> {
    const NOTE: &str = "Levels at most; interpolated, without a final gather, so that the field itself is judged. Links make functions only where \
        there is detail, V3 has them everywhere.";
    let truth = plan.bench.truth(case, source)?;
    let mut section = plan.section(Part::Levels, Some((case, source)), "time and error by levels", NOTE);
    section.varies = Some("levels".into());
    section.reference = Some(truth.standard_error);
    section.plots = vec![TIME_OVER_VALUE, ERROR_OVER_VALUE, ERROR_OVER_TIME];
    let settings = |engine: &Engine| {
        let rays = if case.has_many_functions { "64" } else { "256" };
        let setting = |n: &u32| {
            let mut command = strings(&["points", &source.argument]);
            command.extend(engine.flags_at(case, &["--levels", &n.to_string(), "--rays", rays]));
            Setting { shown: format!("--levels {n} --rays {rays}"), value: Some(f64::from(*n)), command }
        };
        LEVELS.iter().map(setting).collect()
    };
    for engine in ENGINES.iter().filter(|e| ["production", "v3"].contains(&e.id)) {
        let method = Method { title: engine.title.into(), settings: settings(engine) };
        section.curves.push(curve(plan.bench, source, &plan.shortened(method), &truth)?);
    }
    Ok(section)
}

/// Time by points that are read from one kept solution.
pub fn receivers(plan: &Plan<'_>, case: &Case, source: &Source) -> Result<Section> {
    const NOTE: &str = "Points read from one solution of the preset production that was kept in a file; solving is no part of these times. The \
        whole process reads the scene and the solution and writes the table; reading alone is what each further point costs. A path tracer with \
        256 paths a point pays for every point anew. Errors are those at the points of the reference; the other points are \
        as random as they are.";
    let bench = plan.bench;
    let truth = bench.truth(case, source)?;
    let mut section = plan.section(Part::Receivers, Some((case, source)), "time by receivers", NOTE);
    section.varies = Some("receivers".into());
    section.plots = vec![WALL_TIME_OVER_VALUE];
    let kept = bench.folder.join(format!("{}-kept.hplt", source.id));
    let mut solve = strings(&["solve", &source.argument, "--force", "--preset", "production", "--output"]);
    solve.extend([shown(&kept), "--max-time".into(), format!("{}s", bench.effort.limit_seconds)]);
    let solved = bench.hplt.ask(&solve, Some(NOT_CONVERGED))?;
    if solved.document["error"]["code"] == "TIME_LIMIT" || RunAnswer::parse(&solved.document)?.is_cut_short() {
        section.remarks.push("The solution was not done within the time limit: nothing to read.".into());
        return Ok(section);
    }
    let sizes = if bench.effort.is_quick { &RECEIVERS[..2] } else { &RECEIVERS[..] };
    let tables = sizes.iter().map(|n| sample(bench, source, *n)).collect::<Result<Vec<_>>>()?;
    let read = ["--preset", "production", "--solution", &shown(&kept)].map(str::to_owned);
    for (title, gather) in [("interpolated", None), ("gathered, 64 rays", Some("64"))] {
        let mut command = strings(&["points", &source.argument]);
        command.extend(read.iter().cloned().chain(gather.iter().flat_map(|n| strings(&["--final-gather", n]))));
        section.curves.extend(read_all(bench, source, (title, &command), &tables, &truth)?);
    }
    let few: Vec<_> = tables.into_iter().filter(|(n, _)| *n <= MOST_TRACED).collect();
    if let Some(setting) = path_tracer(source).settings.first() {
        let [whole, _] = read_all(bench, source, ("path tracer, 256 paths", &setting.command), &few, &truth)?;
        section.curves.push(whole);
    }
    Ok(section)
}

/// The whole process and reading alone, at the points of the reference and at each table.
fn read_all(
    bench: &Bench<'_>,
    source: &Source,
    (title, command): (&str, &[String]),
    tables: &[(u32, String)],
    truth: &Truth,
) -> Result<[Curve; 2]> {
    let mut whole = Curve::empty(&format!("{title}: whole process"), command);
    let mut alone = Curve::empty(&format!("{title}: reading alone"), &[]);
    let mut put = |n: f64, Measured { mut entry, answer }: Measured| {
        entry.value = Some(n);
        let seconds = ["direct light of points", "indirect light of points"].map(|stage| answer.seconds_of(stage));
        alone.points.push(Entry { errors: entry.errors, ..stage_of(&entry, seconds.iter().sum()) });
        whole.points.push(entry);
    };
    if let Some(measured) = light(bench, &source.id, command.to_vec(), "points of the reference", truth)? {
        put(truth.n_points as f64, measured);
    }
    for (n, table) in tables {
        let mut command = command.to_vec();
        command.extend(strings(&["--force", "--at", table, "--out"]));
        command.push(shown(&bench.folder.join(format!("{}-curve.csv", source.id))));
        let budget = format!("{n} points");
        match if whole.left_out.is_empty() { run(bench, command, &budget)? } else { None } {
            Some(measured) => put(f64::from(*n), measured),
            None => whole.left_out.push(budget),
        }
    }
    for curve in [&mut whole, &mut alone] {
        curve.points.sort_by(|a, b| a.value.unwrap_or(0.0).total_cmp(&b.value.unwrap_or(0.0)));
    }
    Ok([whole, alone])
}

/// A table of `n` random points.
fn sample(bench: &Bench<'_>, source: &Source, n: u32) -> Result<(u32, String)> {
    let table = shown(&bench.folder.join(format!("{}-receivers-{n}.csv", source.id)));
    let command = ["sample-points", &source.argument, "-n", &n.to_string(), "--force", "--output", &table];
    bench.hplt.ask(&strings(&command), None)?;
    Ok((n, table))
}

/// Sweeps and time by albedo, in a closed furnace whose light is known.
pub fn albedo(plan: &Plan<'_>) -> Result<Section> {
    const NOTE: &str = "A closed cube that emits 1 W/m² everywhere: irradiance is 1/(1 - albedo), so that errors are exact. Links solve for all \
        bounces at once (GMRES), the other line is one bounce after the other, rays traced anew for each; two levels both. Both stop when less than 0.1 % of the \
        light is still to come.";
    let bench = plan.bench;
    let mut section = plan.section(Part::Albedo, None, "Sweeps and time by albedo", NOTE);
    section.varies = Some("gain of the furnace, 1/(1 - albedo)".into());
    section.plots = vec![Plot { x: Quantity::Value, y: Quantity::Sweeps }, TIME_OVER_VALUE];
    let scene = shown(&bench.folder.join("white-furnace.glb"));
    bench.hplt.ask_briefly(&strings(&["gen", "white-furnace", "--force", "--output", &scene]))?;
    let points = bench.folder.join("white-furnace.points.csv");
    let sample = ["sample-points", &scene, "--max-albedo", "0.5", "-n", "200", "--force", "--output", &shown(&points)];
    bench.hplt.ask(&strings(&sample), None)?;
    let links = ["--levels", "2"];
    let on_the_fly =
        ["--levels", "2", "--variant", "absolute", "--reconstruction", "nearest", "--bounces", MOST_BOUNCES];
    let methods: [(&str, &[&str]); 2] = [("links, GMRES", &links), ("bounce after bounce, rays anew", &on_the_fly)];
    for (title, flags) in methods {
        let mut curve = Curve::empty(title, &production(&scene, flags));
        for albedo in if bench.effort.is_quick { &ALBEDOS[..3] } else { &ALBEDOS[..] } {
            let truth = furnace(&points, *albedo)?;
            let budget = format!("--max-albedo {albedo}");
            let mut command = production(&scene, flags);
            command.extend(["--max-albedo".into(), albedo.to_string()]);
            let done = curve.left_out.is_empty().then(|| light(bench, "white-furnace", command, &budget, &truth));
            match done.transpose()?.flatten() {
                Some(Measured { entry, .. }) => curve.points.push(Entry { value: Some(1.0 / (1.0 - albedo)), ..entry }),
                None => curve.left_out.push(budget),
            }
        }
        section.curves.push(curve);
    }
    Ok(section)
}

/// The light in the furnace: 1 W/m² of it directly.
fn furnace(points: &Path, albedo: f64) -> Result<Truth> {
    let text = std::fs::read_to_string(points).with_context(|| format!("cannot read {}", points.display()))?;
    let table = points.with_file_name("white-furnace-truth.csv");
    std::fs::write(&table, furnace_table(&text, albedo))?;
    Ok(Truth {
        points: points.into(),
        n_points: text.lines().count().saturating_sub(1),
        table,
        triangles: 12,
        standard_error: StandardError { mean: 0.0, max: 0.0, target: 0.0, points_above_target: 0 },
    })
}

fn furnace_table(points: &str, albedo: f64) -> String {
    let total = 1.0 / (1.0 - albedo);
    let (direct, indirect) = (1.0, total - 1.0);
    let mut table = String::from("x,y,z,nx,ny,nz,Ed_r,Ed_g,Ed_b,Ei_r,Ei_g,Ei_b,E_r,E_g,E_b\n");
    for point in points.lines().skip(1) {
        let cells: Vec<String> = [direct, indirect, total].iter().flat_map(|x| vec![x.to_string(); 3]).collect();
        let _ = writeln!(table, "{point},{}", cells.join(","));
    }
    table
}

/// Time by threads.
pub fn threads(plan: &Plan<'_>, case: &Case, source: &Source) -> Result<Section> {
    const NOTE: &str = "Wall-clock time at one budget of each method; results do not depend on the number of threads.";
    let truth = plan.bench.truth(case, source)?;
    let mut section = plan.section(Part::Threads, Some((case, source)), "time by threads", NOTE);
    section.varies = Some("threads".into());
    section.plots = vec![WALL_TIME_OVER_VALUE];
    let counts = thread_counts(section.machine.cores);
    for method in variants(case, source) {
        // One in the middle: neither start-up alone nor minutes.
        let Some(setting) = plan.shortened(method.clone()).settings.into_iter().take(3).next_back() else { continue };
        let title = format!("{}, {}", method.title, setting.shown);
        let method = Method { title, settings: counts.iter().map(|n| with_threads(&setting, *n)).collect() };
        section.curves.push(curve(plan.bench, source, &method, &truth)?);
    }
    Ok(section)
}

fn with_threads(setting: &Setting, n: usize) -> Setting {
    let mut command = setting.command.clone();
    command.extend(["--threads".into(), n.to_string()]);
    Setting { shown: format!("--threads {n}"), value: Some(n as f64), command }
}

/// Powers of two, and all.
fn thread_counts(cores: usize) -> Vec<usize> {
    let mut counts: Vec<usize> = std::iter::successors(Some(1), |n| Some(2 * n)).take_while(|n| *n < cores).collect();
    counts.push(cores.max(1));
    counts
}

fn production(scene: &str, flags: &[&str]) -> Vec<String> {
    strings(&[&["points", scene, "--preset", "production"], flags].concat())
}

/// A stage of a run.
fn stage_of(entry: &Entry, seconds: f64) -> Entry {
    Entry {
        seconds,
        processor_seconds: None,
        errors: None,
        functions: None,
        rays: None,
        sweeps: None,
        peak_memory: None,
        ..entry.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::entry::tests::entry;
    use super::*;

    #[test]
    fn the_light_of_the_furnace_is_the_geometric_series() {
        let table = furnace_table("x,y,z,nx,ny,nz\n0.5,0,0.5,0,1,0\n", 0.75);
        let rows: Vec<&str> = table.lines().collect();
        assert_eq!(rows[1], "0.5,0,0.5,0,1,0,1,1,1,3,3,3,4,4,4");
        assert_eq!((rows.len(), rows[0].split(',').count()), (2, rows[1].split(',').count()));
    }

    #[test]
    fn threads_end_with_all_cores_and_no_count_comes_twice() {
        assert_eq!(thread_counts(1), [1]);
        assert_eq!(thread_counts(2), [1, 2]);
        assert_eq!(thread_counts(6), [1, 2, 4, 6]);
        assert_eq!(thread_counts(0), [1]);
    }

    #[test]
    fn a_stage_has_its_time_and_nothing_of_the_rest() {
        let whole = Entry { value: Some(36.0), processor_seconds: Some(9.0), ..entry(5.0, 0.02) };
        let stage = stage_of(&whole, 0.5);
        assert_eq!((stage.seconds, stage.value, stage.processor_seconds, stage.errors), (0.5, Some(36.0), None, None));
    }
}
