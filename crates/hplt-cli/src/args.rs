//! The command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::budget::Budget;
use crate::config::Config;
use crate::lights::LightSpec;
use crate::relight::LightChange;
use crate::sections::{RenderSection, RunSection, SceneSection, SolveSection};
use crate::values::Fraction;

const EXIT_CODES: &str = "\
Exit codes:
    0  converged and complete (no light at all counts: the result is black)
    2  a flag or the config file is wrong
    3  the scene or another input is invalid or cannot be read
    4  an input exceeds a limit
    5  more memory would be needed than there is or than --max-memory allows
    6  not converged, no finite solution, out of --max-time, or a comparison beyond its limit;
       outputs are written and marked, with --strict none is
    8  an output cannot be written; the old one is unharmed
    9  a solution file is damaged or belongs to another scene, version or setting
   10  a value that must be finite is not
  101  a bug; please report
  130  interrupted; finished bounces are written and marked, a second signal ends at once

SCENE is a .gltf, .glb or .obj file, or gen:NAME for a built-in one (hplt gen --list), gen:NAME:N with
about N triangles, gen:room-with=FILE:SCALE for the mesh of a file in the closed Cornell room, gen:flat=FILE for a file with
the mean colours of its textures and its cut-outs filled. Outputs appear complete or not at all. A file that hplt did not write is only replaced with --force.
Results go to stdout or to files, everything else to stderr. Without a command, hplt lights the Cornell box:
    hplt render gen:cornell -o out/cornell.png -o out/cornell.exr";

/// Diffuse global illumination on a hierarchy of surface points: no mesh, no UVs.
#[derive(Parser, Debug)]
#[command(name = "hplt", version, about, after_help = EXIT_CODES)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Option<Command>,
}

/// The commands.
#[derive(Subcommand, Debug)]
pub enum Command {
    /// Light a scene and write pictures (.png, .exr)
    Render(RenderArgs),
    /// Light a scene and keep the solution (.hplt)
    Solve(SolveArgs),
    /// Change the lights of a kept solution: no rays, no scene file
    Relight(RelightArgs),
    /// Light a scene and write the irradiance at given points (.csv)
    Points(PointsArgs),
    /// Draw random points on the surface that light can reach (.csv)
    SamplePoints(SamplePointsArgs),
    /// Light a scene by path tracing, independently of the solver: points (.csv) or a picture (.exr, .png)
    Reference(ReferenceArgs),
    /// Compare two pictures or two tables of irradiance
    Compare(CompareArgs),
    /// Say what a scene holds, what is wrong with it, and what lighting it would take
    Info(InfoArgs),
    /// Write a procedural scene (.glb)
    Gen(GenArgs),
}

impl Command {
    /// The flags that all commands share.
    pub fn output(&self) -> &OutputFlags {
        match self {
            Self::Render(a) => &a.common.output,
            Self::Solve(a) => &a.common.output,
            Self::Relight(a) => &a.output_flags,
            Self::Points(a) => &a.common.output,
            Self::SamplePoints(a) => &a.common.output,
            Self::Reference(a) => &a.common.output,
            Self::Compare(a) => &a.output_flags,
            Self::Info(a) => &a.common.output,
            Self::Gen(a) => &a.output_flags,
        }
    }
}

/// Flags about what is said and overwritten.
#[derive(Args, Debug, Clone, Default)]
#[command(next_help_heading = "Run")]
pub struct OutputFlags {
    /// Print one JSON document with the report to stdout
    #[arg(long)]
    pub json: bool,
    /// Say more on stderr
    #[arg(short, long)]
    pub verbose: bool,
    /// Say nothing but errors
    #[arg(short, long, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Replace output files that hplt did not write
    #[arg(long)]
    pub force: bool,
}

/// Flags of the commands that light a scene.
#[derive(Args, Debug, Clone)]
pub struct Common {
    #[command(flatten)]
    pub lights: LightFlags,
    #[command(flatten)]
    pub scene: SceneSection,
    #[command(flatten)]
    pub solve: SolveSection,
    #[command(flatten)]
    pub run: RunSection,
    #[command(flatten)]
    pub output: OutputFlags,
    /// Values from a TOML file with the tables scene, solve, render, run and a list of light; flags win over it
    #[arg(long, value_name = "FILE", help_heading = "Run")]
    pub config: Option<PathBuf>,
    /// Print the effective values as TOML, each with its origin, and stop
    #[arg(long, help_heading = "Run")]
    pub print_config: bool,
    /// Load the scene, print what lighting it would take, and stop
    #[arg(long, help_heading = "Run")]
    pub dry_run: bool,
}

impl Common {
    /// What these flags set, with those of the picture.
    pub fn config(&self, render: &RenderSection) -> Config {
        Config {
            scene: self.scene.clone(),
            solve: self.solve.clone(),
            render: render.clone(),
            run: self.run.clone(),
            light: self.lights.all(),
        }
    }
}

/// Lights that the scene file lacks.
#[derive(Args, Debug, Clone, Default)]
#[command(
    next_help_heading = "Lights (world units; several of a kind are allowed; NAME is that of their group, see hplt relight)"
)]
pub struct LightFlags {
    /// Parallelogram: corner, two edges, radiance in W/(m² sr); it emits along edge1 × edge2 and blocks light
    #[arg(long, value_name = "[NAME=]X,Y,Z:EX,EY,EZ:FX,FY,FZ:R,G,B", allow_hyphen_values = true, value_parser = LightSpec::parse_rect)]
    pub rect_light: Vec<LightSpec>,
    /// Sun: direction towards it, irradiance on a surface facing it in W/m², angular radius in degrees (0: parallel light)
    #[arg(long, value_name = "[NAME=]DX,DY,DZ:R,G,B[:DEGREES]", allow_hyphen_values = true, value_parser = LightSpec::parse_sun)]
    pub sun: Vec<LightSpec>,
    /// Point light: position, radiant intensity in W/sr
    #[arg(long, value_name = "[NAME=]X,Y,Z:R,G,B", allow_hyphen_values = true, value_parser = LightSpec::parse_point)]
    pub point_light: Vec<LightSpec>,
    /// The same radiance from every direction, W/(m² sr)
    #[arg(long, value_name = "[NAME=]R,G,B", allow_hyphen_values = true, value_parser = LightSpec::parse_sky)]
    pub sky: Option<LightSpec>,
    /// Equirectangular picture of radiance (.exr, .hdr): the centre looks along -z, the top is +y
    #[arg(long, value_name = "FILE", conflicts_with = "sky")]
    pub environment: Option<PathBuf>,
}

impl LightFlags {
    fn all(&self) -> Vec<LightSpec> {
        let environment = self.environment.iter().map(|file| LightSpec::Environment { name: None, file: file.clone() });
        let listed = self.rect_light.iter().chain(&self.sun).chain(&self.point_light).chain(&self.sky).cloned();
        listed.chain(environment).collect()
    }
}

/// `hplt render`
#[derive(Args, Debug)]
#[command(after_help = "\
Example: the courtyard of Sponza under sun and sky, a PNG to look at and an EXR with all layers
    hplt render sponza.gltf --camera courtyard_west --sun 0.15,1,0.12:10,10,9:0.27 --sky 1,1,1.1 \\
        -o sponza.png -o sponza.exr

Layers of the EXR: R G B radiance in W/(m² sr), direct, indirect and irradiance in W/m², albedo, N (unit shading normal),
P (position, world), Z (depth along the view axis, world). Its header holds the job, the seed, timings and the error.")]
pub struct RenderArgs {
    /// Scene file, or gen:NAME
    pub scene: String,
    /// Picture to write, .png or .exr; may be repeated
    #[arg(short, long, value_name = "FILE", required_unless_present_any = ["print_config", "dry_run"])]
    pub output: Vec<PathBuf>,
    /// Take the light from a file of `hplt solve` instead of solving
    #[arg(long, value_name = "FILE")]
    pub solution: Option<PathBuf>,
    #[command(flatten)]
    pub render: RenderSection,
    #[command(flatten)]
    pub budget: Budget,
    #[command(flatten)]
    pub common: Common,
}

/// `hplt solve`
#[derive(Args, Debug)]
#[command(after_help = "\
Example: solve once, then read the light at points and in a picture
    hplt solve room.glb -o room.hplt --ply room.ply
    hplt points room.glb --solution room.hplt --at sensors.csv --out light.csv
    hplt render room.glb --solution room.hplt -o room.png

A solution belongs to its scene, lights included: with another scene or version it is refused with exit code 9. With
--keep-links or --all-groups its lights can be changed by hplt relight; they must be on when it is solved.")]
pub struct SolveArgs {
    /// Scene file, or gen:NAME
    pub scene: String,
    /// Solution file to write
    #[arg(short, long, value_name = "FILE.hplt", required_unless_present_any = ["print_config", "dry_run"])]
    pub output: Option<PathBuf>,
    /// Also write the finest level's points with normal, area and total irradiance
    #[arg(long, value_name = "FILE.ply")]
    pub ply: Option<PathBuf>,
    /// Keep the links and the light of each group of lights, solved where they are 16 at most, so that hplt relight can solve for
    /// other lights, or prove a weighted sum
    #[arg(long)]
    pub keep_links: bool,
    /// Solve for each group of lights and keep the solutions, so that hplt relight is a weighted sum; needs no links
    #[arg(long)]
    pub all_groups: bool,
    #[command(flatten)]
    pub budget: Budget,
    #[command(flatten)]
    pub common: Common,
}

/// `hplt relight`
#[derive(Args, Debug)]
#[command(after_help = "\
Example: switch the lamp off and make the sun three times as bright, then look at it
    hplt solve room.glb --keep-links -o room.hplt
    hplt relight room.hplt --list
    hplt relight room.hplt --set lamp=0 --set sun=3 -o evening.hplt
    hplt render room.glb --solution evening.hplt -o evening.png

Groups that are not set stay as they are in the scene. A factor multiplies the light that the solution was made with: a number,
three (red, green, blue), or a colour #rgb or #rrggbb (sRGB; white is 1). The relit solution is read with the scene as it was:
hplt points and hplt render apply its factors to the lights. hplt info lists the groups of a scene.")]
pub struct RelightArgs {
    /// File of hplt solve --keep-links or --all-groups
    pub solution: PathBuf,
    /// Multiply the lights of a group; may be repeated, once per group
    #[arg(long, value_name = "GROUP=FACTOR|R,G,B|#RRGGBB", value_parser = LightChange::parse)]
    pub set: Vec<LightChange>,
    /// Solution file to write
    #[arg(short, long, value_name = "FILE.hplt", required_unless_present = "list")]
    pub output: Option<PathBuf>,
    /// Solve anew even where the solution of each group is kept, which one sweep would prove
    #[arg(long)]
    pub from_scratch: bool,
    /// List the groups of lights and stop
    #[arg(long)]
    pub list: bool,
    /// Solve until the error is below this fraction of the mean [default: as the solution was solved]
    #[arg(long, value_name = "FRACTION", allow_hyphen_values = true)]
    pub tolerance: Option<Fraction>,
    /// Threads; results do not depend on it [default: one per processor]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    #[command(flatten)]
    pub output_flags: OutputFlags,
}

/// `hplt points`
#[derive(Args, Debug)]
#[command(after_help = "\
Examples: irradiance at sensors to a mean error of 1 %, the best that ten seconds allow, and by a gather of 1024 rays each
    hplt points room.glb --at sensors.csv --out light.csv --error 1%
    hplt points room.glb --at sensors.csv --out light.csv --time 10s
    hplt points room.glb --at sensors.csv --out light.csv --final-gather 1024

The input has a row x,y,z,nx,ny,nz per point (world units; other separators and Radiance's .pts are read too), the output
x,y,z,nx,ny,nz,Ed_r,Ed_g,Ed_b,Ei_r,Ei_g,Ei_b,E_r,E_g,E_b: direct, indirect and total irradiance in W/m², in the same order.
A point within --snap of a surface whose normal agrees within 25 degrees is put onto it. Any other point is in the air: its
indirect light is always gathered. Where no light can get to, everything is exactly zero.")]
pub struct PointsArgs {
    /// Scene file, or gen:NAME
    pub scene: String,
    /// Table of points
    #[arg(long, value_name = "FILE.csv", required_unless_present_any = ["print_config", "dry_run"])]
    pub at: Option<PathBuf>,
    /// Table to write [default: -, which is stdout]
    #[arg(short, long, value_name = "FILE.csv|-")]
    pub out: Option<PathBuf>,
    /// Rays of a final gather per point, a multiple of 8 up to 65536, best a power of two, fewer where little noise is left; without it surfaces are interpolated
    #[arg(long, value_name = "N")]
    pub final_gather: Option<u32>,
    /// Rays, at most, of points where interpolation cannot be trusted, a power of two; 0: interpolate there too
    #[arg(long, value_name = "N", default_value_t = crate::indirect::DOUBTFUL_RAYS)]
    pub doubtful_rays: u32,
    /// Distance within which a point is put onto a surface: a fraction of the scene's diagonal
    #[arg(long, value_name = "FRACTION", default_value = "0.1%")]
    pub snap: Fraction,
    /// Take the light from a file of `hplt solve` instead of solving
    #[arg(long, value_name = "FILE")]
    pub solution: Option<PathBuf>,
    #[command(flatten)]
    pub budget: Budget,
    #[command(flatten)]
    pub common: Common,
}

/// `hplt sample-points`
#[derive(Args, Debug)]
#[command(after_help = "\
Example: 2000 points, uniform by area over all surface that light can reach
    hplt sample-points room.glb -n 2000 -o sensors.csv")]
pub struct SamplePointsArgs {
    /// Scene file, or gen:NAME
    pub scene: String,
    /// How many points
    #[arg(short, long, value_name = "N", default_value_t = 2000)]
    pub n: usize,
    /// Table to write: x,y,z,nx,ny,nz [default: -, which is stdout]
    #[arg(short, long, value_name = "FILE.csv|-")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub common: Common,
}

/// `hplt reference`
#[derive(Args, Debug)]
#[command(after_help = "\
Examples: irradiance at points to a standard error of 0.3 % each, and a picture with 256 paths per pixel
    hplt reference room.glb --at sensors.csv --out truth.csv --error 0.3%
    hplt reference room.glb -o truth.exr --samples 256

The table has the columns of hplt points and three more: SE_r,SE_g,SE_b, the standard error of the total.")]
pub struct ReferenceArgs {
    /// Scene file, or gen:NAME
    pub scene: String,
    /// Table of points
    #[arg(long, value_name = "FILE.csv", conflicts_with = "output")]
    pub at: Option<PathBuf>,
    /// Table to write [default: -, which is stdout]
    #[arg(long, value_name = "FILE.csv|-", requires = "at")]
    pub out: Option<PathBuf>,
    /// Picture to write, .exr or .png; may be repeated
    #[arg(short, long, value_name = "FILE", required_unless_present_any = ["at", "print_config", "dry_run"])]
    pub output: Vec<PathBuf>,
    /// Standard error to reach at every point, relative to its luminance
    #[arg(long, value_name = "FRACTION", default_value = "0.3%")]
    pub error: Fraction,
    /// Paths at most: per point (default 2^20) or per pixel (default 256)
    #[arg(long, value_name = "N")]
    pub paths: Option<u64>,
    #[command(flatten)]
    pub render: RenderSection,
    #[command(flatten)]
    pub common: Common,
}

/// `hplt compare`
#[derive(Args, Debug)]
#[command(after_help = "\
Example: fail (exit code 6) when the mean relative error is above 1.5 %
    hplt compare light.csv truth.csv --max-mean 1.5% --max-bias 0.5%

Errors of tables are relative to the luminance of the reference, with a floor of 1 % of its mean.")]
pub struct CompareArgs {
    /// What is tested: .csv of hplt points, .exr or .png
    pub test: PathBuf,
    /// What it is measured against
    pub reference: PathBuf,
    /// Column group of tables
    #[arg(long, default_value = "total")]
    pub quantity: Quantity,
    /// Largest mean relative error (tables)
    #[arg(long, value_name = "FRACTION")]
    pub max_mean: Option<Fraction>,
    /// Largest 95th percentile of the relative error (tables)
    #[arg(long, value_name = "FRACTION")]
    pub max_p95: Option<Fraction>,
    /// Largest relative error of the sum, either way
    #[arg(long, value_name = "FRACTION")]
    pub max_bias: Option<Fraction>,
    /// Largest root mean square error (tables: relative; pictures: in their own unit)
    #[arg(long, value_name = "VALUE")]
    pub max_rms: Option<Fraction>,
    /// Largest relative mean squared error (pictures)
    #[arg(long, value_name = "VALUE")]
    pub max_relmse: Option<Fraction>,
    #[command(flatten)]
    pub output_flags: OutputFlags,
}

/// Column groups of a table of irradiance.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// E
    Total,
    /// Ed
    Direct,
    /// Ei
    Indirect,
}

/// `hplt info`
#[derive(Args, Debug)]
#[command(after_help = "\
Example:
    hplt info house.glb --sky 1,1,1")]
pub struct InfoArgs {
    /// Scene file, or gen:NAME
    pub scene: String,
    #[command(flatten)]
    pub common: Common,
}

/// `hplt gen`
#[derive(Args, Debug)]
#[command(after_help = "\
Example: a statue of about a million triangles in a closed room
    hplt gen statue-room --triangles 1000000 -o room.glb")]
pub struct GenArgs {
    /// Name of the scene, with what `gen:` takes after it
    #[arg(required_unless_present = "list")]
    pub name: Option<String>,
    /// File to write
    #[arg(short, long, value_name = "FILE.glb", required_unless_present = "list")]
    pub output: Option<PathBuf>,
    /// About how many triangles, for the scenes that can choose
    #[arg(long, value_name = "N")]
    pub triangles: Option<usize>,
    /// List the scenes
    #[arg(long)]
    pub list: bool,
    #[command(flatten)]
    pub output_flags: OutputFlags,
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_command_has_a_worked_example() {
        for command in Cli::command().get_subcommands() {
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            assert!(help.contains(&format!("hplt {}", command.get_name())), "{}", command.get_name());
        }
    }

    #[test]
    fn negative_coordinates_are_values_not_flags() {
        let cli =
            Cli::try_parse_from(["hplt", "render", "a.glb", "-o", "a.png", "--eye", "-1,2,3", "--exposure", "-2"]);
        let Some(Command::Render(args)) = cli.unwrap().command else { panic!("not render") };
        assert_eq!(args.render.eye.unwrap().0, [-1.0, 2.0, 3.0]);
        assert_eq!(args.render.exposure, Some(-2.0));
    }
}
