//! The JSON documents of the binary, as far as the tables need them.

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Report of a command that lights a scene.
#[derive(Debug, Clone, Deserialize)]
pub struct RunAnswer {
    /// Hash of everything in the scene that light depends on.
    pub scene_hash: String,
    /// Triangles that are lit.
    pub triangles: u64,
    /// Why the bounces ended.
    pub stop: String,
    /// Stages in order.
    pub stages: Vec<Stage>,
    /// Levels, coarsest first.
    pub levels: Vec<Level>,
    /// Bounces in order. What links gathered once for all of them counts as one.
    pub bounces: Vec<Bounce>,
    /// Links, where all bounces were solved at once.
    pub links: Option<Links>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// Effective values.
    pub settings: Settings,
    /// Figures of single commands.
    #[serde(default)]
    pub more: More,
}

/// A stage and its wall-clock time.
#[derive(Debug, Clone, Deserialize)]
pub struct Stage {
    /// What was done.
    pub stage: String,
    /// How long it took.
    pub seconds: f64,
}

/// Effective values of a run.
#[derive(Debug, Clone, Deserialize)]
pub struct Settings {
    /// Those of the solver.
    pub solve: SolveSettings,
}

/// Effective values of the solver.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(rename_all(deserialize = "kebab-case"))]
pub struct SolveSettings {
    /// Levels at most.
    pub levels: u32,
    /// Rays per gather.
    pub rays: u32,
    /// Levels that senders are read from.
    pub sender_levels: u32,
    /// Refinement: irradiance, W/m².
    pub threshold: f64,
    /// Refinement: fraction of the irradiance.
    pub relative_threshold: f64,
    /// Refinement: standard errors of a gather.
    pub noise_factor: f64,
    /// Bounces at most.
    pub bounces: u32,
}

/// One level of the hierarchy.
#[derive(Debug, Clone, Deserialize)]
pub struct Level {
    /// Points.
    pub points: u64,
}

/// One bounce.
#[derive(Debug, Clone, Deserialize)]
pub struct Bounce {
    /// Gathers per level.
    pub integrals: Vec<u64>,
    /// Rays.
    pub rays: u64,
    /// Rays that left the scene.
    pub escaped: u64,
    /// Hits that nothing answered.
    pub uncovered: u64,
    /// Time.
    pub seconds: f64,
}

/// What linking did.
#[derive(Debug, Clone, Deserialize)]
pub struct Links {
    /// Functions and how many of them were refined, per level.
    pub levels: Vec<[u64; 2]>,
    /// Seconds per level.
    pub seconds: Vec<f64>,
    /// Gather rays.
    pub rays: u64,
    /// Rays that left the scene.
    pub escaped: u64,
    /// Hits without a function.
    pub uncovered: u64,
    /// Products with the operator in the last solve.
    pub sweeps: usize,
}

/// Figures of `hplt reference`.
#[derive(Debug, Clone, Default, Deserialize)]
pub struct More {
    /// How sure it is.
    pub standard_error: Option<StandardError>,
}

/// Standard errors of the luminance over all points, relative to it.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
pub struct StandardError {
    /// Mean.
    pub mean: f64,
    /// Largest.
    pub max: f64,
    /// What was asked for.
    pub target: f64,
    /// Points that missed it.
    pub points_above_target: u64,
}

/// Error of a table against the reference, relative to its luminance with a floor of 1 % of its mean.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
pub struct Figures {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Root mean square.
    pub rms: f64,
    /// Largest.
    pub max: f64,
    /// Relative error of the sum.
    pub bias: f64,
}

impl RunAnswer {
    /// The report in `document`.
    ///
    /// # Errors
    /// When a figure is missing.
    pub fn parse(document: &Value) -> Result<Self> {
        let mut answer: Self = serde_json::from_value(document.clone()).context("the report of hplt lacks a figure")?;
        if let Some(links) = &answer.links {
            answer.bounces.push(Bounce {
                integrals: links.levels.iter().map(|[functions, _]| *functions).collect(),
                rays: links.rays,
                escaped: links.escaped,
                uncovered: links.uncovered,
                seconds: links.seconds.iter().sum(),
            });
        }
        Ok(answer)
    }

    /// Whether a time limit ended it.
    pub fn is_cut_short(&self) -> bool {
        self.stop == "time-limit"
    }

    /// Bounces, or sweeps of the solver over links.
    pub fn rounds(&self) -> String {
        match &self.links {
            Some(links) => format!("{} sweeps", links.sweeps),
            None => format!("{} bounces", self.bounces.len()),
        }
    }

    /// Sweeps of the solver over links, or bounces; `None` where there was neither.
    pub fn n_rounds(&self) -> Option<u64> {
        let n = self.links.as_ref().map_or(self.bounces.len(), |links| links.sweeps);
        (n > 0).then_some(n as u64)
    }

    /// Time of all stages of a name.
    pub fn seconds_of(&self, stage: &str) -> f64 {
        self.stages.iter().filter(|s| s.stage == stage).map(|s| s.seconds).fold(0.0, |a, b| a + b)
    }

    /// Gathers of all bounces.
    pub fn integrals(&self) -> u64 {
        self.bounces.iter().flat_map(|b| &b.integrals).sum()
    }

    /// Rays of all bounces.
    pub fn rays(&self) -> u64 {
        self.bounces.iter().map(|b| b.rays).sum()
    }

    /// Everything that must be the same in every run: all but time.
    pub fn counts(&self) -> Vec<u64> {
        let of =
            |b: &Bounce| b.integrals.iter().chain([&b.rays, &b.escaped, &b.uncovered]).copied().collect::<Vec<_>>();
        self.levels.iter().map(|l| l.points).chain(self.bounces.iter().flat_map(of)).collect()
    }
}

impl Figures {
    /// The figures in a document of `hplt compare`.
    ///
    /// # Errors
    /// When one is missing or not finite.
    pub fn parse(document: &Value) -> Result<Self> {
        serde_json::from_value(document["figures"].clone()).context("hplt compare did not print all figures")
    }
}

#[cfg(test)]
pub mod tests {
    use serde_json::json;

    use super::*;

    /// A report as the binary prints it.
    pub fn report() -> Value {
        let bounce = |n: u64| {
            json!({ "integrals": [n, 2 * n], "rays": 100 * n, "escaped": n, "uncovered": 0, "nearest": 1,
            "unshot": [1.0, 1.0, 1.0], "mean": [1.0, 1.0, 1.0], "seconds": 0.5 })
        };
        json!({
            "command": "solve", "scene": "gen:cornell", "scene_hash": "00ff", "triangles": 36, "converged": true,
            "stop": "converged", "seconds": 3.5, "warnings": [], "memory": [{ "part": "bvh", "bytes": 100 }],
            "stages": [{ "stage": "load", "seconds": 0.25 }, { "stage": "bvh", "seconds": 0.25 },
                { "stage": "points", "seconds": 0.5 }, { "stage": "basis", "seconds": 0.5 },
                { "stage": "direct light", "seconds": 0.5 }, { "stage": "bounces", "seconds": 1.0 },
                { "stage": "error estimate", "seconds": 0.5 }],
            "settings": { "solve": { "levels": 6, "rays": 256, "sender-levels": 3, "threshold": 0.016,
                "relative-threshold": 0.0, "noise-factor": 0.0, "bounces": 3, "variant": "delta" } },
            "levels": [{ "points": 218, "radius": 0.1 }, { "points": 167_000, "radius": 0.003 }],
            "bounces": [bounce(300), bounce(10)],
        })
    }

    #[test]
    fn figures_come_out_of_the_report() {
        let answer = RunAnswer::parse(&report()).unwrap();
        assert_eq!((answer.integrals(), answer.rays()), (930, 31_000));
        assert_eq!((answer.settings.solve.levels, answer.settings.solve.sender_levels), (6, 3));
        assert_eq!(answer.seconds_of("points"), 0.5);
        assert_eq!(answer.seconds_of("no such stage"), 0.0);
    }

    #[test]
    fn a_report_without_bounces_is_an_error_and_not_a_row_of_zeros() {
        let mut document = report();
        document.as_object_mut().unwrap().remove("bounces");
        assert!(RunAnswer::parse(&document).is_err());
        assert!(RunAnswer::parse(&json!({ "error": { "code": "USAGE" } })).is_err());
    }

    #[test]
    fn links_count_as_one_bounce_that_gathers_every_function() {
        let mut document = report();
        document["bounces"] = json!([]);
        document["links"] = json!({ "levels": [[200, 200], [800, 0]], "seconds": [0.5, 0.25], "rays": 64_000, "escaped": 3,
            "uncovered": 1, "sweeps": 9, "links": 5000 });
        let answer = RunAnswer::parse(&document).unwrap();
        assert_eq!((answer.integrals(), answer.rays(), answer.rounds().as_str()), (1000, 64_000, "9 sweeps"));
        assert_eq!((answer.n_rounds(), RunAnswer::parse(&report()).unwrap().n_rounds()), (Some(9), Some(2)));
    }

    #[test]
    fn figures_that_are_not_finite_are_refused() {
        let mut figures =
            json!({ "mean": 0.01, "median": 0.008, "p95": 0.03, "rms": 0.02, "max": 0.2, "bias": -0.001 });
        let of = |figures: &Value| Figures::parse(&json!({ "figures": figures }));
        assert_eq!(of(&figures).unwrap().bias, -0.001);
        figures["rms"] = Value::Null;
        assert!(of(&figures).is_err());
    }

    #[test]
    fn counts_differ_when_any_count_does_and_not_when_times_do() {
        let base = RunAnswer::parse(&report()).unwrap();
        let mut other = report();
        other["bounces"][1]["seconds"] = json!(9.0);
        assert_eq!(RunAnswer::parse(&other).unwrap().counts(), base.counts());
        other["bounces"][1]["escaped"] = json!(11);
        assert_ne!(RunAnswer::parse(&other).unwrap().counts(), base.counts());
    }
}
