use super::json::Document;
use crate::{Error, LoadReport};

/// Extensions that are understood.
const READ: [&str; 5] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "EXT_mesh_gpu_instancing",
];

/// Extensions that a diffuse solution can do without: what they add is left out.
const LEFT_OUT: [&str; 14] = [
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_unlit",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_volume",
    "KHR_materials_clearcoat",
    "KHR_materials_sheen",
    "KHR_materials_iridescence",
    "KHR_materials_anisotropy",
    "KHR_materials_dispersion",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_variants",
    "KHR_animation_pointer",
];

/// Refuses a file that requires what is not understood, and warns about the rest.
pub(super) fn check(document: &Document, report: &mut LoadReport) -> Result<(), Error> {
    for (i, name) in document.extensions_required.iter().enumerate() {
        if !READ.contains(&&name[..]) && !LEFT_OUT.contains(&&name[..]) {
            let message = format!("needs {}, which hplt does not read; {}", crate::sanitized(name), advice(name));
            return Err(Error::invalid(format!("extensionsRequired[{i}]"), "UNSUPPORTED_EXTENSION", message));
        }
    }
    for name in document.extensions_used.iter().filter(|name| !READ.contains(&&name[..])) {
        let what = match &name[..] {
            "KHR_materials_pbrSpecularGlossiness" => "its diffuse part is read, the rest left out",
            "KHR_materials_unlit" => "unlit materials are diffuse reflectors here",
            _ => "left out",
        };
        report.leave_out(format!("extension {name}: {what}"));
    }
    Ok(())
}

pub(super) fn uses(document: &Document, extension: &str) -> bool {
    document.extensions_used.iter().chain(document.extensions_required.iter()).any(|name| name == extension)
}

/// What to do about a file that needs an extension.
pub(super) fn advice(extension: &str) -> &'static str {
    match extension {
        "KHR_draco_mesh_compression" => {
            "decompress it with \"gltf-transform copy in.glb out.glb\" (npm package @gltf-transform/cli), then run again"
        }
        "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "decompress it with \"gltf-transform copy in.glb out.glb\" (npm package @gltf-transform/cli), then run again"
        }
        "KHR_texture_basisu" => {
            "convert the textures with \"gltf-transform ktxdecompress\" (npm package @gltf-transform/cli), then run again"
        }
        "EXT_texture_webp" | "EXT_texture_avif" | "MSFT_texture_dds" => {
            "convert the textures with \"gltf-transform png\" (npm package @gltf-transform/cli), then run again"
        }
        _ => "export the scene without it, then run again",
    }
}
