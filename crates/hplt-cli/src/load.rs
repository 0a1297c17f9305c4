//! From a scene's name to a [`Scene`], with the lights of flags and config.

mod flat;
mod room;

use std::path::Path;

use hplt_geom::{Scene, SceneReport};
use hplt_io::{LoadOptions, LoadReport, Loaded};

use crate::builtin;
use crate::exit::{Exit, Failure};
use crate::lights::add_lights;
use crate::settings::Settings;
use crate::values::Radius;

/// Vertices rounded to more than the finest radius over this are warned of.
const SHARE_OF_RADIUS: f64 = 16.0;

/// A scene that is ready to be lit.
pub struct LoadedScene {
    /// Its name on the command line, safe to print.
    pub name: String,
    /// The scene; `None` for one without surface, where that is accepted.
    pub scene: Option<Scene>,
    /// What the file held.
    pub loaded: LoadReport,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// What is not there, and why.
    pub left_out: Vec<String>,
}

/// Loads `name` (a file or `gen:SPEC`, see [`made`]), adds lights, validates.
///
/// # Errors
/// When the file or a value in it cannot be used.
pub fn load(name: &str, settings: &Settings) -> Result<LoadedScene, Failure> {
    let shown = hplt_io::sanitized(name);
    let Loaded { scene: mut builder, report: loaded } = match name.strip_prefix("gen:") {
        Some(spec) => made(spec, &settings.load)?,
        None => hplt_io::load_scene(Path::new(name), &settings.load)?,
    };
    add_lights(&mut builder, &settings.config.light)?;
    let (scene, built) = match builder.build(settings.load.policy) {
        Ok((scene, report)) => (Some(scene), report),
        Err(hplt_geom::Error::NoSurface) if settings.allow_empty => (None, SceneReport::default()),
        Err(error) => return Err(build_failure(&shown, error)),
    };
    let mut warnings = loaded.warnings.clone();
    if loaded.suppressed_warnings > 0 {
        warnings.push(format!("{} more warnings about the file", loaded.suppressed_warnings));
    }
    warnings.extend(build_warnings(&built));
    let mut left_out = loaded.left_out.clone();
    match &scene {
        Some(scene) => {
            left_out.extend(not_needed(scene));
            warnings.extend(coarse_coordinates(loaded.coordinate_quantum, finest_radius(scene, settings)));
        }
        None => warnings.push("the scene has no surface: there is nothing to light".into()),
    }
    Ok(LoadedScene { name: shown, scene, loaded, warnings, left_out })
}

/// What `gen:SPEC` stands for: `NAME[:TRIANGLES]`, or what is made of a file, `room-with=FILE[:SCALE]` or `flat=FILE`.
///
/// # Errors
/// When there is no such scene, or the file cannot be used.
pub fn made(spec: &str, options: &LoadOptions) -> Result<Loaded, Failure> {
    match spec.split_once('=') {
        Some(("room-with", rest)) => room::load(rest, options),
        Some(("flat", file)) => flat::load(file, options),
        _ => Ok(Loaded { scene: builtin::from_spec(spec)?, report: LoadReport::default() }),
    }
}

/// Why a scene cannot be built, and what would help.
pub fn build_failure(name: &str, error: hplt_geom::Error) -> Failure {
    let hint = match &error {
        hplt_geom::Error::NoSurface => "; --allow-empty accepts it",
        hplt_geom::Error::NotFinite { place, .. } | hplt_geom::Error::OutOfRange { place, .. } => {
            match place.starts_with("mesh") {
                true => "; --drop-bad drops such triangles",
                false if place.starts_with("material") => "; --clamp-materials brings it into range",
                false => "",
            }
        }
        _ => "",
    };
    let error = hplt_io::Error::from(error);
    let exit = if error.exit_code() == 4 { Exit::Limit } else { Exit::Input };
    Failure::new(exit, error.code(), format!("{name}: {error}{hint}"))
}

fn build_warnings(report: &SceneReport) -> Vec<String> {
    let count = |n: u64, what: &str| (n > 0).then(|| format!("{n} {what}"));
    [
        count(report.degenerate, "triangles without area were dropped"),
        count(report.non_finite, "triangles with unusable coordinates were dropped"),
        count(report.duplicates, "triangles that repeat another were dropped"),
        count(report.duplicates_of_other_material, "of them had another material; the first in the file was kept"),
        count(report.repaired_normals, "vertex normals were repaired"),
        count(report.clamped_materials.len() as u64, "materials were clamped into range"),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// A warning where the file places vertices so coarsely that the finest functions would see it.
fn coarse_coordinates(quantum: f64, radius: f64) -> Option<String> {
    (quantum > radius / SHARE_OF_RADIUS).then(|| {
        format!(
            "coordinate quantum {quantum:.3e} m vs radius {radius:.3e} m: the file places its vertices so far from the origin of their \
             mesh that they are rounded to that; keep coordinates small and move the mesh by its node"
        )
    })
}

/// The radius of the finest level that is asked for, m.
fn finest_radius(scene: &Scene, settings: &Settings) -> f64 {
    let coarsest = match settings.radius {
        Radius::World(length) => length,
        Radius::OfDiagonal(fraction) => fraction * f64::from(scene.diagonal()) * scene.frame().scale(),
    };
    coarsest / 2f64.powi(settings.levels as i32 - 1)
}

/// What a scene does not need is not there.
fn not_needed(scene: &Scene) -> Vec<String> {
    let mut out = Vec::new();
    if !scene.mesh().has_uvs() {
        out.push("texture coordinates: no material needs them".into());
    }
    if scene.environment().is_none() {
        out.push("environment look-ups: there is no environment".into());
    }
    if scene.lights().is_empty() {
        out.push("punctual lights: there are none".into());
    }
    if !scene.is_lit() {
        out.push("the solve: nothing emits light".into());
    }
    out
}
