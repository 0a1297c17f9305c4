//! Where light is looked at: counter-based randomness, scrambled Sobol points, warps, and maximal Poisson-disk
//! hierarchies on the reachable surface of a scene.
//!
//! Everything here is a pure function of the scene, the options and a seed: the same bits at any thread count.
//!
//! Decisions. The order in which candidates are drawn is their priority: they are independent draws, so any order is as
//! random as any other, and a longer run only appends. Regions are made of visible paths, never of distances, so that a
//! floor that runs on under a wall belongs to two rooms. Rejected: volumetric flood fill, which leaks through walls thinner
//! than its cells, and sampling by rays from the camera, which misses what the camera does not see.
#![forbid(unsafe_code)]

#[doc = include_str!("../README.md")]
#[cfg(doctest)]
struct Readme;

mod candidates;
mod components;
mod error;
mod hierarchy;
mod morton;
mod options;
pub mod poisson;
pub mod random;
mod refine;
mod region_build;
mod regions;
mod report;
pub mod sobol;
mod surface;
mod union_find;
mod visibility;
pub mod warp;

pub use error::Error;
pub use hierarchy::{Hierarchy, poisson_hierarchy, random_surface_points};
pub use morton::coherent_order;
pub use options::{HierarchyOptions, Radius};
pub use refine::refined_level;
pub use regions::Regions;
pub use report::{HierarchyReport, Warning};
pub use visibility::{FreeHeights, SIGHT_LIFT, free_height, is_in_sight, sight_line};
