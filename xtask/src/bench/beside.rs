//! Our runs of the published variants beside what was published of them.

use super::cells::{count, figures, seconds};
use super::engines::Variant;
use super::measure::{EngineReport, SceneReport};
use super::published::{Published, Timing};
use super::table::{errors, variant_of};

/// A scene and what was published of its counterpart.
pub type Pair<'r> = (&'r SceneReport, &'r Published);

/// Head of all tables here.
pub const PUBLISHED_HEAD: [&str; 7] = [
    "scene",
    "run",
    "bounces 1 / 2 / 3",
    "integrals",
    "transport",
    "hierarchy + BVH",
    "mean error: interpolated / gathered",
];
/// Below the table of GPUs.
pub const GPU_NOTE: &str = "The kernels for GPUs are not built yet. Published figures of 2010 for later comparison.";
/// Below the table of a variant.
pub fn published_note(variant: Variant) -> String {
    let ours = match variant {
        Variant::V1 => "Delta encoding, exact Shepard reconstruction, three bounces; `--preset slides`.",
        _ => {
            "Absolute values, approximate nearest neighbours, push-down, three bounces; `--preset slides --variant absolute --reconstruction \
             nearest` on the CPU."
        }
    };
    format!(
        "{ours} Published rows are those of the slides of 2010 and no timing that we reproduce: their machine, their rays per gather and \
         their error were not published."
    )
}

/// Our runs of a variant on the CPU, each above the published ones.
pub fn published_rows(pairs: &[Pair<'_>], variant: Variant) -> Vec<Vec<String>> {
    let mut rows = Vec::new();
    for (scene, published) in pairs {
        if let Some(u) = scene.unfinished.iter().find(|u| variant_of(u.id) == variant) {
            let run = format!("ours, {}: no result within {} s", u.flags, u.limit_seconds);
            let cells = [&scene.title, &run, "", "", "", "", ""];
            rows.push(cells.map(str::to_owned).into());
            rows.extend(published_cpu_and_gpu(published, variant));
        }
        let Some(engine) = scene.engines.iter().find(|e| variant_of(e.id) == variant) else { continue };
        let bounces: Vec<String> = engine.bounces.iter().map(|b| figures(*b)).collect();
        let s = &engine.settings;
        let cut = engine.cut_short_after.map_or(String::new(), |limit| format!(", cut short at {limit} s"));
        rows.push(vec![
            scene.title.clone(),
            format!("ours, {} rays, {} levels{cut}", s.rays, s.levels),
            format!("{} s", bounces.join(" / ")),
            count(engine.integrals),
            seconds(engine.stages.transport),
            seconds(engine.stages.hierarchy + engine.stages.bvh),
            errors(engine),
        ]);
        rows.extend(published_cpu_and_gpu(published, variant));
        rows.extend(speedups(published, engine, variant));
    }
    rows
}

/// What stands beside our run of a variant on the CPU.
fn published_cpu_and_gpu(published: &Published, variant: Variant) -> Vec<Vec<String>> {
    match variant {
        Variant::V3 => vec![
            published_row(published, "published, GPU", &published.v3_gpu),
            published_row(published, "published, CPU (V1)", &published.v1_cpu),
        ],
        _ => vec![published_row(published, "published, CPU", &published.v1_cpu)],
    }
}

/// How much faster than the published times; nothing where it was cut short.
fn speedups(published: &Published, engine: &EngineReport, variant: Variant) -> Option<Vec<String>> {
    let transport = engine.stages.transport;
    if engine.cut_short_after.is_some() || transport <= 0.0 {
        return None;
    }
    let cpu = format!("CPU {:.1}x", published.v1_cpu.transport_seconds / transport);
    let text = match variant {
        Variant::V3 => format!("{cpu}, GPU {:.2}x", published.v3_gpu.transport_seconds / transport),
        _ => cpu,
    };
    let cells = ["", "published time over ours", "", "", &text, "", ""];
    Some(cells.map(str::to_owned).into())
}

fn published_row(published: &Published, run: &str, timing: &Timing) -> Vec<String> {
    let cells =
        [published.scene, run, timing.bounces, timing.integrals, timing.transport, "not published", "not published"];
    cells.map(str::to_owned).into()
}

/// The published runs on a GPU, each below ours.
pub fn gpu_rows(pairs: &[Pair<'_>]) -> Vec<Vec<String>> {
    let of = |(scene, published): &Pair<'_>| {
        let ours = |run: &str| {
            let cells = [scene.title.as_str(), run, "not built yet", "", "", "", ""];
            cells.map(str::to_owned).to_vec()
        };
        [
            ours("ours, V2"),
            published_row(published, "published, V2", &published.v2_gpu),
            ours("ours, V3"),
            published_row(published, "published, V3", &published.v3_gpu),
        ]
    };
    pairs.iter().flat_map(of).collect()
}
