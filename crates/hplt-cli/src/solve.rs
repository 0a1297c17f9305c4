//! `hplt solve`

use std::path::Path;

use hplt_geom::radiometry::luminance;
use hplt_io::{PlyPoint, write_ply, write_solution};

use crate::args::SolveArgs;
use crate::exit::{Exit, Failure};
use crate::job::{Lit, Run};
use crate::outputs::check_outputs;
use crate::render::inputs;
use crate::sections::RenderSection;
use crate::session::{Ended, session};
use crate::solution;

/// Lights a scene and keeps the solution.
///
/// # Errors
/// With what stopped it.
pub fn run(args: &SolveArgs) -> Result<Ended, Failure> {
    session("solve", (&args.common, &RenderSection::default()), &args.scene, |run| {
        let outputs: Vec<&Path> = args.output.iter().chain(&args.ply).map(|p| p.as_path()).collect();
        check_outputs(&outputs, &inputs(&args.scene, None), args.common.output.force)?;
        solve(run, args)
    })
}

fn solve(run: &mut Run<'_>, args: &SolveArgs) -> Result<(), Failure> {
    let loaded = run.load(&args.scene)?;
    let Some(scene) = &loaded.scene else {
        let message = format!("{}: no surface; expected some to solve on", loaded.name);
        return Err(Failure::new(Exit::Input, "NO_SURFACE", message));
    };
    let lit = run.light(scene)?;
    run.check_strict()?;
    if let Some(path) = &args.output {
        let file = solution::to_file(run, &lit);
        run.stage("write", |_| write_solution(path, &file))?;
        run.report.outputs.push(hplt_io::sanitized(&path.to_string_lossy()));
    }
    if let Some(path) = &args.ply {
        let points = ply_points(&lit);
        run.stage("write", |_| write_ply(path, &points))?;
        run.report.outputs.push(hplt_io::sanitized(&path.to_string_lossy()));
    }
    Ok(())
}

/// The points of the finest level with their total irradiance, in world space.
fn ply_points(lit: &Lit<'_>) -> Vec<PlyPoint> {
    let Some(top) = lit.basis.n_levels().checked_sub(1) else { return Vec::new() };
    let frame = lit.scene.frame();
    let area_scale = (frame.scale() * frame.scale()) as f32;
    let points = lit.basis.points(top);
    let direct = lit.field.direct_at(&lit.model(), points);
    let indirect = lit.field.indirect_at(&lit.model(), points);
    let total: Vec<_> = direct.iter().zip(&indirect).map(|(d, i)| *d + i.irradiance).collect();
    let mean = total.iter().map(|e| f64::from(luminance(*e))).sum::<f64>() / total.len().max(1) as f64;
    // Twice the mean is white.
    let scale = if mean > 0.0 { (0.5 / mean) as f32 } else { 1.0 };
    let color = |x: f32| ((x * scale).clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0 + 0.5) as u8;
    points
        .iter()
        .zip(total)
        .map(|(p, irradiance)| PlyPoint {
            position: frame.world_from_scene_point(p.position).as_vec3(),
            normal: p.normal,
            area: p.area * area_scale,
            irradiance,
            color: irradiance.to_array().map(color),
        })
        .collect()
}
