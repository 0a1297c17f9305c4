//! `hplt sample-points`

use std::io::Write;
use std::path::Path;

use hplt_geom::OrientedPoint;
use hplt_io::write_atomically;
use hplt_sampling::{Regions, random_surface_points};

use crate::args::SamplePointsArgs;
use crate::exit::Failure;
use crate::job::Run;
use crate::outputs::{check_outputs, to_stdout};
use crate::points::file_output;
use crate::render::inputs;
use crate::sections::RenderSection;
use crate::session::{Ended, session};

/// Points at most.
const MAX_POINTS: usize = 100_000_000;

/// Writes random points of the surface that light can reach.
///
/// # Errors
/// With what stopped it.
pub fn run(args: &SamplePointsArgs) -> Result<Ended, Failure> {
    if !(1..=MAX_POINTS).contains(&args.n) {
        return Err(Failure::usage(format!("-n {}; expected 1 to {MAX_POINTS}", args.n)));
    }
    let out = file_output(args.output.as_deref(), args.common.output.json)?;
    session("sample-points", (&args.common, &RenderSection::default()), &args.scene, |run| {
        check_outputs(out.as_slice(), &inputs(&args.scene, None), args.common.output.force)?;
        let lines = sample(run, args)?;
        match out {
            Some(path) => write_file(run, path, &lines),
            None => to_stdout(|out| write_lines(out, &lines)),
        }
    })
}

fn sample(run: &mut Run<'_>, args: &SamplePointsArgs) -> Result<Vec<[f64; 6]>, Failure> {
    let loaded = run.load(&args.scene)?;
    run.report.converged = true;
    run.report.stop = "complete";
    let Some(scene) = &loaded.scene else { return Ok(Vec::new()) };
    let bvh = run.build_bvh(scene);
    let seed = run.settings.transport.seed;
    let reporter = run.reporter;
    let regions = run.stage("regions", |_| Regions::build(scene, &bvh, seed, reporter))?;
    let points = run.stage("points", |_| random_surface_points(scene, &bvh, &regions, args.n, seed));
    if points.len() < args.n {
        run.report.warnings.push(format!("{} of {} points found: hardly anything is reachable", points.len(), args.n));
    }
    run.report.more.insert("points".into(), points.len().into());
    let line = |p: &OrientedPoint| {
        let [x, y, z] = scene.frame().world_from_scene_point(p.position).to_array();
        let [nx, ny, nz] = p.normal.as_dvec3().to_array();
        [x, y, z, nx, ny, nz]
    };
    Ok(points.iter().map(line).collect())
}

fn write_file(run: &mut Run<'_>, path: &Path, lines: &[[f64; 6]]) -> Result<(), Failure> {
    write_atomically(path, |file| {
        let mut writer = std::io::BufWriter::new(file);
        write_lines(&mut writer, lines)?;
        writer.flush()
    })?;
    run.report.outputs.push(hplt_io::sanitized(&path.to_string_lossy()));
    Ok(())
}

fn write_lines(out: &mut dyn Write, lines: &[[f64; 6]]) -> std::io::Result<()> {
    writeln!(out, "x,y,z,nx,ny,nz")?;
    lines.iter().try_for_each(|[x, y, z, nx, ny, nz]| writeln!(out, "{x},{y},{z},{nx},{ny},{nz}"))
}
