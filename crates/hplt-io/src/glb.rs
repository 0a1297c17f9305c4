use std::path::Path;

use hplt_geom::Scene;

use crate::Error;

/// Writes a scene as a GLB file that loads back to the same scene; returns what the format cannot hold, one line each.
///
/// # Errors
/// [`Error::Write`] when the file cannot be written.
pub fn write_glb(path: &Path, scene: &Scene) -> Result<Vec<String>, Error> {
    let _ = scene;
    Err(Error::write(path, std::io::Error::from(std::io::ErrorKind::Unsupported)))
}
