//! `hplt render`

use std::path::{Path, PathBuf};

use hplt_geom::Image;

use crate::args::RenderArgs;
use crate::camera;
use crate::exit::{Exit, Failure};
use crate::job::Run;
use crate::outputs::{check_outputs, extension};
use crate::picture::{self, check_extensions, take, write_tone_mapped};
use crate::progress::say;
use crate::session::{Ended, session};
use crate::solution;
use crate::values::Size;

/// Lights a scene and writes pictures.
///
/// # Errors
/// With what stopped it.
pub fn run(args: &RenderArgs) -> Result<Ended, Failure> {
    args.budget.check(&args.common, args.solution.is_some())?;
    session("render", (&args.common, &args.render), &args.scene, |run| {
        check_extensions(args.output.iter().map(PathBuf::as_path))?;
        let outputs: Vec<&Path> = args.output.iter().map(PathBuf::as_path).collect();
        check_outputs(&outputs, &inputs(&args.scene, args.solution.as_deref()), args.common.output.force)?;
        render(run, args)
    })
}

/// The files that a run reads by name.
pub fn inputs<'a>(scene: &'a str, solution: Option<&'a Path>) -> Vec<&'a Path> {
    std::iter::once(Path::new(scene)).chain(solution).collect()
}

fn render(run: &mut Run<'_>, args: &RenderArgs) -> Result<(), Failure> {
    let mut loaded = run.load(&args.scene)?;
    let render = run.settings.config.render.clone();
    let Some(scene) = &mut loaded.scene else {
        return write_black(run, args, render.size.unwrap_or(Size { width: 720, height: 540 }));
    };
    let mut lit = match &args.solution {
        Some(path) => solution::light(run, scene, path)?,
        None => {
            run.budget = args.budget.clone();
            run.light(scene)?
        }
    };
    let (camera, note) = camera::choose(lit.scene, &lit.bvh, &render)?;
    let size = camera::picture_size(&camera, render.size);
    if !args.common.output.quiet {
        let where_taken = if run.settings.every_pixel { "in each" } else { "at edges" };
        say(&format!("camera    {note}; {size} pixels, {0} x {0} samples {where_taken}", run.settings.samples));
    }
    run.check_strict()?;
    let picture = match take(run, &lit, &camera, size) {
        Err(failure) if failure.exit == Exit::Interrupted => {
            lit.is_cut_short = true;
            run.cut_short();
            run.check_strict()?;
            take(run, &lit, &camera, size)?
        }
        other => other?,
    };
    let metadata = run.metadata();
    for path in &args.output {
        run.stage("write", |_| picture.write(path, &render, &metadata))?;
        run.report.outputs.push(hplt_io::sanitized(&path.to_string_lossy()));
    }
    Ok(())
}

/// A picture of nothing.
fn write_black(run: &mut Run<'_>, args: &RenderArgs, size: Size) -> Result<(), Failure> {
    run.report.converged = true;
    run.report.stop = "no-surface";
    let image = Image::new(size.width, size.height);
    let metadata = run.metadata();
    for path in &args.output {
        match extension(path).as_str() {
            "png" => write_tone_mapped(path, &image, &args.render, &metadata)?,
            _ => picture::write_plain_exr(path, &image, &metadata)?,
        }
        run.report.outputs.push(hplt_io::sanitized(&path.to_string_lossy()));
    }
    Ok(())
}
