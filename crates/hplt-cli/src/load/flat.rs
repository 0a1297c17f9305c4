//! A file in flat colours: `gen:flat=FILE`.

use std::path::Path;

use hplt_io::{LoadOptions, Loaded};

use crate::exit::Failure;

/// The scene of a file with every texture replaced by its mean colour and every cut-out filled: what a renderer lights that is given
/// nothing but triangles with a colour each. Geometry, lights and cameras are those of the file.
///
/// # Errors
/// When the file cannot be used.
pub fn load(file: &str, options: &LoadOptions) -> Result<Loaded, Failure> {
    let mut loaded = hplt_io::load_scene(Path::new(file), options)?;
    for material in loaded.scene.materials_mut() {
        *material = material.flattened();
    }
    let shown = hplt_io::sanitized(file);
    loaded.report.left_out.push(format!("{shown}: textures and cut-outs; their mean colours are in the scene"));
    Ok(loaded)
}
