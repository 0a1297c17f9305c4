//! `hplt reference`

use std::io::Write;
use std::path::{Path, PathBuf};

use hplt_geom::{Bvh, Image, Rgb, Scene};
use hplt_io::{IRRADIANCE_COLUMNS, Limits, SensorPoint, read_points_csv, write_atomically};
use hplt_reference::metrics::luminance;
use hplt_reference::path_tracer::{IrradianceEstimate, IrradianceOptions, PathTracer, RenderOptions};
use serde_json::json;

use crate::args::ReferenceArgs;
use crate::camera;
use crate::exit::{Exit, Failure};
use crate::job::Run;
use crate::outputs::{check_outputs, extension, to_stdout};
use crate::picture::{check_extensions, check_finite, write_plain_exr, write_tone_mapped};
use crate::points::file_output;
use crate::progress::say;
use crate::render::inputs;
use crate::session::{Ended, session};
use crate::snap::place;
use crate::values::{human_count, human_percent};

/// Distance within which a point is put onto a surface, over the scene's diagonal; as `hplt points` does.
const SNAP: f32 = 1e-3;
/// Independent scramblings per point.
const REPLICATES: u32 = 16;
/// Independent scramblings per pixel.
const PIXEL_REPLICATES: u32 = 4;

/// Lights a scene by path tracing.
///
/// # Errors
/// With what stopped it.
pub fn run(args: &ReferenceArgs) -> Result<Ended, Failure> {
    session("reference", (&args.common, &args.render), &args.scene, |run| {
        check_extensions(args.output.iter().map(PathBuf::as_path))?;
        let force = args.common.output.force;
        let loaded = run.load(&args.scene)?;
        run.report.converged = true;
        run.report.stop = "complete";
        let Some(scene) = &loaded.scene else {
            let message = format!("{}: no surface; expected some to light", loaded.name);
            return Err(Failure::new(Exit::Input, "NO_SURFACE", message));
        };
        match &args.at {
            Some(at) => {
                let out = file_output(args.out.as_deref(), args.common.output.json)?;
                let mut read = inputs(&args.scene, None);
                read.push(at);
                check_outputs(out.as_slice(), &read, force)?;
                let sensors = read_points_csv(at, &Limits::default())?;
                points(run, args, scene, &sensors, out)
            }
            None => {
                let outputs: Vec<&Path> = args.output.iter().map(PathBuf::as_path).collect();
                check_outputs(&outputs, &inputs(&args.scene, None), force)?;
                picture(run, args, scene)
            }
        }
    })
}

fn points(
    run: &mut Run<'_>,
    args: &ReferenceArgs,
    scene: &Scene,
    sensors: &[SensorPoint],
    out: Option<&Path>,
) -> Result<(), Failure> {
    let options = irradiance_options(run, args)?;
    let bvh = run.build_bvh(scene);
    let reporter = run.reporter;
    let placed: Vec<_> =
        place(scene, &bvh, sensors, SNAP * scene.diagonal()).into_iter().map(|p| (p.position, p.normal)).collect();
    let estimates = run.stage("paths", |_| PathTracer::new(scene).irradiance(&placed, &options, reporter));
    let estimates = estimates.map_err(reference_failure)?;
    summarize(run, args, &estimates);
    let write = |out: &mut dyn Write| write_table(out, sensors, &estimates);
    match out {
        Some(path) => {
            write_atomically(path, |file| {
                let mut writer = std::io::BufWriter::new(file);
                write(&mut writer)?;
                writer.flush()
            })?;
            run.report.outputs.push(hplt_io::sanitized(&path.to_string_lossy()));
            Ok(())
        }
        None => to_stdout(write),
    }
}

fn irradiance_options(run: &Run<'_>, args: &ReferenceArgs) -> Result<IrradianceOptions, Failure> {
    let paths = args.paths.unwrap_or(1 << 20);
    let per_replicate = paths / u64::from(REPLICATES);
    if !(16..=1 << 28).contains(&per_replicate) {
        return Err(Failure::usage(format!("--paths {paths}; expected 256 to 2^32")));
    }
    // Powers of two, rounded down, so that the limit holds.
    let most = 1u32 << per_replicate.ilog2();
    Ok(IrradianceOptions {
        seed: run.settings.transport.seed,
        replicates: REPLICATES,
        samples_per_replicate: most.min(256),
        max_samples_per_replicate: most,
        target_relative_error: Some(args.error.0),
        ..IrradianceOptions::reference()
    })
}

fn summarize(run: &mut Run<'_>, args: &ReferenceArgs, estimates: &[IrradianceEstimate]) {
    let n = estimates.len().max(1) as f64;
    let of = |e: &IrradianceEstimate| luminance(e.total().as_vec3());
    let mean = estimates.iter().map(of).sum::<f64>() / n;
    let floor = 0.01 * mean;
    let mut errors: Vec<f64> =
        estimates.iter().map(|e| e.luminance_standard_error / of(e).max(floor).max(f64::MIN_POSITIVE)).collect();
    errors.sort_by(f64::total_cmp);
    let worst = errors.last().copied().unwrap_or(0.0);
    let average = errors.iter().sum::<f64>() / n;
    let missed = errors.iter().filter(|&&e| e > args.error.0).count();
    let paths: u64 = estimates.iter().map(|e| e.n_samples).sum();
    let rays: u64 = estimates.iter().map(|e| e.n_rays).sum();
    run.report.more.insert("points".into(), estimates.len().into());
    let errors = json!({ "mean": average, "max": worst, "target": args.error.0, "points_above_target": missed });
    run.report.more.insert("standard_error".into(), errors);
    run.report.more.insert("paths".into(), paths.into());
    run.report.more.insert("rays".into(), rays.into());
    if !args.common.output.quiet {
        say(&format!("paths     {}, {} rays", human_count(paths), human_count(rays)));
        let (average, worst) = (human_percent(average), human_percent(worst));
        say(&format!("error     standard error of the luminance: {average} mean, {worst} at most"));
    }
    if missed > 0 {
        run.report.converged = false;
        run.report.stop = "paths used up";
        let target = human_percent(args.error.0);
        run.report.warnings.push(format!("{missed} points are above the asked {target}: more --paths are needed"));
    }
}

fn write_table(out: &mut dyn Write, sensors: &[SensorPoint], estimates: &[IrradianceEstimate]) -> std::io::Result<()> {
    writeln!(out, "{},SE_r,SE_g,SE_b", IRRADIANCE_COLUMNS.join(","))?;
    for (sensor, e) in sensors.iter().zip(estimates) {
        let [x, y, z] = sensor.position.to_array();
        let [nx, ny, nz] = sensor.normal.to_array();
        write!(out, "{x},{y},{z},{nx},{ny},{nz}")?;
        for value in [e.direct, e.indirect, e.total(), e.total_standard_error].into_iter().flat_map(|v| v.to_array()) {
            write!(out, ",{}", value as f32)?;
        }
        writeln!(out)?;
    }
    Ok(())
}

fn picture(run: &mut Run<'_>, args: &ReferenceArgs, scene: &Scene) -> Result<(), Failure> {
    let paths = args.paths.unwrap_or(256);
    let samples_per_replicate = match u32::try_from(paths / u64::from(PIXEL_REPLICATES)) {
        Ok(n) if n > 0 => n,
        _ => return Err(Failure::usage(format!("--paths {paths}; expected {PIXEL_REPLICATES} or more"))),
    };
    let bvh: Bvh = run.build_bvh(scene);
    let render = run.settings.config.render.clone();
    let (camera, note) = camera::choose(scene, &bvh, &render)?;
    let size = camera::picture_size(&camera, render.size);
    if !args.common.output.quiet {
        say(&format!("camera    {note}; {size} pixels, {paths} paths each"));
    }
    let options = RenderOptions {
        seed: run.settings.transport.seed,
        replicates: PIXEL_REPLICATES,
        samples_per_replicate,
        ..RenderOptions::preview()
    };
    let reporter = run.reporter;
    let estimate =
        run.stage("paths", |_| PathTracer::new(scene).render(&camera, size.width, size.height, &options, reporter));
    let estimate = estimate.map_err(reference_failure)?;
    check_finite(&estimate.mean)?;
    let error = relative_error(&estimate.mean, &estimate.variance_of_mean);
    run.report.more.insert("standard_error".into(), json!({ "relative_rms": error }));
    if !args.common.output.quiet {
        say(&format!("error     standard error of pixels: {} of the mean (rms)", human_percent(error)));
    }
    let mut metadata = run.metadata();
    metadata.push(("hplt.standard_error_rms".into(), error.to_string()));
    for path in &args.output {
        match extension(path).as_str() {
            "png" => write_tone_mapped(path, &estimate.mean, &render, &metadata)?,
            _ => write_plain_exr(path, &estimate.mean, &metadata)?,
        }
        run.report.outputs.push(hplt_io::sanitized(&path.to_string_lossy()));
    }
    Ok(())
}

/// Root mean square of the standard errors of pixels over the mean radiance, all channels alike.
fn relative_error(mean: &Image, variance: &Image) -> f64 {
    let sum = |image: &Image| -> f64 { image.pixels().iter().map(|p: &Rgb| f64::from(p.element_sum())).sum() };
    let n = (3 * mean.pixels().len()).max(1) as f64;
    let average = sum(mean) / n;
    if average > 0.0 { (sum(variance) / n).sqrt() / average } else { 0.0 }
}

fn reference_failure(error: hplt_reference::Error) -> Failure {
    match error {
        hplt_reference::Error::Interrupted(_) => Failure::interrupted(),
        _ => Failure::usage(error.to_string()),
    }
}
