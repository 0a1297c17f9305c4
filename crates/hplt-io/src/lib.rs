//! Scene files in; images, tables and solutions out. The only library crate that opens files.
#![forbid(unsafe_code)]

mod atomic;
mod environment;
mod error;
#[cfg(feature = "exr")]
mod exr;
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
#[cfg(any(feature = "png", feature = "textures"))]
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
