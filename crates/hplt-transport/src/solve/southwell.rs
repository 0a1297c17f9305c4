use hplt_geom::glam::DVec3;

use super::run::{Halt, Problem, Run};
use crate::SparseRows;

/// Shoots residuals from the largest down, and stops when their bound says so.
///
/// Every pass shoots what is above half of the largest residual, relative to the direct light of its component and channel;
/// largest-first up to a factor of 2, without a heap that each of the many receivers of a shot would have to reorder.
pub(crate) fn advance(
    problem: &Problem<'_>,
    rows: &SparseRows,
    x: &mut [DVec3],
    run: &mut Run<'_>,
) -> Result<(), Halt> {
    let columns = Columns::of(rows);
    let mut r = vec![DVec3::ZERO; x.len()];
    run.product(problem.g, x, &mut r)?;
    r.iter_mut().zip(problem.d).for_each(|(r, d)| *r = *d - *r);
    run.history.push(problem.relative_residual(&r));
    let per_light: Vec<DVec3> = problem.max_d.iter().map(|d| d.map(|d| if d > 0.0 { 1.0 / d } else { 0.0 })).collect();
    let importance = |i: usize, r: DVec3| (r.abs() * per_light[problem.blocks.of(i)]).max_element();
    let (n_entries, mut n_read) = (rows.n_entries().max(1), 0);
    loop {
        if problem.is_good(x, &problem.gain.error(&r)) {
            return Ok(());
        }
        let largest = r.iter().enumerate().map(|(i, &r)| importance(i, r)).fold(0.0, f64::max);
        if largest == 0.0 {
            return Ok(());
        }
        for i in 0..x.len() {
            if importance(i, r[i]) < 0.5 * largest {
                continue;
            }
            let shot = std::mem::take(&mut r[i]);
            x[i] += shot;
            for &(receiver, weight) in columns.column(i) {
                let weight = rows.scale(receiver as usize) * DVec3::from(weight.map(f64::from));
                r[receiver as usize] += weight * shot;
            }
            n_read += columns.column(i).len();
            while n_read >= n_entries {
                n_read -= n_entries;
                run.begin_sweep()?;
                run.history.push(problem.relative_residual(&r));
            }
        }
    }
}

/// The matrix by columns: who receives from an unknown.
struct Columns {
    starts: Vec<usize>,
    entries: Vec<(u32, [u16; 3])>,
}

impl Columns {
    fn of(rows: &SparseRows) -> Self {
        let n = rows.n_rows();
        let mut starts = vec![0; n + 1];
        for i in 0..n {
            rows.multiples(i).for_each(|(j, _)| starts[j as usize + 1] += 1);
        }
        for j in 0..n {
            starts[j + 1] += starts[j];
        }
        let (mut next, mut entries) = (starts.clone(), vec![(0, [0; 3]); rows.n_entries()]);
        for i in 0..n {
            for (j, weight) in rows.multiples(i) {
                entries[next[j as usize]] = (i as u32, weight.to_array().map(|w| w as u16));
                next[j as usize] += 1;
            }
        }
        Self { starts, entries }
    }

    fn column(&self, j: usize) -> &[(u32, [u16; 3])] {
        &self.entries[self.starts[j]..self.starts[j + 1]]
    }
}
