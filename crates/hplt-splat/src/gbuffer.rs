use std::ops::Range;

use glam::{DVec3, Vec2, Vec3};
use hplt_geom::{
    Camera, Frame, Hit, Interrupted, OrientedPoint, Progress, Ray, RayCaster, RegionId, Rgb, Scene, TriangleId,
    parallel, radiometry,
};
use hplt_sampling::random::{Stage, Stream, unit_f32};

use crate::counter::Counter;
use crate::facet::Facet;
use crate::{Error, Projection};

/// Pixels per unit of parallel work.
const CHUNK: usize = 256;
/// Samples beyond this are refused: indices are `u32`.
const MAX_SAMPLES: u64 = 1 << 31;

/// The raster of a [`GBuffer`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GBufferOptions {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Samples per pixel along each axis: `n` means `n × n` samples in as many strata. One sample is in the middle of
    /// its pixel; more are jittered.
    pub samples_per_axis: u32,
    /// Seed of the jitter.
    pub seed: u64,
}

impl GBufferOptions {
    /// One sample per pixel.
    pub fn preview(width: u32, height: u32) -> Self {
        Self { width, height, samples_per_axis: 1, seed: 0 }
    }

    /// 3 × 3 samples per pixel.
    pub fn production(width: u32, height: u32) -> Self {
        Self { samples_per_axis: 3, ..Self::preview(width, height) }
    }

    fn samples_per_pixel(&self) -> usize {
        self.samples_per_axis.pow(2) as usize
    }

    fn check(&self) -> Result<(), Error> {
        self.check_for(self.width as usize * self.height as usize, 0)
    }

    /// For so many pixels, and so many samples besides.
    fn check_for(&self, n_pixels: usize, n_others: usize) -> Result<(), Error> {
        let expected = "1 or more";
        for (name, value) in
            [("width", self.width), ("height", self.height), ("samples_per_axis", self.samples_per_axis)]
        {
            if value == 0 {
                return Err(Error::Option { name, value: 0, expected });
            }
        }
        let per_pixel = u64::from(self.samples_per_axis).pow(2);
        let samples = (n_pixels as u64).saturating_mul(per_pixel).saturating_add(n_others as u64);
        if samples > MAX_SAMPLES {
            return Err(Error::Option { name: "width × height × samples", value: samples, expected: "at most 2^31" });
        }
        Ok(())
    }
}

/// What a camera sees, sample by sample, as plain arrays in scene space.
///
/// Pixels are numbered row by row from the top left, and so are their samples: [`samples_of`](GBuffer::samples_of) a pixel are entries of
/// every array, `n × n` in as many strata, row by row. A sample that meets no surface is *background*: its triangle is
/// [`TriangleId::NONE`], its depth infinite, its region [`RegionId::DARK`], its albedo and vectors zero.
#[derive(Debug, Clone, PartialEq)]
pub struct GBuffer {
    options: GBufferOptions,
    projection: Projection,
    frame: Frame,
    /// The first sample of every pixel, and the end of all.
    firsts: Vec<u32>,
    samples: Samples,
}

#[derive(Debug, Clone, PartialEq, Default)]
struct Samples {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    shading_normals: Vec<Vec3>,
    albedos: Vec<Rgb>,
    emitted: Vec<Rgb>,
    depths: Vec<f32>,
    triangles: Vec<TriangleId>,
    fronts: Vec<bool>,
    regions: Vec<RegionId>,
}

impl GBuffer {
    /// Casts one ray per sample. Surface samples start in region 0; see [`set_regions`](Self::set_regions).
    ///
    /// Takes about 90 bytes per sample. Each sample is a pure function of the arguments.
    ///
    /// # Errors
    /// When an option is out of range, or when interrupted.
    pub fn trace(
        scene: &Scene,
        caster: &dyn RayCaster,
        camera: &Camera,
        options: GBufferOptions,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        options.check()?;
        let n_pixels = options.width as usize * options.height as usize;
        let projection = Projection::new(camera, scene.frame(), options.width, options.height);
        let (firsts, samples) = (vec![0; n_pixels + 1], Samples::default());
        let empty = Self { options, projection, frame: *scene.frame(), firsts, samples };
        empty.resampled(options, (scene, caster, camera), &|_| true, progress)
    }

    /// The same picture with `samples_per_axis` squared samples in the pixels that are chosen, and the others as they are. In what is
    /// cast anew, surface samples start in region 0.
    ///
    /// # Errors
    /// When there are none or too many samples, or when interrupted.
    ///
    /// # Panics
    /// When `is_chosen` has not one entry per pixel.
    pub fn refined(
        &self,
        (scene, caster, camera): (&Scene, &dyn RayCaster, &Camera),
        is_chosen: &[bool],
        samples_per_axis: u32,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        assert_eq!(is_chosen.len(), self.n_pixels(), "one choice per pixel");
        let options = GBufferOptions { samples_per_axis, ..self.options };
        let n_kept: usize = (0..self.n_pixels()).filter(|&p| !is_chosen[p]).map(|p| self.samples_of(p).len()).sum();
        options.check_for(is_chosen.iter().filter(|c| **c).count(), n_kept)?;
        self.resampled(options, (scene, caster, camera), &|pixel| is_chosen[pixel], progress)
    }

    /// Casts the rays of the pixels that are chosen, and takes the samples of the others from `self`.
    fn resampled(
        &self,
        options: GBufferOptions,
        (scene, caster, camera): (&Scene, &dyn RayCaster, &Camera),
        is_chosen: &(dyn Fn(usize) -> bool + Sync),
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let n_chunks = self.n_pixels().div_ceil(CHUNK);
        let counter = Counter::new(progress, "g-buffer", n_chunks);
        let chunks = parallel::try_map(n_chunks, Vec::new, |hits, chunk| {
            counter.step()?;
            let pixels = chunk * CHUNK..((chunk + 1) * CHUNK).min(self.n_pixels());
            let chosen = pixels.clone().filter(|&pixel| is_chosen(pixel));
            let rays: Vec<Ray> = chosen.flat_map(|pixel| pixel_rays(scene, camera, &options, pixel)).collect();
            hits.clear();
            hits.resize(rays.len(), Hit::MISS);
            caster.trace_nearest(&rays, hits);
            let mut cast = rays.iter().zip(&*hits);
            let n_kept = self.firsts[pixels.end] - self.firsts[pixels.start];
            let mut samples = Samples::with_capacity(rays.len() + n_kept as usize);
            let mut ends = Vec::with_capacity(CHUNK);
            for pixel in pixels {
                if is_chosen(pixel) {
                    let of_pixel = cast.by_ref().take(options.samples_per_pixel());
                    of_pixel.for_each(|(ray, hit)| samples.push(scene, camera, ray, hit));
                } else {
                    self.samples_of(pixel).for_each(|sample| samples.push_copy(&self.samples, sample));
                }
                ends.push(samples.positions.len() as u32);
            }
            Ok::<_, Interrupted>((ends, samples))
        })?;
        let n_samples = chunks.iter().map(|(_, samples)| samples.positions.len()).sum();
        let mut firsts = Vec::with_capacity(self.firsts.len());
        firsts.push(0);
        let mut samples = Samples::with_capacity(n_samples);
        for (ends, chunk) in chunks {
            let before = samples.positions.len() as u32;
            firsts.extend(ends.into_iter().map(|end| before + end));
            samples.append(chunk);
        }
        Ok(Self { options, projection: self.projection, frame: self.frame, firsts, samples })
    }

    /// Pixels across.
    pub fn width(&self) -> usize {
        self.options.width as usize
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.options.height as usize
    }

    /// Pixels, background included.
    pub fn n_pixels(&self) -> usize {
        self.width() * self.height()
    }

    /// The samples of a pixel.
    pub fn samples_of(&self, pixel: usize) -> Range<usize> {
        self.firsts[pixel] as usize..self.firsts[pixel + 1] as usize
    }

    /// All samples, background included.
    pub fn n_samples(&self) -> usize {
        self.samples.positions.len()
    }

    /// Where scene points fall on the raster.
    pub fn projection(&self) -> &Projection {
        &self.projection
    }

    /// The map between scene space and world space.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Positions.
    pub fn positions(&self) -> &[Vec3] {
        &self.samples.positions
    }

    /// Unit geometric normals on the side that is seen.
    pub fn normals(&self) -> &[Vec3] {
        &self.samples.normals
    }

    /// Unit shading normals, on the same side and within 60° of the geometric ones.
    pub fn shading_normals(&self) -> &[Vec3] {
        &self.samples.shading_normals
    }

    /// Albedos of the sides that are seen.
    pub fn albedos(&self) -> &[Rgb] {
        &self.samples.albedos
    }

    /// Emitted radiance `M/π` of the sides that are seen; for background the radiance of the environment, or zero. W m⁻²
    /// sr⁻¹.
    pub fn emitted(&self) -> &[Rgb] {
        &self.samples.emitted
    }

    /// Distances along the view axis, scene units; infinite for background.
    pub fn depths(&self) -> &[f32] {
        &self.samples.depths
    }

    /// Triangles; [`TriangleId::NONE`] for background.
    pub fn triangles(&self) -> &[TriangleId] {
        &self.samples.triangles
    }

    /// Whether the side that is seen is the front; false for background.
    pub fn fronts(&self) -> &[bool] {
        &self.samples.fronts
    }

    /// The regions of the air that the samples face.
    pub fn regions(&self) -> &[RegionId] {
        &self.samples.regions
    }

    /// Whether a sample meets no surface.
    pub fn is_background(&self, sample: usize) -> bool {
        self.samples.triangles[sample] == TriangleId::NONE
    }

    /// What a sample sees, as far as it tells one piece of surface from another.
    pub(crate) fn facet(&self, sample: usize) -> Facet {
        let s = &self.samples;
        Facet { position: s.positions[sample], normals: [s.normals[sample], s.shading_normals[sample]] }
    }

    /// How many samples meet a surface.
    pub fn n_surface_samples(&self) -> usize {
        self.samples.triangles.iter().filter(|&&t| t != TriangleId::NONE).count()
    }

    /// Position and geometric normal of the samples that meet a surface, in order: what to ask the regions at.
    pub fn surface_points(&self) -> Vec<(Vec3, Vec3)> {
        (0..self.n_samples())
            .filter(|&i| !self.is_background(i))
            .map(|i| (self.samples.positions[i], self.samples.normals[i]))
            .collect()
    }

    /// Sets the regions of the samples that meet a surface, in the order of [`surface_points`](Self::surface_points).
    ///
    /// # Panics
    /// When there are not as many.
    pub fn set_regions(&mut self, regions: Vec<RegionId>) {
        assert_eq!(regions.len(), self.n_surface_samples(), "one region per surface sample");
        let surface = self.samples.triangles.iter().zip(&mut self.samples.regions);
        let surface = surface.filter(|(triangle, _)| **triangle != TriangleId::NONE);
        surface.zip(regions).for_each(|((_, region), new)| *region = new);
    }

    /// A sample as a query, with its *shading* normal, for display: smooth surfaces look smooth.
    pub fn query(&self, sample: usize) -> OrientedPoint {
        let s = &self.samples;
        let (position, normal, region) = (s.positions[sample], s.shading_normals[sample], s.regions[sample]);
        OrientedPoint::new(position, normal, region)
    }

    /// All samples as queries with shading normals; background is in the dark region, where every field is zero.
    pub fn queries(&self) -> Vec<OrientedPoint> {
        (0..self.n_samples()).map(|i| self.query(i)).collect()
    }

    /// All samples as queries with geometric normals, for measurements and for shadow rays that must not start below the
    /// surface.
    pub fn geometric_queries(&self) -> Vec<OrientedPoint> {
        (0..self.n_samples()).map(|i| OrientedPoint { normal: self.samples.normals[i], ..self.query(i) }).collect()
    }

    /// Bytes that the arrays take.
    pub fn memory(&self) -> usize {
        let bytes = 5 * size_of::<Vec3>() + size_of::<f32>() + size_of::<TriangleId>() + 1 + size_of::<RegionId>();
        self.n_samples() * bytes + self.firsts.len() * size_of::<u32>()
    }
}

impl Samples {
    fn with_capacity(n: usize) -> Self {
        Self {
            positions: Vec::with_capacity(n),
            normals: Vec::with_capacity(n),
            shading_normals: Vec::with_capacity(n),
            albedos: Vec::with_capacity(n),
            emitted: Vec::with_capacity(n),
            depths: Vec::with_capacity(n),
            triangles: Vec::with_capacity(n),
            fronts: Vec::with_capacity(n),
            regions: Vec::with_capacity(n),
        }
    }

    fn push(&mut self, scene: &Scene, camera: &Camera, ray: &Ray, hit: &Hit) {
        self.triangles.push(hit.triangle);
        self.fronts.push(hit.is_front);
        if hit.is_miss() {
            self.positions.push(Vec3::ZERO);
            self.normals.push(Vec3::ZERO);
            self.shading_normals.push(Vec3::ZERO);
            self.albedos.push(Rgb::ZERO);
            self.emitted.push(scene.environment().map_or(Rgb::ZERO, |e| e.radiance(ray.direction)));
            self.depths.push(f32::INFINITY);
            self.regions.push(RegionId::DARK);
        } else {
            let point = scene.surface_at(hit);
            let to_point: DVec3 = point.position.as_dvec3() - ray.origin.as_dvec3();
            self.positions.push(point.position);
            self.normals.push(point.normal);
            self.shading_normals.push(point.shading_normal);
            self.albedos.push(scene.albedo(&point));
            self.emitted.push(radiometry::radiance_from_radiosity(scene.exitance(&point)));
            self.depths.push(to_point.dot(camera.forward) as f32);
            self.regions.push(RegionId(0));
        }
    }

    fn push_copy(&mut self, other: &Self, sample: usize) {
        self.positions.push(other.positions[sample]);
        self.normals.push(other.normals[sample]);
        self.shading_normals.push(other.shading_normals[sample]);
        self.albedos.push(other.albedos[sample]);
        self.emitted.push(other.emitted[sample]);
        self.depths.push(other.depths[sample]);
        self.triangles.push(other.triangles[sample]);
        self.fronts.push(other.fronts[sample]);
        self.regions.push(other.regions[sample]);
    }

    fn append(&mut self, mut other: Self) {
        self.positions.append(&mut other.positions);
        self.normals.append(&mut other.normals);
        self.shading_normals.append(&mut other.shading_normals);
        self.albedos.append(&mut other.albedos);
        self.emitted.append(&mut other.emitted);
        self.depths.append(&mut other.depths);
        self.triangles.append(&mut other.triangles);
        self.fronts.append(&mut other.fronts);
        self.regions.append(&mut other.regions);
    }
}

/// The rays of one pixel, stratum by stratum.
fn pixel_rays<'a>(
    scene: &'a Scene,
    camera: &'a Camera,
    options: &'a GBufferOptions,
    pixel: usize,
) -> impl Iterator<Item = Ray> + 'a {
    let (width, height) = (options.width as usize, options.height as usize);
    let corner = Vec2::new((pixel % width) as f32, (pixel / width) as f32);
    let n = options.samples_per_axis;
    let stream = Stream::new(options.seed, Stage::Pixel);
    (0..n * n).map(move |s| {
        let stratum = Vec2::new((s % n) as f32, (s / n) as f32);
        let jitter = if n == 1 { Vec2::splat(0.5) } else { jitter(stream, pixel as u32, s) };
        camera.ray(scene.frame(), width, height, corner + (stratum + jitter) / n as f32)
    })
}

/// Two numbers uniform in `[0, 1)`, a pure function of the arguments.
fn jitter(stream: Stream, pixel: u32, sample: u32) -> Vec2 {
    let [x, y, ..] = stream.words(pixel, sample, 0);
    Vec2::new(unit_f32(x), unit_f32(y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_that_make_no_picture_are_refused() {
        let good = GBufferOptions::production(640, 480);
        assert!(good.check().is_ok());
        assert!(GBufferOptions { width: 0, ..good }.check().is_err());
        assert!(GBufferOptions { samples_per_axis: 0, ..good }.check().is_err());
        assert!(GBufferOptions { samples_per_axis: u32::MAX, ..good }.check().is_err());
    }
}
