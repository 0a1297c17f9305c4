//! Lighting to a given error, or in a given time.

use clap::Args;
use hplt_geom::Progress;
use hplt_transport::{LinkOptions, Threshold};

use crate::args::Common;
use crate::exit::Failure;
use crate::job::{GatherRecord, LinkParts, Lit, Run};
use crate::report::ErrorRow;
use crate::sections::{SolveSection, Variant};
use crate::values::{Fraction, Seconds};

/// How good the light is to be, or what it may cost.
#[derive(Args, Debug, Clone, Default)]
#[command(next_help_heading = "Budget")]
pub struct Budget {
    /// Reach this mean relative error by the solver's own estimate, with as many rays and functions as that takes
    #[arg(long, value_name = "FRACTION")]
    pub error: Option<Fraction>,
    /// Make the best of this span of time, loading included
    #[arg(long, value_name = "TIME")]
    pub time: Option<Seconds>,
}

/// What one attempt spends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Effort {
    /// Index into [`FUNCTIONS`].
    functions: usize,
    n_rays: u32,
}

/// The first attempt. Every other one has more rays where the estimate blames their noise, more functions where it blames those.
const FIRST: Effort = Effort { functions: 0, n_rays: 64 };
/// Levels at most, and the fraction of the light at which functions are refined.
const FUNCTIONS: [(usize, f32); 7] = [(2, 0.3), (3, 0.15), (3, 0.075), (4, 0.05), (5, 0.03), (6, 0.02), (7, 0.015)];
/// Rays of a function at most.
const MOST_RAYS: u32 = 4096;
/// The noise that is stated of rays is more than the true one. About so much of it is true.
const TRUE_NOISE: f64 = 0.7;
/// Share of the error aimed at that either cause may have.
const SHARE: f64 = 0.8;
/// What one attempt leaves of the error of the one before, at least: one that aims further costs too much for what is known.
const LEAST_LEFT: f64 = 0.25;
/// More functions take about so many times as long.
const COST_OF_FUNCTIONS: f64 = 1.7;
/// Two attempts that leave more than this of the error show that it is not the number of rays or functions that it comes from: none
/// follows them.
const STALLED: f64 = 0.8;
/// A field this many times worse than what is asked for is good enough for a gather to read.
const SECOND_ORDER: f64 = 8.0;
/// Rays of a gather.
const GATHER_RAYS: std::ops::RangeInclusive<u32> = 64..=65_536;

impl Reading {
    /// Rays of a gather, if it is one.
    pub fn gather_rays(self) -> Option<u32> {
        match self {
            Self::Interpolated => None,
            Self::Gathered(n_rays) => Some(n_rays),
        }
    }
}

/// How points are to be read so that the budget is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reading {
    /// Interpolated.
    Interpolated,
    /// Through a gather of so many rays each.
    Gathered(u32),
}

impl Budget {
    /// Whether anything was asked for.
    pub fn is_some(&self) -> bool {
        self.error.is_some() || self.time.is_some()
    }

    /// Refuses values out of range, and flags that the budget would have to overrule.
    ///
    /// # Errors
    /// Names the flag.
    pub fn check(&self, common: &Common, is_decided: bool) -> Result<(), Failure> {
        if !self.is_some() {
            return Ok(());
        }
        if is_decided {
            return Err(Failure::usage(
                "--error and --time decide how to solve and read: leave --solution and --final-gather out",
            ));
        }
        if let Some(Fraction(error)) = self.error.filter(|e| !(1e-4..=1.0).contains(&e.0)) {
            return Err(Failure::usage(format!("--error {error}; expected a fraction from 0.01% to 100%")));
        }
        let SolveSection { variant, levels, rays, relative_threshold, threshold, .. } = &common.solve;
        if variant.is_some_and(|v| v != Variant::Links) {
            return Err(Failure::usage("--error and --time need --variant links"));
        }
        if levels.is_some() || rays.is_some() || relative_threshold.is_some() || threshold.is_some() {
            return Err(Failure::usage("--error and --time choose levels, rays and thresholds: leave those flags out"));
        }
        Ok(())
    }
}

impl Effort {
    fn options(self, base: LinkOptions) -> LinkOptions {
        let (n_levels, relative) = FUNCTIONS[self.functions];
        let threshold = Threshold { relative, ..base.threshold };
        LinkOptions { n_levels, n_rays: self.n_rays, threshold, ..base }
    }

    /// The least effort that may bring the error from what it was with this one to `aim`, and how many times as long that takes; `None`
    /// where there is none greater.
    fn next(self, found: &ErrorRow, aim: f64) -> Option<(Self, f64)> {
        let allowed = SHARE * aim.max(LEAST_LEFT * found.mean);
        let of_rays = TRUE_NOISE * found.from_rays;
        let of_functions = (found.mean * found.mean - of_rays * of_rays).max(0.0).sqrt();
        let steps = match of_functions / allowed {
            ..=1.0 => 0,
            ..=2.0 => 1,
            _ => 2,
        };
        let doublings = (2.0 * (of_rays / allowed).log2()).ceil().clamp(0.0, 3.0) as u32;
        let doublings = if steps == 0 { doublings.max(1) } else { doublings };
        let functions = (self.functions + steps).min(FUNCTIONS.len() - 1);
        let next = Self { functions, n_rays: (self.n_rays << doublings).min(MOST_RAYS) };
        let of_functions = COST_OF_FUNCTIONS.powi((functions - self.functions) as i32);
        (next != self).then(|| (next, of_functions * f64::from(next.n_rays / self.n_rays)))
    }
}

/// What is known after an attempt.
#[derive(Clone, Copy)]
struct Attempt {
    /// Mean relative error of the field.
    error: f64,
    /// What the next attempt may bring it to.
    aim: f64,
    /// How points are gathered.
    gathers: GatherRecord,
    /// Seconds since the start of the run.
    now: f64,
    /// What the next one takes; `None` when there is none.
    next: Option<f64>,
}

impl Attempt {
    /// The error to expect of a reading.
    fn expected(&self, reading: Reading) -> f64 {
        match reading {
            Reading::Interpolated => self.error,
            Reading::Gathered(n_rays) => self.noise_of(n_rays).hypot(self.error / SECOND_ORDER),
        }
    }

    fn noise_of(&self, n_rays: u32) -> f64 {
        self.gathers.noise_of_one_ray / f64::from(n_rays).sqrt()
    }

    fn gather_seconds(&self, n_receivers: usize, n_rays: u32) -> f64 {
        n_receivers as f64 * f64::from(n_rays) / self.gathers.rays_per_second
    }

    /// How to read `n_receivers` points if this is to be the last attempt; `None` when the next one is to be made.
    fn choose(&self, budget: &Budget, n_receivers: usize) -> Option<Reading> {
        let left = budget.time.map_or(f64::INFINITY, |t| t.0 - self.now);
        // Powers of two and their middles.
        let gathers = || {
            let halves = 2 * GATHER_RAYS.start().ilog2()..=2 * GATHER_RAYS.end().ilog2();
            halves.map(|k| (2 + k % 2) << (k / 2) >> 1).filter(|_| n_receivers > 0)
        };
        if let Some(Fraction(error)) = budget.error {
            if self.error <= error {
                return Some(Reading::Interpolated);
            }
            let enough = gathers().find(|&n| self.expected(Reading::Gathered(n)) <= error);
            let seconds = |n: u32| self.gather_seconds(n_receivers, n);
            // After the next attempt points are interpolated, or at least gathered with fewer rays.
            let fewest = gathers().find(|&n| self.noise_of(n) <= error);
            let gather_later = if self.aim <= error { 0.0 } else { fewest.map_or(f64::INFINITY, seconds) };
            let is_worth_it =
                |&n: &u32| seconds(n) <= left && self.next.is_none_or(|next| seconds(n) <= next + gather_later);
            if let Some(n) = enough.filter(is_worth_it) {
                return Some(Reading::Gathered(n));
            }
        }
        if self.next.is_some_and(|next| next <= left) {
            return None;
        }
        let affordable = gathers().rfind(|&n| self.gather_seconds(n_receivers, n) <= left);
        let gathered = affordable.map(Reading::Gathered).filter(|&r| self.expected(r) < self.error);
        Some(gathered.unwrap_or(Reading::Interpolated))
    }
}

impl Run<'_> {
    /// Lights a scene by links within the budget of the run, and decides how its receivers are to be read.
    ///
    /// # Errors
    /// Those of the links.
    pub fn link_within<'s>(&mut self, mut parts: LinkParts<'s>) -> Result<Lit<'s>, Failure> {
        let (n_warnings, n_left_out) = (self.report.warnings.len(), self.report.left_out.len());
        let (mut effort, mut errors) = (FIRST, Vec::new());
        loop {
            let begin = self.reporter.now();
            let coarsest = parts.coarsest.clone();
            self.report.warnings.truncate(n_warnings);
            self.report.left_out.truncate(n_left_out);
            let lit = self.link(parts, effort.options(self.settings.links()))?;
            let now = self.reporter.now();
            let Some((error, gathers)) = self.report.error.zip(self.gathers).filter(|_| !lit.is_cut_short) else {
                return Ok(lit);
            };
            errors.push(error.mean);
            // For a time alone, half the error is as good an aim as any.
            let aim = self.budget.error.map_or(0.5 * error.mean, |e| e.0.max(LEAST_LEFT * error.mean));
            let next = effort.next(&error, aim).filter(|_| !is_stalled(&errors));
            let seconds = now - begin;
            let next_seconds = next.map(|(_, times)| times * seconds);
            let attempt = Attempt { error: error.mean, aim, gathers, now, next: next_seconds };
            match (attempt.choose(&self.budget, self.n_receivers), next) {
                (None, Some((greater, _))) => effort = greater,
                (reading, _) => {
                    let reading = reading.unwrap_or(Reading::Interpolated);
                    self.enter_reading(attempt.expected(reading), reading);
                    return Ok(lit);
                }
            }
            let Lit { scene, bvh, regions, lights, .. } = lit;
            parts = LinkParts { scene, bvh, regions, lights, coarsest };
        }
    }

    fn enter_reading(&mut self, expected: f64, reading: Reading) {
        self.reading = reading;
        self.report.more.insert("expected_error".into(), expected.into());
        if let Reading::Gathered(n_rays) = reading {
            self.report.more.insert("gather_rays".into(), n_rays.into());
        }
        let now = self.reporter.now();
        if let Some(Seconds(time)) = self.budget.time.filter(|t| now > 1.1 * t.0) {
            self.report.warnings.push(format!("the roughest attempt took {now:.1} s; {time} s were asked for"));
        }
        if let Some(Fraction(error)) = self.budget.error.filter(|e| expected > e.0) {
            let [expected, error] = [expected, error].map(crate::values::human_percent);
            self.report.warnings.push(format!("an error of {expected} is expected; {error} was asked for"));
            self.report.converged = false;
            self.report.stop = "error-not-reached";
        }
    }
}

/// Whether the last two attempts were of next to no use.
fn is_stalled(errors: &[f64]) -> bool {
    matches!(errors, [.., before, _, now] if *now > STALLED * before)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ATTEMPT: Attempt = Attempt {
        error: 0.04,
        aim: 0.02,
        gathers: GatherRecord { rays_per_second: 1e6, noise_of_one_ray: 0.256 },
        now: 1.0,
        next: Some(3.5),
    };

    fn budget(error: Option<f64>, time: Option<f64>) -> Budget {
        Budget { error: error.map(Fraction), time: time.map(Seconds) }
    }

    #[test]
    fn a_field_that_is_good_enough_is_interpolated() {
        assert_eq!(ATTEMPT.choose(&budget(Some(0.05), None), 100), Some(Reading::Interpolated));
    }

    #[test]
    fn few_points_are_gathered_and_many_wait_for_a_better_field() {
        let asked = budget(Some(0.01), None);
        let Some(Reading::Gathered(n)) = ATTEMPT.choose(&asked, 100) else { panic!("not gathered") };
        assert!(
            ATTEMPT.expected(Reading::Gathered(n)) <= 0.01 && ATTEMPT.expected(Reading::Gathered(n / 4 * 3)) > 0.01
        );
        assert_eq!(ATTEMPT.choose(&asked, 1_000_000), None);
        // A field this bad is no sender, and without receivers there is nothing to gather.
        assert_eq!(Attempt { error: 0.2, ..ATTEMPT }.choose(&asked, 100), None);
        assert_eq!(ATTEMPT.choose(&asked, 0), None);
    }

    #[test]
    fn time_goes_to_attempts_while_the_next_fits_and_then_to_the_gather() {
        assert_eq!(ATTEMPT.choose(&budget(None, Some(10.0)), 100), None);
        let Some(Reading::Gathered(n)) = ATTEMPT.choose(&budget(None, Some(3.0)), 100) else { panic!("not gathered") };
        let seconds = ATTEMPT.gather_seconds(100, n);
        assert!(seconds <= 2.0 && 1.5 * seconds > 2.0, "{n}");
        // No time for a gather that would be better than the field.
        assert_eq!(ATTEMPT.choose(&budget(None, Some(1.01)), 1000), Some(Reading::Interpolated));
        let last = Attempt { next: None, ..ATTEMPT };
        assert!(last.choose(&budget(Some(1e-4), None), 1_000_000_000).is_some());
    }

    #[test]
    fn attempts_end_when_two_of_them_bring_nothing() {
        assert!(!is_stalled(&[0.02, 0.019]) && !is_stalled(&[0.02, 0.025, 0.015]));
        assert!(is_stalled(&[0.02, 0.019, 0.018]) && is_stalled(&[0.5, 0.02, 0.019, 0.018]));
    }

    fn found(from_rays: f64, from_functions: f64) -> ErrorRow {
        let mean = from_rays.hypot(from_functions);
        ErrorRow { mean, from_rays, from_functions, bound: mean, p95: mean, noise: 0.0, points: 256, rays: 512 }
    }

    #[test]
    fn more_effort_goes_to_what_the_error_comes_from() {
        let (noisy, times) = FIRST.next(&found(0.028, 0.0), 0.03).unwrap();
        assert_eq!((noisy, times), (Effort { n_rays: 128, ..FIRST }, 2.0));
        let (coarse, _) = FIRST.next(&found(0.005, 0.015), 0.01).unwrap();
        assert_eq!(coarse, Effort { functions: 1, ..FIRST });
        let (coarser, _) = FIRST.next(&found(0.005, 0.03), 0.01).unwrap();
        assert_eq!(coarser, Effort { functions: 2, ..FIRST });
        let (both, times) = FIRST.next(&found(0.02, 0.01), 0.01).unwrap();
        assert!(both.functions == 2 && both.n_rays == 256 && times > 8.0, "{both:?} {times}");
    }

    #[test]
    fn attempts_end_somewhere() {
        let (mut effort, mut n) = (FIRST, 0);
        while let Some((greater, times)) = effort.next(&found(0.1, 0.1), 1e-4) {
            assert!(greater.functions >= effort.functions && greater.n_rays >= effort.n_rays && times >= 1.0);
            (effort, n) = (greater, n + 1);
        }
        assert!(n < 10 && effort == Effort { functions: FUNCTIONS.len() - 1, n_rays: MOST_RAYS }, "{effort:?}, {n}");
    }

    #[test]
    fn functions_become_finer() {
        for pair in FUNCTIONS.windows(2) {
            assert!(pair[0].0 <= pair[1].0 && pair[0].1 > pair[1].1);
        }
    }
}
