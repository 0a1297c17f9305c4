use hplt_geom::glam::DVec3;
use hplt_geom::{Progress, Rgb};

use super::blocks::{Blocks, Lanes, map2, ratio};
use super::coarse::Coarse;
use super::{
    ComponentReport, Gain, Method, SolveOptions, SolveReport, SolveStop, bicgstab, gauss_seidel, gmres, southwell,
};
use crate::{Error, LinearOperator};

/// Steps of a cycle of GMRES.
const RESTART: usize = 20;
/// Half a unit in the last place of the `f32` that is returned.
const ROUNDING: f64 = f32::EPSILON as f64 / 2.0;

/// `f = d + G f`, and how good an `x` is.
pub(crate) struct Problem<'a> {
    pub g: &'a dyn LinearOperator,
    pub gain: &'a Gain,
    pub blocks: &'a Blocks,
    pub d: &'a [DVec3],
    pub tolerance: f64,
    pub max_d: Lanes,
    mean_d: Lanes,
    /// Without negative values in `d`, its mean is a lower bound of that of `f`.
    is_positive: bool,
}

/// Bounds of an `x`, relative to the mean, per component and channel.
pub(crate) struct Bounds {
    /// On `|x - f|`.
    pub solver: Lanes,
    /// On what is lost by rounding to `f32`.
    pub rounding: Lanes,
}

impl<'a> Problem<'a> {
    pub fn new(g: &'a dyn LinearOperator, gain: &'a Gain, d: &'a [DVec3], tolerance: f64) -> Self {
        let blocks = gain.blocks();
        let (max_d, mean_d) = (blocks.max_abs(d), means_with_light(blocks, d));
        let is_positive = d.iter().all(|d| d.min_element() >= 0.0);
        Self { g, gain, blocks, d, tolerance, max_d, mean_d, is_positive }
    }

    /// # Errors
    /// With the first component whose light never dies.
    pub fn check_finite_solution(&self) -> Result<(), Error> {
        let is_endless = |c: usize| (0..3).any(|k| self.gain.is_white(c, k) && self.max_d[c][k] > 0.0);
        match (0..self.blocks.n_components()).position(is_endless) {
            Some(region) => Err(Error::NoFiniteSolution { region: region as u32 }),
            None => Ok(()),
        }
    }

    /// Sets to zero what belongs to unknowns that nobody reads.
    pub fn keep_read(&self, values: &mut [DVec3]) {
        let unread = values.iter_mut().zip(self.gain.is_read()).filter(|(_, is_read)| !**is_read);
        unread.for_each(|(value, _)| *value = DVec3::ZERO);
    }

    fn is_dark(&self) -> bool {
        self.max_d.iter().all(|d| *d == DVec3::ZERO)
    }

    /// Bounds of `x`, of which `error` is the absolute one.
    pub fn relative(&self, x: &[DVec3], error: &Lanes) -> Bounds {
        let (mean, max) = (self.blocks.mean(x), self.blocks.max_abs(x));
        let floor = |c: usize| {
            let least = (mean[c].abs() - error[c]).max(DVec3::ZERO);
            if self.is_positive { least.max(self.mean_d[c]) } else { least }
        };
        let relative = |e: DVec3, c: usize| {
            map2(e, floor(c), |e, mean| match e {
                0.0 => 0.0,
                _ if mean > 0.0 => e / mean,
                _ => f64::INFINITY,
            })
        };
        let n = self.blocks.n_components();
        Bounds {
            solver: (0..n).map(|c| relative(error[c], c)).collect(),
            rounding: (0..n).map(|c| relative(ROUNDING * (max[c] + error[c]), c)).collect(),
        }
    }

    /// Whether nothing more is to be had: the error is within the tolerance, or as small as the numbers are fine.
    pub fn is_enough(&self, bounds: &Bounds) -> bool {
        bounds.largest() <= self.tolerance || bounds.is_rounding(self.tolerance)
    }

    /// The same for an `x` whose absolute error is at most `error`.
    pub fn is_good(&self, x: &[DVec3], error: &Lanes) -> bool {
        self.is_enough(&self.relative(x, error))
    }

    /// The largest residual, relative to the largest direct irradiance of its lane.
    pub fn relative_residual(&self, r: &[DVec3]) -> f32 {
        let max = self.blocks.max_abs(r);
        max.iter().zip(&self.max_d).map(|(&r, &d)| ratio(r, d).max_element()).fold(0.0, f64::max) as f32
    }
}

/// Means by component and channel. Where all that is lit is unknowns that the mean leaves out, such as fine functions where every
/// coarse one is dark, the mean over all unknowns: an error needs something to be relative to.
fn means_with_light(blocks: &Blocks, d: &[DVec3]) -> Lanes {
    let sums = blocks.fold(DVec3::ZERO, |sum, i| sum + d[i]);
    let counts = blocks.fold(DVec3::ZERO, |count, _| count + DVec3::ONE);
    let mean = |((mean, sum), count): ((DVec3, DVec3), DVec3)| {
        map2(mean, ratio(sum, count), |mean, of_all| if mean == 0.0 { of_all } else { mean })
    };
    blocks.mean(d).into_iter().zip(sums).zip(counts).map(mean).collect()
}

impl Bounds {
    pub fn largest(&self) -> f64 {
        let sum = self.solver.iter().zip(&self.rounding).map(|(&a, &b)| (a + b).max_element());
        sum.fold(0.0, f64::max)
    }

    /// Whether the solver's part vanishes in rounding wherever it is above the tolerance.
    fn is_rounding(&self, tolerance: f64) -> bool {
        let is_small = |a: f64, b: f64| a + b <= tolerance || a <= 0.1 * b;
        self.solver.iter().zip(&self.rounding).all(|(a, b)| (0..3).all(|k| is_small(a[k], b[k])))
    }
}

/// Why a method cannot go on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Halt {
    OutOfSweeps,
    Interrupted,
}

/// The account of a solve.
pub(crate) struct Run<'a> {
    progress: &'a dyn Progress,
    max_sweeps: usize,
    pub sweeps: usize,
    pub history: Vec<f32>,
}

impl<'a> Run<'a> {
    pub fn new(max_sweeps: usize, progress: &'a dyn Progress) -> Self {
        Self { progress, max_sweeps, sweeps: 0, history: Vec::new() }
    }

    /// Enters one sweep before it is made. Methods leave the last one to the final check.
    pub fn begin_sweep(&mut self) -> Result<(), Halt> {
        if self.sweeps + 1 >= self.max_sweeps {
            return Err(Halt::OutOfSweeps);
        }
        self.progress.check().map_err(|_| Halt::Interrupted)?;
        self.count();
        Ok(())
    }

    fn count(&mut self) {
        self.sweeps += 1;
        self.progress.advance("solve", self.sweeps as u64, 0);
    }

    /// `out = x - G x`, one sweep.
    pub fn product(&mut self, g: &dyn LinearOperator, x: &[DVec3], out: &mut [DVec3]) -> Result<(), Halt> {
        self.begin_sweep()?;
        g.apply(x, out);
        out.iter_mut().zip(x).for_each(|(out, x)| *out = *x - *out);
        Ok(())
    }

    /// The same to about single precision for the unknowns that are read, one sweep.
    pub fn rough_product(&mut self, problem: &Problem<'_>, x: &[DVec3], out: &mut [DVec3]) -> Result<(), Halt> {
        self.begin_sweep()?;
        problem.g.apply_roughly(x, problem.gain.is_read(), out);
        out.iter_mut().zip(x).for_each(|(out, x)| *out = *x - *out);
        Ok(())
    }
}

/// Solves, and checks what it claims with a residual computed afresh. A `start` is checked before anything else is done.
pub(crate) fn run(
    problem: &Problem<'_>,
    start: Option<Vec<DVec3>>,
    options: &SolveOptions,
    progress: &dyn Progress,
) -> (Vec<Rgb>, SolveReport) {
    let mut run = Run::new(options.max_sweeps, progress);
    let mut has_start = start.is_some();
    let mut x = start.unwrap_or_else(|| problem.d.to_vec());
    let asked = match (options.method, problem.gain.coarse()) {
        (Method::Auto, Some(_)) => Method::CoarseGmres { restart: RESTART },
        (Method::Auto, None) => Method::Gmres { restart: RESTART },
        (asked, _) => asked,
    };
    if problem.is_dark() {
        return (vec![Rgb::ZERO; x.len()], empty_report(problem, asked, SolveStop::NoLight));
    }
    let (mut method, mut fell_back_after) = (asked, None);
    let mut checked: Option<Checked> = None;
    let (best, stop) = loop {
        let halt = match progress.check() {
            Ok(()) if has_start => None,
            Ok(()) => advance(method, problem, &mut x, &mut run).err(),
            Err(_) => Some(Halt::Interrupted),
        };
        let now = check(problem, &x, &mut run);
        let stood_still = checked.as_ref().is_some_and(|before| now.bound > 0.5 * before.bound);
        x.clone_from(&now.x);
        let best = match checked.take() {
            Some(before) if before.bound < now.bound => before,
            _ => now,
        };
        if let Some(stop) = stop_of(problem, &best, halt, &run) {
            break (best, stop);
        }
        // A start that is not enough says nothing about the method.
        if std::mem::take(&mut has_start) {
            continue;
        }
        if stood_still && !matches!(method, Method::Bounces) && fell_back_after.is_none() {
            fell_back_after = Some(run.sweeps);
            x.clone_from(&best.x);
            method = if problem.g.rows().is_some() { Method::GaussSeidel } else { Method::Bounces };
        }
        checked = Some(best);
    };
    finish(problem, asked, fell_back_after, stop, best, run)
}

fn stop_of(problem: &Problem<'_>, best: &Checked, halt: Option<Halt>, run: &Run<'_>) -> Option<SolveStop> {
    if best.bound <= problem.tolerance {
        Some(SolveStop::Converged)
    } else if best.is_rounding {
        Some(SolveStop::Rounding)
    } else if halt == Some(Halt::Interrupted) {
        Some(SolveStop::Interrupted)
    } else if run.sweeps >= run.max_sweeps {
        Some(SolveStop::MaxSweeps)
    } else {
        None
    }
}

fn advance(method: Method, problem: &Problem<'_>, x: &mut [DVec3], run: &mut Run<'_>) -> Result<(), Halt> {
    match (method, problem.g.rows()) {
        (Method::GaussSeidel, Some(rows)) => gauss_seidel::advance(problem, rows, x, run),
        (Method::Southwell, Some(rows)) => southwell::advance(problem, rows, x, run),
        (Method::BiCgStab, _) => bicgstab::advance(problem, x, run),
        (Method::Gmres { restart }, _) => gmres::advance(problem, restart, None, x, run),
        (Method::CoarseGmres { restart }, rows) => {
            let made = match (problem.gain.coarse(), rows) {
                (None, Some(rows)) => Coarse::build(rows, problem.gain.is_read()),
                _ => None,
            };
            gmres::advance(problem, restart, problem.gain.coarse().or(made.as_ref()), x, run)
        }
        // The check after every advance is one bounce.
        (Method::Auto | Method::Bounces | Method::GaussSeidel | Method::Southwell, _) => Ok(()),
    }
}

/// An `x` with bounds that hold.
struct Checked {
    x: Vec<DVec3>,
    residual: Lanes,
    bounds: Bounds,
    bound: f64,
    is_rounding: bool,
}

/// One sweep: the true residual of `x`, and `d + G x`, which is better than `x`.
fn check(problem: &Problem<'_>, x: &[DVec3], run: &mut Run<'_>) -> Checked {
    run.count();
    let mut y = vec![DVec3::ZERO; x.len()];
    problem.g.apply(x, &mut y);
    let mut r = vec![DVec3::ZERO; x.len()];
    let rounding = problem.g.rounding();
    let mut computed = r.clone();
    for i in 0..x.len() {
        let gx = y[i];
        y[i] = problem.d[i] + gx;
        computed[i] = y[i] - x[i];
        // Nobody would notice if it had been that all the time.
        if !problem.gain.is_read()[i] {
            computed[i] = DVec3::ZERO;
            continue;
        }
        // What rounding may hide counts as residual.
        r[i] = computed[i].abs() + rounding * (gx.abs() + x[i].abs() + problem.d[i].abs());
    }
    run.history.push(problem.relative_residual(&computed));
    let bounds = problem.relative(&y, &problem.gain.error_after_sweep(&r));
    let (bound, is_rounding) = (bounds.largest(), bounds.is_rounding(problem.tolerance));
    Checked { x: y, residual: problem.blocks.max_abs(&computed), bounds, bound, is_rounding }
}

fn finish(
    problem: &Problem<'_>,
    method: Method,
    fell_back_after: Option<usize>,
    stop: SolveStop,
    checked: Checked,
    run: Run<'_>,
) -> (Vec<Rgb>, SolveReport) {
    let mut report = empty_report(problem, method, stop);
    (report.fell_back_after, report.sweeps, report.residual_history) = (fell_back_after, run.sweeps, run.history);
    let mean = problem.blocks.mean(&checked.x);
    for (c, component) in report.components.iter_mut().enumerate() {
        component.residual = checked.residual[c].as_vec3();
        component.mean = mean[c].as_vec3();
        component.bound = (checked.bounds.solver[c] + checked.bounds.rounding[c]).as_vec3();
    }
    report.bound = checked.bound as f32;
    (checked.x.iter().map(|x| x.as_vec3()).collect(), report)
}

fn empty_report(problem: &Problem<'_>, method: Method, stop: SolveStop) -> SolveReport {
    let component = |c: usize| ComponentReport {
        max_row_sum: problem.gain.max_row_sum(c),
        gain: problem.gain.norm(c),
        residual: Rgb::ZERO,
        mean: Rgb::ZERO,
        bound: Rgb::ZERO,
    };
    SolveReport {
        method,
        fell_back_after: None,
        sweeps: 0,
        residual_history: Vec::new(),
        bound: 0.0,
        stop,
        components: (0..problem.blocks.n_components()).map(component).collect(),
    }
}
