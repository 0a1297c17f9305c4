use hplt_geom::glam::DVec3;
use hplt_geom::{Progress, Rgb};

use super::blocks::{Blocks, Lanes, map2, ratio};
use super::coarse::Coarse;
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
    blocks: Blocks,
    barrier: Barrier,
    min_row_sum: Lanes,
    max_row_sum: Lanes,
    /// Unknowns that others read, or that means are taken over. The rest follow from them by one sweep.
    is_read: Vec<bool>,
    /// Where light lives long.
    coarse: Option<Coarse>,
    sweeps: usize,
}

/// `u`, `v = u - G u`, and what follows from them.
#[derive(Debug, Clone)]
struct Barrier {
    u: Vec<DVec3>,
    v: Vec<DVec3>,
    max_u: Lanes,
    max_gu: Lanes,
    /// `max u · max 1/v`, infinite unless both are positive everywhere in the lane.
    norm: Lanes,
}

/// Light that grows by this much, over as many bounces, is worth a coarse level. Measured: a quarter of the sweeps in one room, two
/// fifths in eight; at half that gain a sixth, which its exact products and its making cost again.
const LONG_LIVED: f64 = 20.0;
/// Row sums from here on count as 1.
const WHITE: f64 = 1.0 - 1e-6;

impl Gain {
    /// The gain of `g` in each component.
    ///
    /// # Errors
    /// When interrupted.
    ///
    /// # Panics
    /// When lengths differ, or an entry of `g` joins two components.
    pub fn build(g: &dyn LinearOperator, unknowns: &Unknowns<'_>, progress: &dyn Progress) -> Result<Self, Error> {
        progress.check()?;
        assert_eq!(unknowns.components.len(), g.len(), "one component per unknown");
        let blocks = Blocks::new(unknowns);
        if let Some(rows) = g.rows() {
            assert!(blocks.joined_by(rows).is_none(), "light does not pass between components");
        }
        Self::of(g, blocks, &[], progress)
    }

    /// The gain of `g`, of which no entry joins two components, with the [`barrier`](Self::barrier) of such a gain from before or
    /// none. One sweep computes what it is good for: a wrong one bounds loosely, never wrongly.
    pub(crate) fn of(
        g: &dyn LinearOperator,
        blocks: Blocks,
        barrier: &[Rgb],
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let sums = g.row_sums();
        let ones = Barrier::new(&blocks, vec![DVec3::ONE; blocks.len()], &sums, g.rounding());
        let mut gain = Self {
            max_row_sum: blocks.fold(DVec3::ZERO, |max, i| max.max(sums[i])),
            min_row_sum: blocks.fold(DVec3::INFINITY, |min, i| min.min(sums[i])),
            barrier: ones,
            is_read: is_read(g, &blocks),
            coarse: None,
            sweeps: 0,
            blocks,
        };
        if !barrier.is_empty() {
            gain.improve(g, barrier.iter().map(|u| u.as_dvec3()).collect());
        } else if gain.is_loose(&gain.blocks.mean(&sums)) {
            gain.tighten(g, progress)?;
        }
        if gain.barrier.norm.iter().any(|norm| norm.max_element() >= LONG_LIVED) {
            gain.coarse = g.rows().and_then(|rows| Coarse::build(rows, &gain.is_read));
        }
        Ok(gain)
    }

    /// The barrier `u`, to single precision; empty where row sums say enough.
    pub fn barrier(&self) -> Vec<Rgb> {
        if self.sweeps == 0 { Vec::new() } else { self.barrier.u.iter().map(|u| u.as_vec3()).collect() }
    }

    /// Whether the worst row is so much worse than the mean one that a second look may pay, and something can help.
    fn is_loose(&self, mean_row_sum: &Lanes) -> bool {
        let is_loose = |c: usize, k: usize| {
            let (max, min) = (self.max_row_sum[c][k], self.min_row_sum[c][k]);
            min < WHITE && (max >= 1.0 || (1.0 - mean_row_sum[c][k]) > 2.0 * (1.0 - max))
        };
        (0..self.blocks.n_components()).any(|c| (0..3).any(|k| is_loose(c, k)))
    }

    /// Takes an approximate solution of `u = 1 + G u` in the lanes where it bounds better.
    fn tighten(&mut self, g: &dyn LinearOperator, progress: &dyn Progress) -> Result<(), Error> {
        let (mut u, sweeps) = bicgstab::solve_ones(g, &self.blocks, progress)?;
        let mut gu = vec![DVec3::ZERO; u.len()];
        // One sweep more keeps u positive where Krylov noise did not.
        g.apply(&u, &mut gu);
        u.iter_mut().zip(&gu).for_each(|(u, gu)| *u = DVec3::ONE + *gu);
        self.improve(g, u);
        self.sweeps += sweeps + 1;
        Ok(())
    }

    /// Takes `u` in the lanes where it bounds better: one sweep.
    fn improve(&mut self, g: &dyn LinearOperator, u: Vec<DVec3>) {
        let mut gu = vec![DVec3::ZERO; u.len()];
        g.apply(&u, &mut gu);
        self.barrier.improve(&self.blocks, &Barrier::new(&self.blocks, u, &gu, g.rounding()));
        self.sweeps += 1;
    }

    /// Products with the operator that it took; 0 where row sums say enough.
    pub fn sweeps(&self) -> usize {
        self.sweeps
    }

    /// Bound on `‖(I - G)⁻¹‖∞` in a component: how much a uniform light can grow.
    pub fn norm(&self, component: usize) -> Rgb {
        self.barrier.norm[component].as_vec3()
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

    /// Unknowns that others read, or that means are taken over. What the rest are before a sweep is of no account.
    pub(crate) fn is_read(&self) -> &[bool] {
        &self.is_read
    }

    /// The coarse level, where light lives long enough for it.
    pub(crate) fn coarse(&self) -> Option<&Coarse> {
        self.coarse.as_ref()
    }

    /// The unknowns by component.
    pub(crate) fn blocks(&self) -> &Blocks {
        &self.blocks
    }

    /// Bound on the error of an `x` whose residual is `r`.
    pub(crate) fn error(&self, r: &[DVec3]) -> Lanes {
        self.largest(|i| r[i], &self.barrier.max_u)
    }

    /// Bound on the error of `d + G x`, `r` being the residual of `x`: `|G(x - f)| <= t G u`.
    pub(crate) fn error_after_sweep(&self, r: &[DVec3]) -> Lanes {
        self.largest(|i| r[i], &self.barrier.max_gu)
    }

    /// Bound on the error of an `x` to which a sweep of Gauss-Seidel added `step`: the residual is at most
    /// `G|step| <= s G u`, `s` being the largest `|step|/u`.
    pub(crate) fn error_after_step(&self, step: &[DVec3]) -> Lanes {
        let (blocks, u, v) = (&self.blocks, &self.barrier.u, &self.barrier.v);
        let s = blocks.fold(DVec3::ZERO, |max, i| max.max(ratio(step[i].abs(), u[i])));
        self.largest(|i| s[blocks.of(i)] * (u[i] - v[i]), &self.barrier.max_u)
    }

    /// `t·scale` with the least `t` for which `|r| <= t v`, in each lane; infinite where light remains and there is no gain.
    fn largest(&self, r: impl Fn(usize) -> DVec3, scale: &Lanes) -> Lanes {
        let per_slack = |r: f64, v: f64| match r {
            0.0 => 0.0,
            _ if v > 0.0 => r / v,
            _ => f64::INFINITY,
        };
        let t = self.blocks.fold(DVec3::ZERO, |max, i| max.max(map2(r(i).abs(), self.barrier.v[i], per_slack)));
        let bound = |t: f64, scale: f64, norm: f64| match t {
            0.0 => 0.0,
            _ if norm.is_finite() => t * scale,
            _ => f64::INFINITY,
        };
        let lane = |c: usize| {
            let (t, scale, norm) = (t[c], scale[c], self.barrier.norm[c]);
            DVec3::new(bound(t.x, scale.x, norm.x), bound(t.y, scale.y, norm.y), bound(t.z, scale.z, norm.z))
        };
        (0..self.blocks.n_components()).map(lane).collect()
    }
}

fn is_read(g: &dyn LinearOperator, blocks: &Blocks) -> Vec<bool> {
    let mut is_read = g.rows().map_or_else(|| vec![true; g.len()], |rows| rows.read_columns().to_vec());
    is_read.iter_mut().enumerate().for_each(|(i, is_read)| *is_read |= blocks.share(i) > 0.0);
    is_read
}

impl Barrier {
    fn new(blocks: &Blocks, u: Vec<DVec3>, gu: &[DVec3], rounding: f64) -> Self {
        // Less what rounding may have added.
        let v = u.iter().zip(gu).map(|(&u, &gu)| u - gu - rounding * (u.abs() + gu.abs())).collect();
        Self::of(blocks, u, v)
    }

    fn of(blocks: &Blocks, u: Vec<DVec3>, v: Vec<DVec3>) -> Self {
        let max_u = blocks.fold(DVec3::ZERO, |max, i| max.max(u[i]));
        let max_gu = blocks.fold(DVec3::ZERO, |max, i| max.max(u[i] - v[i]));
        let inverse = |u: f64, v: f64| if u > 0.0 && v > 0.0 { 1.0 / v } else { f64::INFINITY };
        let steepest = blocks.fold(DVec3::ZERO, |max, i| max.max(map2(u[i], v[i], inverse)));
        let product = |u: f64, w: f64| if w.is_finite() { u * w } else { f64::INFINITY };
        let norm = max_u.iter().zip(&steepest).map(|(&u, &w)| map2(u, w, product)).collect();
        Self { u, v, max_u, max_gu, norm }
    }

    /// Takes over the lanes in which `other` has the smaller norm.
    fn improve(&mut self, blocks: &Blocks, other: &Self) {
        let (mut u, mut v) = (std::mem::take(&mut self.u), std::mem::take(&mut self.v));
        for i in 0..blocks.len() {
            let is_better = other.norm[blocks.of(i)].cmplt(self.norm[blocks.of(i)]);
            u[i] = DVec3::select(is_better, other.u[i], u[i]);
            v[i] = DVec3::select(is_better, other.v[i], v[i]);
        }
        *self = Self::of(blocks, u, v);
    }
}
