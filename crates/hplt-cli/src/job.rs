//! The stages that light a scene, in order.

use hplt_basis::{BasisOptions, ShepardBasis};
use hplt_geom::{Bvh, BvhOptions, Extent, Interrupted, OrientedPoint, PointHierarchy, Progress, Scene, parallel};
use hplt_sampling::random::Stage;
use hplt_sampling::{HierarchyOptions, Regions, free_height, poisson_hierarchy, random_surface_points};
use hplt_transport::{
    DirectLight, DirectOptions, ErrorProbe, LinkOptions, Linked, Model, StopReason, direct_irradiance, project_direct,
    transport_links,
};

use crate::budget::{Budget, Reading};
use crate::estimate::Estimate;
use crate::exit::{Exit, Failure};
use crate::field::Field;
use crate::indirect::{DOUBTFUL_RAYS, Gathered, indirect_light};
use crate::kept::{Keep, Kept};
use crate::load::LoadedScene;
use crate::progress::Reporter;
use crate::report::{LevelRow, RunReport};
use crate::scene_hash::scene_hash;
use crate::sections::{Preset, Variant};
use crate::settings::Settings;
use crate::values::{Radius, human_bytes};

/// Points at which the error is measured.
const ERROR_POINTS: usize = 256;
/// Rays of each, at first and at most.
const ERROR_RAYS: [u32; 2] = [512, 2048];
/// Share of the surface that may be out of reach of all functions on the coarsest level of links: their rays go on from there.
const UNCOVERED_BY_LINKS: f64 = 0.03;

/// A lit scene: everything that displays and measurements read.
pub struct Lit<'s> {
    /// The scene.
    pub scene: &'s Scene,
    /// Casts rays against it.
    pub bvh: Bvh,
    /// Which part of the air a point faces.
    pub regions: Regions,
    /// Its lights.
    pub lights: DirectLight<'s>,
    /// The function space.
    pub basis: ShepardBasis,
    /// The light.
    pub field: Field,
    /// What a solution file keeps for changes of light.
    pub kept: Option<Kept>,
    /// Whether the bounces were cut short by a signal or the time limit: what is left must be quick.
    pub is_cut_short: bool,
}

impl Lit<'_> {
    /// What the transport reads.
    pub fn model(&self) -> Model<'_> {
        Model { scene: self.scene, caster: &self.bvh, basis: &self.basis }
    }

    /// Points as queries in their regions.
    pub fn locate(&self, points: &[(hplt_geom::glam::Vec3, hplt_geom::glam::Vec3)]) -> Vec<OrientedPoint> {
        let regions = self.regions.locate(self.scene, &self.bvh, points);
        let query = |(): &mut (), i: usize| {
            let (position, normal) = points[i];
            let extent = Extent::of_query(free_height(&self.bvh, position, normal));
            OrientedPoint { extent, ..OrientedPoint::new(position, normal, regions[i]) }
        };
        parallel::map(points.len(), || (), query)
    }
}

/// What links are made from.
pub struct LinkParts<'s> {
    /// The scene.
    pub scene: &'s Scene,
    /// Casts rays against it.
    pub bvh: Bvh,
    /// Which part of the air a point faces.
    pub regions: Regions,
    /// Its lights.
    pub lights: DirectLight<'s>,
    /// The coarsest level.
    pub coarsest: PointHierarchy,
}

/// Measures the time of the stages of a run and enters it into its report.
pub struct Run<'r> {
    /// Says when to stop.
    pub reporter: &'r Reporter,
    /// All values.
    pub settings: &'r Settings,
    /// What a solve is to keep for changes of light.
    pub keep: Keep,
    /// How good the light is to be, or what it may cost.
    pub budget: Budget,
    /// How many points will be read.
    pub n_receivers: usize,
    /// How to read them so that the budget is kept.
    pub reading: Reading,
    /// How fast points are gathered and how noisily, once the error has been measured.
    pub gathers: Option<GatherRecord>,
    /// What is known about the run so far.
    pub report: RunReport,
}

/// What the gathers of an error estimate took and gave.
#[derive(Debug, Clone, Copy)]
pub struct GatherRecord {
    /// Rays per second, points that no light gets to included.
    pub rays_per_second: f64,
    /// Mean relative standard error, were there one ray a point.
    pub noise_of_one_ray: f64,
}

impl<'r> Run<'r> {
    /// A run that has done nothing yet.
    pub fn new(command: &'static str, settings: &'r Settings, reporter: &'r Reporter) -> Self {
        let report = RunReport {
            command,
            version: env!("CARGO_PKG_VERSION"),
            settings: settings.config.clone(),
            ..RunReport::default()
        };
        Self {
            reporter,
            settings,
            keep: Keep::default(),
            budget: Budget::default(),
            n_receivers: 0,
            reading: Reading::Interpolated,
            gathers: None,
            report,
        }
    }

    /// Does `work` as a stage.
    pub fn stage<T>(&mut self, name: &'static str, work: impl FnOnce(&Self) -> T) -> T {
        let start = self.reporter.now();
        let result = work(self);
        self.report.enter_stage(name, self.reporter.now() - start);
        result
    }

    /// Loads a scene as the first stage.
    ///
    /// # Errors
    /// When it cannot be used.
    pub fn load(&mut self, name: &str) -> Result<LoadedScene, Failure> {
        let loaded = self.stage("load", |run| crate::load::load(name, run.settings))?;
        self.report.scene = loaded.name.clone();
        self.report.warnings = loaded.warnings.clone();
        self.report.left_out = loaded.left_out.clone();
        if let Some(scene) = &loaded.scene {
            self.report.triangles = scene.mesh().n_triangles();
            self.report.scene_hash = scene_hash(scene);
            self.report.enter_memory("mesh", scene.mesh().memory());
            self.report.enter_memory("textures", scene.texture_memory());
        }
        Ok(loaded)
    }

    /// Builds the ray caster.
    pub fn build_bvh(&mut self, scene: &Scene) -> Bvh {
        let (bvh, report) = self.stage("bvh", |_| Bvh::build(scene, BvhOptions::production()));
        self.report.enter_memory("bvh", report.memory);
        bvh
    }

    /// The whole pipeline from a scene to light.
    ///
    /// # Errors
    /// When more memory would be needed than there may be, when there is no finite solution, and when stopped before the
    /// first bounce.
    pub fn light<'s>(&mut self, scene: &'s Scene) -> Result<Lit<'s>, Failure> {
        self.check_memory(scene)?;
        let reporter = self.reporter;
        let settings = self.settings;
        let bvh = self.build_bvh(scene);
        let mut options = hierarchy_options(settings);
        if settings.variant == Variant::Links {
            options.n_levels = 1;
            options.max_uncovered = UNCOVERED_BY_LINKS;
        }
        let hierarchy = self.stage("points", |_| poisson_hierarchy(scene, &bvh, &options, reporter));
        let hierarchy = hierarchy.map_err(sampling_failure)?;
        self.enter_hierarchy(&hierarchy.report);
        self.look_for_sky(scene, &bvh)?;
        let regions = hierarchy.regions;
        let options = settings.direct(DirectOptions::projection());
        let lights = self.stage("lights", |_| DirectLight::new(scene, options));
        if settings.variant == Variant::Links {
            let parts = LinkParts { scene, bvh, regions, lights, coarsest: hierarchy.points };
            return match self.budget.is_some() {
                true => self.link_within(parts),
                false => self.link(parts, settings.links()),
            };
        }
        let basis = self.stage("basis", |_| ShepardBasis::build(hierarchy.points, BasisOptions::default()));
        self.report.enter_memory("points, trees, parents", basis.memory());
        self.report.enter_memory("regions", regions.memory());
        let model = Model { scene, caster: &bvh, basis: &basis };
        let direct = self.stage("direct light", |_| project_direct(&model, &lights, reporter))?;
        let how = (settings.variant, settings.reconstruction);
        let solved = self.stage("bounces", |_| Field::solve(&model, direct, how, &settings.transport, reporter));
        let (field, transport) = solved?;
        self.report.enter_transport(&transport, reporter.stop(), settings.must_converge);
        self.report.enter_memory("coefficients", field.memory());
        self.warn_about(&transport.stop);
        if !field.is_finite() {
            return Err(Failure::new(
                Exit::NotFinite,
                "NOT_FINITE",
                "an irradiance is not finite; expected finite light",
            ));
        }
        let is_cut_short = transport.stop == StopReason::Interrupted;
        let lit = Lit { scene, bvh, regions, lights, basis, field, kept: None, is_cut_short };
        if !is_cut_short && transport.stop != StopReason::NoLight {
            self.look_for_leaks(&lit)?;
            self.measure_error(&lit)?;
        }
        Ok(lit)
    }

    /// Lights a scene by links, from the coarsest level on.
    ///
    /// # Errors
    /// Those of the links.
    pub fn link<'s>(&mut self, parts: LinkParts<'s>, options: LinkOptions) -> Result<Lit<'s>, Failure> {
        let LinkParts { scene, bvh, regions, lights, coarsest } = parts;
        let (settings, reporter) = (self.settings, self.reporter);
        let (keep, by_group) = (self.keep, self.keep.is_any());
        let options = LinkOptions { by_group, ..options };
        let mut linked =
            self.stage("links", |_| transport_links(scene, &bvh, coarsest, &lights, &options, reporter))?;
        self.report.enter_links(&linked, scene.frame().scale(), reporter.stop());
        let kept =
            by_group.then(|| self.stage("light by group", |_| Kept::of(&mut linked, keep, &options.solve, reporter)));
        let kept = kept.transpose()?;
        let Linked { basis, direct, indirect, noise, .. } = linked;
        self.report.enter_memory("points, trees, parents", basis.memory());
        self.report.enter_memory("regions", regions.memory());
        let field = Field::linked(direct, (indirect, noise), settings.reading());
        self.report.enter_memory("coefficients", field.memory());
        let is_cut_short = self.report.stop == "time-limit" || self.report.stop == "interrupted";
        let lit = Lit { scene, bvh, regions, lights, basis, field, kept, is_cut_short };
        if self.report.stop == "no-light" {
            self.warn_about(&StopReason::NoLight);
        } else if !is_cut_short {
            self.look_for_leaks(&lit)?;
            self.measure_error(&lit)?;
        }
        Ok(lit)
    }

    /// Measures the error at random points with fresh rays. A stop while doing so only leaves the error out.
    fn measure_error(&mut self, lit: &Lit<'_>) -> Result<(), Failure> {
        let settings = self.settings;
        let seed = settings.transport.seed;
        let reporter = self.reporter;
        let measured = self.stage("error estimate", |_| {
            let points = random_surface_points(lit.scene, &lit.bvh, &lit.regions, ERROR_POINTS, seed);
            let lights = lit.lights.with_options(settings.direct(DirectOptions::measurement()));
            let direct = direct_irradiance(&lights, &lit.bvh, &points, Stage::Error, reporter)?;
            let gathered = (&Gathered::Doubtful(&|_| false), DOUBTFUL_RAYS);
            let found = indirect_light((lit, settings), &points, &direct, gathered, reporter)?;
            let probe = ErrorProbe {
                points: &points,
                direct: &direct,
                light: &lights,
                n_rays: ERROR_RAYS,
                seed,
                indirect: &found.irradiance,
                noise: &found.noise,
            };
            let start = reporter.now();
            let error = lit.field.error(&lit.model(), settings.transport.sender_levels, probe, reporter)?;
            Ok::<_, Interrupted>((error, reporter.now() - start))
        });
        match measured {
            Ok((error, seconds)) => {
                let rays = f64::from(error.n_rays);
                self.gathers = Some(GatherRecord {
                    rays_per_second: error.n_points as f64 * rays / seconds.max(1e-6),
                    noise_of_one_ray: error.noise * rays.sqrt(),
                });
                self.report.error = (error.n_points > 0).then(|| error.into());
            }
            Err(_) => self.report.warnings.push("stopped before the error was measured".into()),
        }
        Ok(())
    }

    fn enter_hierarchy(&mut self, report: &hplt_sampling::HierarchyReport) {
        let rows = report.points_per_level.iter().zip(&report.radii);
        self.report.levels = rows.map(|(&points, &radius)| LevelRow { points: points as usize, radius }).collect();
        self.report.regions = report.n_regions;
        self.report.reachable = Some(report.reachable_fraction);
        self.report.warnings.extend(report.warnings.iter().map(ToString::to_string));
        if report.dark_fraction > 0.0 {
            let percent = crate::values::human_percent(report.dark_fraction);
            self.report.left_out.push(format!("functions on {percent} of the reflecting sides: no light gets there"));
        }
    }

    fn warn_about(&mut self, stop: &StopReason) {
        match stop {
            StopReason::NoLight => self.report.warnings.push("no light: nothing emits, the result is black".into()),
            StopReason::MaxBounces if self.settings.must_converge => self
                .report
                .warnings
                .push("not converged: more --bounces are needed; --tolerance none if exactly so many are meant".into()),
            StopReason::Interrupted => {
                self.report.warnings.push("stopped early: the bounces finished so far are written".into());
            }
            _ => {}
        }
    }

    /// Refuses work that would not fit.
    ///
    /// # Errors
    /// With what was estimated, by part.
    pub fn check_memory(&self, scene: &Scene) -> Result<(), Failure> {
        let limit = match self.settings.config.run.max_memory {
            Some(bytes) => Some(bytes.0),
            None => crate::estimate::available_memory().map(|bytes| bytes / 5 * 4),
        };
        let Some(limit) = limit else { return Ok(()) };
        let estimate = Estimate::of(scene, self.settings);
        let needed = estimate.memory;
        if needed <= limit {
            return Ok(());
        }
        let message = format!(
            "{}: {} points at most, estimated {} ({}); the limit is {}; use a larger --radius, fewer --levels, or raise \
             --max-memory",
            self.report.scene,
            estimate.points(),
            human_bytes(needed),
            estimate.parts_in_words(),
            human_bytes(limit)
        );
        Err(Failure::new(Exit::Memory, "LIMIT_MEMORY", message))
    }
}

/// How points are placed.
pub fn hierarchy_options(settings: &Settings) -> HierarchyOptions {
    let preset = match settings.config.solve.preset {
        Some(Preset::Slides) => HierarchyOptions::slides(),
        _ => HierarchyOptions::production(),
    };
    HierarchyOptions {
        seed: settings.transport.seed,
        n_levels: settings.levels,
        coarsest_radius: match settings.radius {
            Radius::World(length) => hplt_sampling::Radius::World(length),
            Radius::OfDiagonal(fraction) => hplt_sampling::Radius::Fraction(fraction),
        },
        ..preset
    }
}

/// A failure to place points.
pub fn sampling_failure(error: hplt_sampling::Error) -> Failure {
    use hplt_sampling::Error as E;
    match error {
        E::Interrupted(_) => Failure::interrupted(),
        E::TooManyPoints { .. } => Failure::new(Exit::Memory, "LIMIT_MEMORY", error.to_string()),
        _ => Failure::usage(error.to_string()),
    }
}
