//! Flags, config file and preset put together: every value, checked.

use hplt_geom::BuildPolicy;
use hplt_io::{LightUnit, LoadOptions};
use hplt_transport::{DirectOptions, LinkOptions, LinkPrecision, Method, SolveOptions, Threshold, TransportOptions};

use crate::args::Common;
use crate::config::{Config, with_origins};
use crate::exit::Failure;
use crate::field::ReadOptions;
use crate::sections::{
    Ablation, Display, LightUnitName, Preset, ProgressMode, ReconstructionName, RenderSection, RunSection,
    SceneSection, SolveSection, SolverName, ToneMapName, Variant,
};
use crate::values::{Radius, Tolerance};

/// Levels of a hierarchy are refused beyond this.
const MAX_LEVELS: usize = 16;

/// Everything that was asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// All values, including those that nobody set.
    pub config: Config,
    /// The same as TOML, each value with its origin.
    pub with_origins: String,
    /// How the scene is read.
    pub load: LoadOptions,
    /// Whether a scene without surface is accepted.
    pub allow_empty: bool,
    /// Encoding.
    pub variant: Variant,
    /// How senders are read.
    pub reconstruction: ReconstructionName,
    /// How links are solved.
    pub solver: Method,
    /// Levels of the hierarchy.
    pub levels: usize,
    /// Poisson radius of the coarsest one.
    pub radius: Radius,
    /// How bounces are computed.
    pub transport: TransportOptions,
    /// Parts of links that are switched off.
    pub without: Vec<Ablation>,
    /// Whether a stop tolerance was set, so that missing it is a failure.
    pub must_converge: bool,
    /// How light gets to pixels.
    pub display: Display,
    /// Rays of a final gather per point of a picture.
    pub gather_rays: u32,
    /// Rays, at most, of a gather at pixels where interpolation cannot be trusted; 0 for none.
    pub doubtful_rays: u32,
    /// Samples along each side of a pixel that an edge is in.
    pub samples: usize,
    /// Whether all pixels are sampled and shaded as if an edge were in them.
    pub every_pixel: bool,
    /// Whether nothing is written unless it is converged.
    pub strict: bool,
}

impl Settings {
    /// Reads the config file, if any, and completes flags and file with the preset.
    ///
    /// # Errors
    /// When the file or a value is wrong.
    pub fn resolve(common: &Common, render: &RenderSection) -> Result<Self, Failure> {
        let flags = common.config(render);
        let mut file = common.config.as_deref().map(Config::load).transpose()?.unwrap_or_default();
        let sets_sky = |config: &Config| {
            use crate::lights::LightSpec::{Environment, Sky};
            config.light.iter().any(|l| matches!(l, Sky { .. } | Environment { .. }))
        };
        if sets_sky(&flags) {
            use crate::lights::LightSpec::{Environment, Sky};
            file.light.retain(|l| !matches!(l, Sky { .. } | Environment { .. }));
        }
        let asked = flags.clone().or(file.clone());
        check_solve(&asked.solve)?;
        check_render(&asked.render)?;
        check_rest(&asked.scene, &asked.run)?;
        let preset = asked.solve.preset.unwrap_or(Preset::Production);
        let config = asked.clone().or(defaults(preset, asked.solve.variant));
        let with_origins = with_origins(&config, &flags, &file);
        Ok(Self::from_complete(config, with_origins))
    }

    /// `config` must have every value that has a default.
    fn from_complete(config: Config, with_origins: String) -> Self {
        let preset = config.solve.preset.unwrap_or(Preset::Production);
        let base = transport_options(preset);
        let solve = &config.solve;
        let tolerance = solve.tolerance.unwrap_or(Tolerance(None)).0;
        let transport = TransportOptions {
            seed: solve.seed.unwrap_or(0),
            n_rays: solve.rays.unwrap_or(base.n_rays),
            sender_levels: solve.sender_levels.unwrap_or(base.sender_levels),
            max_bounces: solve.bounces.unwrap_or(base.max_bounces),
            tolerance: tolerance.unwrap_or(0.0) as f32,
            threshold: Threshold {
                absolute: solve.threshold.unwrap_or(base.threshold.absolute),
                relative: solve.relative_threshold.unwrap_or(base.threshold.relative),
                noise: solve.noise_factor.unwrap_or(base.threshold.noise),
            },
            shaped_push_down: base.shaped_push_down,
        };
        let (levels, radius) = default_hierarchy();
        Self {
            load: load_options(&config.scene),
            allow_empty: config.scene.allow_empty.unwrap_or(false),
            variant: solve.variant.unwrap_or(Variant::Links),
            reconstruction: solve.reconstruction.unwrap_or(ReconstructionName::Nearest),
            solver: solve.solver.map_or(SolveOptions::default().method, method),
            levels: solve.levels.unwrap_or(levels),
            radius: solve.radius.unwrap_or(radius),
            transport,
            without: solve.without.clone().unwrap_or_default(),
            must_converge: tolerance.is_some(),
            display: config.render.display.unwrap_or(Display::Evaluate),
            gather_rays: config.render.gather_rays.unwrap_or(64),
            doubtful_rays: config.render.doubtful_rays.unwrap_or(0),
            samples: config.render.samples.unwrap_or(4),
            every_pixel: config.render.every_pixel.unwrap_or(false),
            strict: config.run.strict.unwrap_or(false),
            config,
            with_origins,
        }
    }
}

impl Settings {
    fn has(&self, part: Ablation) -> bool {
        !self.without.contains(&part)
    }

    /// How a field of links is read.
    pub fn reading(&self) -> ReadOptions {
        ReadOptions {
            reconstruction: self.reconstruction,
            has_gradients: self.has(Ablation::Gradients),
            has_sight_rays: self.has(Ablation::Sight),
        }
    }

    /// How direct light is sampled where `base` would do.
    pub fn direct(&self, base: DirectOptions) -> DirectOptions {
        DirectOptions { seed: self.transport.seed, is_exact: self.has(Ablation::ExactLight), ..base }
    }

    /// How links are made.
    pub fn links(&self) -> LinkOptions {
        let solve =
            SolveOptions { method: self.solver, tolerance: self.transport.tolerance, ..SolveOptions::default() };
        LinkOptions {
            seed: self.transport.seed,
            n_rays: self.transport.n_rays,
            n_levels: self.levels,
            threshold: self.transport.threshold,
            precision: match self.reconstruction {
                ReconstructionName::Nearest => LinkPrecision::Nearest,
                ReconstructionName::Shepard => LinkPrecision::Shepard,
            },
            has_sight_rays: self.has(Ablation::Sight),
            solve,
            ..LinkOptions::production()
        }
    }
}

/// The values of a preset, for a variant that may be another than its own.
fn defaults(preset: Preset, variant: Option<Variant>) -> Config {
    let mut transport = transport_options(preset);
    let (mut levels, radius) = default_hierarchy();
    let variant = variant.unwrap_or(if preset == Preset::Slides { Variant::Delta } else { Variant::Links });
    if variant == Variant::Links {
        let links = if preset == Preset::Preview { LinkOptions::preview() } else { LinkOptions::production() };
        transport.n_rays = links.n_rays;
        if preset != Preset::Slides {
            transport.threshold = links.threshold;
            levels = links.n_levels;
        }
    }
    // As in the two published versions, but that what is kept is read exactly: nearest neighbours are biased at the rim of
    // shadows. Read level by level, as the delta encoding does, they need not converge.
    let reconstruction = match (variant, preset) {
        (Variant::Delta, _) | (Variant::Absolute, Preset::Production) => ReconstructionName::Shepard,
        (Variant::Absolute | Variant::Links, _) => ReconstructionName::Nearest,
    };
    // Through its shortest decimal form, so that 1e-3 does not become 0.0010000000474974513.
    let tolerance = transport.tolerance.to_string().parse::<f64>().ok().filter(|t| *t > 0.0);
    Config {
        scene: SceneSection {
            clamp_materials: Some(false),
            drop_bad: Some(false),
            one_sided: Some(false),
            allow_empty: Some(false),
            length_scale: Some(1.0),
            light_unit: Some(LightUnitName::Auto),
            max_albedo: Some(LoadOptions::default().max_albedo),
        },
        solve: SolveSection {
            preset: Some(preset),
            variant: Some(variant),
            reconstruction: Some(reconstruction),
            solver: (variant == Variant::Links).then_some(SolverName::Auto),
            levels: Some(levels),
            radius: Some(radius),
            rays: Some(transport.n_rays),
            sender_levels: Some(transport.sender_levels.min(MAX_LEVELS)),
            threshold: Some(transport.threshold.absolute),
            relative_threshold: Some(transport.threshold.relative),
            noise_factor: Some(transport.threshold.noise),
            bounces: Some(transport.max_bounces),
            tolerance: Some(Tolerance(tolerance)),
            seed: Some(transport.seed),
            without: None,
        },
        render: RenderSection {
            samples: Some(4),
            every_pixel: Some(false),
            display: Some(Display::Evaluate),
            gather_rays: Some(64),
            doubtful_rays: Some(0),
            tone_map: Some(ToneMapName::Aces),
            ..RenderSection::default()
        },
        run: RunSection { progress: Some(ProgressMode::Auto), strict: Some(false), ..RunSection::default() },
        light: Vec::new(),
    }
}

fn method(solver: SolverName) -> Method {
    match solver {
        SolverName::Auto => Method::Auto,
        SolverName::Gmres => Method::Gmres { restart: 20 },
        SolverName::CoarseGmres => Method::CoarseGmres { restart: 20 },
        SolverName::Bicgstab => Method::BiCgStab,
        SolverName::GaussSeidel => Method::GaussSeidel,
        SolverName::Southwell => Method::Southwell,
        SolverName::Bounces => Method::Bounces,
    }
}

fn transport_options(preset: Preset) -> TransportOptions {
    match preset {
        Preset::Slides => TransportOptions::slides(),
        Preset::Preview => TransportOptions::preview(),
        Preset::Production => TransportOptions::production(),
    }
}

/// Six levels from 8.5 % of the diagonal on: the published 218 … 167k functions on the Cornell box.
fn default_hierarchy() -> (usize, Radius) {
    (6, Radius::OfDiagonal(0.085))
}

fn load_options(scene: &SceneSection) -> LoadOptions {
    let base = LoadOptions::default();
    LoadOptions {
        policy: BuildPolicy {
            drop_bad_triangles: scene.drop_bad.unwrap_or(false),
            clamp_materials: scene.clamp_materials.unwrap_or(false),
        },
        one_sided: scene.one_sided.unwrap_or(false),
        max_albedo: scene.max_albedo.unwrap_or(base.max_albedo),
        light_unit: match scene.light_unit.unwrap_or(LightUnitName::Auto) {
            LightUnitName::Auto => LightUnit::Auto,
            LightUnitName::Radiometric => LightUnit::Radiometric,
            LightUnitName::Photometric => LightUnit::Photometric,
        },
        length_scale: scene.length_scale.unwrap_or(base.length_scale),
        ..base
    }
}

fn check_solve(solve: &SolveSection) -> Result<(), Failure> {
    power_of_two("--rays", solve.rays)?;
    within("--levels", solve.levels, 1, MAX_LEVELS)?;
    within("--sender-levels", solve.sender_levels, 1, MAX_LEVELS)?;
    within("--bounces", solve.bounces, 1, 1_000_000)?;
    let is_slides = solve.variant.is_none() && solve.preset == Some(Preset::Slides);
    let is_other = is_slides || solve.variant.is_some_and(|v| v != Variant::Links);
    if is_other && solve.solver.is_some() {
        return Err(Failure::usage("--solver solves links: it needs --variant links"));
    }
    if is_other && solve.without.is_some() {
        return Err(Failure::usage("--without switches parts of links off: it needs --variant links"));
    }
    for (flag, value) in [
        ("--threshold", solve.threshold),
        ("--relative-threshold", solve.relative_threshold),
        ("--noise-factor", solve.noise_factor),
    ] {
        if let Some(value) = value.filter(|v| !(*v >= 0.0 && v.is_finite())) {
            return Err(Failure::usage(format!("{flag} {value}; expected a finite number of 0 or more")));
        }
    }
    Ok(())
}

fn check_render(render: &RenderSection) -> Result<(), Failure> {
    within("--samples", render.samples, 1, 16)?;
    power_of_two("--gather-rays", render.gather_rays)?;
    doubtful_rays(render.doubtful_rays)?;
    if let Some(fov) = render.fov.filter(|f| !(*f > 0.0 && *f < 180.0)) {
        return Err(Failure::usage(format!("--fov {fov}; expected an angle between 0 and 180 degrees")));
    }
    if let Some(ev) = render.exposure.filter(|e| !(-100.0..=100.0).contains(e)) {
        return Err(Failure::usage(format!("--exposure {ev}; expected -100 to 100 stops")));
    }
    if render.eye.is_some() != render.target.is_some() {
        return Err(Failure::usage("--eye and --target; expected both or none"));
    }
    if render.camera.is_some() && render.eye.is_some() {
        return Err(Failure::usage("--camera and --eye; expected one of them"));
    }
    Ok(())
}

fn check_rest(scene: &SceneSection, run: &RunSection) -> Result<(), Failure> {
    within("--threads", run.threads, 1, 4096)?;
    if let Some(scale) = scene.length_scale.filter(|s| !(*s > 0.0 && s.is_finite())) {
        return Err(Failure::usage(format!("--length-scale {scale}; expected a finite number above 0")));
    }
    if let Some(albedo) = scene.max_albedo.filter(|a| !(0.0..=1.0).contains(a)) {
        return Err(Failure::usage(format!("--max-albedo {albedo}; expected 0 to 1")));
    }
    Ok(())
}

/// Rays come in powers of two: scrambled Sobol points are best there.
pub fn power_of_two(flag: &str, value: Option<u32>) -> Result<(), Failure> {
    match value {
        Some(n) if !n.is_power_of_two() || !(8..=65_536).contains(&n) => {
            Err(Failure::usage(format!("{flag} {n}; expected a power of two from 8 to 65536")))
        }
        _ => Ok(()),
    }
}

/// Whole groups of eight, which tell the noise.
pub fn multiple_of_eight(flag: &str, value: Option<u32>) -> Result<(), Failure> {
    match value {
        Some(n) if !n.is_multiple_of(8) || !(8..=65_536).contains(&n) => {
            Err(Failure::usage(format!("{flag} {n}; expected a multiple of 8 from 8 to 65536")))
        }
        _ => Ok(()),
    }
}

/// A power of two too, or 0 for none.
pub fn doubtful_rays(value: Option<u32>) -> Result<(), Failure> {
    power_of_two("--doubtful-rays", value.filter(|&n| n > 0))
}

fn within(flag: &str, value: Option<usize>, low: usize, high: usize) -> Result<(), Failure> {
    match value {
        Some(n) if !(low..=high).contains(&n) => Err(Failure::usage(format!("{flag} {n}; expected {low} to {high}"))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::{Cli, Command};

    fn resolve(flags: &[&str]) -> Result<Settings, Failure> {
        let cli = Cli::try_parse_from([&["hplt", "render", "a.glb", "-o", "a.png"], flags].concat()).unwrap();
        let Some(Command::Render(args)) = cli.command else { panic!("not render") };
        Settings::resolve(&args.common, &args.render)
    }

    #[test]
    fn presets_are_those_of_the_libraries() {
        let settings = resolve(&["--preset", "slides"]).unwrap();
        assert_eq!(settings.transport, TransportOptions::slides());
        assert_eq!((settings.variant, settings.must_converge), (Variant::Delta, false));
        let settings = resolve(&[]).unwrap();
        let (links, production) = (settings.links(), LinkOptions::production());
        assert_eq!((settings.variant, links), (Variant::Links, production));
        let settings = resolve(&["--variant", "absolute"]).unwrap();
        let production = TransportOptions { sender_levels: MAX_LEVELS, ..TransportOptions::production() };
        assert_eq!(settings.transport, production);
        assert!(settings.must_converge);
    }

    #[test]
    fn flags_override_the_preset() {
        let settings = resolve(&["--rays", "64", "--tolerance", "none", "--bounces", "3"]).unwrap();
        assert_eq!((settings.transport.n_rays, settings.transport.max_bounces), (64, 3));
        assert!(!settings.must_converge);
    }

    #[test]
    fn parts_are_switched_off_one_by_one() {
        let parts = |flags: &[&str]| {
            let settings = resolve(flags).unwrap();
            let ReadOptions { has_gradients, has_sight_rays, .. } = settings.reading();
            assert_eq!(settings.links().has_sight_rays, has_sight_rays);
            [has_gradients, has_sight_rays, settings.direct(DirectOptions::display()).is_exact]
        };
        assert_eq!(parts(&[]), [true; 3]);
        assert_eq!(parts(&["--without", "gradients"]), [false, true, true]);
        assert_eq!(parts(&["--without", "sight", "--without", "exact-light"]), [true, false, false]);
        for other in [["--variant", "delta"], ["--preset", "slides"]] {
            let failure = resolve(&[&other[..], &["--without", "sight"]].concat()).unwrap_err();
            assert!(failure.message.contains("--without"), "{failure}");
        }
    }

    #[test]
    fn the_printed_config_gives_the_same_settings() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("job.toml");
        for flags in [
            &["--preset", "slides", "--sun", "0,1,0:1,1,1"][..],
            &["--eye", "0,0,1", "--target", "0,0,0"],
            &["--without", "sight", "--without", "gradients"],
        ] {
            let settings = resolve(flags).unwrap();
            std::fs::write(&path, &settings.with_origins).unwrap();
            let again = resolve(&["--config", path.to_str().unwrap()]).unwrap();
            assert_eq!(again.config, settings.config);
            assert_eq!(again.transport, settings.transport);
        }
    }

    #[test]
    fn values_out_of_range_name_the_flag() {
        for flags in [
            ["--rays", "0"],
            ["--rays", "100"],
            ["--levels", "0"],
            ["--sender-levels", "0"],
            ["--bounces", "0"],
            ["--threshold", "-1"],
            ["--noise-factor", "nan"],
            ["--samples", "0"],
            ["--fov", "180"],
            ["--threads", "0"],
            ["--length-scale", "0"],
            ["--max-albedo", "2"],
            ["--eye", "1,2,3"],
        ] {
            let failure = resolve(&flags).unwrap_err();
            assert!(failure.exit == crate::exit::Exit::Usage && failure.message.contains(flags[0]), "{failure}");
        }
    }
}
