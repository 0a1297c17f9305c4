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

#[cfg(test)]
mod tests {
    use hplt_geom::{BuildPolicy, Rgb};

    use super::*;

    /// A cut-out triangle with a texture of two texels: black and transparent, white and opaque.
    const LEAF: &str = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":2},"indices":1,"material":0}]}],
        "materials":[{"name":"leaf","alphaMode":"MASK","pbrMetallicRoughness":
        {"baseColorFactor":[0.8,0.4,0.2,1],"metallicFactor":0,"baseColorTexture":{"index":0}}}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
        {"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"},{"bufferView":0,"componentType":5126,"count":3,"type":"VEC2"}],
        "bufferViews":[{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":6}],"buffers":[{"byteLength":44,
        "uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAABAAIAAAA="}],
        "textures":[{"source":0}],"images":[{"uri":"data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAIAAAABCAYAAAD0In+KAAAADklEQVR4nGNgAIL/QAAACf8D/daDQRcAAAAASUVORK5CYII="}]}"#;

    #[test]
    fn only_the_materials_change() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("leaf.gltf");
        std::fs::write(&path, LEAF).unwrap();
        let (flat, textured) = (
            load(&path.to_string_lossy(), &LoadOptions::default()).unwrap(),
            hplt_io::load_scene(&path, &LoadOptions::default()).unwrap(),
        );
        assert!(flat.report.left_out.len() > textured.report.left_out.len());
        let [flat, textured] = [flat, textured].map(|loaded| loaded.scene.build(BuildPolicy::default()).unwrap().0);
        assert_eq!(flat.mesh().positions(), textured.mesh().positions());
        let [leaf, before] = [&flat.materials()[0], &textured.materials()[0]];
        assert!(before.needs_uvs() && before.alpha.is_some() && !leaf.needs_uvs() && leaf.alpha.is_none());
        assert_eq!((leaf.name.as_str(), leaf.albedo), ("leaf", Rgb::new(0.4, 0.2, 0.1)));
    }
}
