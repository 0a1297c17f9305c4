//! Scene nouns, radiometry, rays, and a watertight BVH.
//!
//! This crate owns the values that flow through the pipeline: [`Scene`] (geometry, materials, lights),
//! [`Camera`], [`OrientedPoint`] and [`PointHierarchy`], and the one trait that every stage casts rays
//! through, [`RayCaster`], with its implementation [`Bvh`].
//!
//! # Spaces
//!
//! Everything inside a [`Scene`] is in *scene space*: world space, recentred, and scaled by an exact power of two so
//! that the scene is about one unit large ([`Frame`]). Recentring happens in `f64`, before anything is rounded to `f32`,
//! so a scene far from the origin keeps its detail. World coordinates appear only at the door: in
//! [`SceneBuilder`], in loaders, and in what is written out.
//!
//! # Quantities
//!
//! See [`radiometry`]. The basis stores irradiance `E`; materials store albedo `ρ` and emitted exitance `M`.
#![forbid(unsafe_op_in_unsafe_fn)]

pub use glam;

mod bvh;
mod camera;
mod cell_order;
mod environment;
mod error;
mod frame;
mod image;
mod light;
mod light_groups;
mod material;
mod mesh;
pub mod parallel;
mod point;
mod progress;
pub mod radiometry;
mod ray;
mod scene;
mod shaft;
mod texture;

pub use bvh::{Bvh, BvhOptions, BvhReport};
pub use camera::Camera;
pub use cell_order::order_by_cell;
pub use environment::Environment;
pub use error::Error;
pub use frame::Frame;
pub use image::Image;
pub use light::{Light, LightShape};
pub use light_groups::{LightGroupId, LightGroups};
pub use material::{AlphaMask, Material, MaterialId, Sides, TextureSlot};
pub use mesh::{Mesh, TriangleId};
pub use point::{Extent, N_SECTORS, OrientedPoint, PointHierarchy, PointLevel, RegionId};
pub use progress::{Interrupted, NoProgress, Progress};
pub use radiometry::Rgb;
pub use ray::{Blocker, Hit, Ray, RayCaster, offset_origin};
pub use scene::{BuildPolicy, MeshInput, Scene, SceneBuilder, SceneReport, SurfacePoint};
pub use shaft::Shaft;
pub use texture::{Texture, UvTransform, Wrap};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadmeExample;
