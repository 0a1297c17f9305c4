//! What lighting a scene would take, before it is done.

use hplt_geom::{Scene, TriangleId};
use serde::Serialize;

use crate::kept::Keep;
use crate::sections::{ReconstructionName, Variant};
use crate::settings::Settings;
use crate::values::{Radius, human_bytes};

/// Points of a maximal random set per area over `r²`.
const POINTS_PER_AREA: f64 = 0.7;
/// Bytes of the program itself, threads and their buffers included.
const PROGRAM_BYTES: u64 = 12 << 20;
/// Bytes per function: point, kd-tree, parents and children, coefficients of a solve in progress.
const BYTES_PER_POINT: f64 = 320.0;
/// Bytes per candidate point while a hierarchy is made, times candidates per point of the finest level: five, and as many
/// again where the first leave gaps.
const BYTES_OF_CANDIDATES: f64 = 10.0 * 40.0;
/// Bytes per function of the finest level while it is placed around those of the level before: of four one is refined, and has 64
/// candidates, twice.
const BYTES_OF_REFINING: f64 = 64.0 * 60.0 * 2.0 / 4.0;
/// Bytes per link: in the rows that levels are added to, and in the operator made from them.
const BYTES_PER_LINK: f64 = 16.0 + 8.0;
/// Share of the functions of a whole level that links make on levels from the third on, where light has detail; each level after it
/// has this share of that share.
const REFINED_SHARE: [f64; 2] = [0.5, 0.6];
/// Rays of which half meet a function that another ray of the same receiver has met.
const RAYS_OF_FEW_LINKS: f64 = 700.0;
/// Links per ray where all functions around are linked.
const SHEPARD_LINKS: f64 = 10.0;
/// Bytes of the BVH per triangle.
const BVH_BYTES_PER_TRIANGLE: f64 = 90.0;
/// Bytes per triangle, the BVH included, while it is built and its triangles are put together to surfaces; what an allocator keeps
/// of memory given back counts.
const BUILDING_BYTES_PER_TRIANGLE: f64 = 400.0;
/// The BVH is built in groups of about so many triangles, one per thread at a time, ...
const TRIANGLES_PER_GROUP: f64 = 80_000.0;
/// ... each of which takes so much more, per triangle.
const BUILDING_BYTES_IN_A_GROUP: f64 = 330.0;
/// Rays per second and thread that a solve gets through, all else included; a guess that a scene may miss by a factor of 3.
const RAYS_PER_SECOND: f64 = 4e5;
/// Share of the functions that are gathered in all bounces together.
const GATHERED_SHARE: f64 = 0.15;

/// Points, bytes and seconds. All reflecting sides are counted, since which of them light reaches is not known yet.
#[derive(Debug, Clone, Serialize)]
pub struct Estimate {
    /// Points per level, at most.
    pub points_per_level: Vec<u64>,
    /// Bytes by part.
    pub parts: Vec<(&'static str, u64)>,
    /// The most bytes that are in use at any time: those of all parts together, or those that reading the scene took.
    pub memory: u64,
    /// Seconds, about.
    pub seconds: f64,
    /// Links that a function has at most.
    #[serde(skip)]
    rays_per_function: f64,
}

impl Estimate {
    /// The estimate for a scene.
    pub fn of(scene: &Scene, settings: &Settings) -> Self {
        let mesh = scene.mesh();
        let sides = |t: TriangleId| {
            let material = scene.material(t);
            [true, false].into_iter().filter(|&front| material.reflects.includes(front)).count() as f64
        };
        let triangles = (0..mesh.n_triangles() as u32).map(TriangleId);
        let area: f64 = triangles.map(|t| mesh.area(t) * sides(t)).sum();
        let radius = match settings.radius {
            Radius::World(length) => length / scene.frame().scale(),
            Radius::OfDiagonal(fraction) => fraction * f64::from(scene.diagonal()),
        };
        let points_per_level: Vec<u64> = (0..settings.levels)
            .map(|level| {
                let r = radius / (1u64 << level) as f64;
                // Saturates, which is what a limit wants.
                (POINTS_PER_AREA * area / (r * r)).ceil() as u64
            })
            .collect();
        let n = points_per_level.iter().map(|&n| n as f64).sum::<f64>();
        let finest = points_per_level.last().copied().unwrap_or(0) as f64;
        let rays_per_function = f64::from(settings.transport.n_rays);
        let (points, links) = match settings.variant {
            Variant::Links => bytes_of_links(&points_per_level, settings),
            _ => (n * BYTES_PER_POINT + finest * BYTES_OF_CANDIDATES, 0.0),
        };
        let n_triangles = mesh.n_triangles() as f64;
        let bvh = BVH_BYTES_PER_TRIANGLE * n_triangles;
        // What building takes in passing serves the points afterwards.
        let threads = settings.config.run.threads.unwrap_or_else(available_threads) as f64;
        let at_once = (threads * TRIANGLES_PER_GROUP).min(n_triangles);
        let building = BUILDING_BYTES_PER_TRIANGLE * n_triangles + BUILDING_BYTES_IN_A_GROUP * at_once;
        let building = (building - bvh - points - links).max(0.0);
        let (geometry, textures) = (mesh.memory() as u64, scene.texture_memory() as u64);
        let loaded = memory_in_use().map_or(0, |now| now.saturating_sub(geometry + textures));
        let parts = vec![
            ("program", PROGRAM_BYTES.max(loaded)),
            ("geometry", geometry),
            ("textures", textures),
            ("bvh", bvh as u64),
            ("building the bvh", building as u64),
            ("points", points as u64),
            ("links", links as u64),
        ];
        let gathers = GATHERED_SHARE * n * f64::from(settings.transport.n_rays);
        let shadow_rays = finest * 32.0;
        let seconds = (gathers + shadow_rays) / (RAYS_PER_SECOND * threads);
        let together = parts.iter().fold(0, |sum: u64, part: &(&str, u64)| sum.saturating_add(part.1));
        let memory = together.max(most_memory_in_use().unwrap_or(0));
        Self { points_per_level, parts, memory, seconds, rays_per_function }
    }

    /// Points on all levels.
    pub fn points(&self) -> u64 {
        self.points_per_level.iter().fold(0, |sum: u64, &n| sum.saturating_add(n))
    }

    /// Bytes of a solution file for what it keeps of links and groups of lights.
    pub fn bytes_kept(&self, keep: Keep, n_groups: usize) -> u64 {
        // An entry a link; length, sums and barrier a row.
        let of_links = if keep.links { 8.0 * self.rays_per_function + 40.0 } else { 0.0 };
        let of_groups = (if keep.is_solved(n_groups) { 36.0 } else { 24.0 }) * n_groups as f64;
        (GATHERED_SHARE * self.points() as f64 * (of_links + of_groups)) as u64
    }

    /// `geometry 3 kB, textures 0 B, …`
    pub fn parts_in_words(&self) -> String {
        self.parts.iter().map(|(name, bytes)| format!("{name} {}", human_bytes(*bytes))).collect::<Vec<_>>().join(", ")
    }
}

/// Bytes of functions and of links, where the first two levels are everywhere and the others where light has detail.
fn bytes_of_links(points_per_level: &[u64], settings: &Settings) -> (f64, f64) {
    let [of_third, of_next] = REFINED_SHARE;
    let share = |level: usize| if level < 2 { 1.0 } else { of_third * of_next.powi(level as i32 - 2) };
    let functions: Vec<f64> = points_per_level.iter().enumerate().map(|(level, &n)| n as f64 * share(level)).collect();
    let [coarsest, finest] = [functions.first(), functions.last()].map(|n| n.copied().unwrap_or(0.0));
    let n = functions.iter().sum::<f64>();
    let rays = f64::from(settings.transport.n_rays);
    let per_function = match settings.reconstruction {
        ReconstructionName::Nearest => rays / (1.0 + rays / RAYS_OF_FEW_LINKS),
        ReconstructionName::Shepard => SHEPARD_LINKS * rays,
    };
    let placing = (coarsest * BYTES_OF_CANDIDATES).max(finest * BYTES_OF_REFINING);
    (n * BYTES_PER_POINT + placing, n * per_function * BYTES_PER_LINK)
}

/// Threads that the machine can run at once.
pub fn available_threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Bytes of memory that the system could give, where it says so.
pub fn available_memory() -> Option<u64> {
    kilobytes("/proc/meminfo", "MemAvailable:")
}

/// Bytes of memory that this process has now, where the system says so.
fn memory_in_use() -> Option<u64> {
    kilobytes("/proc/self/status", "VmRSS:")
}

/// The most that it ever had: reading a file may take more than lighting what it holds.
fn most_memory_in_use() -> Option<u64> {
    kilobytes("/proc/self/status", "VmHWM:")
}

/// Bytes from a line `label 123 kB` of a file.
fn kilobytes(file: &str, label: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix(label))?;
    let kilobytes: u64 = line.trim().trim_end_matches("kB").trim().parse().ok()?;
    Some(kilobytes.saturating_mul(1024))
}
