//! What a camera sees of a field on a point hierarchy: G-buffer, per-pixel evaluation, splatting, and pictures.
//!
//! A [`GBuffer`] holds what every sample of every pixel sees. Three displays fill it with irradiance:
//!
//! | display | function | per sample | differs from the first by |
//! |---|---|---|---|
//! | per-pixel evaluation | [`evaluate`] | a range query per level | - |
//! | splatting | [`splat_delta`], [`splat_absolute`] | blending, about 8.5 functions per level | rounding: the same weights in another order |
//! | flattened splatting | [`flatten_delta`] or [`flatten_absolute`], then [`splat_flattened`] | blending, about 8.5 functions in all | one Shepard interpolation on the level of the leaves, and the details below the threshold |
//!
//! One sample a pixel tells where there are [`Edges`], and [`GBuffer::refined`] adds samples there; what is slow to read is read where it
//! changes ([`read_where_it_changes`]) and once for each surface in a pixel ([`Patches`]).
//!
//! [`radiance`] and [`layers`] then make pictures. This crate knows nothing of transport: direct light at the samples
//! comes from the caller, who asks for it at [`GBuffer::queries`]; so do the regions of the air
//! ([`GBuffer::surface_points`], [`GBuffer::set_regions`]), without which all surfaces are in one region.
//!
//! ```text
//! L = (M + ρ (E_direct + E_indirect))/π
//! ```
//!
//! Decided: splatting runs as on a GPU, supports projected to rectangles, sorted into tiles, blended in a fixed order within
//! each, so that thread counts do not change bits and a GPU version has a twin to be checked against. Rejected: splatting in
//! world space through the kd-tree, which is per-pixel evaluation in disguise.
#![forbid(unsafe_code)]

#[doc = include_str!("../README.md")]
#[cfg(doctest)]
struct Readme;

mod counter;
mod edges;
mod error;
mod evaluate;
mod facet;
mod flat_splat;
mod flatten;
mod gbuffer;
mod lattice;
mod patches;
mod projection;
mod report;
mod shade;
mod splat;
mod tiles;

pub use edges::{Edges, uneven, widened};
pub use error::Error;
pub use evaluate::evaluate;
pub use flat_splat::splat_flattened;
pub use flatten::{FlattenReport, Flattened, flatten_absolute, flatten_delta};
pub use gbuffer::{GBuffer, GBufferOptions};
pub use lattice::{Arriving, read_where_it_changes};
pub use patches::Patches;
pub use projection::{PixelRect, Projection};
pub use report::{SplatReport, Splatted};
pub use shade::{Layer, LayerValues, layers, radiance};
pub use splat::{splat_absolute, splat_delta};
