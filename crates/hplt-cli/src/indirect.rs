//! Indirect light at points: interpolated where that can be trusted, gathered where not.

use hplt_geom::radiometry::luminance;
use hplt_geom::{Interrupted, OrientedPoint, Progress, RegionId, Rgb};
use hplt_sampling::random::Stage;
use hplt_transport::{CONTACT, DirectOptions, FinalGather, FinalGatherOptions, Reading};

use crate::job::Lit;
use crate::settings::Settings;

/// Rays, at most, of points where interpolation cannot be trusted, unless another number is asked for.
pub const DOUBTFUL_RAYS: u32 = 1024;
/// Spread of the functions over the total irradiance, above which a point is gathered. What interpolation gets badly wrong,
/// leaks and small hollows, is far above.
const DOUBT: f32 = 0.3;
/// Rays of a first try at every point, at least, and their share of the rays that are allowed. Points in slits and hollows and on
/// surface that next to no light reaches are settled by it.
const FIRST_TRY: (u32, u32) = (256, 16);
/// The share of a second try, after which those points go on that are noisy beside the others.
const SECOND_TRY: u32 = 4;
/// How noisy that is, over the mean noise of all that are left then.
const NOISY: f32 = 0.5;

/// When a try needs no further one.
#[derive(Clone, Copy)]
struct Settled {
    /// At noise, over the total irradiance, of no more than this.
    noise: f32,
    /// Also where no ray has found any light.
    in_the_dark: bool,
}

impl Settled {
    /// Where all points are gathered.
    const ALL: Self = Self { noise: 0.0025, in_the_dark: false };
    /// Where it is only those that cannot be interpolated: many of them are in slits and hollows that no light gets to.
    const DOUBTFUL: Self = Self { noise: 0.01, in_the_dark: true };

    /// The same where the points that are left have noise of `mean` on average.
    fn beside(self, mean: f32) -> Self {
        Self { noise: self.noise.max(NOISY * mean), ..self }
    }

    fn by(&self, found: &FinalGather, point: &OrientedPoint, total: f32) -> bool {
        let may_be_dark = self.in_the_dark || point.region == RegionId::DARK || found.irradiance != Rgb::ZERO;
        may_be_dark && luminance(found.noise) <= self.noise * total
    }
}

/// Which points are gathered.
pub enum Gathered<'a> {
    /// All.
    All,
    /// Those that this says, and all that interpolation cannot be trusted at.
    Doubtful(&'a dyn Fn(usize) -> bool),
    /// Those that this says.
    Only(&'a dyn Fn(usize) -> bool),
}

/// What was found at points.
pub struct Indirect {
    /// Indirect irradiance, W/m².
    pub irradiance: Vec<Rgb>,
    /// What is known of its standard error, by luminance, W/m².
    pub noise: Vec<f32>,
    /// How many of the points were gathered.
    pub n_gathered: usize,
}

/// The indirect irradiance at `points`, where `direct` arrives: with `n_rays` wherever all is gathered, at most as many where
/// interpolation cannot be trusted.
///
/// # Errors
/// When interrupted.
pub fn indirect_light(
    (lit, settings): (&Lit<'_>, &Settings),
    points: &[OrientedPoint],
    direct: &[Rgb],
    (gathered, n_rays): (&Gathered<'_>, u32),
    progress: &dyn Progress,
) -> Result<Indirect, Interrupted> {
    let readings = match gathered {
        Gathered::All => vec![Reading { irradiance: Rgb::ZERO, spread: f32::INFINITY, noise: 0.0 }; points.len()],
        _ => lit.field.indirect_at(&lit.model(), points),
    };
    let mut irradiance: Vec<Rgb> = readings.iter().map(|reading| reading.irradiance).collect();
    let mut noise: Vec<f32> = readings.iter().map(|reading| reading.noise).collect();
    let scale = Scale::of(direct, &irradiance);
    let must_gather = |&i: &usize| match gathered {
        Gathered::All => true,
        Gathered::Doubtful(chosen) => chosen(i) || scale.doubts(i, &readings[i]),
        Gathered::Only(chosen) => chosen(i),
    };
    let mut pending: Vec<usize> = (0..points.len()).filter(must_gather).collect();
    let n_gathered = pending.len();
    if n_gathered == 0 {
        return Ok(Indirect { irradiance, noise, n_gathered });
    }
    let light = lit.lights.with_options(DirectOptions::one_sample());
    let seed = settings.transport.seed;
    let settled = if matches!(gathered, Gathered::All) { Settled::ALL } else { Settled::DOUBTFUL };
    let [first, second] = tries(n_rays);
    let mut found = vec![FinalGather::default(); points.len()];
    for n_rays in [first, second].into_iter().flatten().chain([n_rays]) {
        let options = FinalGatherOptions { n_rays, stage: Stage::FinalGather, seed, light: &light, contact: CONTACT };
        let how = (&lit.model(), settings.transport.sender_levels);
        lit.field.gather(how, (points, &pending), &mut found, options, progress)?;
        for &i in &pending {
            (irradiance[i], noise[i]) = (found[i].irradiance, luminance(found[i].noise));
        }
        let scale = Scale::of(direct, &irradiance);
        let settled = match Some(n_rays) == second {
            true => settled.beside(scale.mean_noise(&found, &pending)),
            false => settled,
        };
        pending.retain(|&i| !settled.by(&found[i], &points[i], scale.at(i)));
    }
    Ok(Indirect { irradiance, noise, n_gathered })
}

/// The rays of a first and of a second try, where fewer than `n_rays` can tell anything.
fn tries(n_rays: u32) -> [Option<u32>; 2] {
    let (least, share) = FIRST_TRY;
    let first = (n_rays / share).max(least);
    let second = n_rays / SECOND_TRY;
    [(first < n_rays).then_some(first), (first < second).then_some(second)]
}

/// What errors are measured by.
struct Scale {
    /// Luminance of the total irradiance at every point, W/m².
    totals: Vec<f32>,
    /// A hundredth of their mean. Where it is darker, what matters is the error over this.
    floor: f32,
}

impl Scale {
    fn of(direct: &[Rgb], indirect: &[Rgb]) -> Self {
        let totals: Vec<f32> = direct.iter().zip(indirect).map(|(d, i)| luminance(*d + *i)).collect();
        let mean = totals.iter().map(|&t| f64::from(t)).sum::<f64>() / totals.len().max(1) as f64;
        Self { totals, floor: (0.01 * mean) as f32 }
    }

    /// What an error at point `i` is to be held against.
    fn at(&self, i: usize) -> f32 {
        self.totals[i].max(self.floor)
    }

    /// The mean noise of what was found at the points with these indices, each over its light.
    fn mean_noise(&self, found: &[FinalGather], indices: &[usize]) -> f32 {
        let over = |&i: &usize| f64::from(luminance(found[i].noise) / self.at(i).max(f32::MIN_POSITIVE));
        (indices.iter().map(over).sum::<f64>() / indices.len().max(1) as f64) as f32
    }

    /// Whether interpolation cannot be trusted at point `i`: the functions around differ by much of the light.
    fn doubts(&self, i: usize, reading: &Reading) -> bool {
        reading.is_doubtful(DOUBT, self.at(i))
    }
}

#[cfg(test)]
mod tests {
    use hplt_geom::glam::Vec3;

    use super::*;

    #[test]
    fn a_gather_that_finds_no_light_is_settled_only_where_there_is_none() {
        let found = |irradiance: f32, noise: f32| FinalGather {
            irradiance: Rgb::splat(irradiance),
            noise: Rgb::splat(noise),
            escaped: 0,
            n_rays: 256,
        };
        let point = |region| OrientedPoint::new(Vec3::ZERO, Vec3::Z, region);
        let by = |settled: Settled, found, region| settled.by(&found, &point(region), 2.0);
        assert!(!by(Settled::ALL, found(0.0, 0.0), RegionId(0)));
        assert!(by(Settled::ALL, found(0.0, 0.0), RegionId::DARK));
        assert!(by(Settled::DOUBTFUL, found(0.0, 0.0), RegionId(0)));
        assert!(by(Settled::ALL, found(1.0, 0.004), RegionId(0)));
        assert!(!by(Settled::ALL, found(1.0, 0.006), RegionId(0)));
        assert!(by(Settled::DOUBTFUL, found(1.0, 0.019), RegionId(0)));
        assert!(!by(Settled::DOUBTFUL, found(1.0, 0.021), RegionId(0)));
        // Beside points that are noisier, and never less than where all are quiet.
        assert!(by(Settled::ALL.beside(0.05), found(1.0, 0.049), RegionId(0)));
        assert!(!by(Settled::ALL.beside(0.05), found(1.0, 0.051), RegionId(0)));
        assert!(!by(Settled::ALL.beside(0.05), found(0.0, 0.0), RegionId(0)));
        assert!(by(Settled::ALL.beside(0.0), found(1.0, 0.004), RegionId(0)));
    }

    #[test]
    fn a_second_try_comes_after_a_first_one_and_before_the_last() {
        assert_eq!(tries(256), [None, None]);
        assert_eq!(tries(512), [Some(256), None]);
        assert_eq!(tries(1024), [Some(256), None]);
        assert_eq!(tries(2048), [Some(256), Some(512)]);
        assert_eq!(tries(16384), [Some(1024), Some(4096)]);
    }

    #[test]
    fn noise_counts_over_the_light_of_its_point() {
        let found = |noise: f32| FinalGather { noise: Rgb::splat(noise), n_rays: 256, ..FinalGather::default() };
        let scale = Scale { totals: vec![2.0, 0.0, 1.0], floor: 0.5 };
        let found = [found(0.2), found(0.1), found(9.0)];
        assert!((scale.mean_noise(&found, &[0, 1]) - 0.15).abs() < 1e-6);
        assert_eq!(scale.mean_noise(&found, &[]), 0.0);
    }

    #[test]
    fn readings_are_doubted_by_their_spread_over_the_total_light() {
        let reading = |irradiance: f32, spread| Reading { irradiance: Rgb::splat(irradiance), spread, noise: 0.0 };
        let readings =
            [reading(1.0, 0.2), reading(1.0, 0.4), reading(0.0, 0.001), reading(0.0, 0.1), reading(1.0, f32::INFINITY)];
        let doubts = |direct: f32| {
            let scale = Scale::of(&[Rgb::splat(direct); 5], &readings.map(|r| r.irradiance));
            std::array::from_fn(|i| scale.doubts(i, &readings[i]))
        };
        assert_eq!(doubts(0.0), [false, true, false, true, true]);
        assert_eq!(doubts(9.0), [false, false, false, false, true]);
    }
}
