//! Solves `f = d + G f`, all bounces at once, to a known error.

mod bicgstab;
mod blocks;
mod coarse;
mod gain;
mod gauss_seidel;
mod gmres;
mod report;
mod run;
mod southwell;
mod system;

use hplt_geom::glam::DVec3;
use hplt_geom::{Progress, Rgb};

pub use gain::Gain;
pub use report::{ComponentReport, SolveReport, SolveStop};
pub use system::System;

use crate::{Error, LinearOperator};
pub(crate) use blocks::{Blocks, Lanes};
use run::Problem;

/// What the solver knows of the unknowns, by flat index.
#[derive(Debug, Clone, Copy)]
pub struct Unknowns<'a> {
    /// The region of each unknown; light does not pass between regions.
    pub components: &'a [u32],
    /// How many regions there are.
    pub n_components: usize,
    /// Weights of the mean irradiance of a region, such as areas, m²; 0 leaves an unknown out of it.
    pub areas: &'a [f32],
}

/// How to solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// GMRES; with the coarse level where light lives for 20 bounces or more, which is where that pays. Restarts after 20.
    Auto,
    /// Jacobi: the Neumann series, one bounce a sweep.
    Bounces,
    /// Every row in turn with what the rows before it just found.
    GaussSeidel,
    /// Shooting: the largest residuals first (Southwell 1946; progressive refinement, Cohen et al. 1988). Everything above
    /// half of the largest residual of its component and channel is shot in one pass.
    Southwell,
    /// BiCGStab (van der Vorst 1992); two products an iteration.
    BiCgStab,
    /// GMRES (Saad & Schultz 1986); one product an iteration.
    Gmres {
        /// Iterations before it starts afresh; it keeps one vector for each.
        restart: usize,
    },
    /// The same, preconditioned from the right by a coarse level of aggregates, about one for a room: light that is even in white rooms and
    /// takes long to pass between them is solved at once. As [`Gmres`](Self::Gmres) where the operator shows no rows, or is
    /// made of too many places.
    CoarseGmres {
        /// As for [`Gmres`](Self::Gmres).
        restart: usize,
    },
}

/// Options of [`solve`].
#[derive(Debug, Clone, PartialEq)]
pub struct SolveOptions {
    /// The method.
    pub method: Method,
    /// Stop once the error bound is below this fraction of the mean irradiance, in every component and channel.
    pub tolerance: f32,
    /// Sweeps to compute at most: products with the operator, or their equivalent in entries read.
    pub max_sweeps: usize,
}

impl Default for SolveOptions {
    /// By itself to 0.1 %.
    fn default() -> Self {
        Self { method: Method::Auto, tolerance: 1e-3, max_sweeps: 10_000 }
    }
}

impl SolveOptions {
    fn check(&self) -> Result<(), Error> {
        let fail = |name, value, expected| Err(Error::Option { name, value, expected });
        if !(self.tolerance >= 0.0 && self.tolerance.is_finite()) {
            return fail("tolerance", self.tolerance.into(), "a finite number, 0 or more");
        }
        if self.max_sweeps == 0 {
            return fail("max_sweeps", 0.0, "1 or more");
        }
        if matches!(self.method, Method::Gmres { restart: 0 } | Method::CoarseGmres { restart: 0 }) {
            return fail("restart", 0.0, "1 or more");
        }
        Ok(())
    }
}

/// The solution of `f = d + G f`, W/m², and how it was reached.
///
/// ```text
/// |x - f| <= max|r|·‖(I - G)⁻¹‖∞          r = d + G x - x       per component and channel, relative to its mean of f
/// ```
///
/// `G` has no negative entries. Every component and channel is solved as if it were alone, with scalars of its own, so that
/// rooms of any brightness are equally exact. Running out of sweeps, or an interruption, is told in the report; what is
/// returned then is the best so far, and its bound holds.
///
/// # Errors
/// When an option is out of range, `d` is not finite (the function of the error is the flat index), or a component is lit and
/// its rows all sum to 1.
///
/// # Panics
/// When lengths differ, or an entry of `G` joins two components.
pub fn solve(
    g: &dyn LinearOperator,
    d: &[Rgb],
    unknowns: &Unknowns<'_>,
    options: &SolveOptions,
    progress: &dyn Progress,
) -> Result<(Vec<Rgb>, SolveReport), Error> {
    let mut solutions = solve_many(g, &[d], unknowns, options, progress)?;
    Ok(solutions.pop().expect("one solution per right-hand side"))
}

/// As [`solve`], for several right-hand sides, such as groups of lights: the gain of the operator is computed once.
///
/// # Errors
/// As [`solve`].
///
/// # Panics
/// As [`solve`].
pub fn solve_many(
    g: &dyn LinearOperator,
    d: &[&[Rgb]],
    unknowns: &Unknowns<'_>,
    options: &SolveOptions,
    progress: &dyn Progress,
) -> Result<Vec<(Vec<Rgb>, SolveReport)>, Error> {
    let gain = Gain::build(g, unknowns, progress)?;
    d.iter().map(|d| solve_with_gain(g, &gain, d, options, progress)).collect()
}

/// As [`solve`], with the gain of the operator (and its components) from before: changed lights need no other preparation.
///
/// # Errors
/// As [`solve`].
///
/// # Panics
/// When lengths differ.
pub fn solve_with_gain(
    g: &dyn LinearOperator,
    gain: &Gain,
    d: &[Rgb],
    options: &SolveOptions,
    progress: &dyn Progress,
) -> Result<(Vec<Rgb>, SolveReport), Error> {
    solve_from(g, gain, d, None, options, progress)
}

/// As [`solve_with_gain`], beginning at `start` when there is one, such as what is known of similar light. A start within the
/// tolerance costs one sweep, which proves that.
///
/// # Errors
/// As [`solve`]; also when `start` is not finite.
///
/// # Panics
/// When lengths differ.
pub fn solve_from(
    g: &dyn LinearOperator,
    gain: &Gain,
    d: &[Rgb],
    start: Option<&[Rgb]>,
    options: &SolveOptions,
    progress: &dyn Progress,
) -> Result<(Vec<Rgb>, SolveReport), Error> {
    options.check()?;
    assert!(start.is_none_or(|start| start.len() == d.len()), "one value per unknown");
    assert!(d.len() == g.len() && gain.blocks().len() == g.len(), "one value per unknown");
    if let Some(function) = d.iter().chain(start.unwrap_or_default()).position(|d| !d.is_finite()) {
        let function = function % d.len();
        return Err(Error::NotFinite { bounce: 0, level: 0, function });
    }
    let d: Vec<DVec3> = d.iter().map(|d| d.as_dvec3()).collect();
    let problem = Problem::new(g, gain, &d, f64::from(options.tolerance));
    problem.check_finite_solution()?;
    let start = start.map(|start| start.iter().map(|x| x.as_dvec3()).collect());
    let (x, report) = run::run(&problem, start, options, progress);
    match x.iter().position(|x| !x.is_finite()) {
        Some(function) => Err(Error::NotFinite { bounce: report.sweeps, level: 0, function }),
        None => Ok((x, report)),
    }
}
