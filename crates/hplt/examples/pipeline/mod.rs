//! The pipeline that the examples share: everything but the stage that each of them replaces.
#![allow(dead_code)] // every example uses a part

use hplt::basis::{Absolute, ApproximateNearest, BasisOptions, ExactShepard, Kernel, Reconstruction, ShepardBasis};
use hplt::geom::{Bvh, BvhOptions, Image, NoProgress, RayCaster, Scene};
use hplt::reference::{metrics::image_error, scenes};
use hplt::sampling::{Hierarchy, HierarchyOptions, poisson_hierarchy, random::Stage};
use hplt::splat::{GBuffer, GBufferOptions, evaluate, radiance};
use hplt::transport::{
    DirectLight, DirectOptions, Model, Oracle, TransportOptions, TransportReport, direct_irradiance, project_direct,
    transport_absolute,
};

pub type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// The stages that can be swapped.
#[derive(Clone, Copy)]
pub struct Stages<'a> {
    /// Casts all rays.
    pub caster: &'a dyn RayCaster,
    /// The shape of the basis functions.
    pub kernel: Kernel,
    /// Where to refine; `None` for the threshold of the preview.
    pub oracle: Option<&'a dyn Oracle>,
    /// Reads senders at the hits of gather rays.
    pub senders: &'a dyn Reconstruction<Absolute>,
    /// Reads the solution at the pixels.
    pub display: &'a dyn Reconstruction<Absolute>,
}

impl<'a> Stages<'a> {
    /// What hplt brings.
    pub fn usual(caster: &'a dyn RayCaster) -> Self {
        Self { caster, kernel: Kernel::Smoothstep, oracle: None, senders: &ApproximateNearest, display: &ExactShepard }
    }
}

/// The Cornell box and its rays.
pub fn cornell() -> (Scene, Bvh) {
    let scene = scenes::build(scenes::cornell_box());
    let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
    (scene, bvh)
}

/// Lights a scene and takes its picture: sample, basis, direct light, bounces, G-buffer, display.
pub fn render(scene: &Scene, stages: Stages<'_>, size: u32) -> Result<(Image, TransportReport)> {
    let Stages { caster, kernel, oracle, senders, display } = stages;
    let quiet = NoProgress;
    let Hierarchy { points, regions, .. } = poisson_hierarchy(scene, caster, &HierarchyOptions::preview(), &quiet)?;
    let basis = ShepardBasis::build(points, BasisOptions { kernel, ..BasisOptions::default() });
    let model = Model { scene, caster, basis: &basis };
    let direct = project_direct(&model, &DirectLight::new(scene, DirectOptions::projection()), &quiet)?;
    let options = TransportOptions::preview();
    let oracle = oracle.unwrap_or(&options.threshold);
    let solution = transport_absolute(&model, &direct, senders, oracle, &options, &quiet)?;

    let camera = scene.cameras().first().ok_or("the scene has no camera")?;
    let mut gbuffer = GBuffer::trace(scene, caster, camera, GBufferOptions::preview(size, size), &quiet)?;
    gbuffer.set_regions(regions.locate(scene, caster, &gbuffer.surface_points()));
    let lights = DirectLight::new(scene, DirectOptions::display());
    let direct = direct_irradiance(&lights, caster, &gbuffer.queries(), Stage::Shading, &quiet)?;
    let (indirect, _) = evaluate(&basis, &solution.indirect, display, &gbuffer, &quiet)?;
    Ok((radiance(&gbuffer, &direct, &indirect), solution.report))
}

/// Renders the Cornell box with the usual stages and with `mine`, and prints what the swap changed.
pub fn compare(scene: &Scene, bvh: &Bvh, mine: Stages<'_>) -> Result<()> {
    let (usual, usual_report) = render(scene, Stages::usual(bvh), 128)?;
    let (swapped, report) = render(scene, mine, 128)?;
    let error = image_error(&swapped, &usual)?;
    let (before, after) = (usual_report.n_integrals(), report.n_integrals());
    println!("gathers: {before} before the swap, {after} after; difference of the pictures: {error:?}");
    Ok(())
}
