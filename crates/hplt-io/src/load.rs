use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use hplt_geom::SceneBuilder;

use crate::{Error, LoadOptions, LoadReport};

/// A scene as its file describes it, not built yet, so that lights and an environment can be added.
#[derive(Debug, Clone)]
pub struct Loaded {
    /// Geometry, materials, lights and cameras, in metres, world space.
    pub scene: SceneBuilder,
    /// What was found, changed and left out.
    pub report: LoadReport,
}

/// The scene in a `.gltf`, `.glb` or `.obj` file. A file that starts like a GLB is one, whatever its name.
///
/// # Errors
/// When a file cannot be read, is malformed, exceeds a limit, or needs a feature that is not understood. Values that
/// are out of range are found by `SceneBuilder::build`.
pub fn load_scene(path: &Path, options: &LoadOptions) -> Result<Loaded, Error> {
    let mut loaded = guarded(|| load_by_format(path, options)).map_err(|e| e.in_file(path))?;
    warn_about_geometry(&mut loaded);
    Ok(loaded)
}

fn warn_about_geometry(loaded: &mut Loaded) {
    let Loaded { scene, report } = loaded;
    if report.winding_disagreements > 0 && report.triangles > 0 {
        let percent = 100.0 * report.winding_disagreements as f64 / report.triangles as f64;
        let n = report.winding_disagreements;
        report.warn(format!("{n} triangles ({percent:.2} %) face away from their vertex normals; winding decides"));
    }
    if let Some((min, max)) = scene.bounds() {
        let quantum = report.coordinate_quantum;
        let diagonal = (max - min).length();
        if quantum > 1e-5 * diagonal {
            report.warn(format!(
                "the scene is far from its origin: single precision resolves {quantum:.1e} of its size {diagonal:.1e}"
            ));
        }
    }
}

fn load_by_format(path: &Path, options: &LoadOptions) -> Result<Loaded, Error> {
    if !(options.length_scale.is_finite() && options.length_scale > 0.0) {
        let message = format!("length scale {}; expected a positive number", options.length_scale);
        return Err(Error::invalid("", "OPTION_NOT_IN_RANGE", message));
    }
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    match extension.as_str() {
        #[cfg(feature = "obj")]
        "obj" => crate::obj::load(path, options),
        #[cfg(feature = "gltf")]
        _ => crate::gltf::load(path, options),
        #[cfg(not(feature = "gltf"))]
        _ => {
            let message = "unknown kind of scene file; this program was built to read .obj at most";
            Err(Error::invalid("", "FORMAT_UNKNOWN", message))
        }
    }
}

/// Runs a reader; a panic inside it becomes an error.
pub(crate) fn guarded<T>(read: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
    catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(|payload| {
        let message = payload
            .downcast_ref::<&str>()
            .map(|s| (*s).to_owned())
            .or_else(|| payload.downcast_ref::<String>().cloned())
            .unwrap_or_default();
        Err(Error::Internal { file: String::new(), message: crate::sanitized(&message) })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_an_error() {
        let error = guarded::<()>(|| panic!("index {}", 7)).unwrap_err().in_file(Path::new("a.glb"));
        assert_eq!(error.to_string(), "a.glb: internal error in loader (please report): index 7");
        assert_eq!((error.code(), error.exit_code()), ("INTERNAL", 3));
    }
}
