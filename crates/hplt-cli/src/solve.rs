//! `hplt solve`

use std::path::Path;

use hplt_geom::radiometry::luminance;
use hplt_geom::{LightGroups, Scene};
use hplt_io::{PlyPoint, write_ply, write_solution};
use serde_json::json;

use crate::args::SolveArgs;
use crate::estimate::Estimate;
use crate::exit::{Exit, Failure};
use crate::job::{Lit, Run};
use crate::kept::{Keep, Kept};
use crate::outputs::check_outputs;
use crate::progress::say;
use crate::render::inputs;
use crate::sections::{RenderSection, Variant};
use crate::session::{Ended, session};
use crate::solution;
use crate::values::human_bytes;

/// Lights a scene and keeps the solution.
///
/// # Errors
/// With what stopped it.
pub fn run(args: &SolveArgs) -> Result<Ended, Failure> {
    args.budget.check(&args.common, false)?;
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
    run.keep = keep(run, args)?;
    run.budget = args.budget.clone();
    run.keep.check(scene)?;
    say_what_will_be_kept(run, scene, args.common.output.quiet);
    let mut lit = run.light(scene)?;
    run.check_strict()?;
    if let Some(path) = &args.output {
        enter_kept(run, lit.kept.as_ref(), args.common.output.quiet);
        let file = solution::to_file(run, &mut lit);
        run.stage("write", |_| write_solution(path, &file))?;
        run.report.more.insert("file_bytes".into(), std::fs::metadata(path).map_or(0, |m| m.len()).into());
        run.report.outputs.push(hplt_io::sanitized(&path.to_string_lossy()));
    }
    if let Some(path) = &args.ply {
        let points = ply_points(&lit);
        run.stage("write", |_| write_ply(path, &points))?;
        run.report.outputs.push(hplt_io::sanitized(&path.to_string_lossy()));
    }
    Ok(())
}

/// What the flags ask to keep.
fn keep(run: &Run<'_>, args: &SolveArgs) -> Result<Keep, Failure> {
    let keep = Keep { links: args.keep_links, all_groups: args.all_groups };
    if keep.is_any() && run.settings.variant != Variant::Links {
        let name = run.settings.variant.name();
        let message = format!("--variant {name} has no links; --keep-links and --all-groups need --variant links");
        return Err(Failure::usage(message));
    }
    Ok(keep)
}

fn say_what_will_be_kept(run: &Run<'_>, scene: &Scene, is_quiet: bool) {
    if is_quiet || !run.keep.is_any() {
        return;
    }
    let n_groups = LightGroups::of(scene).len();
    let per_function = Estimate::of(scene, run.settings).bytes_kept(run.keep, n_groups);
    let most = human_bytes(per_function);
    say(&format!(
        "keep      light of {n_groups} groups{}; about {most} at most",
        match run.keep.links {
            true => " and links",
            false => "",
        }
    ));
}

fn enter_kept(run: &mut Run<'_>, kept: Option<&Kept>, is_quiet: bool) {
    let Some(kept) = kept else { return };
    let (links, groups) = (kept.bytes_of_links(), kept.bytes_of_groups());
    let names: Vec<&str> = kept.groups.iter().map(|g| &g.name[..]).collect();
    if !is_quiet {
        let shown: Vec<String> = names.iter().map(|n| hplt_io::sanitized(n)).collect();
        let (links, groups) = (human_bytes(links), human_bytes(groups));
        say(&format!("kept      links {links}, light of {} groups {groups}: {}", names.len(), shown.join(", ")));
    }
    let row = json!({ "links_bytes": links, "groups_bytes": groups, "light_groups": names });
    run.report.more.insert("kept".into(), row);
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
