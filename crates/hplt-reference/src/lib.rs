//! The judge of the workspace: everything that says whether a solution is right, and by how much it is wrong.
//!
//! The judge shares with the solver the scene nouns of `hplt-geom` and nothing else: its rays, its sampling and its
//! statistics are its own, so that an error has to be made twice, differently, to go unseen.
//!
//! * [`scenes`]: procedural scenes, from the Cornell box to a colonnade of a quarter of a million triangles
//! * [`closed_forms`]: exact answers, with the constants to test against
//! * [`conformance`]: checks that an implementation of a trait of ours can be put through
//! * [`metrics`]: errors of irradiance at points and of images
//! * [`path_tracer`]: the reference itself
//! * [`statistics`]: equivalence tests, standard errors from replicates
#![forbid(unsafe_code)]
#![cfg_attr(doctest, doc = include_str!("../README.md"))]

pub mod closed_forms;
pub mod conformance;
mod error;
pub mod metrics;
mod parallel;
pub mod path_tracer;
pub mod scenes;
pub mod statistics;

pub use error::Error;
pub use path_tracer::PathTracer;
