//! Changed lights on the same links: a new right-hand side, no rays.

use glam::DVec3;
use hplt_geom::{Progress, Rgb};

use crate::solve::{Blocks, Gain, Lanes, SolveOptions, SolveReport, System, solve_from};
use crate::{Error, SparseRows};

/// The light of one group of lights at the functions, by flat index, W/m². All of it is linear in the power of the group.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupLight {
    /// Name of the group ([`LightGroups`](hplt_geom::LightGroups)).
    pub name: String,
    /// Direct irradiance.
    pub direct: Vec<Rgb>,
    /// Irradiance that arrives by one bounce.
    pub first_bounce: Vec<Rgb>,
    /// All bounces, once they are solved for this group alone.
    pub solved: Option<SolvedGroup>,
}

/// The solution for one group of lights alone.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedGroup {
    /// Indirect irradiance, all bounces, W/m².
    pub indirect: Vec<Rgb>,
    /// Bound on its error in each region and channel, W/m²; infinite where there is none.
    pub error: Vec<Rgb>,
}

/// A scene under changed lights.
#[derive(Debug, Clone, PartialEq)]
pub struct Relit {
    /// Direct irradiance at the functions, by flat index, W/m².
    pub direct: Vec<Rgb>,
    /// Indirect irradiance, all bounces, W/m².
    pub indirect: Vec<Rgb>,
    /// Bound on the error of the solver, relative to the mean indirect irradiance of its region and channel; the largest.
    pub bound: f32,
    /// How it was solved; `None` for a sum of solved groups.
    pub solve: Option<SolveReport>,
}

/// Links with the light of each group apart: made once, relit as often as wanted.
///
/// ```text
/// f = d + G f        d = Σ_k c_k d_k        c_k: factor of group k, per channel
/// ```
///
/// The links `G` do not depend on lights. They were refined for the lights that they were traced with: where a light that was faint
/// then is made the brightest, its noise and the detail that it would have needed show.
#[derive(Debug, Clone)]
pub struct Relighting {
    links: SparseRows,
    system: System,
    gain: Gain,
    groups: Vec<GroupLight>,
}

impl Relighting {
    /// Prepares links for changes of light; what depends on the operator alone is computed here.
    ///
    /// # Errors
    /// [`Error::Links`] when a link leads from one region to another, or when interrupted.
    ///
    /// # Panics
    /// When lengths differ.
    pub fn new(
        links: SparseRows,
        system: System,
        groups: Vec<GroupLight>,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        Self::with_barrier(links, &[], system, groups, progress)
    }

    /// As [`new`](Self::new), with the [`barrier`](Self::barrier) of the same links from before, which is most of the work.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    ///
    /// # Panics
    /// When lengths differ.
    pub fn with_barrier(
        links: SparseRows,
        barrier: &[Rgb],
        system: System,
        groups: Vec<GroupLight>,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let n = system.len();
        let fits = |v: &[Rgb]| v.len() == n;
        assert!(links.n_rows() == n, "one row per unknown");
        assert!(barrier.is_empty() || fits(barrier), "one value per unknown");
        assert!(groups.iter().all(|g| fits(&g.direct) && fits(&g.first_bounce)), "one value per unknown");
        let blocks = Blocks::new(&system.unknowns());
        if let Some(row) = blocks.joined_by(&links) {
            return Err(Error::Links { row, problem: "one leads to another region" });
        }
        let gain = Gain::of(&links, blocks, barrier, progress)?;
        Ok(Self { links, system, gain, groups })
    }

    /// What bounds the error of a solution ([`Gain::barrier`]), to be kept beside the links; empty where their row sums do.
    pub fn barrier(&self) -> Vec<Rgb> {
        self.gain.barrier()
    }

    /// The groups of lights.
    pub fn groups(&self) -> &[GroupLight] {
        &self.groups
    }

    /// Links and groups, given back.
    pub fn into_parts(self) -> (SparseRows, Vec<GroupLight>) {
        (self.links, self.groups)
    }

    /// Solves for every group alone. From then on a change of light is a weighted sum, which one sweep proves.
    ///
    /// # Errors
    /// As [`solve`](crate::solve()).
    pub fn solve_groups(&mut self, options: &SolveOptions, progress: &dyn Progress) -> Result<(), Error> {
        for i in 0..self.groups.len() {
            let d = &self.groups[i].first_bounce;
            let (indirect, report) = solve_from(&self.links, &self.gain, d, None, options, progress)?;
            progress.check()?;
            self.groups[i].solved = Some(SolvedGroup { indirect, error: absolute_error(&report) });
        }
        Ok(())
    }

    /// The light when every group is multiplied by its factor, per channel: one solve, no rays. It begins at the weighted sum
    /// of the groups' own solutions where there are such, else at the once reflected light.
    ///
    /// # Errors
    /// As [`solve`](crate::solve()); [`Error::Factor`] when a factor is negative or not finite.
    ///
    /// # Panics
    /// When there is not one factor per group.
    pub fn relight(&self, factors: &[Rgb], options: &SolveOptions, progress: &dyn Progress) -> Result<Relit, Error> {
        check_factors(&self.groups, factors)?;
        let n = self.system.len();
        let d = sum(n, &self.groups, factors, |g| Some(&g.first_bounce)).expect("every group has it");
        let start = sum(n, &self.groups, factors, |g| g.solved.as_ref().map(|s| &s.indirect));
        let (indirect, report) = solve_from(&self.links, &self.gain, &d, start.as_deref(), options, progress)?;
        let direct = sum(n, &self.groups, factors, |g| Some(&g.direct)).expect("every group has it");
        Ok(Relit { direct, indirect, bound: report.bound, solve: Some(report) })
    }
}

/// The light when every group is multiplied by its factor, per channel, as the sum of what each was solved to: neither solve nor
/// links. `None` when a group is not solved.
///
/// # Errors
/// [`Error::Factor`] when a factor is negative or not finite.
///
/// # Panics
/// When there is not one factor per group, or lengths differ.
pub fn weighted_sum(system: &System, groups: &[GroupLight], factors: &[Rgb]) -> Result<Option<Relit>, Error> {
    check_factors(groups, factors)?;
    let n = system.len();
    let indirect = sum(n, groups, factors, |g| g.solved.as_ref().map(|s| &s.indirect));
    let direct = sum(n, groups, factors, |g| Some(&g.direct));
    let (Some(indirect), Some(direct)) = (indirect, direct) else { return Ok(None) };
    let blocks = Blocks::new(&system.unknowns());
    let mut error: Lanes = vec![DVec3::ZERO; blocks.n_components()];
    for (group, factor) in groups.iter().zip(factors) {
        let of_group = group.solved.iter().flat_map(|s| &s.error);
        // Zero times an unknown error is none.
        let part = |e: &Rgb| DVec3::select(factor.cmpeq(Rgb::ZERO), DVec3::ZERO, factor.as_dvec3() * e.as_dvec3());
        error.iter_mut().zip(of_group).for_each(|(sum, e)| *sum += part(e));
    }
    let x: Vec<DVec3> = indirect.iter().map(|x| x.as_dvec3()).collect();
    let (mean, max) = (blocks.mean(&x), blocks.max_abs(&x));
    let relative = |c: usize| {
        let error = error[c] + f64::from(f32::EPSILON) * max[c];
        DVec3::select(error.cmpgt(DVec3::ZERO), error / (mean[c] - error).max(DVec3::ZERO), DVec3::ZERO).max_element()
    };
    let bound = (0..blocks.n_components()).map(relative).fold(0.0, f64::max) as f32;
    Ok(Some(Relit { direct, indirect, bound, solve: None }))
}

fn check_factors(groups: &[GroupLight], factors: &[Rgb]) -> Result<(), Error> {
    assert_eq!(factors.len(), groups.len(), "one factor per group");
    for (group, factor) in groups.iter().zip(factors) {
        if let Some(&value) = factor.to_array().iter().find(|f| !(**f >= 0.0 && f.is_finite())) {
            return Err(Error::Factor { group: group.name.clone(), value });
        }
    }
    Ok(())
}

/// `Σ_k c_k x_k`; `None` when a group that is not dark has no `x`.
fn sum<'g>(
    n: usize,
    groups: &'g [GroupLight],
    factors: &[Rgb],
    of: impl Fn(&'g GroupLight) -> Option<&'g Vec<Rgb>>,
) -> Option<Vec<Rgb>> {
    let mut sums = vec![DVec3::ZERO; n];
    for (group, factor) in groups.iter().zip(factors).filter(|(_, factor)| **factor != Rgb::ZERO) {
        let (values, factor) = (of(group)?, factor.as_dvec3());
        assert_eq!(values.len(), n, "one value per unknown");
        sums.iter_mut().zip(values).for_each(|(sum, x)| *sum += factor * x.as_dvec3());
    }
    Some(sums.into_iter().map(|s| s.as_vec3()).collect())
}

/// The bounds of a solution as irradiance. They are relative to a mean that may be off by as much.
fn absolute_error(report: &SolveReport) -> Vec<Rgb> {
    let absolute = |bound: f32, mean: f32| match bound {
        0.0 => 0.0,
        bound if bound < 1.0 => bound * mean / (1.0 - bound) * (1.0 + 4.0 * f32::EPSILON),
        _ => f32::INFINITY,
    };
    let of = |b: Rgb, m: Rgb| Rgb::new(absolute(b.x, m.x), absolute(b.y, m.y), absolute(b.z, m.z));
    report.components.iter().map(|c| of(c.bound, c.mean)).collect()
}
