use std::borrow::Cow;

use hplt_geom::glam::DVec3;

use super::blocks::{Lanes, map2, ratio};
use super::coarse::Coarse;
use super::run::{Halt, Problem, Run};

/// Cycles without halving the bound after which the method stands still.
const PATIENCE: usize = 2;
/// What rough products leave of the bound that a cycle begins with, at most.
const ROUGHNESS: f64 = 2e-5;
/// A residual is looked at when it is expected to be within this factor of the tolerance: far off before the first look, since a
/// peaked residual becomes a smooth one, whose largest value is smaller.
const NEAR: [f64; 2] = [300.0, 30.0];
/// Tolerances finer than this are a matter of rounding.
const FINEST: f64 = 1e-6;

/// Cycles of at most `restart` steps, until the residual bounds the error well enough, or the method stands still. Preconditioned
/// from the right, so that residuals are the true ones.
pub(crate) fn advance(
    problem: &Problem<'_>,
    restart: usize,
    coarse: Option<&Coarse>,
    x: &mut [DVec3],
    run: &mut Run<'_>,
) -> Result<(), Halt> {
    let (mut best, mut n_idle) = (f64::INFINITY, 0);
    loop {
        let mut r = vec![DVec3::ZERO; x.len()];
        run.product(problem.g, x, &mut r)?;
        r.iter_mut().zip(problem.d).for_each(|(r, d)| *r = *d - *r);
        problem.keep_read(&mut r);
        run.history.push(problem.relative_residual(&r));
        let end = cycle(problem, Space::new(problem, coarse, &r), restart, x, &r, run);
        n_idle = if end.bound < 0.5 * best { 0 } else { n_idle + 1 };
        best = best.min(end.bound);
        end.halt?;
        if end.is_good || n_idle >= PATIENCE {
            return Ok(());
        }
    }
}

/// How a cycle ended.
struct End {
    /// What its running residual says, relative to the mean.
    bound: f64,
    is_good: bool,
    halt: Result<(), Halt>,
}

/// A residual that was looked at.
struct Look {
    norm: Lanes,
    /// Of the error, relative to the mean.
    bound: f64,
    relative_residual: f32,
}

impl Look {
    /// What a residual of that norm is expected to say.
    fn scaled_to(&self, norm: &Lanes) -> (f64, f32) {
        let factor = norm.iter().zip(&self.norm).map(|(&a, &b)| ratio(a, b).max_element()).fold(0.0, f64::max);
        (self.bound * factor, self.relative_residual * factor as f32)
    }
}

/// One cycle from `x` with residual `r`, of the unknowns that are read, which `space` begins with.
fn cycle(
    problem: &Problem<'_>,
    mut space: Space<'_>,
    restart: usize,
    x: &mut [DVec3],
    r: &[DVec3],
    run: &mut Run<'_>,
) -> End {
    let mut w = vec![DVec3::ZERO; x.len()];
    let mut end = End { bound: f64::INFINITY, is_good: false, halt: Ok(()) };
    let mut look = Look {
        norm: space.length.clone(),
        bound: problem.relative(x, &problem.gain.error(r)).largest(),
        relative_residual: problem.relative_residual(r),
    };
    let mut near = NEAR[0];
    // A coarse level returns vectors that are longer by up to the gain, and the error of rough products with them.
    let is_rough = space.coarse.is_none() && look.bound * ROUGHNESS < problem.tolerance;
    for step in 0..restart {
        let direction = space.direction(step);
        end.halt = match is_rough {
            true => run.rough_product(problem, &direction, &mut w),
            false => run.product(problem.g, &direction, &mut w),
        };
        if end.halt.is_err() {
            break;
        }
        problem.keep_read(&mut w);
        space.grow(problem, &w);
        let norm = space.norm();
        let (expected, relative_residual) = look.scaled_to(&norm);
        // The residual itself costs as much as all steps so far: it is looked at when it may be small enough.
        if expected.is_finite() && expected > near * problem.tolerance.max(FINEST) && step + 1 < restart {
            run.history.push(relative_residual);
            continue;
        }
        near = NEAR[1];
        let residual = space.residual(problem);
        let mut candidate = x.to_vec();
        space.add_solution(problem, &mut candidate);
        let bounds = problem.relative(&candidate, &problem.gain.error(&residual));
        look = Look { norm, bound: bounds.largest(), relative_residual: problem.relative_residual(&residual) };
        run.history.push(look.relative_residual);
        (end.bound, end.is_good) = (look.bound, problem.is_enough(&bounds));
        if end.is_good {
            break;
        }
    }
    space.add_solution(problem, x);
    end
}

/// The Krylov space, with one small least-squares problem per component and channel: `A M⁻¹ V_j = V_{j+1} H_j`.
struct Space<'a> {
    /// What stands for `M`; nothing for `I`.
    coarse: Option<&'a Coarse>,
    basis: Vec<Vec<DVec3>>,
    /// Columns of `H`, as they came.
    hessenberg: Vec<Vec<Lanes>>,
    /// The same, rotated to upper triangular form.
    triangle: Vec<Vec<Lanes>>,
    rotations: Vec<(Lanes, Lanes)>,
    /// The rotated right-hand side.
    rhs: Vec<Lanes>,
    length: Lanes,
}

impl<'a> Space<'a> {
    fn new(problem: &Problem<'_>, coarse: Option<&'a Coarse>, r: &[DVec3]) -> Self {
        let length = norms(problem, r);
        let basis = vec![divided(problem, r, &length)];
        let rhs = vec![length.clone()];
        let (hessenberg, triangle, rotations) = (Vec::new(), Vec::new(), Vec::new());
        Self { coarse, basis, hessenberg, triangle, rotations, rhs, length }
    }

    /// `M⁻¹` of a basis vector.
    fn direction(&self, step: usize) -> Cow<'_, [DVec3]> {
        let mut direction = Cow::from(&self.basis[step]);
        if let Some(coarse) = self.coarse {
            coarse.apply(direction.to_mut());
        }
        direction
    }

    /// Takes `w = A v` of the last basis vector: modified Gram-Schmidt, then one more rotation.
    fn grow(&mut self, problem: &Problem<'_>, w: &[DVec3]) {
        let blocks = problem.blocks;
        let mut w = w.to_vec();
        let before = norms(problem, &w);
        let mut column: Vec<Lanes> = Vec::with_capacity(self.basis.len() + 1);
        for v in &self.basis {
            let h = blocks.dot(v, &w);
            let minus: Lanes = h.iter().map(|&h| -h).collect();
            blocks.add_scaled(&mut w, &minus, v);
            column.push(h);
        }
        // What is left by rounding alone is no new direction: the space of that lane is complete.
        let after = norms(problem, &w);
        let sound = |c: usize| map2(after[c], before[c], |a, b| if a > 1e-13 * b { a } else { 0.0 });
        let after: Lanes = (0..after.len()).map(sound).collect();
        self.basis.push(divided(problem, &w, &after));
        column.push(after);
        self.hessenberg.push(column.clone());
        self.rotate(column);
    }

    fn rotate(&mut self, mut column: Vec<Lanes>) {
        let (j, n) = (column.len() - 2, self.length.len());
        for (i, (cos, sin)) in self.rotations.iter().enumerate() {
            for c in 0..n {
                let (a, b) = (column[i][c], column[i + 1][c]);
                column[i][c] = cos[c] * a + sin[c] * b;
                column[i + 1][c] = cos[c] * b - sin[c] * a;
            }
        }
        let hypotenuse = |c: usize| map2(column[j][c], column[j + 1][c], f64::hypot);
        let cos: Lanes =
            (0..n).map(|c| map2(column[j][c], hypotenuse(c), |a, h| if h > 0.0 { a / h } else { 1.0 })).collect();
        let sin: Lanes = (0..n).map(|c| ratio(column[j + 1][c], hypotenuse(c))).collect();
        let diagonal: Lanes = (0..n).map(hypotenuse).collect();
        column[j] = diagonal;
        column.truncate(j + 1);
        let last = self.rhs[j].clone();
        self.rhs[j] = (0..n).map(|c| cos[c] * last[c]).collect();
        self.rhs.push((0..n).map(|c| -sin[c] * last[c]).collect());
        self.triangle.push(column);
        self.rotations.push((cos, sin));
    }

    /// The coordinates of the solution in the space, by back substitution.
    fn coordinates(&self) -> Vec<Lanes> {
        let (m, n) = (self.triangle.len(), self.length.len());
        let mut y = vec![Lanes::new(); m];
        for i in (0..m).rev() {
            let solved = |c: usize| {
                let known: DVec3 = (i + 1..m).map(|j| self.triangle[j][i][c] * y[j][c]).sum();
                ratio(self.rhs[i][c] - known, self.triangle[i][i][c])
            };
            y[i] = (0..n).map(solved).collect();
        }
        y
    }

    fn add_solution(&self, problem: &Problem<'_>, x: &mut [DVec3]) {
        let add = |x: &mut [DVec3]| {
            let coordinates = self.coordinates();
            coordinates.iter().zip(&self.basis).for_each(|(y, v)| problem.blocks.add_scaled(x, y, v));
        };
        let Some(coarse) = self.coarse else { return add(x) };
        let mut step = vec![DVec3::ZERO; x.len()];
        add(&mut step);
        coarse.apply(&mut step);
        x.iter_mut().zip(&step).for_each(|(x, step)| *x += *step);
    }

    /// The norm of the residual of the solution.
    fn norm(&self) -> Lanes {
        self.rhs[self.rhs.len() - 1].iter().map(|r| r.abs()).collect()
    }

    /// The residual of the solution, `V (|r| e_1 - H y)`, without another product.
    fn residual(&self, problem: &Problem<'_>) -> Vec<DVec3> {
        let y = self.coordinates();
        let mut r = vec![DVec3::ZERO; problem.d.len()];
        for (i, v) in self.basis.iter().enumerate() {
            let coordinate = |c: usize| {
                let start = if i == 0 { self.length[c] } else { DVec3::ZERO };
                // H has one entry below its diagonal.
                let product: DVec3 = (i.saturating_sub(1)..y.len()).map(|j| self.hessenberg[j][i][c] * y[j][c]).sum();
                start - product
            };
            let coordinates: Lanes = (0..self.length.len()).map(coordinate).collect();
            problem.blocks.add_scaled(&mut r, &coordinates, v);
        }
        r
    }
}

fn norms(problem: &Problem<'_>, a: &[DVec3]) -> Lanes {
    problem.blocks.dot(a, a).into_iter().map(|s| s.map(f64::sqrt)).collect()
}

fn divided(problem: &Problem<'_>, a: &[DVec3], by: &Lanes) -> Vec<DVec3> {
    a.iter().enumerate().map(|(i, &a)| ratio(a, by[problem.blocks.of(i)])).collect()
}
