use hplt_geom::glam::DVec3;
use hplt_geom::{Interrupted, NoProgress, Progress};

use super::blocks::{Blocks, Lanes, map2, ratio};
use super::run::{Halt, Problem, Run};
use crate::LinearOperator;

/// Below this, a scalar product of two vectors is rounding, relative to their lengths.
const BREAKDOWN: f64 = 1e-12;

/// Products without halving the best bound after which the method stands still.
const PATIENCE: usize = 40;

/// Iterates until the running residual bounds the error well enough, or the method stands still.
pub(crate) fn advance(problem: &Problem<'_>, x: &mut [DVec3], run: &mut Run<'_>) -> Result<(), Halt> {
    let mut r = vec![DVec3::ZERO; x.len()];
    run.product(problem.g, x, &mut r)?;
    r.iter_mut().zip(problem.d).for_each(|(r, d)| *r = *d - *r);
    run.history.push(problem.relative_residual(&r));
    let mut best = (f64::INFINITY, run.sweeps);
    iterate(problem.g, problem.blocks, x, &mut r, run, |x, r, run| {
        run.history.push(problem.relative_residual(r));
        let bounds = problem.relative(x, &problem.gain.error(r));
        let bound = bounds.largest();
        if bound < 0.5 * best.0 {
            best = (bound, run.sweeps);
        }
        problem.is_enough(&bounds) || run.sweeps - best.1 >= PATIENCE
    })
}

/// An approximate solution of `u = 1 + G u`, with a residual of at most 1/4 if it can be had soon; and the sweeps it took.
pub(crate) fn solve_ones(
    g: &dyn LinearOperator,
    blocks: &Blocks,
    progress: &dyn Progress,
) -> Result<(Vec<DVec3>, usize), Interrupted> {
    const MAX_SWEEPS: usize = 60;
    let mut run = Run::new(MAX_SWEEPS, &NoProgress);
    let mut u = vec![DVec3::ZERO; blocks.len()];
    let mut r = vec![DVec3::ONE; blocks.len()];
    // Running out of sweeps is no failure: whoever asks checks what comes back.
    let _ = iterate(g, blocks, &mut u, &mut r, &mut run, |_, r, _| {
        progress.is_cancelled() || blocks.max_abs(r).iter().all(|r| r.max_element() <= 0.25)
    });
    progress.check()?;
    Ok((u, run.sweeps))
}

/// BiCGStab with scalars per component and channel, from `x` with residual `r`, until `is_done(x, r)`, which is asked after
/// every product.
///
/// A lane whose recurrence breaks down starts afresh from its residual, on its own.
fn iterate(
    g: &dyn LinearOperator,
    blocks: &Blocks,
    x: &mut [DVec3],
    r: &mut [DVec3],
    run: &mut Run<'_>,
    mut is_done: impl FnMut(&[DVec3], &[DVec3], &mut Run<'_>) -> bool,
) -> Result<(), Halt> {
    let (mut shadow, mut p) = (r.to_vec(), r.to_vec());
    let (mut v, mut t) = (vec![DVec3::ZERO; x.len()], vec![DVec3::ZERO; x.len()]);
    let mut rho = blocks.dot(&shadow, r);
    loop {
        run.product(g, &p, &mut v)?;
        let alpha = quotients(&rho, &blocks.dot(&shadow, &v), &lengths(blocks, &shadow, &v));
        blocks.add_scaled(x, &alpha, &p);
        blocks.add_scaled(r, &negative(&alpha), &v);
        if is_done(x, r, run) {
            return Ok(());
        }
        run.product(g, r, &mut t)?;
        let omega = quotients(&blocks.dot(&t, r), &blocks.dot(&t, &t), &lengths(blocks, &t, &t));
        blocks.add_scaled(x, &omega, r);
        blocks.add_scaled(r, &negative(&omega), &t);
        if is_done(x, r, run) {
            return Ok(());
        }
        let new_rho = blocks.dot(&shadow, r);
        let length = lengths(blocks, &shadow, r);
        let beta: Lanes = (0..rho.len())
            .map(|c| {
                let is_sound = map2(new_rho[c].abs(), length[c], |rho, length| f64::from(rho > BREAKDOWN * length));
                is_sound * ratio(new_rho[c], rho[c]) * ratio(alpha[c], omega[c])
            })
            .collect();
        for i in 0..x.len() {
            let (beta, omega) = (beta[blocks.of(i)], omega[blocks.of(i)]);
            p[i] = r[i] + beta * (p[i] - omega * v[i]);
            shadow[i] = select(beta, shadow[i], r[i]);
        }
        rho = blocks.dot(&shadow, r);
    }
}

/// `a` where the lane goes on, `b` where it starts afresh.
fn select(beta: DVec3, a: DVec3, b: DVec3) -> DVec3 {
    DVec3::select(beta.cmpne(DVec3::ZERO), a, b)
}

fn lengths(blocks: &Blocks, a: &[DVec3], b: &[DVec3]) -> Lanes {
    let (aa, bb) = (blocks.dot(a, a), blocks.dot(b, b));
    aa.iter().zip(&bb).map(|(&a, &b)| map2(a, b, |a, b| a.sqrt() * b.sqrt())).collect()
}

/// `a / b`, 0 where `b` is rounding beside `length`.
fn quotients(a: &Lanes, b: &Lanes, length: &Lanes) -> Lanes {
    (0..a.len())
        .map(|c| ratio(a[c], map2(b[c], length[c], |b, l| if b.abs() > BREAKDOWN * l { b } else { 0.0 })))
        .collect()
}

fn negative(a: &Lanes) -> Lanes {
    a.iter().map(|&a| -a).collect()
}
