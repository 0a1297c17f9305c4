//! Scene files in; images, tables and solutions out. The only library crate that opens files.
//!
//! ```no_run
//! use std::path::Path;
//!
//! use hplt_io::{LoadOptions, load_scene};
//!
//! let options = LoadOptions::default();
//! let loaded = load_scene(Path::new("room.glb"), &options)?;
//! for warning in &loaded.report.warnings {
//!     eprintln!("warning: {warning}");
//! }
//! let (scene, dropped) = loaded.scene.build(options.policy)?;
//! println!("{} triangles, {} dropped", scene.mesh().n_triangles(), dropped.degenerate + dropped.duplicates);
//! # Ok::<(), hplt_io::Error>(())
//! ```
//!
//! # How files are read
//!
//! | in the file | in the scene |
//! |---|---|
//! | base colour (factor × texture), OBJ `Kd` × `map_Kd` | diffuse albedo; metallic, roughness and every gloss are left out, with a warning that names the material when it is metallic |
//! | albedo above [`LoadOptions::max_albedo`] (0.98), up to 1 | lowered to it, with a warning and a count: a closed room of albedo 1 has no solution |
//! | albedo outside [0, 1], emission below 0, NaN, infinity | an error of `SceneBuilder::build`; clamped when the policy says so |
//! | no material | grey: albedo 0.8 in glTF, 0.5 in OBJ, with a warning. (The default material of glTF is white metal, which would be black or nearly divergent here.) |
//! | emission (factor × strength × texture), OBJ `Ke` × `map_Ke` | radiance `L` in W m⁻² sr⁻¹; the exitance is `M = πL` |
//! | single-sided material | reflects on both sides (a sheet of paper is painted on both), emits from its front; black on its back with [`LoadOptions::one_sided`] |
//! | double-sided material | reflects and emits on both sides |
//! | `alphaMode` MASK, BLEND | a cut-out; opaque, with a warning |
//! | candela, lux of punctual lights | W/sr and W/m² one to one, or divided by 683: [`LightUnit`]; their range is left out |
//! | texture without coordinates in the mesh, or an emissive texture with a coordinate set of its own | its mean |
//! | node transforms | composed in `f64`; a mirror turns the winding round, so that fronts stay fronts |
//! | vertex colours, skins, morph targets, animations, lines, points, orthographic cameras | left out, and listed in the report |
//! | lengths | metres, times [`LoadOptions::length_scale`] |
//!
//! glTF extensions: `KHR_lights_punctual`, `KHR_materials_emissive_strength`, `KHR_mesh_quantization`,
//! `KHR_texture_transform` and `EXT_mesh_gpu_instancing` are read, the diffuse part of
//! `KHR_materials_pbrSpecularGlossiness` too; other material extensions are left out. A file that requires anything else
//! (Draco, meshopt, Basis textures) is refused with the advice what to do.
//!
//! OBJ polygons are split as fans, which is right for convex ones alone.
//!
//! # Files that lie
//!
//! Nothing is allocated because a file declares it: sizes are checked against the bytes that exist and against
//! [`Limits`]. Files are read from the folder of the scene and below it, regular files only; a reference with a scheme
//! other than `data:` is refused. Errors are one line with the file, the place, the value and a stable
//! [code](Error::code). The JSON of glTF is parsed into types of our own with `serde_json`, and accessors are read by a
//! reader of our own: the importers at hand panic on damaged files or follow them out of their folder.
//!
//! Outputs are [written atomically](write_atomically): an old file is never lost.
#![forbid(unsafe_code)]

#[cfg(all(doctest, feature = "gltf", feature = "exr"))]
#[doc = include_str!("../README.md")]
struct Readme;

mod atomic;
mod environment;
mod error;
#[cfg(feature = "exr")]
mod exr;
#[cfg_attr(
    not(any(feature = "gltf", feature = "obj", feature = "exr", feature = "hdr", feature = "png", feature = "csv")),
    allow(dead_code, reason = "the formats that read whole files are off")
)]
mod files;
#[cfg(any(feature = "gltf", feature = "obj"))]
mod folder;
#[cfg(feature = "gltf")]
mod glb;
#[cfg(feature = "gltf")]
mod gltf;
#[cfg(feature = "hdr")]
mod hdr;
mod load;
#[cfg(feature = "obj")]
mod obj;
mod options;
mod ply;
#[cfg(feature = "png")]
mod png;
#[cfg(feature = "csv")]
mod points;
#[cfg(any(feature = "gltf", feature = "obj"))]
mod policy;
mod report;
pub mod solution;
mod srgb;
#[cfg(any(feature = "gltf", feature = "obj"))]
mod texture;
#[cfg(any(feature = "gltf", feature = "obj"))]
mod winding;

pub use atomic::write_atomically;
pub use environment::{load_environment, read_image};
pub use error::{Error, sanitized};
#[cfg(feature = "exr")]
pub use exr::{ExrChannel, ExrImage, ExrPrecision, ExrSamples, read_exr, write_exr};
#[cfg(feature = "gltf")]
pub use glb::write_glb;
#[cfg(feature = "hdr")]
pub use hdr::read_hdr;
pub use load::{Loaded, load_scene};
pub use options::{LightUnit, Limits, LoadOptions};
pub use ply::{PlyPoint, write_ply};
#[cfg(feature = "png")]
pub use png::{PngOptions, ToneMap, read_png, write_png};
#[cfg(feature = "csv")]
pub use points::{
    IRRADIANCE_COLUMNS, IrradianceRow, SensorPoint, read_irradiance_csv, read_points_csv, write_irradiance_csv,
    write_irradiance_rows,
};
pub use report::LoadReport;
pub use solution::{Section, SectionData, SolutionFile, read_solution, write_solution};
pub use srgb::linear_from_srgb;
