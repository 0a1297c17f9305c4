use hplt_geom::Rgb;

use super::Method;

/// Why a solve ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SolveStop {
    /// The error bound is below the tolerance.
    Converged,
    /// As many sweeps as asked for.
    MaxSweeps,
    /// What is left is rounding: the tolerance is finer than the numbers.
    Rounding,
    /// The caller interrupted; one sweep more told how good the solution was by then.
    Interrupted,
    /// Nothing is lit; the solution is zero.
    NoLight,
}

/// How a solution was reached, and how good it is.
#[derive(Debug, Clone, PartialEq)]
pub struct SolveReport {
    /// The method asked for, or what [`Method::Auto`] took.
    pub method: Method,
    /// Sweeps after which Gauss-Seidel (or bounces, where the operator shows no rows) took over because the method stood
    /// still.
    pub fell_back_after: Option<usize>,
    /// Products with the operator, or their equivalent in entries read.
    pub sweeps: usize,
    /// After each sweep: the largest residual, relative to the largest direct irradiance of its component and channel. Each
    /// method's running account; the bound at the end is computed afresh.
    pub residual_history: Vec<f32>,
    /// Bound on the error, relative to the mean irradiance of its component and channel; the largest of all. Rounding of the
    /// result to `f32` is in it.
    pub bound: f32,
    /// Why it ended.
    pub stop: SolveStop,
    /// Per component.
    pub components: Vec<ComponentReport>,
}

/// One component of a solution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComponentReport {
    /// Largest row sum: the largest fraction of a uniform light that any unknown receives again.
    pub max_row_sum: Rgb,
    /// Bound on `‖(I - G)⁻¹‖∞`.
    pub gain: Rgb,
    /// Largest residual, W/m², before the last sweep.
    pub residual: Rgb,
    /// Mean irradiance, direct included, W/m².
    pub mean: Rgb,
    /// Bound on the error, relative to the mean; 0 in channels without light.
    pub bound: Rgb,
}

impl SolveReport {
    /// Whether the error bound is below the tolerance.
    pub fn is_converged(&self) -> bool {
        matches!(self.stop, SolveStop::Converged | SolveStop::NoLight)
    }
}
