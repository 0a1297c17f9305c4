//! What can be set, each thing once: the same structs are flags and tables of the config file. Nothing is set until somebody sets it.

use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};

use crate::values::{Bytes, Radius, Seconds, Size, Tolerance, Triple};

/// How the scene is read. Config table `[scene]`.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
#[command(next_help_heading = "Scene")]
pub struct SceneSection {
    /// Clamp albedos into [0, 1] and negative emission to 0 instead of refusing the scene
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    pub clamp_materials: Option<bool>,
    /// Drop triangles with coordinates that are not finite or beyond 1e18 instead of refusing the scene
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    pub drop_bad: Option<bool>,
    /// Let single-sided materials be black on their back
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    pub one_sided: Option<bool>,
    /// Accept a scene without any surface
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    pub allow_empty: Option<bool>,
    /// Metres per unit of length in the file [default: 1]
    #[arg(long, value_name = "FACTOR")]
    pub length_scale: Option<f64>,
    /// What the numbers of punctual lights in the file mean [default: auto]
    #[arg(long, value_name = "UNIT")]
    pub light_unit: Option<LightUnitName>,
    /// Lower albedos above this to it, with a warning [default: 0.98]
    #[arg(long, value_name = "ALBEDO")]
    pub max_albedo: Option<f32>,
}

/// How light is computed. Config table `[solve]`.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
#[command(next_help_heading = "Solve")]
pub struct SolveSection {
    /// Where all values below start from [default: production]
    #[arg(long)]
    pub preset: Option<Preset>,
    /// Encoding of the coefficients: delta is the original (V1), absolute the optimised version (V3)
    #[arg(long)]
    pub variant: Option<Variant>,
    /// How senders are read where a ray arrives
    #[arg(long)]
    pub reconstruction: Option<ReconstructionName>,
    /// How links are solved for all bounces
    #[arg(long)]
    pub solver: Option<SolverName>,
    /// Levels of the point hierarchy, 1 to 16
    #[arg(long, value_name = "N")]
    pub levels: Option<usize>,
    /// Poisson radius of the coarsest level: world units, or with % of the scene's diagonal
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true)]
    pub radius: Option<Radius>,
    /// Rays per gather, a power of two from 8 to 65536
    #[arg(long, value_name = "N")]
    pub rays: Option<u32>,
    /// Levels that senders are read from, counted from the coarsest
    #[arg(long, value_name = "N")]
    pub sender_levels: Option<usize>,
    /// Refine where a bounce changes more than this, W/m²
    #[arg(long, value_name = "W/M2", allow_hyphen_values = true)]
    pub threshold: Option<f32>,
    /// Refine where a bounce changes more than this fraction of the irradiance
    #[arg(long, value_name = "FRACTION", allow_hyphen_values = true)]
    pub relative_threshold: Option<f32>,
    /// Refine where a bounce changes more than this many standard errors of the gather
    #[arg(long, value_name = "SIGMAS", allow_hyphen_values = true)]
    pub noise_factor: Option<f32>,
    /// Bounces at most
    #[arg(long, value_name = "N")]
    pub bounces: Option<usize>,
    /// Stop when less than this fraction of the light is still to come; none computes exactly --bounces bounces
    #[arg(long, value_name = "FRACTION|none", allow_hyphen_values = true)]
    pub tolerance: Option<Tolerance>,
    /// Seed of everything random [default: 0]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Switch a part of links off, to see what it is worth; may be repeated
    #[arg(long, value_name = "PART", help_heading = "Ablations")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub without: Option<Vec<Ablation>>,
}

/// How pictures are made. Config table `[render]`.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
#[command(next_help_heading = "Picture")]
pub struct RenderSection {
    /// Camera of the scene file, by name or index [default: the first]
    #[arg(long, value_name = "NAME|INDEX")]
    pub camera: Option<String>,
    /// Position of the eye, world units
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub eye: Option<Triple>,
    /// Point that the camera looks at, world units
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub target: Option<Triple>,
    /// Direction towards the top of the picture [default: 0,1,0]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub up: Option<Triple>,
    /// Full vertical angle of view, degrees [default: 45]
    #[arg(long, value_name = "DEGREES")]
    pub fov: Option<f64>,
    /// Size of the picture in pixels [default: the aspect of the camera, 720 across]
    #[arg(long, value_name = "WxH")]
    pub size: Option<Size>,
    /// Samples along each side of a pixel where there is an edge of a surface, a texture or a shadow, 1 to 16; others take one
    /// [default: 4]
    #[arg(long, value_name = "N")]
    pub samples: Option<usize>,
    /// Take all samples in every pixel and read the light in each, instead of where neighbours differ: slow, but nothing thinner than
    /// a pixel is overlooked
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    pub every_pixel: Option<bool>,
    /// How indirect light gets to the pixels [default: evaluate]
    #[arg(long)]
    pub display: Option<Display>,
    /// Rays of --display final-gather at every point that is read, a power of two [default: 64]
    #[arg(long, value_name = "N")]
    pub gather_rays: Option<u32>,
    /// Rays, at most, of pixels where interpolation cannot be trusted, a power of two; 0: interpolate there too [default: 0]
    #[arg(long, value_name = "N")]
    pub doubtful_rays: Option<u32>,
    /// Exposure of PNG files, in stops [default: chosen from the picture]
    #[arg(long, value_name = "EV", allow_hyphen_values = true)]
    pub exposure: Option<f32>,
    /// Tone map of PNG files [default: aces]
    #[arg(long)]
    pub tone_map: Option<ToneMapName>,
}

/// How the program runs. Config table `[run]`.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
#[command(next_help_heading = "Run")]
pub struct RunSection {
    /// Threads; results do not depend on it [default: one per processor]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Refuse work that is estimated to need more than this [default: 80 % of what is available]
    #[arg(long, value_name = "SIZE", allow_hyphen_values = true)]
    pub max_memory: Option<Bytes>,
    /// Stop after this time with the bounces that are finished (exit code 6)
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub max_time: Option<Seconds>,
    /// Progress on stderr [default: auto, a bar on a terminal and nothing elsewhere]
    #[arg(long)]
    pub progress: Option<ProgressMode>,
    /// Write nothing unless the result is converged
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    pub strict: Option<bool>,
}

/// Named sets of values.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// The published parameters (Zollhöfer 2010): delta, Shepard, 1024 rays, 3 sender levels, 3 bounces, τ = 0.016
    Slides,
    /// A quick look: a few per cent of error
    Preview,
    /// For results that are kept: all bounces, about one per cent of error
    Production,
}

/// Encodings of the coefficients.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Variant {
    /// Corrections from level to level, unshot energy (V1)
    Delta,
    /// The value itself on every level, push-down (V3)
    Absolute,
    /// Rays traced once and kept as links, all bounces solved at once, functions only where they are needed
    Links,
}

/// How senders are read.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReconstructionName {
    /// The exact Shepard expansion
    Shepard,
    /// The approximately nearest function
    Nearest,
}

/// Parts of links that can be switched off.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ablation {
    /// First-order reconstruction: functions are constant where the field is read
    Gradients,
    /// Rays that tell which functions are in sight of where the field is read: what they know of their surroundings decides
    Sight,
    /// Closed forms of direct light, and blockers cut out of lamps: all of it is sampled
    ExactLight,
}

/// How links are solved.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SolverName {
    /// Coarse-gmres where nearly white rooms keep light for long, else gmres
    Auto,
    /// Generalised minimal residuals: fewest products
    Gmres,
    /// The same with a coarse level of about one unknown a room, solved directly
    CoarseGmres,
    /// Stabilised biconjugate gradients: least memory
    Bicgstab,
    /// One sweep in place after another
    GaussSeidel,
    /// Largest residuals first: progressive shooting
    Southwell,
    /// One bounce after another
    Bounces,
}

/// How indirect light gets to the pixels.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Display {
    /// The basis, evaluated per pixel
    Evaluate,
    /// Basis functions splatted level by level
    Splat,
    /// The hierarchy flattened to its leaves, then splatted
    Flatten,
    /// One more gather per pixel sample
    FinalGather,
}

/// Tone maps of PNG files.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ToneMapName {
    /// Values above 1 are cut off
    None,
    /// x/(1+x)
    Reinhard,
    /// A fit of the ACES curve
    Aces,
}

/// What the numbers of punctual lights mean.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LightUnitName {
    /// Radiometric, and the report says that it was assumed
    Auto,
    /// W/sr and W/m²
    Radiometric,
    /// Divided by 683 lm/W
    Photometric,
}

/// How progress is shown on stderr.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProgressMode {
    /// A bar on a terminal, nothing elsewhere
    Auto,
    /// A bar
    Bar,
    /// A line every second
    Plain,
    /// A JSON document a line
    Json,
    /// Nothing
    None,
}

macro_rules! named {
    ($kind:ident: $($variant:ident = $name:literal),*) => {
        impl $kind {
            /// The name, as flags and config files spell it.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }

            /// The value of that name.
            pub fn from_name(name: &str) -> Option<Self> {
                match name { $($name => Some(Self::$variant),)* _ => None }
            }
        }
    };
}

named!(Variant: Delta = "delta", Absolute = "absolute", Links = "links");
named!(ReconstructionName: Shepard = "shepard", Nearest = "nearest");

macro_rules! layered {
    ($name:ident: $($field:ident),*) => {
        impl $name {
            /// These values, and where one is not set that of `below`.
            pub fn or(self, below: Self) -> Self {
                Self { $($field: self.$field.or(below.$field)),* }
            }
        }
    };
}

layered!(SceneSection: clamp_materials, drop_bad, one_sided, allow_empty, length_scale, light_unit, max_albedo);
layered!(SolveSection: preset, variant, reconstruction, solver, levels, radius, rays, sender_levels, threshold,
    relative_threshold, noise_factor, bounces, tolerance, seed, without);
layered!(RenderSection: camera, eye, target, up, fov, size, samples, every_pixel, display, gather_rays, doubtful_rays, exposure,
    tone_map);
layered!(RunSection: threads, max_memory, max_time, progress, strict);
