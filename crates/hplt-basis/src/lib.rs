//! Shepard bases on a point hierarchy.
//!
//! Every level of a [`PointHierarchy`](hplt_geom::PointHierarchy) spans one function space: the normalised weights
//! (Shepard 1968) of its points, a partition of unity over the reachable surface. [`ShepardBasis`] evaluates them,
//! [`Coefficients`] holds a field in them, its type carrying the encoding ([`Delta`] or [`Absolute`]), and a
//! [`Reconstruction`] turns coefficients back into values.
//!
//! ```text
//! w_i(p) = K(d_i(p)/b) · max(0, n·n_i)²      d_i(p) = |Δ + 2 (Δ·n_i) n_i|,  Δ = p - x_i
//! B_i(p) = w_i(p) / Σ_j w_j(p)
//! delta:     F(p)  = Σ_l Σ_j α_j^l B_j^l(p)        α_i^0 = f_i,  α_i^l = f_i - F_{l-1}(p_i)
//! absolute:  F^l(p) =    Σ_j α_j^l B_j^l(p)        α_i^l = f_i
//! ```
//!
//! Functions are indexed by `u32` within their level, in the order of the hierarchy's points. Weights never cross from
//! one [`RegionId`](hplt_geom::RegionId) to another: light cannot either.
//!
//! Decided: the functions store *irradiance*, so that albedo detail (textures) stays exact; the rejected alternative, storing
//! radiosity, blurs it.
#![forbid(unsafe_code)]

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadmeExample;

mod basis;
mod cells;
mod coefficients;
mod coverage;
mod expand;
mod kernel;
mod lanes;
mod layered;
mod nearest;
mod parents;
mod reconstruction;

pub use basis::{BasisOptions, Footprint, MIN_WEIGHT_SUM, ShepardBasis, Weight};
pub use coefficients::{Absolute, Coefficients, Delta, absolute_from_delta, delta_from_absolute, restrict};
pub use coverage::Coverage;
pub use expand::LayeredScratch;
pub use kernel::{Kernel, distance_squared, smoothstep};
pub use layered::{Layered, LayeredNearest};
pub use parents::Parents;
pub use reconstruction::{ApproximateNearest, ExactShepard, Reconstruction};
