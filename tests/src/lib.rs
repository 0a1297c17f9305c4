//! What the integration tests share: the pipeline from a scene to a solution, and where big scenes are.
//!
//! The tests themselves are in `tests/`, one file per section of what is promised: exact answers, form factors, invariants,
//! materials and lights, geometry, extremes. [`checks`] are those members of the suite that the planted [`faults`] are held
//! against.

pub mod checks;
pub mod faults;
pub mod manufactured;
mod stages;
mod verdict;

pub use stages::{Nearest, Occluded, Read, Run, StagedBvh, StagedRead, Stages};
pub use verdict::{area_mean, assert_equivalent, mean_luminance, replicated, slope};

use std::path::{Path, PathBuf};

use hplt::basis::{Absolute, BasisOptions, Coefficients, Coverage, ExactShepard, LayeredNearest, ShepardBasis};
use hplt::geom::{Bvh, BvhOptions, NoProgress, OrientedPoint, RegionId, Rgb, Scene, glam::DVec3, glam::Vec3};
use hplt::sampling::{Hierarchy, HierarchyOptions, HierarchyReport, Radius, Regions, poisson_hierarchy, random::Stage};
use hplt::transport::{
    DirectLight, DirectOptions, Error, FinalGather, FinalGatherOptions, LinkOptions, Linked, Model, Sender, Solution,
    TransportOptions, TransportReport, direct_irradiance, final_gather, project_direct, transport_absolute,
    transport_delta, transport_links,
};

/// How a scene is solved.
#[derive(Debug, Clone)]
pub struct Setup {
    /// Levels of the hierarchy.
    pub n_levels: usize,
    /// Coarsest Poisson radius as a fraction of the diagonal.
    pub radius: f64,
    /// Seed of the points.
    pub points_seed: u64,
    /// Direct light.
    pub direct: DirectOptions,
    /// Bounces.
    pub transport: TransportOptions,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            n_levels: 4,
            radius: 0.085,
            points_seed: 0,
            direct: DirectOptions::projection(),
            transport: TransportOptions { n_rays: 256, ..TransportOptions::production() },
        }
    }
}

/// A scene with everything up to the basis.
pub struct Prepared {
    /// The scene.
    pub scene: Scene,
    /// Its rays.
    pub bvh: StagedBvh,
    /// Regions of the air.
    pub regions: Regions,
    /// Counts of the hierarchy.
    pub placed: HierarchyReport,
    /// The function space.
    pub basis: ShepardBasis,
    /// How it is solved.
    pub setup: Setup,
    /// By which functions.
    pub stages: Stages,
}

/// The solution in absolute encoding.
pub struct Solved {
    /// Direct irradiance.
    pub direct: Coefficients<Absolute>,
    /// Indirect irradiance.
    pub indirect: Coefficients<Absolute>,
    /// What the bounces did.
    pub report: TransportReport,
}

impl Prepared {
    /// Builds BVH, hierarchy and basis.
    pub fn new(scene: Scene, setup: Setup) -> Self {
        Self::of(&Stages::SOUND, scene, setup)
    }

    /// The same with the functions of `stages`.
    pub fn of(stages: &Stages, scene: Scene, setup: Setup) -> Self {
        let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
        let options = HierarchyOptions {
            n_levels: setup.n_levels,
            coarsest_radius: Radius::Fraction(setup.radius),
            seed: setup.points_seed,
            ..HierarchyOptions::production()
        };
        let Hierarchy { points, regions, report: placed } =
            poisson_hierarchy(&scene, &bvh, &options, &NoProgress).expect("the options are in range");
        let basis = ShepardBasis::build((stages.points)(points), BasisOptions::default());
        Self { scene, bvh: StagedBvh::new(bvh, stages), regions, placed, basis, setup, stages: *stages }
    }

    /// What every stage of the transport reads.
    pub fn model(&self) -> Model<'_> {
        Model { scene: &self.scene, caster: &self.bvh, basis: &self.basis }
    }

    /// The lights.
    pub fn light(&self) -> DirectLight<'_> {
        DirectLight::new(&self.scene, self.setup.direct)
    }

    /// Direct light on the hierarchy.
    pub fn project(&self) -> Coefficients<Absolute> {
        project_direct(&self.model(), &self.light(), &NoProgress).expect("nothing interrupts")
    }

    /// Solves by the absolute variant with nearest senders.
    ///
    /// # Errors
    /// As [`transport_absolute`].
    pub fn solve(&self) -> Result<Solved, Error> {
        let direct = self.project();
        let options = &self.setup.transport;
        let senders = StagedRead(self.stages.senders);
        let transport = |options: &TransportOptions| {
            transport_absolute(&self.model(), &direct, &senders, &options.threshold, options, &NoProgress)
        };
        let Solution { indirect, report } = (self.stages.run)(options, &transport)?;
        Ok(Solved { direct, indirect, report })
    }

    /// Solves by the delta variant with Shepard senders and returns the values.
    ///
    /// # Errors
    /// As [`transport_delta`].
    pub fn solve_delta(&self) -> Result<Solved, Error> {
        let direct = self.project();
        let options = &self.setup.transport;
        let delta = hplt::basis::delta_from_absolute(&self.basis, &direct);
        let Solution { indirect, report } =
            transport_delta(&self.model(), &delta, &ExactShepard, &options.threshold, options, &NoProgress)?;
        Ok(Solved { direct, indirect: hplt::basis::absolute_from_delta(&self.basis, &indirect), report })
    }

    /// Points given by position and normal in scene space, with their regions.
    pub fn locate(&self, points: &[(Vec3, Vec3)]) -> Vec<OrientedPoint> {
        let regions = self.regions.locate(&self.scene, &self.bvh.bvh, points);
        points
            .iter()
            .zip(regions)
            .map(|(&(position, normal), region)| OrientedPoint::new(position, normal, region))
            .collect()
    }

    /// Points given by position and normal in world space, with their regions.
    pub fn locate_world(&self, points: &[(DVec3, Vec3)]) -> Vec<OrientedPoint> {
        let frame = self.scene.frame();
        self.locate(&points.iter().map(|&(p, n)| (frame.scene_from_world_point(p), n)).collect::<Vec<_>>())
    }

    /// Total irradiance at points, the indirect part interpolated, as it leaves the pipeline.
    pub fn interpolated_at(&self, solved: &Solved, points: &[OrientedPoint]) -> Vec<Rgb> {
        let (indirect, _) = self.interpolate(&solved.indirect, points);
        self.finish(points, self.direct_at(points).iter().zip(&indirect).map(|(d, i)| *d + *i))
    }

    /// Total irradiance at points, the indirect part gathered, as it leaves the pipeline.
    pub fn gathered_at(&self, solved: &Solved, points: &[OrientedPoint], n_rays: u32) -> Vec<Rgb> {
        let indirect = self.gather(solved, points, n_rays);
        self.finish(points, self.direct_at(points).iter().zip(&indirect).map(|(d, i)| *d + i.irradiance))
    }

    /// Direct irradiance at points, as it leaves the pipeline.
    pub fn direct_alone_at(&self, points: &[OrientedPoint]) -> Vec<Rgb> {
        self.finish(points, self.direct_at(points).into_iter())
    }

    fn finish(&self, points: &[OrientedPoint], values: impl Iterator<Item = Rgb>) -> Vec<Rgb> {
        points.iter().zip(values).map(|(p, e)| (self.stages.output)(&self.scene, &self.bvh.bvh, p, e)).collect()
    }

    /// Direct irradiance at points, at measurement quality.
    pub fn direct_at(&self, points: &[OrientedPoint]) -> Vec<Rgb> {
        let options = DirectOptions { estimator: self.setup.direct.estimator, ..DirectOptions::measurement() };
        let light = DirectLight::new(&self.scene, options);
        direct_irradiance(&light, &self.bvh, points, Stage::Error, &NoProgress).expect("nothing interrupts")
    }

    /// A field interpolated at points, on all levels.
    pub fn interpolate(&self, field: &Coefficients<Absolute>, points: &[OrientedPoint]) -> (Vec<Rgb>, Coverage) {
        let mut out = vec![Rgb::ZERO; points.len()];
        let coverage = (self.stages.display)(&self.basis, field, self.basis.n_levels(), points, &mut out);
        (out, coverage)
    }

    /// The scene lit by links from its coarsest level on.
    pub fn link(&self, options: &LinkOptions) -> Linked {
        let light = DirectLight::new(&self.scene, self.setup.direct);
        let coarsest = self.basis.hierarchy().clone();
        transport_links(&self.scene, &self.bvh, coarsest, &light, options, &NoProgress).expect("links")
    }

    /// Indirect irradiance at points by a final gather over what was linked.
    pub fn gather_linked(&self, linked: &Linked, points: &[OrientedPoint], n_rays: u32) -> Vec<FinalGather> {
        let model = Model { basis: &linked.basis, ..self.model() };
        let sender = Sender { coefficients: &linked.indirect, reconstruction: &LayeredNearest, n_levels: usize::MAX };
        let light = DirectLight::new(&self.scene, self.setup.direct);
        let options = FinalGatherOptions { n_rays, stage: Stage::Error, seed: 1, light: &light, contact: 1.0 };
        final_gather(&model, &sender, points, options, &NoProgress).expect("nothing interrupts")
    }

    /// Indirect irradiance at points by a final gather.
    pub fn gather(&self, solved: &Solved, points: &[OrientedPoint], n_rays: u32) -> Vec<FinalGather> {
        let senders = StagedRead(self.stages.senders);
        let sender = Sender { coefficients: &solved.indirect, reconstruction: &senders, n_levels: usize::MAX };
        let light = DirectLight::new(&self.scene, DirectOptions::one_sample());
        let options = FinalGatherOptions { n_rays, stage: Stage::Error, seed: 1, light: &light, contact: 1.0 };
        final_gather(&self.model(), &sender, points, options, &NoProgress).expect("nothing interrupts")
    }
}

/// A scene with rays and no functions: for direct light at points.
pub struct Bare {
    /// The scene.
    pub scene: Scene,
    /// Its rays.
    pub bvh: StagedBvh,
    stages: Stages,
}

impl Bare {
    /// Builds the BVH.
    pub fn new(scene: Scene) -> Self {
        Self::of(&Stages::SOUND, scene)
    }

    /// The same with the functions of `stages`.
    pub fn of(stages: &Stages, scene: Scene) -> Self {
        let (bvh, _) = Bvh::build(&scene, BvhOptions::default());
        Self { scene, bvh: StagedBvh::new(bvh, stages), stages: *stages }
    }

    /// Direct irradiance at points given by position and normal in world space, as it leaves the pipeline.
    pub fn direct_at(&self, points: &[(DVec3, Vec3)], options: DirectOptions) -> Vec<Rgb> {
        let frame = self.scene.frame();
        let place = |&(p, n): &(DVec3, Vec3)| OrientedPoint::new(frame.scene_from_world_point(p), n, RegionId(0));
        let points: Vec<OrientedPoint> = points.iter().map(place).collect();
        let light = DirectLight::new(&self.scene, options);
        let values = direct_irradiance(&light, &self.bvh, &points, Stage::Error, &NoProgress);
        let values = values.expect("nothing interrupts");
        let finish = |(p, e)| (self.stages.output)(&self.scene, &self.bvh.bvh, p, e);
        points.iter().zip(values).map(finish).collect()
    }
}

impl Solved {
    /// Total irradiance on the finest level.
    pub fn finest(&self) -> Vec<Rgb> {
        let top = self.direct.n_levels() - 1;
        self.direct.level(top).iter().zip(self.indirect.level(top)).map(|(d, i)| *d + *i).collect()
    }
}

/// The most bytes of memory that this process ever had, where the system says so.
pub fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = peak.trim().trim_end_matches("kB").trim().parse().ok()?;
    Some(kilobytes << 10)
}

/// The path of a big scene file below the folder that `HPLT_SCENES` names, or `../shared/scenes` beside the checkout. `None`
/// is logged, so that `cargo xtask test` can count what was skipped.
pub fn big_scene(relative: &str) -> Option<PathBuf> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent()?;
    let folder = std::env::var_os("HPLT_SCENES")
        .map_or_else(|| workspace.join("..").join("shared").join("scenes"), PathBuf::from);
    let path = folder.join(relative);
    if path.is_file() {
        return Some(path);
    }
    eprintln!("skipped: {relative} is not there");
    if let Some(log) = std::env::var_os("HPLT_SKIP_LOG") {
        use std::io::Write;
        let file = std::fs::OpenOptions::new().append(true).create(true).open(log);
        // The log only counts skips: a test does not fail for it.
        let _ = file.and_then(|mut f| writeln!(f, "{relative}"));
    }
    None
}
