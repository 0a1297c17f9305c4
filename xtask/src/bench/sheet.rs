//! The report as comma-separated values.

use super::measure::{EngineReport, Reading, SceneReport};

/// Names of the columns.
pub const CSV_HEAD: [&str; 43] = [
    "scene",
    "is_stand_in",
    "triangles",
    "points",
    "reference_se_mean",
    "reference_se_max",
    "engine",
    "flags",
    "functions_l0",
    "functions_finest",
    "load_s",
    "bvh_s",
    "hierarchy_s",
    "direct_s",
    "transport_s",
    "solve_median_s",
    "solve_least_s",
    "solve_most_s",
    "completion_median_s",
    "completion_least_s",
    "completion_most_s",
    "runs",
    "processor_s",
    "peak_memory_bytes",
    "stop",
    "integrals",
    "rays",
    "rays_per_s",
    "escaped",
    "uncovered",
    "interpolated_mean",
    "interpolated_median",
    "interpolated_p95",
    "interpolated_bias",
    "interpolated_lit_mean",
    "interpolated_s",
    "gather_rays",
    "gathered_mean",
    "gathered_median",
    "gathered_p95",
    "gathered_bias",
    "gathered_lit_mean",
    "gathered_s",
];

/// All figures of one way of lighting one scene.
pub fn csv_row(scene: &SceneReport, engine: &EngineReport) -> Vec<String> {
    let (s, e) = (&engine.stages, engine);
    let ends = |of: Option<&u64>| of.copied().unwrap_or(0).to_string();
    let known = |of: Option<String>| of.unwrap_or_default();
    let mut cells = vec![scene.id.clone(), scene.is_stand_in.to_string()];
    cells.extend([scene.triangles, scene.n_points as u64].map(|n| n.to_string()));
    cells.extend([scene.reference.mean, scene.reference.max].map(|x| x.to_string()));
    cells.extend([e.id.to_owned(), e.flags.clone()]);
    cells.extend([ends(e.points_per_level.first()), ends(e.points_per_level.last())]);
    cells.extend([s.load, s.bvh, s.hierarchy, s.direct, s.transport].map(|x| x.to_string()));
    for times in [&e.solve, &e.completion] {
        cells.extend([times.median, times.least, times.most].map(|x| x.to_string()));
    }
    cells.push(e.completion.runs.to_string());
    cells.push(known(e.processor_seconds.map(|x| x.to_string())));
    cells.push(known(e.peak_memory.map(|x| x.to_string())));
    cells.push(e.stop.clone());
    cells.extend([e.integrals, e.rays].map(|n| n.to_string()));
    cells.push(e.rays_per_second.to_string());
    cells.extend([e.escaped, e.uncovered].map(|n| n.to_string()));
    cells.extend(reading(Some(&e.interpolated)));
    cells.push(known(e.gathered.and_then(|g| g.gather_rays).map(|n| n.to_string())));
    cells.extend(reading(e.gathered.as_ref()));
    cells
}

fn reading(of: Option<&Reading>) -> [String; 6] {
    let Some(r) = of else { return Default::default() };
    [r.all.mean, r.all.median, r.all.p95, r.all.bias, r.lit.mean, r.seconds].map(|x| x.to_string())
}
