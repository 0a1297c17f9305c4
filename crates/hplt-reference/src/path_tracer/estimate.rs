use std::sync::atomic::{AtomicU64, Ordering};

use hplt_geom::glam::{DVec3, Vec2, Vec3};
use hplt_geom::{Camera, Image, Progress};

use super::PathTracer;
use super::rng::{PathNumbers, hash};
use super::vertex::Vertex;
use super::walk::{Arrived, Rules};
use crate::metrics::RELATIVE_FLOOR;
use crate::{Error, parallel};

/// Fewer paths than this that found light say little about how rare such paths are: a standard error of them, 0 above all, is not
/// trusted before a point has had [`LOOKING`] paths.
const TELLING: u64 = 64;
/// Paths of a point that next to no light was found at.
const LOOKING: u64 = 1 << 16;

/// How paths find emitting surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Emission {
    /// By light sampling combined with the reflected ray.
    #[default]
    NextEvent,
    /// By the reflected ray alone: for furnaces and scenes where most surfaces emit.
    Hit,
}

/// How to estimate irradiance at points.
#[derive(Debug, Clone, PartialEq)]
pub struct IrradianceOptions {
    /// Every random number follows from it.
    pub seed: u64,
    /// Independent scramblings per point, at least 2. The standard error has one degree of freedom less.
    pub replicates: u32,
    /// Paths per replicate of every point; a power of two.
    pub samples_per_replicate: u32,
    /// Go on doubling the paths of a point until the standard error of its luminance is below this part of
    /// `max(luminance, 1 % of the mean luminance of all points)`, and as long as next to none of a few ten thousand has found light.
    pub target_relative_error: Option<f64>,
    /// With a target: at most this many paths per replicate.
    pub max_samples_per_replicate: u32,
    /// Reflections before Russian roulette may end a path.
    pub min_bounces: u32,
    /// Leave out light that was reflected more often; `None` for all light.
    pub max_bounces: Option<u32>,
    /// How emitting surfaces are found.
    pub emission: Emission,
}

impl IrradianceOptions {
    /// A few thousand paths per point: one or two per cent on simple scenes.
    pub fn preview() -> Self {
        Self {
            seed: 0,
            replicates: 16,
            samples_per_replicate: 256,
            target_relative_error: None,
            max_samples_per_replicate: 1 << 20,
            min_bounces: 3,
            max_bounces: None,
            emission: Emission::NextEvent,
        }
    }

    /// As many paths per point as a standard error of 0.3 % takes, up to 4 million.
    pub fn reference() -> Self {
        Self { target_relative_error: Some(0.003), max_samples_per_replicate: 1 << 18, ..Self::preview() }
    }

    fn rules(&self) -> Rules {
        Rules { emission: self.emission, min_bounces: self.min_bounces, max_bounces: self.max_bounces }
    }

    fn check(&self) -> Result<(), Error> {
        if self.replicates < 2 {
            let value = self.replicates.into();
            return Err(Error::BadOption { option: "replicates", value, expected: "at least 2" });
        }
        if !self.samples_per_replicate.is_power_of_two() {
            let value = self.samples_per_replicate.into();
            return Err(Error::BadOption { option: "samples per replicate", value, expected: "a power of two" });
        }
        match self.target_relative_error {
            Some(value) if !(value > 0.0 && value.is_finite()) => {
                Err(Error::BadOption { option: "target relative error", value, expected: "more than 0" })
            }
            _ => Ok(()),
        }
    }
}

/// The irradiance at one point, W/m², with standard errors over replicates.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct IrradianceEstimate {
    /// Light that comes straight from emitting surfaces, lights and the environment.
    pub direct: DVec3,
    /// Light that was reflected at least once.
    pub indirect: DVec3,
    /// Standard error of `direct`.
    pub direct_standard_error: DVec3,
    /// Standard error of `indirect`.
    pub indirect_standard_error: DVec3,
    /// Standard error of the sum; not that of independent parts, since both come from the same paths.
    pub total_standard_error: DVec3,
    /// Standard error of the luminance of the sum.
    pub luminance_standard_error: f64,
    /// Paths.
    pub n_samples: u64,
    /// Rays, shadow rays included.
    pub n_rays: u64,
}

impl IrradianceEstimate {
    /// Direct and indirect light together.
    pub fn total(&self) -> DVec3 {
        self.direct + self.indirect
    }
}

/// How to render.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderOptions {
    /// Every random number follows from it.
    pub seed: u64,
    /// Independent scramblings per pixel, at least 2; the variance comes from their spread.
    pub replicates: u32,
    /// Paths per replicate and pixel.
    pub samples_per_replicate: u32,
    /// Reflections before Russian roulette may end a path.
    pub min_bounces: u32,
    /// Leave out light that was reflected more often before it reached the visible surface; `None` for all light.
    pub max_bounces: Option<u32>,
    /// How emitting surfaces are found.
    pub emission: Emission,
}

impl RenderOptions {
    /// 64 paths per pixel.
    pub fn preview() -> Self {
        Self {
            seed: 0,
            replicates: 4,
            samples_per_replicate: 16,
            min_bounces: 3,
            max_bounces: None,
            emission: Emission::NextEvent,
        }
    }
}

/// A rendered picture.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderEstimate {
    /// Radiance, W m⁻² sr⁻¹; box filter over each pixel.
    pub mean: Image,
    /// The variance of `mean` per pixel and channel, from replicates.
    pub variance_of_mean: Image,
    /// Rays, shadow rays included.
    pub n_rays: u64,
}

impl PathTracer<'_> {
    /// The irradiance at every `(position, normal)` (scene space), in the same order.
    ///
    /// A position may lie up to 1e-4 scene units beside its surface; it is moved onto it, to the side that the normal
    /// points to. Farther away it counts as a point in the air. With a target error, stopping depends on the estimate:
    /// a bias far below the standard error.
    ///
    /// # Errors
    /// When an option is out of range, and when cancelled.
    pub fn irradiance(
        &self,
        points: &[(Vec3, Vec3)],
        options: &IrradianceOptions,
        progress: &dyn Progress,
    ) -> Result<Vec<IrradianceEstimate>, Error> {
        options.check()?;
        let first = options.samples_per_replicate;
        let done = AtomicU64::new(0);
        let stages = if options.target_relative_error.is_some() { 2 } else { 1 };
        let n_units = (stages * points.len()) as u64;
        let advance = || progress.advance("reference", done.fetch_add(1, Ordering::Relaxed) + 1, n_units);
        let mut sums = parallel::map(points.len(), progress, |i| {
            let (position, normal) = points[i];
            let start = Vertex::from_point(self.scene, &self.tree, position, normal);
            let mut point = PointSums::new(start, i, options.replicates);
            self.add_samples(&mut point, first, options);
            advance();
            point
        })?;
        if let Some(target) = options.target_relative_error {
            let mean = sums.iter().map(PointSums::luminance).sum::<f64>() / sums.len().max(1) as f64;
            let floor = RELATIVE_FLOOR * mean;
            sums = parallel::map(points.len(), progress, |i| {
                let mut point = sums[i].clone();
                self.refine(&mut point, target, floor, options, progress);
                advance();
                point
            })?;
            // A point that was cut short must not pass for a finished one.
            progress.check()?;
        }
        Ok(sums.iter().map(PointSums::estimate).collect())
    }

    /// Doubles the paths of a point until its error is small enough.
    fn refine(
        &self,
        point: &mut PointSums,
        target: f64,
        floor: f64,
        options: &IrradianceOptions,
        progress: &dyn Progress,
    ) {
        let is_noisy = |point: &PointSums| {
            point.luminance_standard_error() > target * point.luminance().max(floor)
                || point.n_lit < TELLING && point.n_samples() < LOOKING
        };
        while is_noisy(point)
            && point.n.saturating_mul(2) <= options.max_samples_per_replicate
            && !progress.is_cancelled()
        {
            self.add_samples(point, point.n, options);
        }
    }

    fn add_samples(&self, point: &mut PointSums, n: u32, options: &IrradianceOptions) {
        let rules = options.rules();
        for replicate in 0..point.sums.len() {
            let key = hash(&[options.seed, point.index as u64, replicate as u64]);
            let mut sum = point.sums[replicate];
            for i in point.n..point.n + n {
                let arrived = self.walk(point.start, &mut PathNumbers::new(key, i.into()), rules);
                sum.direct += arrived.direct;
                sum.indirect += arrived.indirect;
                sum.n_rays += arrived.n_rays;
                point.n_lit += u64::from(arrived.direct + arrived.indirect != DVec3::ZERO);
            }
            point.sums[replicate] = sum;
        }
        point.n += n;
    }

    /// The picture that `camera` sees, radiance `L = (M + ρE)/π` of the first surface; shading normals count there and
    /// nowhere else.
    ///
    /// # Errors
    /// With fewer than two replicates or no samples, and when cancelled.
    pub fn render(
        &self,
        camera: &Camera,
        width: usize,
        height: usize,
        options: &RenderOptions,
        progress: &dyn Progress,
    ) -> Result<RenderEstimate, Error> {
        if options.replicates < 2 || options.samples_per_replicate == 0 {
            let value = options.replicates.min(options.samples_per_replicate).into();
            return Err(Error::BadOption { option: "replicates and samples", value, expected: "at least 2 and 1" });
        }
        let done = AtomicU64::new(0);
        let rows = parallel::map(height, progress, |row| {
            let pixels: Vec<_> =
                (0..width).map(|column| self.pixel(camera, [width, height], [column, row], options)).collect();
            progress.advance("reference image", done.fetch_add(1, Ordering::Relaxed) + 1, height as u64);
            pixels
        })?;
        let pixels: Vec<_> = rows.into_iter().flatten().collect();
        Ok(RenderEstimate {
            mean: Image::from_pixels(width, height, pixels.iter().map(|p| p.0.as_vec3()).collect()),
            variance_of_mean: Image::from_pixels(width, height, pixels.iter().map(|p| (p.1 * p.1).as_vec3()).collect()),
            n_rays: pixels.iter().map(|p| p.2).sum(),
        })
    }

    /// Mean and standard error of one pixel, and the rays it took.
    fn pixel(
        &self,
        camera: &Camera,
        size: [usize; 2],
        pixel: [usize; 2],
        options: &RenderOptions,
    ) -> (DVec3, DVec3, u64) {
        let rules =
            Rules { emission: options.emission, min_bounces: options.min_bounces, max_bounces: options.max_bounces };
        let mut n_rays = 0;
        let corner = Vec2::new(pixel[0] as f32, pixel[1] as f32);
        let means: Vec<DVec3> = (0..options.replicates)
            .map(|replicate| {
                let key = hash(&[options.seed, pixel[0] as u64, pixel[1] as u64, replicate.into()]);
                let mut sum = DVec3::ZERO;
                for i in 0..options.samples_per_replicate {
                    let mut numbers = PathNumbers::new(key, i.into());
                    let place = corner + numbers.pixel().as_vec2();
                    let ray = camera.ray(self.scene.frame(), size[0], size[1], place);
                    let direction = ray.direction.as_dvec3().normalize();
                    let (radiance, rays) = self.radiance(ray.origin.as_dvec3(), direction, &mut numbers, rules);
                    sum += radiance;
                    n_rays += rays;
                }
                sum / f64::from(options.samples_per_replicate)
            })
            .collect();
        let (mean, error) = mean_and_error(&means);
        (mean, error, n_rays)
    }
}

/// Running sums of one point, per replicate.
#[derive(Debug, Clone)]
struct PointSums {
    start: Vertex,
    index: usize,
    n: u32,
    /// Paths that found light.
    n_lit: u64,
    sums: Vec<Arrived>,
}

impl PointSums {
    fn new(start: Vertex, index: usize, replicates: u32) -> Self {
        Self { start, index, n: 0, n_lit: 0, sums: vec![Arrived::default(); replicates as usize] }
    }

    fn n_samples(&self) -> u64 {
        u64::from(self.n) * self.sums.len() as u64
    }

    fn means(&self, part: impl Fn(&Arrived) -> DVec3) -> Vec<DVec3> {
        self.sums.iter().map(|sum| part(sum) / f64::from(self.n.max(1))).collect()
    }

    fn luminance(&self) -> f64 {
        luminance(mean_and_error(&self.means(|sum| sum.direct + sum.indirect)).0)
    }

    fn luminance_standard_error(&self) -> f64 {
        let values = self.means(|sum| DVec3::splat(luminance(sum.direct + sum.indirect)));
        mean_and_error(&values).1.x
    }

    fn estimate(&self) -> IrradianceEstimate {
        let (direct, direct_standard_error) = mean_and_error(&self.means(|sum| sum.direct));
        let (indirect, indirect_standard_error) = mean_and_error(&self.means(|sum| sum.indirect));
        let (_, total_standard_error) = mean_and_error(&self.means(|sum| sum.direct + sum.indirect));
        IrradianceEstimate {
            direct,
            indirect,
            direct_standard_error,
            indirect_standard_error,
            total_standard_error,
            luminance_standard_error: self.luminance_standard_error(),
            n_samples: self.n_samples(),
            n_rays: self.sums.iter().map(|sum| sum.n_rays).sum(),
        }
    }
}

/// Mean and standard error of the mean of independent replicates; at least two.
fn mean_and_error(values: &[DVec3]) -> (DVec3, DVec3) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<DVec3>() / n;
    let squares: DVec3 = values.iter().map(|&v| (v - mean) * (v - mean)).sum();
    let variance = squares / (n * (n - 1.0));
    (mean, DVec3::new(variance.x.sqrt(), variance.y.sqrt(), variance.z.sqrt()))
}

fn luminance(rgb: DVec3) -> f64 {
    rgb.dot(DVec3::new(0.2126, 0.7152, 0.0722))
}
