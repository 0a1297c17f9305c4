//! Estimates irradiance at random points of a procedural scene and prints speed and standard error.
//!
//! `cargo run --release -p hplt-reference --example reference_points -- SCENE POINTS SAMPLES_PER_REPLICATE`
use std::error::Error;
use std::time::Instant;

use hplt_geom::glam::Vec3;
use hplt_geom::{NoProgress, Scene, TriangleId};
use hplt_reference::metrics::luminance;
use hplt_reference::path_tracer::IrradianceOptions;
use hplt_reference::{PathTracer, scenes};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [name, n_points, samples] = &arguments[..] else {
        return Err("expected SCENE POINTS SAMPLES_PER_REPLICATE".into());
    };
    let scene = scenes::build(match name.as_str() {
        "cornell" => scenes::cornell_box(),
        "statue" => scenes::statue_room(scenes::STATUE_TRIANGLES),
        "colonnade" => scenes::colonnade(scenes::COLONNADE_TRIANGLES),
        other => return Err(format!("no scene {other}: expected cornell, statue or colonnade").into()),
    });
    let points = points_by_area(&scene, n_points.parse()?);
    let tracer = PathTracer::new(&scene);
    let options = IrradianceOptions { samples_per_replicate: samples.parse()?, ..IrradianceOptions::preview() };
    let start = Instant::now();
    let estimates = tracer.irradiance(&points, &options, &NoProgress)?;
    let seconds = start.elapsed().as_secs_f64();
    let (paths, rays) = estimates.iter().fold((0, 0), |(p, r), e| (p + e.n_samples, r + e.n_rays));
    let lit: Vec<_> = estimates.iter().filter(|e| e.total().max_element() > 0.0).collect();
    let mean = lit.iter().map(|e| luminance(e.total().as_vec3())).sum::<f64>() / estimates.len() as f64;
    let relative = |e: &hplt_reference::path_tracer::IrradianceEstimate| {
        e.luminance_standard_error / luminance(e.total().as_vec3()).max(0.01 * mean)
    };
    println!("{seconds:.1} s, {:.2} Mpath/s, {:.2} Mray/s", paths as f64 / seconds / 1e6, rays as f64 / seconds / 1e6);
    let error = lit.iter().map(|e| relative(e)).sum::<f64>() / lit.len().max(1) as f64;
    println!("{} of {} points lit, mean standard error {:.2} %", lit.len(), points.len(), 100.0 * error);
    Ok(())
}

/// The front side at the middle of the triangles that a walk in equal steps of area meets.
fn points_by_area(scene: &Scene, n: usize) -> Vec<(Vec3, Vec3)> {
    let mesh = scene.mesh();
    let triangles = || (0..mesh.n_triangles() as u32).map(TriangleId);
    let step = triangles().map(|t| mesh.area(t)).sum::<f64>() / n as f64;
    let (mut area, mut points) = (0.0, Vec::new());
    for t in triangles() {
        area += mesh.area(t);
        while (points.len() as f64 + 0.5) * step < area && points.len() < n {
            // A sequence that fills large triangles evenly (golden ratio and its square).
            let i = points.len() as f64;
            let (a, b) = ((i * 0.754_877_666).fract().sqrt(), (i * 0.569_840_291).fract());
            points.push((mesh.position_at(t, (1.0 - a) as f32, (a * b) as f32), mesh.face_normal(t)));
        }
    }
    points
}
