//! References by path tracing, kept between runs.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde_json::Value;

use super::answers::{RunAnswer, StandardError};
use super::child::{Hplt, NOT_CONVERGED};
use super::measure::{shown, strings};
use super::scenes::Source;

/// Seed of the points; another than the solver's, which measures its own error at the points of its seed.
const SEED: u64 = 2010;

/// The light at random reachable points.
pub struct Truth {
    /// Table of points.
    pub points: PathBuf,
    /// Table of irradiance.
    pub table: PathBuf,
    /// How many points.
    pub n_points: usize,
    /// Triangles of the scene that are lit.
    pub triangles: u64,
    /// How sure it is.
    pub standard_error: StandardError,
}

/// What a reference has to be like.
pub struct Wanted {
    /// Points.
    pub n_points: usize,
    /// Standard error to reach at each, relative.
    pub error: f64,
    /// Paths per point at most, even if that misses the error.
    pub most_paths: Option<u64>,
}

/// The hash of everything in a scene that light depends on. Reads all of it, so that the next command finds it in memory.
///
/// # Errors
/// When the scene cannot be read.
pub fn scene_hash(hplt: &Hplt, source: &Source) -> Result<String> {
    let answer = hplt.ask(&strings(&["info", &source.argument]), None)?;
    let hash = answer.document["scene_hash"].as_str().filter(|hash| !hash.is_empty());
    Ok(hash.with_context(|| format!("hplt info prints no hash of {}", source.title))?.to_owned())
}

/// The kept reference of a scene, or a new one where there is none for this very scene, number of points and error.
///
/// # Errors
/// When it cannot be made.
pub fn find_or_trace(hplt: &Hplt, folder: &Path, source: &Source, scene_hash: &str, wanted: &Wanted) -> Result<Truth> {
    let name = file_stem(&source.id, wanted);
    let file = |extension: &str| folder.join("reference").join(format!("{name}.{extension}"));
    let (points, table, report) = (file("points.csv"), file("csv"), file("json"));
    let kept = std::fs::read_to_string(&report).ok().filter(|_| points.is_file() && table.is_file());
    if let Some(truth) = kept.and_then(|text| from_report(&text, scene_hash, &points, &table)) {
        eprintln!("reference of {}: kept, {}; {}", source.title, report.display(), truth.certainty());
        return Ok(truth);
    }
    std::fs::create_dir_all(folder.join("reference"))?;
    let n = wanted.n_points.to_string();
    let mut sample = strings(&["sample-points", &source.argument, "-n", &n, "--seed", &SEED.to_string(), "--force"]);
    sample.extend(["--output".into(), shown(&points)]);
    hplt.ask(&sample, None)?;
    let mut trace = strings(&["reference", &source.argument, "--seed", &SEED.to_string(), "--force"]);
    trace.extend(["--at".into(), shown(&points), "--out".into(), shown(&table)]);
    trace.extend(["--error".into(), wanted.error.to_string()]);
    trace.extend(wanted.most_paths.into_iter().flat_map(|n| ["--paths".into(), n.to_string()]));
    let answer = hplt.ask(&trace, Some(NOT_CONVERGED))?;
    let text = format!("{:#}\n", answer.document);
    // Last, so that a reference whose making was cut short is not taken for a whole one.
    std::fs::write(&report, &text).with_context(|| format!("cannot write {}", report.display()))?;
    let truth = from_report(&text, scene_hash, &points, &table)
        .with_context(|| format!("{}: the reference is of another scene than the solution", source.title))?;
    eprintln!("reference of {}: {}", source.title, truth.certainty());
    Ok(truth)
}

impl Truth {
    fn certainty(&self) -> String {
        let e = &self.standard_error;
        let [mean, max] = [e.mean, e.max].map(|x| 100.0 * x);
        format!("standard error {mean:.2} % mean, {max:.2} % at most, {} points", self.n_points)
    }
}

fn file_stem(id: &str, wanted: &Wanted) -> String {
    let paths = wanted.most_paths.map_or(String::new(), |n| format!("-paths{n}"));
    format!("{id}-n{}-seed{SEED}-error{}{paths}", wanted.n_points, wanted.error)
}

/// `None` for the report of another scene.
fn from_report(text: &str, scene_hash: &str, points: &Path, table: &Path) -> Option<Truth> {
    let document: Value = serde_json::from_str(text).ok()?;
    let answer = RunAnswer::parse(&document).ok().filter(|a| a.scene_hash == scene_hash)?;
    Some(Truth {
        points: points.into(),
        table: table.into(),
        n_points: usize::try_from(document["more"]["points"].as_u64()?).ok()?,
        triangles: answer.triangles,
        standard_error: answer.more.standard_error?,
    })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::answers::tests::report;
    use super::*;

    #[test]
    fn a_kept_reference_counts_for_its_own_scene_only() {
        let mut document = report();
        document["more"] = json!({ "points": 2000, "paths": 9, "rays": 10,
            "standard_error": { "mean": 0.002, "max": 0.003, "target": 0.003, "points_above_target": 0 } });
        let read = |hash: &str| from_report(&document.to_string(), hash, Path::new("p"), Path::new("t"));
        let truth = read("00ff").unwrap();
        assert_eq!((truth.n_points, truth.standard_error.mean), (2000, 0.002));
        assert!(read("0000").is_none());
        assert!(from_report("{", "00ff", Path::new("p"), Path::new("t")).is_none());
    }

    #[test]
    fn names_tell_points_and_errors_apart() {
        let stem = |error, most_paths| file_stem("sponza", &Wanted { n_points: 2000, error, most_paths });
        assert_eq!(stem(0.003, None), "sponza-n2000-seed2010-error0.003");
        assert_eq!(stem(0.01, Some(4096)), "sponza-n2000-seed2010-error0.01-paths4096");
    }
}
