//! A21, A22: a cube made so that its answer is known everywhere, a sphere with a lamp off its centre, and the order in which the error
//! falls.

use std::f64::consts::PI;

use hplt::geom::glam::DVec3;
use hplt::geom::{Material, Rgb, SceneBuilder};
use hplt::reference::closed_forms;
use hplt::reference::scenes;
use hplt::sampling::random_surface_points;
use hplt::transport::{Threshold, TransportOptions};
use hplt_tests::checks::hemisphere;
use hplt_tests::{Prepared, Setup, manufactured, slope};

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

/// A22: in a sphere of one albedo all bounces together are the same everywhere, and a point light off its centre is not: the irradiance
/// is `I cosθ/d² + ρΦ/((1-ρ)A)`, in closed form and not constant. The error of the field falls with the root of the number of functions, from
/// 2⁷ to 2¹³ of them, with rays and facets enough for their noise to be less. (The sphere with bands of A10 and the concentric ones of A13 say
/// nothing of this: their irradiance is constant, which functions reproduce.)
#[test]
#[ignore = "slow: a hundred million rays"]
fn a22_the_error_in_a_sphere_falls_with_the_number_of_functions() {
    let (albedo, intensity) = (0.3f32, 1.0);
    let lamp = DVec3::new(0.3, 0.2, 0.1);
    let mut builder = SceneBuilder::new();
    let wall = builder.push_material(Material::diffuse("wall", Rgb::splat(albedo)));
    let mut sphere = scenes::geodesic_sphere(1.0, 1_310_720);
    sphere.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    sphere.push_into(&mut builder, "sphere", wall);
    builder.push_point_light("lamp", lamp, Rgb::splat(intensity as f32));
    let bounced = closed_forms::mean_indirect_irradiance(4.0 * PI * intensity, albedo.into(), sphere.area());
    let scene = scenes::build(builder);
    let mut errors = Vec::new();
    for n in [128.0, 512.0, 2048.0, 8192.0] {
        // 0.7 A/r² functions, the diagonal being 2√3.
        let radius = (0.7 * 4.0 * PI / n).sqrt() / 12f64.sqrt();
        let threshold = Threshold { absolute: 0.0, relative: 0.0, noise: 0.0 };
        let transport = TransportOptions {
            n_rays: 2048,
            threshold,
            shaped_push_down: false,
            max_bounces: 6,
            tolerance: 1e-3,
            ..TransportOptions::production()
        };
        let prepared = Prepared::new(scene.clone(), Setup { n_levels: 1, radius, transport, ..Setup::default() });
        let solved = prepared.solve().unwrap();
        let points = random_surface_points(&prepared.scene, &prepared.bvh.bvh, &prepared.regions, 4000, 22);
        let (values, _) = prepared.interpolate(&solved.direct.plus(&solved.indirect), &points);
        let exact = |p: &hplt::geom::OrientedPoint| {
            let to_lamp = lamp - prepared.scene.frame().world_from_scene_point(p.position);
            let cosine = to_lamp.normalize().dot(p.normal.as_dvec3());
            intensity * cosine / to_lamp.length_squared() + bounced
        };
        let off = |factor: f64| {
            let error = |(v, p): (&Rgb, &hplt::geom::OrientedPoint)| (factor * f64::from(v.x) / exact(p) - 1.0).abs();
            values.iter().zip(&points).map(error).sum::<f64>() / points.len() as f64
        };
        let n = prepared.basis.n_functions(0) as f64;
        println!("{n} functions: mean error {:.3} %", 100.0 * off(1.0));
        errors.push((n, off(1.0), off(1.01)));
    }
    let order = |of: &dyn Fn(&(f64, f64, f64)) -> f64| -slope(&errors.iter().map(|e| (e.0, of(e))).collect::<Vec<_>>());
    println!("order {:.2} in the number of functions", order(&|e| e.1));
    assert!(order(&|e| e.1) >= 0.45, "{errors:?}");
    assert!(errors[3].1 < 0.005, "{errors:?}");
    // Negative control: one per cent too much everywhere is a plateau that the order shows.
    assert!(order(&|e| e.2) < 0.45, "{errors:?}");
}
