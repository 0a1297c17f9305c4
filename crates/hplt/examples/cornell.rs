//! The Cornell box from nothing to `cornell.png` and `cornell.exr`, or the names given.
mod pipeline;

use std::path::PathBuf;

use hplt::io::{ExrImage, ExrPrecision, PngOptions, write_exr, write_png};

fn main() -> pipeline::Result<()> {
    let name = |i: usize, usual: &str| PathBuf::from(std::env::args().nth(i).unwrap_or_else(|| usual.into()));
    let (scene, bvh) = pipeline::cornell();
    let (image, report) = pipeline::render(&scene, pipeline::Stages::usual(&bvh), 256)?;
    write_png(&name(1, "cornell.png"), &image, &PngOptions::default(), &[])?;
    let mut exr = ExrImage::new(image.width(), image.height());
    exr.push_rgb("", &image, ExrPrecision::Half);
    write_exr(&name(2, "cornell.exr"), &exr)?;
    println!("{} bounces, {} gathers, {} rays", report.bounces.len(), report.n_integrals(), report.n_rays());
    Ok(())
}
