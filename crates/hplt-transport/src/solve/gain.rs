use hplt_geom::glam::DVec3;
use hplt_geom::{Interrupted, Progress, Rgb};

use super::blocks::{Blocks, Lanes, map2, ratio};
use super::{Unknowns, bicgstab};
use crate::{Error, LinearOperator};

/// How large an error a residual can hide, per component and channel: what turns `r = d + G x - x` into a bound on `x - f`.
///
/// For any `u > 0` with `v = u - G u > 0`, and since `G >= 0`: `|r| <= t v` implies `|x - f| = |(I - G)⁻¹ r| <= t u`
/// (comparison with a barrier, the M-matrix property; Berman & Plemmons 1994, chapter 6). `u = 1` gives the bound
/// `‖r‖∞ / (1 - largest row sum)`. Where a few rows sum to nearly 1 and most do not, that is far too large; there `u` is an
/// approximate solution of `u = 1 + G u`, which makes `max u` the norm of `(I - G)⁻¹`. Any approximation is rigorous, because
/// `v` is computed from it.
///
/// It depends on the operator alone: build it once, use it for every light.
#[derive(Debug, Clone)]
pub struct Gain {
    u: Vec<DVec3>,
    v: Vec<DVec3>,
    max_u: Lanes,
    norm: Lanes,
    min_row_sum: Lanes,
    max_row_sum: Lanes,
    sweeps: usize,
}

/// Row sums from here on count as 1.
const WHITE: f64 = 1.0 - 1e-6;

impl Gain {
    /// The gain of `g` in each component.
    ///
    /// # Errors
    /// When interrupted.
    pub fn build(g: &dyn LinearOperator, unknowns: &Unknowns<'_>, progress: &dyn Progress) -> Result<Self, Error> {
        progress.check()?;
        Ok(Self::of_blocks(g, &Blocks::new(unknowns), progress)?)
    }

    fn of_blocks(g: &dyn LinearOperator, blocks: &Blocks, progress: &dyn Progress) -> Result<Self, Interrupted> {
        let sums = g.row_sums();
        let max_row_sum = blocks.fold(DVec3::ZERO, |max, i| max.max(sums[i]));
        let min_row_sum = blocks.fold(DVec3::INFINITY, |min, i| min.min(sums[i]));
        let mean_row_sum = blocks.mean(&sums);
        let u = vec![DVec3::ONE; blocks.len()];
        let v = slack(&u, &sums, g.rounding());
        let mut gain = Self::new(blocks, u, v);
        (gain.max_row_sum, gain.min_row_sum) = (max_row_sum, min_row_sum);
        // Worth another look where the worst row is much worse than the mean one, unless nothing can help.
        let is_loose = (0..blocks.n_components()).any(|c| {
            (0..3).any(|k| {
                let (max, min) = (gain.max_row_sum[c][k], gain.min_row_sum[c][k]);
                min < WHITE && (max >= 1.0 || (1.0 - mean_row_sum[c][k]) > 2.0 * (1.0 - max))
            })
        });
        if is_loose {
            gain.tighten(g, blocks, progress)?;
        }
        Ok(gain)
    }

    fn new(blocks: &Blocks, u: Vec<DVec3>, v: Vec<DVec3>) -> Self {
        let max_u = blocks.fold(DVec3::ZERO, |max, i| max.max(u[i]));
        let largest = blocks.fold(DVec3::ZERO, |max, i| {
            // 1/v, infinite unless both are positive.
            max.max(map2(u[i], v[i], |u, v| if u > 0.0 && v > 0.0 { 1.0 / v } else { f64::INFINITY }))
        });
        let norm = max_u.iter().zip(&largest).map(|(&u, &w)| map2(u, w, |u, w| if u > 0.0 { u * w } else { 0.0 }));
        let none = vec![DVec3::ZERO; blocks.n_components()];
        Self { norm: norm.collect(), u, v, max_u, min_row_sum: none.clone(), max_row_sum: none, sweeps: 0 }
    }

    /// Replaces `u` where an approximate solution of `u = 1 + G u` bounds better.
    fn tighten(&mut self, g: &dyn LinearOperator, blocks: &Blocks, progress: &dyn Progress) -> Result<(), Interrupted> {
        let (mut u, sweeps) = bicgstab::solve_ones(g, blocks, progress)?;
        let mut gu = vec![DVec3::ZERO; u.len()];
        // One sweep more: it keeps u positive where Krylov noise did not, and costs nothing but its product.
        g.apply(&u, &mut gu);
        u.iter_mut().zip(&gu).for_each(|(u, gu)| *u = DVec3::ONE + *gu);
        g.apply(&u, &mut gu);
        let v = slack(&u, &gu, g.rounding());
        let better = Self::new(blocks, u, v);
        for i in 0..blocks.len() {
            for k in 0..3 {
                if better.norm[blocks.of(i)][k] < self.norm[blocks.of(i)][k] {
                    (self.u[i][k], self.v[i][k]) = (better.u[i][k], better.v[i][k]);
                }
            }
        }
        let updated = Self::new(blocks, std::mem::take(&mut self.u), std::mem::take(&mut self.v));
        let (max_row_sum, min_row_sum) = (std::mem::take(&mut self.max_row_sum), std::mem::take(&mut self.min_row_sum));
        *self = Self { max_row_sum, min_row_sum, sweeps: sweeps + 2, ..updated };
        Ok(())
    }

    /// Products with the operator that it took; 0 where row sums say enough.
    pub fn sweeps(&self) -> usize {
        self.sweeps
    }

    /// Bound on `‖(I - G)⁻¹‖∞` in a component: how much a uniform light can grow.
    pub fn norm(&self, component: usize) -> Rgb {
        self.norm[component].as_vec3()
    }

    /// Largest row sum of a component.
    pub fn max_row_sum(&self, component: usize) -> Rgb {
        self.max_row_sum[component].as_vec3()
    }

    /// Whether no row of a component loses light in channel `k`.
    pub(crate) fn is_white(&self, component: usize, k: usize) -> bool {
        let min = self.min_row_sum[component][k];
        min.is_finite() && min >= WHITE
    }

    /// Bound on the error of an `x` whose residual is `r`.
    pub(crate) fn error(&self, blocks: &Blocks, r: &[DVec3]) -> Lanes {
        self.largest(blocks, |i| r[i], &self.max_u)
    }

    /// Bound on the error of `d + G x`, `r` being the residual of `x`: `|G(x - f)| <= t G u = t (u - v)`.
    pub(crate) fn error_after_sweep(&self, blocks: &Blocks, r: &[DVec3]) -> Lanes {
        let max_gu = blocks.fold(DVec3::ZERO, |max, i| max.max(self.u[i] - self.v[i]));
        self.largest(blocks, |i| r[i], &max_gu)
    }

    /// Bound on the error of an `x` to which a sweep of Gauss-Seidel added `step`: the residual is at most
    /// `G|step| <= s G u = s (u - v)`, `s` being the largest `|step|/u`.
    pub(crate) fn error_after_step(&self, blocks: &Blocks, step: &[DVec3]) -> Lanes {
        let s = blocks.fold(DVec3::ZERO, |max, i| max.max(ratio(step[i].abs(), self.u[i])));
        self.largest(blocks, |i| s[blocks.of(i)] * (self.u[i] - self.v[i]), &self.max_u)
    }

    /// `t·scale` with the least `t` for which `|r| <= t v`, in each lane; infinite where light remains and there is no gain.
    fn largest(&self, blocks: &Blocks, r: impl Fn(usize) -> DVec3, scale: &Lanes) -> Lanes {
        let per_slack = |r: f64, v: f64| match r {
            0.0 => 0.0,
            _ if v > 0.0 => r / v,
            _ => f64::INFINITY,
        };
        let t = blocks.fold(DVec3::ZERO, |max, i| max.max(map2(r(i).abs(), self.v[i], per_slack)));
        let bound = |c: usize| {
            let is_bounded = map2(self.norm[c], t[c], |norm, t| if norm.is_finite() || t == 0.0 { 1.0 } else { 0.0 });
            map2(map2(t[c], scale[c], |t, u| if t == 0.0 { 0.0 } else { t * u }), is_bounded, |e, is_bounded| {
                if is_bounded == 1.0 { e } else { f64::INFINITY }
            })
        };
        (0..blocks.n_components()).map(bound).collect()
    }
}

/// `u - G u` less what rounding may have added.
fn slack(u: &[DVec3], gu: &[DVec3], rounding: f64) -> Vec<DVec3> {
    u.iter().zip(gu).map(|(&u, &gu)| u - gu - rounding * (u.abs() + gu.abs())).collect()
}
