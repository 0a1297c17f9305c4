//! Where light is looked at: counter-based randomness, scrambled Sobol points, warps, and maximal Poisson-disk
//! hierarchies on the reachable surface of a scene.
//!
//! Everything here is a pure function of the scene, the options and a seed: the same bits at any thread count.
#![forbid(unsafe_code)]

mod error;
pub mod random;
pub mod sobol;
pub mod warp;

pub use error::Error;
