use hplt_geom::radiometry::luminance;
use hplt_geom::{Interrupted, OrientedPoint, Progress, Rgb};
use hplt_sampling::random::Stage;

use crate::{DirectLight, FinalGather, FinalGatherOptions, Model, Sender, final_gather_more};

/// What the noise of the gathers may be of what is measured with them.
const TELLING: f64 = 0.7;
/// [`FinalGatherOptions::contact`] of these gathers. What is read near a point is as wrong as what is judged there, in hollows above
/// all: paths that land within so many supports go on. At 4 the estimate sees more of that and takes twice as long.
const APART: f32 = 1.0;
/// The 99th percentile of the normal distribution.
const NORMAL_99: f64 = 2.326;

/// How far a solution is from its own gather, at points that are no functions. Relative to the total irradiance there, by
/// luminance, with a floor of 1 % of the mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorEstimate {
    /// Mean over the points of `|found - gathered| / total`, the noise of the gather taken out in the square; not less than the
    /// standard error of that mean, below which nothing can be told.
    pub mean: f64,
    /// What of `mean` the noise that is known of what was found explains: rays of functions, and of points that were gathered. At most,
    /// as that noise is an overestimate.
    pub from_rays: f64,
    /// The rest of `mean`, in the square: what the functions cannot resolve. Bounces left out are in neither.
    pub from_functions: f64,
    /// What the mean error over the whole surface is below in 95 of 100 runs and more: the upper end of a one-sided interval of 99 %
    /// about the mean that was measured, in which the noise of the gather still is, and what is wrong everywhere alike, of which a
    /// gather over the same field shows only the share that is not reflected again. Infinite where no point receives direct light.
    pub bound: f64,
    /// The 95th percentile over the points; includes the noise of the gather.
    pub p95: f64,
    /// Mean relative error by noise of the gathers that this was measured with: half of what two halves of their rays differ by.
    pub noise: f64,
    /// How many points.
    pub n_points: usize,
    /// Rays of each.
    pub n_rays: u32,
}

/// Where and how the error is measured.
#[derive(Debug, Clone, Copy)]
pub struct ErrorProbe<'a> {
    /// Random points that are no functions.
    pub points: &'a [OrientedPoint],
    /// The direct irradiance there.
    pub direct: &'a [Rgb],
    /// Sampled where the rays land.
    pub light: &'a DirectLight<'a>,
    /// Fresh rays per point, at first and at most; powers of two, at least 16. Two independent halves are gathered, which tells their
    /// noise, and more while that is above seven tenths of what is measured.
    pub n_rays: [u32; 2],
    /// Seed of the rays.
    pub seed: u64,
    /// The indirect irradiance that is judged, at each point, W/m².
    pub indirect: &'a [Rgb],
    /// What is known of its standard error there, by luminance, W/m²; 0 where nothing is.
    pub noise: &'a [f32],
}

/// Measures what was found at points against gathers of fresh rays over `sender`, the indirect irradiance as gathers read it.
///
/// The gathers read `sender` only away from a point, by the support of the functions there. Neither the estimate nor the bound
/// sees errors that both share even so, bounces left out above all
/// ([`TransportReport::truncation_bound`](crate::TransportReport)).
///
/// # Errors
/// When interrupted.
pub fn estimate_error<E>(
    model: &Model<'_>,
    sender: &Sender<'_, E>,
    probe: ErrorProbe<'_>,
    progress: &dyn Progress,
) -> Result<ErrorEstimate, Interrupted> {
    let ErrorProbe { points, light, seed, n_rays: [mut n_rays, most], .. } = probe;
    let twice = [points, points].concat();
    let all: Vec<usize> = (0..twice.len()).collect();
    let mut halves = vec![FinalGather::default(); twice.len()];
    loop {
        let options = FinalGatherOptions { n_rays: n_rays / 2, stage: Stage::Error, seed, light, contact: APART };
        final_gather_more(model, sender, (&twice, &all), &mut halves, options, progress)?;
        let (estimate, measured) = judge(&probe, halves.split_at(points.len()), n_rays);
        if estimate.noise <= TELLING * measured || 2 * n_rays > most {
            return Ok(estimate);
        }
        n_rays *= 2;
    }
}

/// The estimate by two halves of `n_rays` at every point, and the mean that was measured, noise included.
fn judge(
    probe: &ErrorProbe<'_>,
    (some, others): (&[FinalGather], &[FinalGather]),
    n_rays: u32,
) -> (ErrorEstimate, f64) {
    let ErrorProbe { points, direct, .. } = *probe;
    let fresh: Vec<Rgb> = some.iter().zip(others).map(|(a, b)| 0.5 * (a.irradiance + b.irradiance)).collect();
    let total: Vec<f64> = fresh.iter().zip(direct).map(|(g, d)| f64::from(luminance(*g) + luminance(*d))).collect();
    let n = points.len().max(1) as f64;
    let floor = 0.01 * total.iter().sum::<f64>() / n;
    let relative = |value: f32, i: usize| f64::from(value) / total[i].max(floor).max(f64::MIN_POSITIVE);
    let mut errors: Vec<f64> =
        (0..points.len()).map(|i| relative((luminance(probe.indirect[i]) - luminance(fresh[i])).abs(), i)).collect();
    // Half the difference of two halves is as large on average as the error of their mean.
    let half = |i: usize| 0.5 * (luminance(some[i].irradiance) - luminance(others[i].irradiance)).abs();
    let noise = (0..points.len()).map(|i| relative(half(i), i)).sum::<f64>() / n;
    let (measured, standard_error) = mean_and_error(&errors);
    let common = common_error(probe.indirect, &fresh, direct, n);
    let bound = upper_end(&errors) + common;
    errors.sort_by(f64::total_cmp);
    let p95 = errors.get((errors.len() * 95) / 100).copied().unwrap_or(0.0);
    let mean = (measured * measured - noise * noise).max(standard_error * standard_error).sqrt();
    // The mean of what is normally distributed is less than its standard deviation.
    let known = probe.noise.iter().enumerate().map(|(i, &noise)| relative(noise, i)).sum::<f64>() / n;
    let from_rays = (known * (2.0 / std::f64::consts::PI).sqrt()).min(mean);
    let from_functions = (mean * mean - from_rays * from_rays).sqrt();
    let n_points = points.len();
    (ErrorEstimate { mean, from_rays, from_functions, bound, p95, noise, n_points, n_rays }, measured)
}

fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (mean, (squares / (n * (n - 1.0).max(1.0))).sqrt())
}

/// The upper end of the one-sided interval of 99 % about the mean of `values`.
fn upper_end(values: &[f64]) -> f64 {
    let (mean, standard_error) = mean_and_error(values);
    mean + NORMAL_99 * standard_error
}

/// The relative error that all points may have in common beyond what the gathers show. An error `e` of the whole field changes what
/// is gathered from it by `ρe`, so that only `(1-ρ)e` is seen; `1-ρ` is the direct part of all light.
fn common_error(indirect: &[Rgb], fresh: &[Rgb], direct: &[Rgb], n: f64) -> f64 {
    let sum = |values: &mut dyn Iterator<Item = f32>| values.map(f64::from).sum::<f64>();
    let arrives = sum(&mut direct.iter().map(|d| luminance(*d)));
    let all = arrives + sum(&mut fresh.iter().map(|g| luminance(*g)));
    if all <= 0.0 {
        return 0.0;
    }
    let differences: Vec<f64> =
        indirect.iter().zip(fresh).map(|(i, g)| f64::from(luminance(*i) - luminance(*g)) * n / all).collect();
    let negated: Vec<f64> = differences.iter().map(|d| -d).collect();
    upper_end(&differences).max(upper_end(&negated)) * (all / arrives - 1.0)
}
