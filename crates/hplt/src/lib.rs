//! Hierarchical point-based light transport: diffuse global illumination in a function space on a hierarchy of surface
//! points, without unwrapping or remeshing (Zollhöfer 2010; Zollhöfer & Stamminger 2011; Lehtinen et al. 2008).
//!
//! This crate is the façade: every crate of the workspace as a module, and this guide. Depend on a single crate where you need a
//! single stage; depend on this one to light scenes.
//!
//! # How light flows from a scene file to a picture
//!
//! Nouns flow, verbs are free functions: each step makes a plain value out of finished ones.
//!
//! 1. [`io::load_scene`] reads glTF, GLB or OBJ into a [`geom::SceneBuilder`], to which lights and cameras can be added;
//!    [`build`](geom::SceneBuilder::build) checks every number once and maps all of it into *scene space*, about one unit large.
//! 2. [`geom::Bvh::build`] makes it castable: a [`geom::RayCaster`].
//! 3. [`sampling::poisson_hierarchy`] spreads oriented points over the surface that light can reach, level by level, radii halving,
//!    and finds the *regions* of the air: closed rooms never mix.
//! 4. [`basis::ShepardBasis::build`] turns the points into functions: a partition of unity per level.
//! 5. [`transport::project_direct`] stores the irradiance that arrives straight from lights; the functions store *irradiance*, so that
//!    albedo and its textures stay sharp.
//! 6. [`transport::transport_absolute`] (or [`transport_delta`](transport::transport_delta), the original) gathers bounce after bounce, refining where
//!    an [`Oracle`](transport::Oracle) asks for it, and reports how much light is still to come.
//! 7. [`splat::GBuffer::trace`] finds what the camera sees. Direct light is computed at every sample
//!    ([`transport::direct_irradiance`]), indirect light is read from the functions ([`splat::evaluate`] or one of the splatting
//!    displays), and [`splat::radiance`] makes the picture.
//! 8. [`io::write_exr`] and [`io::write_png`] write it.
//!
#![cfg_attr(not(feature = "exr"), doc = "[`io::write_exr`]: crate::io")]
#![cfg_attr(not(feature = "png"), doc = "[`io::write_png`]: crate::io")]
//!
//! All of it, on a scene whose answer is known: a closed box whose walls have albedo ½ and emit 1 W/m². Every point receives
//! `E = M/(1-ρ) = 2` W/m², and radiates `(M + ρE)/π = 2/π` W m⁻² sr⁻¹.
//!
//! ```
//! use hplt::basis::{ApproximateNearest, BasisOptions, ExactShepard, ShepardBasis};
//! use hplt::geom::{Bvh, BvhOptions, Camera, NoProgress, Rgb, glam::DVec3};
//! use hplt::reference::scenes;
//! use hplt::sampling::{Hierarchy, HierarchyOptions, poisson_hierarchy, random::Stage};
//! use hplt::splat::{GBuffer, GBufferOptions, evaluate, radiance};
//! use hplt::transport::{
//!     DirectLight, DirectOptions, Model, TransportOptions, direct_irradiance, project_direct, transport_absolute,
//! };
//!
//! // A scene, its rays, points on it, functions on them.
//! let scene = scenes::build(scenes::furnace_box(Rgb::splat(0.5), Rgb::ONE));
//! let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
//! let options = HierarchyOptions { n_levels: 2, ..HierarchyOptions::preview() };
//! let Hierarchy { points, regions, .. } = poisson_hierarchy(&scene, &bvh, &options, &NoProgress)?;
//! let basis = ShepardBasis::build(points, BasisOptions::default());
//! let model = Model { scene: &scene, caster: &bvh, basis: &basis };
//!
//! // Direct light, then all bounces.
//! let lights = DirectLight::new(&scene, DirectOptions::projection());
//! let direct = project_direct(&model, &lights, &NoProgress)?;
//! let options = TransportOptions { n_rays: 64, tolerance: 1e-4, ..TransportOptions::production() };
//! let oracle = options.threshold;
//! let solution = transport_absolute(&model, &direct, &ApproximateNearest, &oracle, &options, &NoProgress)?;
//! assert!(solution.report.is_converged());
//! assert_eq!(solution.report.n_escaped(), 0);
//!
//! // What a camera sees of it.
//! let camera = Camera::look_at(DVec3::splat(0.1), DVec3::splat(0.9), DVec3::Y, 1.2)?;
//! let mut gbuffer = GBuffer::trace(&scene, &bvh, &camera, GBufferOptions::preview(16, 16), &NoProgress)?;
//! gbuffer.set_regions(regions.locate(&scene, &bvh, &gbuffer.surface_points()));
//! let direct = direct_irradiance(&lights, &bvh, &gbuffer.queries(), Stage::Shading, &NoProgress)?;
//! let (indirect, coverage) = evaluate(&basis, &solution.indirect, &ExactShepard, &gbuffer, &NoProgress)?;
//! assert_eq!(coverage.uncovered, 0);
//! let image = radiance(&gbuffer, &direct, &indirect);
//! let exact = 2.0 / std::f32::consts::PI;
//! assert!(image.pixels().iter().all(|pixel| (*pixel - exact).abs().max_element() < 1e-3 * exact));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Swapping a stage
//!
//! A trait exists where a stage calls back: [`geom::RayCaster`], [`transport::Oracle`], [`basis::Reconstruction`], and the
//! function in [`basis::Kernel`]. Everything else is swapped by calling another function. The examples `swap_caster`, `swap_oracle`,
//! `swap_reconstruction` and `swap_kernel` replace one stage each, in at most 20 lines, and print what that changes; `cornell` is the
//! whole way to a PNG and an EXR file.
//!
//! # Units, errors, repeatability
//!
//! Metres, W/m² and W m⁻² sr⁻¹ in linear Rec. 709; see [`geom::radiometry`], the only module with a π. Libraries never print and
//! never read a clock; callers pass a [`geom::Progress`]. The same input, options and seed give the same bits at any number of
//! threads, with and without the feature `rayon`.
#![forbid(unsafe_code)]

#[doc = include_str!("../README.md")]
#[cfg(doctest)]
struct Readme;

pub use hplt_basis as basis;
pub use hplt_geom as geom;
pub use hplt_io as io;
pub use hplt_kdtree as kdtree;
pub use hplt_reference as reference;
pub use hplt_sampling as sampling;
pub use hplt_splat as splat;
pub use hplt_transport as transport;
