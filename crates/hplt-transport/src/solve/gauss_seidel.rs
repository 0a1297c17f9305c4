use hplt_geom::glam::DVec3;

use super::blocks::map2;
use super::run::{Halt, Problem, Run};
use crate::SparseRows;

/// Sweeps in order of the unknowns, until what a sweep changes bounds the error well enough.
pub(crate) fn advance(
    problem: &Problem<'_>,
    rows: &SparseRows,
    x: &mut [DVec3],
    run: &mut Run<'_>,
) -> Result<(), Halt> {
    let diagonal: Vec<DVec3> =
        (0..x.len()).map(|i| rows.row(i).filter(|(j, _)| *j as usize == i).map(|(_, weight)| weight).sum()).collect();
    let mut step = vec![DVec3::ZERO; x.len()];
    loop {
        run.begin_sweep()?;
        for i in 0..x.len() {
            let own = diagonal[i];
            let rest = problem.d[i] + rows.row_times(i, x) - own * x[i];
            // A row that returns all its light to itself has no solution of its own: take one bounce instead.
            let solved = map2(rest, own, |rest, own| if own < 1.0 { rest / (1.0 - own) } else { rest });
            step[i] = solved - x[i];
            x[i] = solved;
        }
        run.history.push(problem.relative_residual(&step));
        if problem.is_good(x, &problem.gain.error_after_step(&step)) {
            return Ok(());
        }
    }
}
