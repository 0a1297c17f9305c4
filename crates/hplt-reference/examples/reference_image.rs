//! Renders the cameras of a procedural scene with the path tracer and writes raw pictures: width and height as u32, then
//! RGB radiance as f32, all little-endian.
//!
//! `cargo run --release -p hplt-reference --example reference_image -- SCENE WIDTH SAMPLES PREFIX`
use std::error::Error;
use std::time::Instant;

use hplt_geom::NoProgress;
use hplt_reference::path_tracer::RenderOptions;
use hplt_reference::{PathTracer, scenes};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [name, width, samples, prefix] = &arguments[..] else {
        return Err("expected SCENE WIDTH SAMPLES PREFIX".into());
    };
    let builder = match name.as_str() {
        "cornell" => scenes::cornell_box(),
        "statue" => scenes::statue_room(scenes::STATUE_TRIANGLES),
        "colonnade" => scenes::colonnade(scenes::COLONNADE_TRIANGLES),
        other => return Err(format!("no scene {other}: expected cornell, statue or colonnade").into()),
    };
    let scene = scenes::build(builder);
    let start = Instant::now();
    let tracer = PathTracer::new(&scene);
    println!("{} triangles, tree built in {:.2?}", scene.mesh().n_triangles(), start.elapsed());
    let width: usize = width.parse()?;
    let options = RenderOptions { samples_per_replicate: samples.parse()?, ..RenderOptions::preview() };
    for camera in scene.cameras() {
        let height = (width as f64 / camera.aspect.unwrap_or(1.0)).round() as usize;
        let start = Instant::now();
        let picture = tracer.render(camera, width, height, &options, &NoProgress)?;
        let seconds = start.elapsed().as_secs_f64();
        println!("{}: {seconds:.1} s, {:.2} Mray/s", camera.name, picture.n_rays as f64 / seconds / 1e6);
        let mut bytes = Vec::new();
        for n in [width as u32, height as u32] {
            bytes.extend(n.to_le_bytes());
        }
        bytes.extend(picture.mean.pixels().iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes));
        std::fs::write(format!("{prefix}{}.raw", camera.name), bytes)?;
    }
    Ok(())
}
