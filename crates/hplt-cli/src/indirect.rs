//! Indirect light at points: interpolated where that can be trusted, gathered where not.

use hplt_geom::radiometry::luminance;
use hplt_geom::{Interrupted, OrientedPoint, Progress, Rgb};
use hplt_sampling::random::Stage;
use hplt_transport::{CONTACT, DirectLight, DirectOptions, FinalGather, FinalGatherOptions, Reading};

use crate::job::Lit;
use crate::settings::Settings;

/// Spread of the functions over the total irradiance, above which a point is gathered. What interpolation gets badly wrong,
/// leaks and small hollows, is far above.
const DOUBT: f32 = 0.3;
/// Rays of the first tries at doubtful points. Many of them lie in slits and hollows that are next to black, where few rays tell.
const FIRST_TRIES: [u32; 1] = [256];
/// Noise of a first try over the total irradiance that needs no second one.
const SETTLED: f32 = 0.01;

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
    let light = DirectLight::new(lit.scene, DirectOptions::one_sample());
    let seed = settings.transport.seed;
    let gather = |points: &[OrientedPoint], n_rays| {
        let options = FinalGatherOptions { n_rays, stage: Stage::FinalGather, seed, light: &light, contact: CONTACT };
        lit.field.gather(&lit.model(), settings.transport.sender_levels, points, options, progress)
    };
    let (chosen, also_doubtful) = match gathered {
        Gathered::All => {
            let irradiance = gather(points, n_rays)?.iter().map(|found| found.irradiance).collect();
            return Ok(Indirect { irradiance, n_gathered: points.len() });
        }
        Gathered::Doubtful(chosen) => (chosen, true),
        Gathered::Only(chosen) => (chosen, false),
    };
    let readings = lit.field.indirect_at(&lit.model(), points);
    let scale = Scale::of(direct, &readings);
    let mut irradiance: Vec<Rgb> = readings.iter().map(|reading| reading.irradiance).collect();
    let mut pending: Vec<usize> =
        (0..points.len()).filter(|&i| chosen(i) || also_doubtful && scale.doubts(i, &readings[i])).collect();
    let n_gathered = pending.len();
    for n_rays in FIRST_TRIES.into_iter().filter(|&n| n < n_rays).chain([n_rays]) {
        let receivers: Vec<OrientedPoint> = pending.iter().map(|&i| points[i]).collect();
        let found = gather(&receivers, n_rays)?;
        pending.iter().zip(&found).for_each(|(&i, found)| irradiance[i] = found.irradiance);
        let noisy = pending.iter().zip(&found).filter(|(i, found)| !scale.is_settled(direct[**i], found));
        pending = noisy.map(|(&i, _)| i).collect();
    }
    Ok(Indirect { irradiance, n_gathered })
}

/// What errors are measured by.
struct Scale {
    /// Luminance of the total irradiance at every point, W/m².
    totals: Vec<f32>,
    /// A hundredth of their mean. Where it is darker, what matters is the error over this.
    floor: f32,
}

impl Scale {
    fn of(direct: &[Rgb], readings: &[Reading]) -> Self {
        let totals: Vec<f32> = direct.iter().zip(readings).map(|(d, r)| luminance(*d + r.irradiance)).collect();
        let mean = totals.iter().map(|&t| f64::from(t)).sum::<f64>() / totals.len().max(1) as f64;
        Self { totals, floor: (0.01 * mean) as f32 }
    }

    /// Whether interpolation cannot be trusted at point `i`: the functions around differ by much of the light.
    fn doubts(&self, i: usize, reading: &Reading) -> bool {
        reading.is_doubtful(DOUBT, self.totals[i].max(self.floor))
    }

    /// Whether more rays would not change much of the light at a point where `direct` arrives.
    fn is_settled(&self, direct: Rgb, found: &FinalGather) -> bool {
        luminance(found.noise) <= SETTLED * luminance(direct + found.irradiance).max(self.floor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_are_doubted_by_their_spread_over_the_total_light() {
        let reading = |irradiance: f32, spread| Reading { irradiance: Rgb::splat(irradiance), spread };
        let readings =
            [reading(1.0, 0.2), reading(1.0, 0.4), reading(0.0, 0.001), reading(0.0, 0.1), reading(1.0, f32::INFINITY)];
        let doubts = |direct: f32| {
            let scale = Scale::of(&[Rgb::splat(direct); 5], &readings);
            std::array::from_fn(|i| scale.doubts(i, &readings[i]))
        };
        assert_eq!(doubts(0.0), [false, true, false, true, true]);
        assert_eq!(doubts(9.0), [false, false, false, false, true]);
    }

    #[test]
    fn gathers_are_settled_when_their_noise_is_little_of_all_light() {
        let scale = Scale { totals: Vec::new(), floor: 0.1 };
        let found = |noise: f32| FinalGather { irradiance: Rgb::ONE, noise: Rgb::splat(noise), escaped: 0 };
        let is_settled = |direct: f32, noise: f32| scale.is_settled(Rgb::splat(direct), &found(noise));
        assert!(is_settled(0.0, 0.019) && !is_settled(0.0, 0.03) && is_settled(1.0, 0.03));
        let dark = FinalGather { irradiance: Rgb::ZERO, noise: Rgb::splat(0.0019), escaped: 0 };
        assert!(scale.is_settled(Rgb::ZERO, &dark), "the floor counts where it is darker");
    }
}
