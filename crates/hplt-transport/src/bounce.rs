//! What the delta and the absolute variant share: gathering one level, and the account of a bounce.

use hplt_basis::{Coefficients, Coverage, ShepardBasis};
use hplt_geom::{Interrupted, Progress, RegionId, Rgb, parallel};
use hplt_sampling::random::Stage;

use crate::gather::{Batch, Counter, Gathered, scramble};
use crate::{BounceReport, Error, Model, Sender, StopReason, TransportOptions, TransportReport};

/// Gathers the `active` functions of a level, in order.
pub(crate) fn gather_level<E>(
    model: &Model<'_>,
    sender: &Sender<'_, E>,
    level: usize,
    active: &[u32],
    options: &TransportOptions,
    progress: &dyn Progress,
) -> Result<(Vec<Gathered>, Coverage), Interrupted> {
    const BATCH: usize = 32;
    let batches: Vec<&[u32]> = active.chunks(BATCH).collect();
    let counter = Counter::new(progress, "bounce", active.len());
    let first_id: usize = (0..level).map(|l| model.basis.n_functions(l)).sum();
    let batches = parallel::try_map(batches.len(), Batch::default, |batch, k| {
        for &function in batches[k] {
            counter.step()?;
            let receiver = &model.basis.points(level)[function as usize];
            let scramble = scramble(options.seed, Stage::Gather, first_id as u32 + function);
            batch.trace(model, receiver, scramble, options.n_rays);
        }
        Ok::<_, Interrupted>(batch.read(model, sender, options.n_rays))
    })?;
    let (mut gathers, mut coverage) = (Vec::with_capacity(active.len()), Coverage::default());
    for (of_batch, its_coverage) in batches {
        gathers.extend(of_batch);
        coverage += its_coverage;
    }
    Ok((gathers, coverage))
}

/// The children of the refined functions of `level`, ascending, each once.
pub(crate) fn children_of(basis: &ShepardBasis, level: usize, refined: &[u32]) -> Vec<u32> {
    if level + 1 >= basis.n_levels() {
        return Vec::new();
    }
    let mut is_active = vec![false; basis.n_functions(level + 1)];
    for &function in refined {
        for &child in basis.parents(level + 1).children(function) {
            is_active[child as usize] = true;
        }
    }
    (0..is_active.len() as u32).filter(|&i| is_active[i as usize]).collect()
}

/// Functions of a level that nothing coarser stands in for: all of level 0, and the first functions of regions that no
/// coarser level has.
pub(crate) fn always_active(basis: &ShepardBasis, level: usize) -> Vec<u32> {
    (0..basis.n_functions(level) as u32).filter(|&i| level == 0 || basis.parents(level).of(i).is_empty()).collect()
}

/// Merges two ascending lists without repetition.
pub(crate) fn merge(mut a: Vec<u32>, b: &[u32]) -> Vec<u32> {
    if !b.is_empty() {
        a.extend_from_slice(b);
        a.sort_unstable();
        a.dedup();
    }
    a
}

/// Per region: what decides when to stop.
#[derive(Debug, Clone)]
pub(crate) struct RegionAccount {
    /// Largest row sum of any gather so far, per channel.
    max_row_sum: Rgb,
    /// Smallest row sum of the coarsest gathers, largest channel.
    min_row_sum: f32,
    /// Mean irradiance so far, area-weighted on level 0.
    pub mean: Rgb,
    /// Largest irradiance that the last bounce added.
    unshot: Rgb,
}

/// The books of a transport.
pub(crate) struct Account {
    pub regions: Vec<RegionAccount>,
    bounces: Vec<BounceReport>,
    n_growing: usize,
    started: f64,
    current: BounceReport,
}

impl Account {
    pub fn new(basis: &ShepardBasis) -> Self {
        let region =
            RegionAccount { max_row_sum: Rgb::ZERO, min_row_sum: f32::INFINITY, mean: Rgb::ZERO, unshot: Rgb::ZERO };
        let regions = vec![region; basis.hierarchy().n_regions as usize];
        Self { regions, bounces: Vec::new(), n_growing: 0, started: 0.0, current: empty_bounce() }
    }

    /// Takes the direct light as what there is before the first bounce: its means per region.
    pub fn add_mean(&mut self, basis: &ShepardBasis, level0: &[Rgb]) {
        for (region, mean) in region_means(basis, level0, self.regions.len()).into_iter().enumerate() {
            self.regions[region].mean += mean;
        }
    }

    pub fn begin_bounce(&mut self, now: f64) {
        self.started = now;
        self.current = empty_bounce();
        self.regions.iter_mut().for_each(|r| r.unshot = Rgb::ZERO);
    }

    /// Enters the gathers of one level.
    ///
    /// # Errors
    /// On a gather that is not finite.
    pub fn enter(
        &mut self,
        basis: &ShepardBasis,
        level: usize,
        active: &[u32],
        gathered: &[Gathered],
        coverage: Coverage,
        n_rays: u32,
    ) -> Result<(), Error> {
        self.current.integrals.push(active.len() as u64);
        self.current.rays += active.len() as u64 * u64::from(n_rays);
        self.current.coverage += coverage;
        for (&function, g) in active.iter().zip(gathered) {
            if !g.irradiance.is_finite() {
                let bounce = self.bounces.len() + 1;
                return Err(Error::NotFinite { bounce, level, function: function as usize });
            }
            self.current.escaped += u64::from(g.escaped);
            let region = &mut self.regions[basis.points(level)[function as usize].region.0 as usize];
            region.max_row_sum = region.max_row_sum.max(g.row_sum);
            region.min_row_sum = region.min_row_sum.min(g.row_sum.max_element());
            region.unshot = region.unshot.max(g.irradiance.abs());
            self.current.unshot = self.current.unshot.max(g.irradiance.abs());
        }
        Ok(())
    }

    /// Closes the books of a bounce that added `level0` on the coarsest level.
    pub fn end_bounce(&mut self, basis: &ShepardBasis, level0: &[Rgb], now: f64) {
        self.add_mean(basis, level0);
        self.current.mean = area_mean(basis, level0);
        self.current.seconds = now - self.started;
        self.bounces.push(std::mem::replace(&mut self.current, empty_bounce()));
    }

    /// Counts how many bounces in a row added more light than the one before.
    ///
    /// # Errors
    /// When there are too many of them for it to be chance.
    pub fn check_growth(&mut self) -> Result<(), Error> {
        const TOO_MANY: usize = 12;
        if let [.., before, last] = &self.bounces[..] {
            let grew = last.unshot.max_element() > before.unshot.max_element();
            self.n_growing = if grew { self.n_growing + 1 } else { 0 };
        }
        if self.n_growing >= TOO_MANY { Err(Error::Diverging { n_growing: self.n_growing }) } else { Ok(()) }
    }

    /// The largest bound on what is still to come, relative to the mean irradiance of its region and channel.
    pub fn truncation_bound(&self) -> f32 {
        let bound = |r: &RegionAccount, c: usize| {
            if r.unshot[c] == 0.0 {
                return 0.0;
            }
            let q = r.max_row_sum[c];
            if q >= 1.0 { f32::INFINITY } else { r.unshot[c] * q / ((1.0 - q) * r.mean[c]) }
        };
        self.regions.iter().flat_map(|r| (0..3).map(move |c| bound(r, c))).fold(0.0, f32::max)
    }

    /// The region, if any, whose every gather passes on all its light: its bounces never end.
    ///
    /// # Errors
    /// With the first such region.
    pub fn check_finite_solution(&self) -> Result<(), Error> {
        let closed_white =
            |r: &RegionAccount| r.min_row_sum.is_finite() && r.min_row_sum > 1.0 - 1e-6 && r.unshot.max_element() > 0.0;
        match self.regions.iter().position(closed_white) {
            Some(region) => Err(Error::NoFiniteSolution { region: region as u32 }),
            None => Ok(()),
        }
    }

    pub fn finish(self, stop: StopReason) -> TransportReport {
        let truncation_bound = if stop == StopReason::NoLight { 0.0 } else { self.truncation_bound() };
        let max_row_sum = self.regions.iter().map(|r| r.max_row_sum.max_element()).fold(0.0, f32::max);
        TransportReport { bounces: self.bounces, stop, max_row_sum, truncation_bound }
    }
}

fn empty_bounce() -> BounceReport {
    BounceReport {
        integrals: Vec::new(),
        rays: 0,
        escaped: 0,
        coverage: Coverage::default(),
        unshot: Rgb::ZERO,
        mean: Rgb::ZERO,
        seconds: 0.0,
    }
}

/// Area-weighted mean of level-0 values per region.
fn region_means(basis: &ShepardBasis, level0: &[Rgb], n_regions: usize) -> Vec<Rgb> {
    let mut sums = vec![(glam::DVec3::ZERO, 0.0f64); n_regions];
    for (point, value) in basis.points(0).iter().zip(level0) {
        if point.region == RegionId::DARK {
            continue;
        }
        let area = f64::from(point.area.max(f32::MIN_POSITIVE));
        let (sum, total) = &mut sums[point.region.0 as usize];
        *sum += value.as_dvec3() * area;
        *total += area;
    }
    sums.into_iter().map(|(sum, total)| if total > 0.0 { (sum / total).as_vec3() } else { Rgb::ZERO }).collect()
}

fn area_mean(basis: &ShepardBasis, level0: &[Rgb]) -> Rgb {
    let (mut sum, mut total) = (glam::DVec3::ZERO, 0.0);
    for (point, value) in basis.points(0).iter().zip(level0) {
        let area = f64::from(point.area.max(f32::MIN_POSITIVE));
        sum += value.as_dvec3() * area;
        total += area;
    }
    if total > 0.0 { (sum / total).as_vec3() } else { Rgb::ZERO }
}

/// Runs bounces until one of the stop rules holds.
///
/// `bounce` computes one bounce from what is unshot and enters its gathers into the books.
pub(crate) fn run<E>(
    model: &Model<'_>,
    direct: &Coefficients<E>,
    options: &TransportOptions,
    progress: &dyn Progress,
    level0_values: impl Fn(&Coefficients<E>) -> Vec<Rgb>,
    mut bounce: impl FnMut(&Coefficients<E>, &Coefficients<E>, &mut Account) -> Result<Coefficients<E>, Error>,
) -> Result<(Coefficients<E>, TransportReport), Error> {
    options.check()?;
    let mut indirect = Coefficients::zeros(model.basis);
    let mut account = Account::new(model.basis);
    if direct.max_abs() == 0.0 || model.basis.n_levels() == 0 {
        return Ok((indirect, account.finish(StopReason::NoLight)));
    }
    account.add_mean(model.basis, &level0_values(direct));
    let mut unshot: Option<Coefficients<E>> = None;
    let mut stop = StopReason::MaxBounces;
    for _ in 0..options.max_bounces {
        account.begin_bounce(progress.now());
        let new = match bounce(unshot.as_ref().unwrap_or(direct), &indirect, &mut account) {
            Ok(new) => new,
            Err(Error::Interrupted(_)) => {
                stop = StopReason::Interrupted;
                break;
            }
            Err(error) => return Err(error),
        };
        account.end_bounce(model.basis, &level0_values(&new), progress.now());
        account.check_finite_solution()?;
        account.check_growth()?;
        indirect.add(&new);
        unshot = Some(new);
        if account.truncation_bound() <= options.tolerance {
            stop = StopReason::Converged;
            break;
        }
    }
    Ok((indirect, account.finish(stop)))
}
