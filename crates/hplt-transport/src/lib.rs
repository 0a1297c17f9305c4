//! Direct projection, the gather, and the two variants of hierarchical transport.
//!
//! ```text
//! E'(x) = ∫ (1/π) B(y_ω) <n, ω> dω ≈ (1/N) Σ_k ρ(y_k) F_s(y_k)        y_k = first hit of cosine-distributed ray k
//! ```
//!
//! Light flows through four functions:
//!
//! 1. [`project_direct`]: the light that arrives straight from emitters, lights and sky, as coefficients;
//! 2. [`transport_delta`] (V1, the original) or [`transport_absolute`] (V3, the optimised version): bounce after bounce, on
//!    the fly, refined where an [`Oracle`] asks for it, to a [`Solution`] and a [`TransportReport`];
//! 3. [`final_gather`]: the solution read through one more gather, at any points;
//! 4. [`estimate_error`]: how far the solution is from its own gather with fresh rays.
//!
//! [`direct_irradiance`] gives the direct part at any points; displays and measurements add it to the indirect part.
//!
//! The rays of a receiver are a pure function of the seed and the receiver, the same in every bounce: the bounces are the
//! Neumann series of one fixed linear operator. Everything is bit-identical at any thread count.
#![forbid(unsafe_code)]

mod absolute;
mod bounce;
mod delta;
mod direct;
mod emitters;
mod error;
mod estimate;
mod final_gather;
mod gather;
mod gradients;
mod leaks;
mod light_tree;
mod links;
mod next_event;
mod operator;
mod options;
mod oracle;
mod paths;
mod relight;
mod report;
mod sight;
mod sky;
mod sky_view;
mod solve;
mod sparse;
mod visible;

pub use absolute::transport_absolute;
pub use delta::transport_delta;
pub use direct::{
    DirectEstimator, DirectLight, DirectOptions, direct_irradiance, direct_irradiance_by_group, project_direct,
};
pub use error::Error;
pub use estimate::{ErrorEstimate, ErrorProbe, estimate_error};
pub use final_gather::{CONTACT, FinalGather, FinalGatherOptions, final_gather, final_gather_more};
pub use gather::Sender;
pub use gradients::Gradients;
pub use leaks::{Leak, leaks};
pub use links::{LinkOptions, LinkPrecision, LinkReport, Linked, LinkedLevel, transport_links};
pub use operator::LinearOperator;
pub use options::{Model, TransportOptions};
pub use oracle::{Detail, Oracle, Threshold};
pub use relight::{GroupLight, Relighting, Relit, SolvedGroup, weighted_sum};
pub use report::{BounceReport, Solution, StopReason, TransportReport};
pub use sight::{FieldView, LayeredInSight, LayeredNearestInSight, OpenAir, Reading, read_in_sight};
pub use sky_view::{SkyView, sky_view};
pub use solve::{
    ComponentReport, Gain, Method, SolveOptions, SolveReport, SolveStop, System, Unknowns, solve, solve_from,
    solve_many, solve_with_gain,
};
pub use sparse::{SparseParts, SparseRows};
