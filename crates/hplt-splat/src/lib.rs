//! Displays.
#![forbid(unsafe_code)]

mod counter;
mod error;
mod evaluate;
mod gbuffer;
mod projection;
mod report;
mod shade;
mod splat;
mod tiles;

pub use error::Error;
pub use evaluate::evaluate;
pub use gbuffer::{GBuffer, GBufferOptions};
pub use projection::{PixelRect, Projection};
pub use report::{SplatReport, Splatted};
pub use shade::{Layer, LayerValues, layers, radiance};
pub use splat::{splat_absolute, splat_delta};
