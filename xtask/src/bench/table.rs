//! The report as Markdown and as comma-separated values.

use std::fmt::{self, Write};
use std::time::Instant;

use serde::Serialize;

use super::beside::{GPU_NOTE, PUBLISHED_HEAD, Pair, gpu_rows, published_note, published_rows};
use super::cells::{count, csv, percent, seconds, signed_percent, spread, table};
use super::child::processor_seconds_of_children;
use super::engines::{ENGINES, Variant};
use super::machine::Machine;
use super::measure::{EngineReport, Reading, SceneReport, Unfinished};
use super::published::Published;
use super::sheet::{CSV_HEAD, csv_row};

/// Everything that is printed.
#[derive(Debug, Serialize)]
pub struct Report {
    /// On what.
    pub machine: Machine,
    /// How the command was called, in words.
    pub mode: String,
    /// What it took so far.
    pub total: Total,
    /// One per scene.
    pub scenes: Vec<SceneReport>,
    /// What is doubtful.
    pub warnings: Vec<String>,
}

/// What all measurements together took, references that had to be made included.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Total {
    /// Wall-clock time.
    pub seconds: f64,
    /// Time on processors, all processes and threads together.
    pub processor_seconds: Option<f64>,
}

/// When measuring began.
#[derive(Debug, Clone, Copy)]
pub struct Start {
    instant: Instant,
    processor_seconds: Option<f64>,
}

impl Start {
    /// Now.
    pub fn now() -> Self {
        Self { instant: Instant::now(), processor_seconds: processor_seconds_of_children() }
    }

    /// Until now.
    pub fn total(&self) -> Total {
        let processor = processor_seconds_of_children().zip(self.processor_seconds);
        Total {
            seconds: self.instant.elapsed().as_secs_f64(),
            processor_seconds: processor.map(|(now, start)| now - start),
        }
    }
}

impl fmt::Display for Total {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} in all", seconds(self.seconds))?;
        self.processor_seconds.map_or(Ok(()), |s| write!(f, ", {} on processors", seconds(s)))
    }
}

impl Report {
    /// The document, with the published figures of each scene's counterpart.
    pub fn markdown(&self, published: &[&Published]) -> String {
        let pairs: Vec<Pair<'_>> = self.scenes.iter().zip(published.iter().copied()).collect();
        let mut out = String::from("# Error and run time\n\n");
        let m = &self.machine;
        let _ = writeln!(out, "{} on {} cores ({}), commit {}, {}.", m.date, m.cores, m.cpu, m.commit, self.mode);
        let _ = writeln!(out, "Measuring took {}.", self.total);
        for warning in &self.warnings {
            let _ = write!(out, "\n**Warning:** {warning}.\n");
        }
        let mut section = |title: &str, head: &[&str], rows: Vec<Vec<String>>, note: &str| {
            if !rows.is_empty() {
                let _ = write!(out, "\n## {title}\n\n{}\n{note}\n", table(head, &rows));
            }
        };
        section("Scenes and parameters", &PARAMETER_HEAD, parameter_rows(&pairs), PARAMETER_NOTE);
        let variants = [(Variant::V1, "The original (V1)"), (Variant::V3, "The optimised variant (V3)")];
        for (variant, title) in variants {
            section(title, &PUBLISHED_HEAD, published_rows(&pairs, variant), &published_note(variant));
        }
        section("On a GPU", &PUBLISHED_HEAD, gpu_rows(&pairs), GPU_NOTE);
        section("Error of total irradiance", &ERROR_HEAD, self.rows(&error_rows), ERROR_NOTE);
        let mut times = self.rows(&|s, e| vec![time_row(s, e)]);
        times.extend(self.scenes.iter().flat_map(|s| s.unfinished.iter().map(|u| unfinished_row(s, u))));
        section("Time and memory", &TIME_HEAD, times, TIME_NOTE);
        section("Rays", &RAY_HEAD, self.rows(&|s, e| vec![ray_row(s, e)]), RAY_NOTE);
        out
    }

    /// All figures, a line for each way of lighting each scene.
    pub fn csv(&self) -> String {
        csv(&CSV_HEAD, &self.rows(&|s, e| vec![csv_row(s, e)]))
    }

    fn rows(&self, of: &dyn Fn(&SceneReport, &EngineReport) -> Vec<Vec<String>>) -> Vec<Vec<String>> {
        self.scenes.iter().flat_map(|scene| scene.engines.iter().flat_map(|engine| of(scene, engine))).collect()
    }
}

const PARAMETER_HEAD: [&str; 8] = [
    "scene",
    "primitives",
    "variant",
    "levels",
    "sender levels",
    "threshold, W/m²",
    "rays per gather",
    "functions L0 / finest",
];
const PARAMETER_NOTE: &str = "Published are the parameters of the slides of 2010. Their Happy Buddha (1.05M triangles) is not at hand: \
the Stanford dragon in a closed room takes its place, or a stand-in where the title says so. Their Cornell box and Sponza are other files \
than ours, with other emitters, so that the same absolute threshold does not mean the same work. Links have levels only where light has \
detail, read senders from the level that fits the footprint of a ray, and refine at a fraction of the irradiance.";
const ERROR_HEAD: [&str; 11] = [
    "scene",
    "engine",
    "read",
    "mean",
    "median",
    "p95",
    "rms",
    "bias",
    "mean where lit",
    "reference SE, mean",
    "solve + reading",
];
const ERROR_NOTE: &str = "Relative error of the luminance of total irradiance at random reachable points, corners \
included, against the path tracer, whose own error is in these figures (SE: standard error); the floor is 1 % of the mean. \
Points below the floor are called dark; hardly any light gets there, and an error there says little. \
Reading is the time for all points, direct light included.";
const TIME_HEAD: [&str; 13] = [
    "scene",
    "engine",
    "load",
    "BVH",
    "hierarchy",
    "direct light",
    "transport",
    "solve",
    "to completion",
    "processor time",
    "peak memory",
    "ended by",
    "mean error: interpolated / gathered",
];
const TIME_NOTE: &str = "Medians, with least and most in brackets. Every run is a process of its own; the files of the scene have been read \
once before the first. The solve counts all stages but writing the solution and the solver's own error estimate; completion is the process from \
start to end, both included. Processor time is that of all threads of the process; it hardly depends on what else the machine does. \
The hierarchy of links is the coarsest level alone: their finer levels are placed while they are linked, in the time of transport. Memory is the \
largest resident set.";
const RAY_HEAD: [&str; 8] = [
    "scene",
    "engine",
    "integrals",
    "rays",
    "rays per second",
    "escaped or leaked",
    "uncovered",
    "mean error: interpolated / gathered",
];
const RAY_NOTE: &str = "Gather rays of the transport, over its median time; shadow rays are not in them. The Cornell box is open in front and Sponza above, where rays \
escape; a closed room loses a ray only through a leak. Uncovered are hits that no function answered.";

fn parameter_rows(pairs: &[Pair<'_>]) -> Vec<Vec<String>> {
    let mut rows = Vec::new();
    for (scene, published) in pairs {
        for engine in &scene.engines {
            let s = &engine.settings;
            let is_links = variant_of(engine.id) == Variant::Links;
            let threshold = match is_links {
                true => format!("{} and {} σ", percent(s.relative_threshold), s.noise_factor),
                false => short(s.threshold),
            };
            let levels = format!("{}{}", if is_links { "at most " } else { "" }, s.levels);
            let senders = if is_links { "by footprint".into() } else { s.sender_levels.to_string() };
            rows.push(vec![
                scene.title.clone(),
                count(scene.triangles),
                engine.title.into(),
                levels,
                senders,
                threshold,
                s.rays.to_string(),
                functions(engine),
            ]);
        }
        let p = published;
        let cells =
            [p.scene, p.primitives, "published 2010", p.levels, p.sender_levels, p.threshold, "unknown", p.functions];
        rows.push(cells.map(str::to_owned).into());
    }
    rows
}

fn error_rows(scene: &SceneReport, engine: &EngineReport) -> Vec<Vec<String>> {
    let line = |reading: &Reading| {
        let e = &reading.all;
        let how = reading.gather_rays.map_or("interpolated".into(), |n| format!("gathered, {n} rays"));
        let mut cells = vec![scene.title.clone(), engine.title.into(), how];
        cells.extend([e.mean, e.median, e.p95, e.rms].map(percent));
        cells.push(signed_percent(e.bias));
        cells.push(format!("{} ({} of {})", percent(reading.lit.mean), reading.lit.n_lit, scene.n_points));
        cells.push(format!("{} ({} at most)", percent(scene.reference.mean), percent(scene.reference.max)));
        cells.push(format!("{} + {}", seconds(engine.solve.median), seconds(reading.seconds)));
        cells
    };
    std::iter::once(&engine.interpolated).chain(&engine.gathered).map(line).collect()
}

fn time_row(scene: &SceneReport, engine: &EngineReport) -> Vec<String> {
    let s = &engine.stages;
    let mut cells = vec![scene.title.clone(), engine.title.into()];
    cells.extend([s.load, s.bvh, s.hierarchy, s.direct, s.transport].map(seconds));
    cells.extend([&engine.solve, &engine.completion].map(spread));
    cells.push(engine.processor_seconds.map_or("unknown".into(), seconds));
    cells.push(engine.peak_memory.map_or("unknown".into(), |b| format!("{} MB", b / 1_000_000)));
    cells.push(match engine.cut_short_after {
        Some(limit) => format!("the time limit of {limit} s, after {}", engine.rounds),
        None => format!("{} ({})", engine.rounds, engine.stop),
    });
    cells.push(errors(engine));
    cells
}

fn unfinished_row(scene: &SceneReport, unfinished: &Unfinished) -> Vec<String> {
    let mut cells = vec![String::new(); TIME_HEAD.len()];
    cells[0].clone_from(&scene.title);
    cells[1] = unfinished.title.into();
    cells[8] = format!("more than {} s", unfinished.limit_seconds);
    cells[10] = unfinished.peak_memory.map_or("unknown".into(), |b| format!("{} MB until then", b / 1_000_000));
    cells[11] = format!("the time limit of {} s, before there was a result", unfinished.limit_seconds);
    cells[12] = "none".into();
    cells
}

fn ray_row(scene: &SceneReport, engine: &EngineReport) -> Vec<String> {
    let share = |n: u64| match engine.rays {
        0 => "0".into(),
        rays => format!("{} ({})", count(n), percent(n as f64 / rays as f64)),
    };
    let escaped = if scene.is_closed { format!("leaked: {}", share(engine.escaped)) } else { share(engine.escaped) };
    vec![
        scene.title.clone(),
        engine.title.into(),
        count(engine.integrals),
        count(engine.rays),
        count(engine.rays_per_second as u64),
        escaped,
        share(engine.uncovered),
        errors(engine),
    ]
}

/// The published variant that an engine is.
pub fn variant_of(id: &str) -> Variant {
    ENGINES.iter().find(|e| e.id == id).map_or(Variant::Links, |e| e.variant)
}

/// Mean errors, interpolated and gathered.
pub fn errors(engine: &EngineReport) -> String {
    let gathered = engine.gathered.map_or("not within the time limit".into(), |g| percent(g.all.mean));
    format!("{} / {gathered}", percent(engine.interpolated.all.mean))
}

fn functions(engine: &EngineReport) -> String {
    let of = |n: Option<&u64>| n.map_or("0".into(), |&n| count(n));
    format!("{} / {}", of(engine.points_per_level.first()), of(engine.points_per_level.last()))
}

/// A single-precision number without the digits it does not have.
fn short(value: f64) -> String {
    (value as f32).to_string()
}

#[cfg(test)]
mod tests {
    use super::super::answers::{Figures, SolveSettings, StandardError};
    use super::super::lit::LitError;
    use super::super::measure::StageSeconds;
    use super::super::scenes::CASES;
    use super::super::stats::Spread;
    use super::*;

    fn reading(mean: f64, gather_rays: Option<u32>) -> Reading {
        let lit = LitError { mean: 0.9 * mean, n_lit: 1900, n_dark: 100 };
        let all =
            Figures { mean, median: 0.8 * mean, p95: 3.0 * mean, rms: 1.5 * mean, max: 9.0 * mean, bias: -0.1 * mean };
        Reading { gather_rays, all, lit, seconds: 0.25 }
    }

    fn engine(id: &'static str, title: &'static str) -> EngineReport {
        EngineReport {
            id,
            title,
            flags: "--preset x".into(),
            settings: SolveSettings {
                levels: 6,
                rays: 256,
                sender_levels: 3,
                threshold: f64::from(0.016f32),
                relative_threshold: 0.05,
                noise_factor: 2.0,
                bounces: 3,
            },
            points_per_level: vec![218, 900, 167_000],
            completion: Spread::of(&[9.5, 10.5, 9.75]),
            solve: Spread::of(&[8.5, 7.5, 9.5]),
            stages: StageSeconds { transport: 4.0, hierarchy: 1.5, bvh: 0.25, ..StageSeconds::default() },
            processor_seconds: Some(15.5),
            peak_memory: Some(123_456_789),
            bounces: vec![12.0, 2.5, 1.25],
            rounds: "3 bounces".into(),
            stop: "max-bounces".into(),
            cut_short_after: None,
            integrals: 12_345,
            rays: 3_000_000,
            rays_per_second: 750_000.0,
            escaped: 30_000,
            uncovered: 2,
            interpolated: reading(0.0123, None),
            gathered: Some(reading(0.0045, Some(4096))),
            warnings: vec![],
        }
    }

    fn scene(title: &str, ids: &[&'static str]) -> SceneReport {
        let title_of = |id: &str| ENGINES.iter().find(|e| e.id == id).unwrap().title;
        SceneReport {
            id: "cornell".into(),
            title: title.into(),
            is_stand_in: false,
            is_closed: false,
            triangles: 36,
            n_points: 2000,
            reference: StandardError { mean: 0.0022, max: 0.004, target: 0.003, points_above_target: 1 },
            engines: ids.iter().map(|id| engine(id, title_of(id))).collect(),
            unfinished: vec![],
        }
    }

    fn report(scenes: Vec<SceneReport>) -> Report {
        let total = Total { seconds: 83.2, processor_seconds: Some(140.5) };
        Report { machine: Machine::look(), mode: "quick".into(), total, scenes, warnings: vec!["the sky fell".into()] }
    }

    fn line<'t>(text: &'t str, needles: &[&str]) -> &'t str {
        let found = text.lines().find(|l| needles.iter().all(|n| l.contains(n)));
        found.unwrap_or_else(|| panic!("{needles:?}\n{text}"))
    }

    #[test]
    fn every_table_has_as_many_cells_in_each_row_as_in_its_head() {
        let mut other = scene("Other", &["production"]);
        other.unfinished.push(Unfinished {
            id: "v1",
            title: "V1, original",
            flags: "--preset slides".into(),
            limit_seconds: 600,
            peak_memory: None,
        });
        let report = report(vec![scene("Cornell", &["production", "preview", "v1", "v3"]), other]);
        let text = report.markdown(&[CASES[0].published, CASES[1].published]);
        let mut n_tables = 0;
        for block in text.split("\n\n").filter(|b| b.starts_with("| ")) {
            let bars: Vec<usize> =
                block.lines().filter(|l| l.starts_with('|')).map(|l| l.matches('|').count()).collect();
            assert!(bars.len() > 2 && bars.iter().all(|&n| n == bars[0]), "{block}");
            n_tables += 1;
        }
        assert_eq!(n_tables, 7);
        assert!(line(&text, &["Other", "no result within 600 s"]).contains("--preset slides"));
        let csv = report.csv();
        let commas: Vec<usize> = csv.lines().map(|l| l.matches(',').count()).collect();
        assert!(commas.len() == 6 && commas.iter().all(|&n| n == CSV_HEAD.len() - 1), "{csv}");
    }

    #[test]
    fn what_measuring_took_is_said() {
        let text = report(Vec::new()).markdown(&[]);
        assert!(text.contains("Measuring took 83.2 s in all, 140 s on processors."), "{text}");
        let unknown = Total { seconds: 83.2, processor_seconds: None };
        assert_eq!(unknown.to_string(), "83.2 s in all");
    }

    #[test]
    fn no_time_stands_without_its_error() {
        let text = report(vec![scene("Cornell", &["production", "v1"])]).markdown(&[CASES[0].published]);
        let gathered = line(&text, &["links, production", "gathered, 4096 rays"]);
        for part in ["0.45 %", "-0.04 %", "0.22 % (0.40 % at most)", "1900 of 2000", "8.50 s + 0.25 s"] {
            assert!(gathered.contains(part), "{part} in {gathered}");
        }
        let times = line(&text, &["links, production", "123 MB"]);
        for part in ["8.50 s (7.50 to 9.50, 3 runs)", "9.75 s (9.50 to 10.5, 3 runs)", "1.23 % / 0.45 %", "15.5 s"] {
            assert!(times.contains(part), "{part} in {times}");
        }
        assert!(line(&text, &["links, production", "750k"]).contains("30.0k (1.00 %)"));
        assert!(line(&text, &["ours, 256 rays", "12.3k"]).contains("1.23 % / 0.45 %"));
    }

    #[test]
    fn published_figures_are_called_so_and_stand_beside_their_own_variant() {
        let text = report(vec![scene("Cornell", &["v1", "v3"])]).markdown(&[CASES[0].published]);
        assert!(line(&text, &["published, CPU "]).contains("21 / 2.9 / 2.4 s"));
        assert!(line(&text, &["published, GPU"]).contains("0.49 / 0.15 / 0.1 s"));
        assert!(line(&text, &["CPU 8.0x, GPU 0.25x"]).contains("published time over ours"));
        assert!(line(&text, &["ours, V3"]).contains("not built yet"));
        let without = report(vec![scene("Cornell", &["production"])]).markdown(&[CASES[0].published]);
        assert!(!without.contains("## The original") && without.contains("## On a GPU"));
        assert!(text.contains("**Warning:** the sky fell."));
    }

    #[test]
    fn a_run_that_was_cut_short_says_so_and_is_not_compared() {
        let mut scene = scene("Cornell", &["v1"]);
        scene.engines[0].cut_short_after = Some(600);
        scene.engines[0].gathered = None;
        let text = report(vec![scene]).markdown(&[CASES[0].published]);
        assert!(text.contains("cut short at 600 s") && text.contains("the time limit of 600 s, after 3 bounces"));
        assert!(!text.contains("published time over ours") && !text.contains("gathered, 4096"));
        assert!(line(&text, &["750k"]).contains("1.23 % / not within the time limit"));
    }

    #[test]
    fn rays_that_leave_a_closed_room_have_leaked() {
        let mut scene = scene("Cornell", &["v1"]);
        scene.is_closed = true;
        let text = report(vec![scene]).markdown(&[CASES[0].published]);
        assert!(line(&text, &["750k"]).contains("leaked: 30.0k (1.00 %)"));
    }
}
