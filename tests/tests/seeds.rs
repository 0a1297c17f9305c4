//! E7: any seed is as good as any other, and seeds differ by what they should.

use hplt::geom::glam::{DVec3, Vec3};
use hplt::geom::{Material, Rgb, SceneBuilder};
use hplt::reference::closed_forms::parallel_rectangles;
use hplt::reference::scenes::{self, Shape};
use hplt::reference::statistics::normal_upper_quantile;
use hplt::transport::{DirectEstimator, DirectOptions};
use hplt_tests::{Bare, Prepared, Setup, area_mean};

const EXTREME: [u64; 3] = [0, 1, u64::MAX];

/// The interval that a chi-square variable over its degrees of freedom leaves with probability `alpha` (Wilson & Hilferty 1931).
fn chi_square_band(degrees: f64, alpha: f64) -> [f64; 2] {
    let z = normal_upper_quantile(0.5 * alpha);
    let a = 2.0 / (9.0 * degrees);
    [-z, z].map(|z| (1.0 - a + z * a.sqrt()).powi(3))
}

/// A square of exitance 1 one metre above a point, found blindly with one ray at each of `n` copies of the point: the mean of `n`
/// trials that succeed with the probability of the form factor.
fn trials(n: usize, seed: u64) -> f64 {
    let mut builder = SceneBuilder::new();
    let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::ONE));
    let at = |x: f64, z: f64| DVec3::new(x, 1.0, z);
    let corners = [at(-0.5, -0.5), at(0.5, -0.5), at(0.5, 0.5), at(-0.5, 0.5)];
    Shape::new().quad(corners).push_into(&mut builder, "lamp", lamp);
    let bare = Bare::new(scenes::build(builder));
    let options =
        DirectOptions { seed, sky_samples: 1, estimator: DirectEstimator::Hemisphere, ..DirectOptions::projection() };
    let values = bare.direct_at(&vec![(DVec3::ZERO, Vec3::Y); n], options);
    values.iter().map(|v| f64::from(v.x)).sum::<f64>() / n as f64
}

fn variance(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64
}

#[test]
fn the_band_is_that_of_the_tables() {
    // Tables: 63 degrees of freedom, 0.5 % on each side: 37.84 and 95.65.
    let band = chi_square_band(63.0, 0.01);
    assert!((band[0] * 63.0 - 37.84).abs() < 0.2 && (band[1] * 63.0 - 95.65).abs() < 0.2, "{band:?}");
}

/// Seeds 0, 1 and 2⁶⁴-1 light a room alike.
#[test]
fn extreme_seeds_are_ordinary() {
    let scene = scenes::build(scenes::cornell_box());
    let means = EXTREME.map(|seed| {
        let mut setup = Setup { n_levels: 2, ..Setup::default() };
        (setup.direct.seed, setup.transport.seed, setup.transport.n_rays) = (seed, seed, 64);
        let prepared = Prepared::new(scene.clone(), setup);
        area_mean(prepared.basis.points(1), &prepared.solve().unwrap().finest())
    });
    println!("{means:?}");
    assert!(means.iter().all(|m| (m / means[0] - 1.0).abs() < 0.01), "{means:?}");
    assert!(means[0] != means[1] && means[1] != means[2], "{means:?}");
}

/// The spread of 64 seeds is the binomial one, and neither smaller, as of seeds that share rays, nor larger.
#[test]
fn the_spread_of_seeds_is_the_predicted_one() {
    let n = 4096;
    // A quarter of the square is a square of half the side, seen from its corner.
    let factor = 4.0 * hplt::reference::closed_forms::point_to_parallel_rectangle(0.5, 0.5);
    assert!(factor > parallel_rectangles(1.0, 1.0));
    let means: Vec<f64> = EXTREME.into_iter().chain(1000..1061).map(|seed| trials(n, seed)).collect();
    let ratio = variance(&means) / (factor * (1.0 - factor) / n as f64);
    let band = chi_square_band(63.0, 1e-4);
    println!("variance of 64 seeds over the binomial one: {ratio:.3}, band {band:.3?}");
    assert!((band[0]..band[1]).contains(&ratio), "{ratio} {band:?}");
    // Points that shared their rays two by two would double it, and be seen.
    assert!(!(band[0]..band[1]).contains(&(2.0 * ratio)));
}

/// The standard error that a gather states is not below the spread of 64 seeds, nor many times above.
#[test]
#[ignore = "slow: 64 solutions"]
fn stated_noise_covers_the_spread_of_seeds() {
    use hplt::geom::NoProgress;
    use hplt::sampling::random::Stage;
    use hplt::transport::{DirectLight, FinalGatherOptions, Sender, final_gather};
    let scene = scenes::build(scenes::cornell_box());
    let mut setup = Setup { n_levels: 3, ..Setup::default() };
    setup.transport.n_rays = 64;
    let prepared = Prepared::new(scene, setup);
    let solved = prepared.solve().unwrap();
    let points = hplt::sampling::random_surface_points(&prepared.scene, &prepared.bvh.bvh, &prepared.regions, 200, 9);
    let light = DirectLight::new(&prepared.scene, DirectOptions::one_sample());
    let sender =
        Sender { coefficients: &solved.indirect, reconstruction: &hplt::basis::ExactShepard, n_levels: usize::MAX };
    let gathers: Vec<_> = (0..64)
        .map(|seed| {
            let options = FinalGatherOptions { n_rays: 64, stage: Stage::Error, seed, light: &light, contact: 0.25 };
            final_gather(&prepared.model(), &sender, &points, options, &NoProgress).unwrap()
        })
        .collect();
    let (mut spread, mut stated) = (0.0, 0.0);
    for i in 0..points.len() {
        let values: Vec<f64> = gathers.iter().map(|g| f64::from(g[i].irradiance.y)).collect();
        spread += variance(&values);
        stated += gathers.iter().map(|g| f64::from(g[i].noise.y).powi(2)).sum::<f64>() / 64.0;
    }
    println!("variance of 64 seeds over the stated one: {:.3}", spread / stated);
    assert!((0.2..1.1).contains(&(spread / stated)), "{spread} {stated}");
}
