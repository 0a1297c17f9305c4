//! Indirect light at points: interpolated where that can be trusted, gathered where not.

use hplt_geom::radiometry::luminance;
use hplt_geom::{Interrupted, OrientedPoint, Progress, Rgb};
use hplt_sampling::random::Stage;
use hplt_transport::{CONTACT, DirectLight, DirectOptions, FinalGatherOptions, Reading};

use crate::job::Lit;
use crate::settings::Settings;

/// Spread of the functions over the total irradiance, above which a point is gathered. What interpolation gets badly wrong,
/// leaks and small hollows, is far above.
const DOUBT: f32 = 0.3;

/// Which points are gathered.
pub enum Gathered<'a> {
    /// All.
    All,
    /// Those that this says, and all that interpolation cannot be trusted at.
    Doubtful(&'a dyn Fn(usize) -> bool),
}

/// What was found at points.
pub struct Indirect {
    /// Indirect irradiance, W/m².
    pub irradiance: Vec<Rgb>,
    /// How many of the points were gathered.
    pub n_gathered: usize,
}

/// The indirect irradiance at `points`, where `direct` arrives, with `n_rays` wherever it is gathered.
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
        Gathered::All => vec![Reading { irradiance: Rgb::ZERO, spread: f32::INFINITY }; points.len()],
        Gathered::Doubtful(_) => lit.field.indirect_at(&lit.model(), points),
    };
    let doubtful = doubtful(direct, &readings);
    let must_gather = |i: &usize| match gathered {
        Gathered::All => true,
        Gathered::Doubtful(others) => doubtful[*i] || others(*i),
    };
    let chosen: Vec<usize> = (0..points.len()).filter(must_gather).collect();
    let receivers: Vec<OrientedPoint> = chosen.iter().map(|&i| points[i]).collect();
    let light = DirectLight::new(lit.scene, DirectOptions::one_sample());
    let options = FinalGatherOptions {
        n_rays,
        stage: Stage::FinalGather,
        seed: settings.transport.seed,
        light: &light,
        contact: CONTACT,
    };
    let found = lit.field.gather(&lit.model(), settings.transport.sender_levels, &receivers, options, progress)?;
    let mut irradiance: Vec<Rgb> = readings.iter().map(|reading| reading.irradiance).collect();
    chosen.iter().zip(found).for_each(|(&i, gather)| irradiance[i] = gather.irradiance);
    Ok(Indirect { irradiance, n_gathered: chosen.len() })
}

/// Whether interpolation cannot be trusted at each point: the functions around differ by much of the total irradiance, or by
/// much of a hundredth of its mean where that is more.
fn doubtful(direct: &[Rgb], readings: &[Reading]) -> Vec<bool> {
    let totals: Vec<f32> = direct.iter().zip(readings).map(|(d, r)| luminance(*d + r.irradiance)).collect();
    let mean = totals.iter().map(|&t| f64::from(t)).sum::<f64>() / totals.len().max(1) as f64;
    let floor = (0.01 * mean) as f32;
    let is_doubtful = |(reading, total): (&Reading, &f32)| reading.is_doubtful(DOUBT, total.max(floor));
    readings.iter().zip(&totals).map(is_doubtful).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_are_doubted_by_their_spread_over_the_total_light() {
        let reading = |irradiance: f32, spread| Reading { irradiance: Rgb::splat(irradiance), spread };
        let readings =
            [reading(1.0, 0.2), reading(1.0, 0.4), reading(0.0, 0.001), reading(0.0, 0.1), reading(1.0, f32::INFINITY)];
        let doubts = |direct: f32| doubtful(&[Rgb::splat(direct); 5], &readings);
        assert_eq!(doubts(0.0), [false, true, false, true, true]);
        assert_eq!(doubts(9.0), [false, false, false, false, true]);
    }
}
