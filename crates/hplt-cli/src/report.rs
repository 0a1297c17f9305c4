//! What a run says about itself: for people on stderr, for programs as one JSON document.

use std::fmt::Write;

use hplt_transport::{BounceReport, ErrorEstimate, Linked, SolveStop, StopReason, TransportReport};
use serde::Serialize;

use crate::config::Config;
use crate::progress::{Stop, say};
use crate::values::{human_bytes, human_count, human_percent};

/// The report of a run that lights a scene. Seconds are wall-clock time.
#[derive(Debug, Clone, Default, Serialize)]
pub struct RunReport {
    /// The command.
    pub command: &'static str,
    /// The version of this program.
    pub version: &'static str,
    /// The scene's name on the command line.
    pub scene: String,
    /// Hash of everything in the scene that light depends on.
    pub scene_hash: String,
    /// Triangles that are lit.
    pub triangles: usize,
    /// Whether the light still to come is below the tolerance and nothing was cut short.
    pub converged: bool,
    /// Why the bounces ended.
    pub stop: &'static str,
    /// Stages in order.
    pub stages: Vec<StageTime>,
    /// All stages together.
    pub seconds: f64,
    /// Levels, coarsest first.
    pub levels: Vec<LevelRow>,
    /// Regions that light reaches.
    pub regions: u32,
    /// Share of all reflecting sides, by area, that light reaches.
    pub reachable: Option<f64>,
    /// Bounces in order.
    pub bounces: Vec<BounceRow>,
    /// What linking did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub links: Option<LinkRow>,
    /// Bound on the relative error left by bounces that were not computed.
    pub truncation_bound: Option<f64>,
    /// Largest row sum of the transport operator.
    pub max_row_sum: Option<f64>,
    /// Measured error of the interpolated field.
    pub error: Option<ErrorRow>,
    /// Bytes by part.
    pub memory: Vec<MemoryPart>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// What is not there, and why.
    pub left_out: Vec<String>,
    /// Files written.
    pub outputs: Vec<String>,
    /// More figures of the command.
    #[serde(skip_serializing_if = "serde_json::Map::is_empty")]
    pub more: serde_json::Map<String, serde_json::Value>,
    /// All effective values.
    pub settings: Config,
}

/// What linking did.
#[derive(Debug, Clone, Serialize)]
pub struct LinkRow {
    /// Functions, and those that were refined, per level.
    pub levels: Vec<[u64; 2]>,
    /// Seconds per level.
    pub seconds: Vec<f64>,
    /// Gather rays.
    pub rays: u64,
    /// Gather rays that left the scene.
    pub escaped: u64,
    /// Hits without a function.
    pub uncovered: u64,
    /// Entries of the transport operator.
    pub links: u64,
    /// Products with it in the last solve.
    pub sweeps: usize,
    /// The residual after each, relative to the largest direct irradiance.
    pub residuals: Vec<f32>,
}

/// A stage and its time.
#[derive(Debug, Clone, Serialize)]
pub struct StageTime {
    /// What was done.
    pub stage: &'static str,
    /// How long it took.
    pub seconds: f64,
}

/// One level.
#[derive(Debug, Clone, Serialize)]
pub struct LevelRow {
    /// Points.
    pub points: usize,
    /// Poisson radius, world units.
    pub radius: f64,
}

/// One bounce.
#[derive(Debug, Clone, Serialize)]
pub struct BounceRow {
    /// Gathers per level.
    pub integrals: Vec<u64>,
    /// Rays.
    pub rays: u64,
    /// Rays that left the scene.
    pub escaped: u64,
    /// Hits that no function covered and no neighbour answered.
    pub uncovered: u64,
    /// Hits that the nearest function answered, none covering them.
    pub nearest: u64,
    /// Largest irradiance added, W/m².
    pub unshot: [f32; 3],
    /// Mean irradiance added, W/m².
    pub mean: [f32; 3],
    /// Time.
    pub seconds: f64,
}

/// The measured error.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ErrorRow {
    /// Mean relative error.
    pub mean: f64,
    /// What of it the noise of rays explains, at most.
    pub from_rays: f64,
    /// The rest, in the square: what the functions cannot resolve.
    pub from_functions: f64,
    /// What the mean is below, as far as chance goes, in 95 of 100 runs and more.
    pub bound: f64,
    /// 95th percentile of the relative error, noise of the measurement included.
    pub p95: f64,
    /// Noise of the measurement.
    pub noise: f64,
    /// Points.
    pub points: usize,
    /// Rays of each, as many as it took to tell the error from their noise.
    pub rays: u32,
}

/// Memory of one part.
#[derive(Debug, Clone, Serialize)]
pub struct MemoryPart {
    /// What.
    pub part: &'static str,
    /// Bytes.
    pub bytes: u64,
}

impl From<&BounceReport> for BounceRow {
    fn from(b: &BounceReport) -> Self {
        Self {
            integrals: b.integrals.clone(),
            rays: b.rays,
            escaped: b.escaped,
            uncovered: b.coverage.uncovered,
            nearest: b.coverage.nearest,
            unshot: b.unshot.to_array(),
            mean: b.mean.to_array(),
            seconds: b.seconds,
        }
    }
}

impl From<ErrorEstimate> for ErrorRow {
    fn from(e: ErrorEstimate) -> Self {
        let ErrorEstimate { mean, from_rays, from_functions, bound, p95, noise, n_points, n_rays } = e;
        Self { mean, from_rays, from_functions, bound, p95, noise, points: n_points, rays: n_rays }
    }
}

impl RunReport {
    /// Enters a transport.
    pub fn enter_transport(&mut self, report: &TransportReport, stopped: Option<Stop>, must_converge: bool) {
        self.bounces = report.bounces.iter().map(BounceRow::from).collect();
        self.truncation_bound = Some(f64::from(report.truncation_bound));
        self.max_row_sum = Some(f64::from(report.max_row_sum));
        self.stop = match (report.stop, stopped) {
            (StopReason::Converged, _) => "converged",
            (StopReason::MaxBounces, _) => "max-bounces",
            (StopReason::NoLight, _) => "no-light",
            (StopReason::Interrupted, Some(Stop::TimeLimit)) => "time-limit",
            (StopReason::Interrupted, _) => "interrupted",
        };
        self.converged = report.is_converged() || (report.stop == StopReason::MaxBounces && !must_converge);
    }

    /// Enters what links found; `scale` is the length of a scene unit.
    pub fn enter_links(&mut self, linked: &Linked, scale: f64, stopped: Option<Stop>) {
        let report = &linked.report;
        let levels = linked.basis.hierarchy().levels.iter();
        self.levels =
            levels.map(|l| LevelRow { points: l.points.len(), radius: f64::from(l.poisson_radius) * scale }).collect();
        self.truncation_bound = Some(f64::from(report.solve.bound));
        let row_sum = report.solve.components.iter().map(|c| c.max_row_sum.max_element()).fold(0.0, f32::max);
        self.max_row_sum = Some(f64::from(row_sum));
        self.stop = match (report.is_cut_short, report.solve.stop) {
            (true, _) | (_, SolveStop::Interrupted) if stopped == Some(Stop::TimeLimit) => "time-limit",
            (true, _) | (_, SolveStop::Interrupted) => "interrupted",
            (_, SolveStop::NoLight) => "no-light",
            (_, SolveStop::Converged) => "converged",
            (_, SolveStop::MaxSweeps | SolveStop::Rounding) => "max-bounces",
        };
        self.converged = report.solve.is_converged() && !report.is_cut_short;
        self.links = Some(LinkRow {
            levels: report.levels.iter().map(|l| [l.functions, l.refined]).collect(),
            seconds: report.levels.iter().map(|l| l.seconds).collect(),
            rays: report.rays,
            escaped: report.escaped,
            uncovered: report.coverage.uncovered,
            links: report.n_links,
            sweeps: report.solve.sweeps,
            residuals: report.solve.residual_history.clone(),
        });
        let unrefined: u64 = report.levels.iter().rev().skip(1).map(|l| l.functions - l.refined).sum();
        if unrefined > 0 {
            self.left_out.push(format!("finer functions around {}: no detail there", human_count(unrefined)));
        }
        self.enter_memory("links", report.memory);
    }

    /// Enters the time of a stage.
    pub fn enter_stage(&mut self, stage: &'static str, seconds: f64) {
        match self.stages.iter_mut().find(|row| row.stage == stage) {
            Some(row) => row.seconds += seconds,
            None => self.stages.push(StageTime { stage, seconds }),
        }
        self.seconds += seconds;
    }

    /// Rays of the gathers that left the scene.
    pub fn escaped(&self) -> u64 {
        self.links.as_ref().map_or(0, |links| links.escaped) + self.bounces.iter().map(|b| b.escaped).sum::<u64>()
    }

    /// Enters the memory of a part, in place of what was known about it.
    pub fn enter_memory(&mut self, part: &'static str, bytes: usize) {
        self.memory.retain(|known| known.part != part);
        self.memory.push(MemoryPart { part, bytes: bytes as u64 });
    }

    fn time_of(&self, stage: &str) -> f64 {
        self.stages.iter().filter(|s| s.stage == stage).map(|s| s.seconds).fold(0.0, |a, b| a + b)
    }

    /// Says the summary on stderr; with `is_verbose` everything.
    pub fn print(&self, is_verbose: bool) {
        for warning in &self.warnings {
            say(&format!("warning: {warning}"));
        }
        if !self.levels.is_empty() {
            say(&self.points_line());
            if self.links.is_none() {
                say(&self.direct_line());
            }
        }
        if let Some(links) = &self.links {
            say(&self.links_line(links));
        }
        self.print_bounces(is_verbose);
        if let Some(line) = self.error_line() {
            say(&line);
        }
        let total: u64 = self.memory.iter().map(|m| m.bytes).sum();
        if is_verbose {
            self.memory.iter().for_each(|m| say(&format!("memory    {:<24} {:>9}", m.part, human_bytes(m.bytes))));
            self.left_out.iter().for_each(|line| say(&format!("left out  {line}")));
        } else if total > 0 {
            say(&format!("memory    {} in all; -v lists the parts and what was left out", human_bytes(total)));
        }
        for output in &self.outputs {
            say(&format!("wrote     {output}"));
        }
        if is_verbose {
            self.stages.iter().for_each(|s| say(&format!("time      {:<24} {:>7.2} s", s.stage, s.seconds)));
        }
        say(&format!("total     {:.1} s", self.seconds));
    }

    fn points_line(&self) -> String {
        let counts: Vec<String> = self.levels.iter().map(|l| human_count(l.points as u64)).collect();
        let n: usize = self.levels.iter().map(|l| l.points).sum();
        let seconds = self.time_of("points") + self.time_of("basis");
        let text = format!("{} in {} levels ({})", human_count(n as u64), counts.len(), counts.join(", "));
        format!("points    {text:<64} {seconds:>7.2} s")
    }

    fn direct_line(&self) -> String {
        format!("direct    {:<64} {:>7.2} s", "light straight from emitters, per point", self.time_of("direct light"))
    }

    fn links_line(&self, links: &LinkRow) -> String {
        let text = format!(
            "{} rays, {} links, {} sweeps ({})",
            human_count(links.rays),
            human_count(links.links),
            links.sweeps,
            self.stop
        );
        format!("solve     {text:<64} {:>7.2} s", self.time_of("links"))
    }

    fn print_bounces(&self, is_verbose: bool) {
        if self.bounces.is_empty() {
            return;
        }
        if is_verbose {
            say("bounce      gathers        rays  escaped  uncovered    unshot, W/m²   time");
            self.bounces.iter().enumerate().for_each(|(i, b)| say(&bounce_line(i, b)));
        }
        let gathers: u64 = self.bounces.iter().flat_map(|b| &b.integrals).sum();
        let rays: u64 = self.bounces.iter().map(|b| b.rays).sum();
        let text = format!(
            "{} bounces ({}), {} gathers, {} rays",
            self.bounces.len(),
            self.stop,
            human_count(gathers),
            human_count(rays)
        );
        say(&format!("solve     {text:<64} {:>7.2} s", self.time_of("bounces")));
    }

    fn error_line(&self) -> Option<String> {
        let mut text = String::new();
        if let Some(e) = self.error {
            let _ = write!(
                text,
                "interpolated: {} mean ({} at most from rays, {} at least from functions; below {} in 95 of 100 runs), {} at the 95th percentile of {} \
                 points",
                human_percent(e.mean),
                human_percent(e.from_rays),
                human_percent(e.from_functions),
                human_percent(e.bound),
                human_percent(e.p95),
                e.points
            );
        }
        if let Some(expected) = self.more.get("expected_error").and_then(serde_json::Value::as_f64) {
            let rays =
                self.more.get("gather_rays").map(|n| format!(" through a gather of {n} rays")).unwrap_or_default();
            let _ = write!(text, "; read{rays}: about {} expected", human_percent(expected));
        }
        if let Some(bound) = self.truncation_bound.filter(|_| !self.bounces.is_empty() || self.links.is_some()) {
            let bound = if bound.is_finite() { human_percent(bound) } else { "without bound".into() };
            let _ = write!(text, "{}bounces left out: {bound} at most", if text.is_empty() { "" } else { "; " });
        }
        (!text.is_empty()).then(|| format!("error     {text}"))
    }
}

fn bounce_line(i: usize, b: &BounceRow) -> String {
    let gathers: u64 = b.integrals.iter().sum();
    let unshot = b.unshot.iter().fold(0.0f32, |a, &x| a.max(x));
    format!(
        "{:>6} {:>12} {:>11} {:>8} {:>10} {:>15.3e} {:>6.2}   per level {:?}",
        i + 1,
        human_count(gathers),
        human_count(b.rays),
        b.escaped,
        b.uncovered,
        unshot,
        b.seconds,
        b.integrals
    )
}
