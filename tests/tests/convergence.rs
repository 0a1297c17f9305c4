//! A21: a cube made so that its answer is known everywhere, and the order in which the error falls.

use hplt::geom::glam::DVec3;
use hplt::transport::{Threshold, TransportOptions};
use hplt_tests::checks::hemisphere;
use hplt_tests::{Prepared, Setup, manufactured};

/// The slope of `ln y` over `ln x`, least squares.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let logs: Vec<(f64, f64)> = points.iter().map(|&(x, y)| (x.ln(), y.ln())).collect();
    let (mx, my) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    logs.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>() / logs.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>()
}

/// Mean relative error of interpolated irradiance over a grid on all faces, at radii that halve twice. Rays enough for their
/// noise, 0.1 %, to stay below the error of the functions.
#[test]
fn a21_the_error_falls_with_the_first_power_of_the_radius() {
    let (scene, faces) = (manufactured::scene(), manufactured::faces());
    let mut errors = Vec::new();
    for radius in [0.24, 0.17, 0.12, 0.085] {
        let mut setup = Setup { radius, ..hemisphere(1, 4096, 1e-3) };
        let threshold = Threshold { absolute: 0.0, relative: 0.0, noise: 0.0 };
        setup.transport = TransportOptions { threshold, shaped_push_down: false, max_bounces: 8, ..setup.transport };
        let prepared = Prepared::new(scene.clone(), setup);
        let solved = prepared.solve().unwrap();
        let (mut sum, mut n) = (0.0, 0.0);
        for (on, &[a, b, c, d]) in faces.iter().enumerate() {
            let normal = (b - a).cross(c - a).normalize().as_vec3();
            let places: Vec<DVec3> = hplt_tests::checks::cells(8).map(|(u, v)| a + (b - a) * u + (d - a) * v).collect();
            let points = prepared.locate_world(&places.iter().map(|&p| (p, normal)).collect::<Vec<_>>());
            // Total irradiance, direct light interpolated too: it is the reconstruction that is measured.
            let total = solved.direct.plus(&solved.indirect);
            let (values, _) = prepared.interpolate(&total, &points);
            for (value, &place) in values.iter().zip(&places) {
                let exact = manufactured::irradiance(&faces, on, place);
                sum += (f64::from(value.x) / exact - 1.0).abs();
                n += 1.0;
            }
        }
        let radius = prepared.placed.radii[0];
        println!("radius {radius:.4}: mean error {:.3} %", 100.0 * sum / n);
        errors.push((radius, sum / n));
    }
    let order = slope(&errors);
    println!("order {order:.2}");
    assert!(order >= 0.9, "order {order}: {errors:?}");
    assert!(errors[3].1 < 0.01, "{errors:?}");
}
