//! Solution files: the hierarchy with its light, tied to its scene.

use std::path::Path;

use hplt_basis::{BasisOptions, ShepardBasis};
use hplt_geom::glam::Vec3;
use hplt_geom::{Extent, LightGroups, N_SECTORS, OrientedPoint, PointHierarchy, PointLevel, RegionId, Rgb, Scene};
use hplt_io::{Limits, Section, SectionData, SolutionFile, read_solution};
use hplt_sampling::Regions;
use hplt_transport::{DirectLight, DirectOptions};
use serde_json::json;

use crate::exit::{Exit, Failure};
use crate::field::{Field, ReadOptions};
use crate::job::{Lit, Run};
use crate::kept;
use crate::report::LevelRow;
use crate::sections::{ReconstructionName, Variant};

/// The layout of sections in the file; changes with it.
const LAYOUT: &str = "2";

/// The content of a solution file for a lit scene.
pub fn to_file(run: &Run<'_>, lit: &mut Lit<'_>) -> SolutionFile {
    let mut metadata = run.metadata();
    metadata.push(("hplt.layout".into(), LAYOUT.into()));
    metadata.push(("hplt.variant".into(), lit.field.variant().name().into()));
    metadata.push(("hplt.reconstruction".into(), run.settings.reconstruction.name().into()));
    metadata.push(("hplt.levels".into(), lit.basis.n_levels().to_string()));
    metadata.push(("hplt.regions".into(), lit.regions.n_regions().to_string()));
    let mut sections = Vec::new();
    let mut push = |name: String, data: SectionData| sections.push(Section { name, data });
    for (l, level) in lit.basis.hierarchy().levels.iter().enumerate() {
        let points = &level.points;
        let [direct, indirect] = lit.field.level(l);
        let vectors = |get: fn(&OrientedPoint) -> Vec3| SectionData::F32(flat(points.iter().map(get)));
        push(format!("level{l}.radius"), SectionData::F32(vec![level.poisson_radius]));
        push(format!("level{l}.position"), vectors(|p| p.position));
        push(format!("level{l}.normal"), vectors(|p| p.normal));
        push(format!("level{l}.area"), SectionData::F32(points.iter().map(|p| p.area).collect()));
        let extents = points.iter().flat_map(|p| extent_to_floats(&p.extent));
        push(format!("level{l}.extent"), SectionData::F32(extents.collect()));
        let flags = level.is_refined.iter().map(|&r| u32::from(r));
        push(format!("level{l}.refined"), SectionData::U32(flags.collect()));
        push(format!("level{l}.region"), SectionData::U32(points.iter().map(|p| p.region.0).collect()));
        push(format!("level{l}.direct"), SectionData::F32(flat(direct.iter().copied())));
        push(format!("level{l}.indirect"), SectionData::F32(flat(indirect.iter().copied())));
    }
    let mut file = SolutionFile { metadata, sections };
    if let Some(kept) = lit.kept.take() {
        kept.push_to(&mut file, lit.scene, run.settings.transport.tolerance);
    }
    file
}

/// Light from a solution file instead of a solve. The lights of `scene` are multiplied by the factors of a relit solution.
///
/// # Errors
/// When the file is damaged, or belongs to another scene, layout or version.
pub fn light<'s>(run: &mut Run<'_>, scene: &'s mut Scene, path: &Path) -> Result<Lit<'s>, Failure> {
    let bvh = run.build_bvh(scene);
    let shown = hplt_io::sanitized(&path.to_string_lossy());
    let refuse = |what: String| Failure::new(Exit::Solution, "SOLUTION_MISMATCH", format!("{shown}: {what}"));
    let file = run.stage("read solution", |_| read_solution(path, &Limits::default()))?;
    check_matches(run, &file).map_err(&refuse)?;
    let (points, [direct, indirect]) = read_hierarchy(&file, &refuse)?;
    let variant = Variant::from_name(value(&file, "hplt.variant").map_err(&refuse)?)
        .ok_or_else(|| refuse("unknown variant".into()))?;
    let reconstruction = ReconstructionName::from_name(value(&file, "hplt.reconstruction").map_err(&refuse)?)
        .ok_or_else(|| refuse("unknown reconstruction".into()))?;
    let seed = number(&file, "hplt.seed").map_err(&refuse)?;
    let reporter = run.reporter;
    let regions = run.stage("regions", |_| Regions::build(scene, &bvh, seed, reporter))?;
    if regions.n_regions() != points.n_regions {
        let (found, expected) = (points.n_regions, regions.n_regions());
        return Err(refuse(format!("{found} regions; the scene has {expected}; solve again")));
    }
    // Regions are those of the lights that the links were made with, lit or not.
    let groups = LightGroups::of(scene);
    if let Some(factors) = kept::factors(&file, &groups, scene).map_err(&refuse)? {
        scene.scale_lights(&groups, &factors).map_err(|e| refuse(e.to_string()))?;
        enter_factors(run, groups.names(), &factors);
    }
    let scene: &'s Scene = scene;
    let lights = run.stage("lights", |_| DirectLight::new(scene, DirectOptions::projection()));
    let basis = run.stage("basis", |_| ShepardBasis::build(points, BasisOptions::default()));
    let reading = ReadOptions { reconstruction, ..run.settings.reading() };
    let field = Field::from_levels([direct, indirect], variant, reading);
    enter(run, &file, &basis, scene.frame().scale());
    run.report.enter_memory("points, trees, parents", basis.memory());
    run.report.enter_memory("coefficients", field.memory());
    Ok(Lit { scene, bvh, regions, lights, basis, field, kept: None, is_cut_short: false })
}

/// Notes which lights a relit solution multiplies.
fn enter_factors(run: &mut Run<'_>, names: &[String], factors: &[Rgb]) {
    let row = |(name, factor): (&String, &Rgb)| json!({ "name": name, "factor": factor.to_array() });
    run.report.more.insert("light_groups".into(), names.iter().zip(factors).map(row).collect());
    let changed = names.iter().zip(factors).filter(|(_, factor)| **factor != Rgb::ONE);
    let words: Vec<String> = changed.map(|(name, f)| format!("{}={f}", hplt_io::sanitized(name))).collect();
    if !words.is_empty() {
        run.report.warnings.push(format!("the lights are changed, as the solution says: {}", words.join(", ")));
    }
}

/// Light by level, then by function.
pub type Levels = Vec<Vec<Rgb>>;

/// The points of a solution file and its light, direct and indirect, by level.
///
/// # Errors
/// When they are damaged.
pub fn read_hierarchy(
    file: &SolutionFile,
    refuse: &impl Fn(String) -> Failure,
) -> Result<(PointHierarchy, [Levels; 2]), Failure> {
    let levels: usize = number(file, "hplt.levels").map_err(refuse)?;
    if levels > 64 {
        return Err(refuse(format!("{levels} levels; expected 64 at most")));
    }
    let n_regions: u32 = number(file, "hplt.regions").map_err(refuse)?;
    let (mut hierarchy, mut direct, mut indirect) = (Vec::new(), Vec::new(), Vec::new());
    for l in 0..levels {
        let (level, d, i) = read_level(file, l, n_regions, refuse)?;
        hierarchy.push(level);
        direct.push(d);
        indirect.push(i);
    }
    Ok((PointHierarchy { levels: hierarchy, n_regions }, [direct, indirect]))
}

fn check_matches(run: &Run<'_>, file: &SolutionFile) -> Result<(), String> {
    check_version(file)?;
    check_values(file, &[("hplt.scene_hash", &run.report.scene_hash, "scene (lights included) with hash")])
}

/// Refuses files of another layout or version.
///
/// # Errors
/// In words.
pub fn check_version(file: &SolutionFile) -> Result<(), String> {
    let version = env!("CARGO_PKG_VERSION");
    check_values(file, &[("hplt.layout", LAYOUT, "layout"), ("hplt.version", version, "version of hplt")])
}

fn check_values(file: &SolutionFile, expected: &[(&str, &str, &str)]) -> Result<(), String> {
    for &(key, expected, what) in expected {
        let found = value(file, key)?;
        if found != expected {
            let found = hplt_io::sanitized(found);
            return Err(format!("is of another {what}: {found}; expected {expected}; solve again"));
        }
    }
    Ok(())
}

fn enter(run: &mut Run<'_>, file: &SolutionFile, basis: &ShepardBasis, scale: f64) {
    let levels = basis.hierarchy().levels.iter();
    run.report.levels =
        levels.map(|l| LevelRow { points: l.points.len(), radius: f64::from(l.poisson_radius) * scale }).collect();
    run.report.converged = file.value("hplt.converged") == Some("true");
    run.report.stop = match file.value("hplt.stop") {
        Some("converged") => "converged",
        Some("max-bounces") => "max-bounces",
        Some("no-light") => "no-light",
        Some("time-limit") => "time-limit",
        _ => "stopped early",
    };
    run.report.truncation_bound = file.value("hplt.truncation_bound").and_then(|v| v.parse().ok());
    if !run.report.converged {
        run.report.warnings.push("the solution is not converged".into());
    }
}

/// Numbers of an extent in a file: below, above, the height of the sight, and the inverse depths.
const EXTENT_FLOATS: usize = 3 + N_SECTORS;

fn extent_to_floats(extent: &Extent) -> Vec<f32> {
    [&[extent.below, extent.above, extent.sight_height][..], &extent.inverse_depths].concat()
}

fn extent_from_floats(floats: &[f32]) -> Extent {
    let mut inverse_depths = [0.0; N_SECTORS];
    inverse_depths.copy_from_slice(&floats[3..]);
    Extent { below: floats[0], above: floats[1], sight_height: floats[2], inverse_depths }
}

type ReadLevel = (PointLevel, Vec<Rgb>, Vec<Rgb>);

fn read_level(
    file: &SolutionFile,
    l: usize,
    n_regions: u32,
    refuse: &impl Fn(String) -> Failure,
) -> Result<ReadLevel, Failure> {
    let floats = |what: &str| file.floats(&format!("level{l}.{what}"));
    let [radius, area, extent] = [floats("radius")?, floats("area")?, floats("extent")?];
    let [position, normal, direct, indirect] =
        [floats("position")?, floats("normal")?, floats("direct")?, floats("indirect")?];
    let region = file.integers(&format!("level{l}.region"))?;
    let n = region.len();
    let is_refined: Vec<bool> = file.integers(&format!("level{l}.refined"))?.iter().map(|&r| r != 0).collect();
    let vectors_fit = [position, normal, direct, indirect].iter().all(|v| v.len() == 3 * n);
    let flags_fit = is_refined.is_empty() || is_refined.len() == n;
    let fits = flags_fit && radius.len() == 1 && area.len() == n && extent.len() == EXTENT_FLOATS * n && vectors_fit;
    if !fits {
        return Err(refuse(format!("level {l}: sections of different lengths; expected {n} points in each")));
    }
    let all = [radius, area, position, normal, direct, indirect];
    if all.iter().any(|v| v.iter().any(|x| !x.is_finite())) || radius[0] <= 0.0 {
        return Err(refuse(format!("level {l}: a number is not finite, or the radius not above 0")));
    }
    let extents: Vec<Extent> = extent.chunks_exact(EXTENT_FLOATS).map(extent_from_floats).collect();
    // Heights are infinite where nothing is above or below.
    let is_good = |e: &Extent| {
        e.below > 0.0
            && e.above > 0.0
            && e.sight_height >= 0.0
            && e.inverse_depths.iter().all(|d| *d >= 0.0 && d.is_finite())
    };
    if let Some(bad) = extents.iter().position(|e| !is_good(e)) {
        return Err(refuse(format!("level {l}: extent {bad} is {:?}; expected lengths above 0", extents[bad])));
    }
    if let Some(bad) = region.iter().find(|&&r| r >= n_regions) {
        return Err(refuse(format!("level {l}: region {bad}; expected less than {n_regions}")));
    }
    let (positions, normals) = (vectors(position), vectors(normal));
    if let Some(i) = normals.iter().position(|v| (v.length() - 1.0).abs() > 1e-3) {
        return Err(refuse(format!("level {l}: normal {i} has length {}; expected 1", normals[i].length())));
    }
    let points = (0..n).map(|i| OrientedPoint {
        position: positions[i],
        normal: normals[i],
        region: RegionId(region[i]),
        area: area[i],
        extent: extents[i],
    });
    let level = PointLevel { is_refined, ..PointLevel::new(radius[0], points.collect()) };
    Ok((level, vectors(direct), vectors(indirect)))
}

/// The value of a key.
///
/// # Errors
/// In words, when there is none.
pub fn value<'f>(file: &'f SolutionFile, key: &str) -> Result<&'f str, String> {
    file.value(key).ok_or_else(|| format!("has no {key}; expected one"))
}

/// The value of a key, as a number.
///
/// # Errors
/// In words, when there is none, or no number.
pub fn number<T: std::str::FromStr>(file: &SolutionFile, key: &str) -> Result<T, String> {
    let text = value(file, key)?;
    text.parse().map_err(|_| format!("{key} is \"{}\"; expected a number", hplt_io::sanitized(text)))
}

/// Groups of three numbers as vectors.
pub fn vectors(floats: &[f32]) -> Vec<Vec3> {
    floats.chunks_exact(3).map(|c| Vec3::new(c[0], c[1], c[2])).collect()
}

/// The numbers of vectors, one after another.
pub fn flat(values: impl Iterator<Item = Vec3>) -> Vec<f32> {
    values.flat_map(|v| v.to_array()).collect()
}
