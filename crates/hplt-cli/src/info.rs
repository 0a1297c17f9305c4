//! `hplt info`

use std::fmt::Write;

use hplt_geom::{LightShape, Scene, TriangleId};
use serde_json::json;

use crate::args::InfoArgs;
use crate::estimate::Estimate;
use crate::exit::Failure;
use crate::job::Run;
use crate::light_table::light_table;
use crate::load::LoadedScene;
use crate::outputs::to_stdout;
use crate::sections::RenderSection;
use crate::session::{Ended, session};
use crate::values::{human_bytes, human_count};

/// Says what a scene holds and what lighting it would take.
///
/// # Errors
/// When the scene cannot be used.
pub fn run(args: &InfoArgs) -> Result<Ended, Failure> {
    session("info", (&args.common, &RenderSection::default()), &args.scene, |run| {
        let loaded = run.load(&args.scene)?;
        run.report.converged = true;
        run.report.stop = "complete";
        let text = describe(run, &loaded);
        if !args.common.output.json {
            to_stdout(|out| out.write_all(text.as_bytes()))?;
        }
        Ok(())
    })
}

fn describe(run: &mut Run<'_>, loaded: &LoadedScene) -> String {
    let mut text = String::new();
    let mut line = |label: &str, content: String| {
        let _ = writeln!(text, "{label:<12}{content}");
    };
    line("scene", loaded.name.clone());
    let Some(scene) = &loaded.scene else {
        line("surface", "none".into());
        return text;
    };
    describe_geometry(scene, loaded, &mut line);
    describe_lights(scene, &mut line);
    let groups = light_table(scene);
    groups.iter().for_each(|group| line("light group", group.in_words()));
    run.report.more.insert("light_groups".into(), serde_json::to_value(&groups).unwrap_or_default());
    for (i, camera) in scene.cameras().iter().enumerate() {
        let [x, y, z] = camera.eye.to_array();
        let fov = camera.vertical_fov.to_degrees();
        let name = hplt_io::sanitized(&camera.name);
        line("camera", format!("{i} \"{name}\" at ({x:.3}, {y:.3}, {z:.3}), {fov:.1} degrees"));
    }
    for part in &run.report.memory {
        line("memory", format!("{:<24} {:>9}", part.part, human_bytes(part.bytes)));
    }
    for what in &loaded.left_out {
        line("left out", what.clone());
    }
    let estimate = Estimate::of(scene, run.settings);
    line(
        "estimate",
        format!(
            "at most {} points in {} levels, {}",
            human_count(estimate.points()),
            estimate.points_per_level.len(),
            human_bytes(estimate.memory)
        ),
    );
    line("", format!("about {:.0} to {:.0} s", estimate.seconds / 3.0, 3.0 * estimate.seconds));
    let (min, max) = world_bounds(scene);
    let scale = scene.frame().scale();
    run.report.more.insert("estimate".into(), serde_json::to_value(&estimate).unwrap_or_default());
    run.report.more.insert("bounds".into(), json!([min, max]));
    run.report.more.insert("diagonal".into(), json!(f64::from(scene.diagonal()) * scale));
    run.report.more.insert("materials".into(), scene.materials().len().into());
    run.report.more.insert("max_albedo".into(), json!(scene.max_albedo()));
    run.report.more.insert("emissive_triangles".into(), scene.emissive_triangles().count().into());
    run.report.more.insert("lights".into(), scene.lights().len().into());
    run.report.more.insert("has_environment".into(), scene.environment().is_some().into());
    run.report.more.insert("cameras".into(), scene.cameras().len().into());
    text
}

fn world_bounds(scene: &Scene) -> ([f64; 3], [f64; 3]) {
    let (min, max) = scene.mesh().bounds().unwrap_or_default();
    let world = |p| scene.frame().world_from_scene_point(p).to_array();
    (world(min), world(max))
}

fn describe_geometry(scene: &Scene, loaded: &LoadedScene, line: &mut impl FnMut(&str, String)) {
    let mesh = scene.mesh();
    let scale = scene.frame().scale();
    let area: f64 = (0..mesh.n_triangles() as u32).map(|t| mesh.area(TriangleId(t))).sum();
    line(
        "geometry",
        format!(
            "{} triangles, {} vertices, {:.4} m2 of surface",
            human_count(mesh.n_triangles() as u64),
            human_count(mesh.positions().len() as u64),
            area * scale * scale
        ),
    );
    let (min, max) = world_bounds(scene);
    line(
        "bounds",
        format!(
            "({:.3}, {:.3}, {:.3}) to ({:.3}, {:.3}, {:.3}) m, diagonal {:.4} m",
            min[0],
            min[1],
            min[2],
            max[0],
            max[1],
            max[2],
            f64::from(scene.diagonal()) * scale
        ),
    );
    let textured = scene.materials().iter().filter(|m| m.needs_uvs()).count();
    let masked = scene.materials().iter().filter(|m| m.alpha.is_some()).count();
    let one_sided = scene.materials().iter().filter(|m| !m.reflects.includes(false)).count();
    line(
        "materials",
        format!(
            "{} ({textured} with textures, {masked} with cut-outs, {one_sided} one-sided), largest albedo {}",
            scene.materials().len(),
            scene.max_albedo()
        ),
    );
    if loaded.loaded.textures > 0 {
        line("textures", format!("{}, {}", loaded.loaded.textures, human_bytes(loaded.loaded.texture_bytes)));
    }
    line("units", "metres, W/m2, W/(m2 sr); linear Rec. 709".into());
}

fn describe_lights(scene: &Scene, line: &mut impl FnMut(&str, String)) {
    let emissive: Vec<TriangleId> = scene.emissive_triangles().collect();
    let scale = scene.frame().scale();
    if !emissive.is_empty() {
        let area: f64 = emissive.iter().map(|&t| scene.mesh().area(t)).sum();
        line(
            "light",
            format!("{} emissive triangles, {:.4} m2", human_count(emissive.len() as u64), area * scale * scale),
        );
    }
    for light in scene.lights() {
        let kind = match light.shape {
            LightShape::Point { .. } => "point",
            LightShape::Spot { .. } => "spot",
            LightShape::Directional { angular_radius, .. } if angular_radius > 0.0 => "sun",
            LightShape::Directional { .. } => "directional",
            _ => "other",
        };
        line("light", format!("{kind} \"{}\"", hplt_io::sanitized(&light.name)));
    }
    match scene.environment().map(|e| (e.as_constant(), e.map())) {
        Some((Some(radiance), _)) => line("light", format!("sky of constant radiance {radiance}")),
        Some((None, map)) => line("light", format!("environment of {}x{} texels", map.width(), map.height())),
        None => {}
    }
    if !scene.is_lit() {
        line("light", "none: the result would be black; see --rect-light, --sun, --sky, --environment".into());
    }
}
