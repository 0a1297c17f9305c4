//! A23: the solver against the path tracer, which shares the scene with it and nothing else.

use hplt::geom::radiometry::luminance;
use hplt::geom::{NoProgress, Rgb};
use hplt::reference::path_tracer::{IrradianceOptions, PathTracer};
use hplt::reference::scenes;
use hplt::transport::TransportOptions;
use hplt_tests::{Prepared, Setup};

/// The mean irradiance of the Cornell box at random points by final gather, within 1 % of the path tracer's at the same points:
/// 99.9 % confidence, both noises counted.
#[test]
fn a23_cornell_against_the_path_tracer() {
    let transport = TransportOptions { n_rays: 512, ..TransportOptions::production() };
    let prepared = Prepared::new(scenes::build(scenes::cornell_box()), Setup { transport, ..Setup::default() });
    let solved = prepared.solve().unwrap();
    let points = hplt::sampling::random_surface_points(&prepared.scene, &prepared.bvh.bvh, &prepared.regions, 128, 9);
    let gathered = prepared.gather(&solved, &points, 1024);
    let direct = prepared.direct_at(&points);
    let places: Vec<_> = points.iter().map(|p| (p.position, p.normal)).collect();
    let options = IrradianceOptions { seed: 0xa23, samples_per_replicate: 256, ..IrradianceOptions::preview() };
    let reference = PathTracer::new(&prepared.scene).irradiance(&places, &options, &NoProgress).unwrap();
    let y = |rgb: Rgb| f64::from(luminance(rgb));
    let (mut sum, mut expected, mut variance) = (0.0, 0.0, 0.0);
    for ((g, d), r) in gathered.iter().zip(&direct).zip(&reference) {
        sum += y(g.irradiance) + y(*d);
        expected += y(r.total().as_vec3());
        variance += y(g.noise).powi(2) + r.luminance_standard_error.powi(2);
    }
    let (bias, half_width) = (sum / expected - 1.0, 3.3 * variance.sqrt() / expected);
    println!("bias {:+.3} %, half-width {:.3} %", 100.0 * bias, 100.0 * half_width);
    assert!(bias.abs() + half_width <= 0.01, "bias {bias}, half-width {half_width}");
    // Negative control: two per cent of light too much would not pass.
    assert!((1.02 * sum / expected - 1.0).abs() + half_width > 0.01);
}
