//! Mray/s of hplt's hierarchy and of Embree's robust mode on the same rays of the same triangles. See README.md.

mod embree;
mod rays;

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use embree::{Embree, EmbreeScene, Width};
use hplt_geom::glam::DVec3;
use hplt_geom::{BuildPolicy, Bvh, BvhOptions, Hit, Material, MeshInput, Ray, RayCaster, Rgb, Scene, SceneBuilder};
use rays::{N_RAYS, Rays};

const USAGE: &str = "usage: hplt-bench-embree [--embree LIBRARY] [--receivers N] [--repeats N] [--threads LIST] [--fast-build] [--room] SCENE...";

struct Job {
    library: Option<PathBuf>,
    receivers: u32,
    repeats: usize,
    threads: Vec<usize>,
    options: BvhOptions,
    room: bool,
    scenes: Vec<PathBuf>,
}

fn job() -> Result<Job> {
    let mut job = Job {
        library: None,
        receivers: 4096,
        repeats: 5,
        threads: vec![1, 2],
        options: BvhOptions::production(),
        room: false,
        scenes: Vec::new(),
    };
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().context(USAGE);
        match argument.as_str() {
            "--embree" => job.library = Some(value()?.into()),
            "--receivers" => job.receivers = value()?.parse()?,
            "--repeats" => job.repeats = value()?.parse()?,
            "--threads" => job.threads = value()?.split(',').map(str::parse).collect::<Result<_, _>>()?,
            "--room" => job.room = true,
            "--fast-build" => job.options = BvhOptions::fast(),
            _ if argument.starts_with('-') => bail!(USAGE),
            _ => job.scenes.push(argument.into()),
        }
    }
    anyhow::ensure!(!job.scenes.is_empty() && job.repeats > 0, USAGE);
    Ok(job)
}

fn main() -> Result<()> {
    let job = job()?;
    let threads = job.threads.iter().copied().max().unwrap_or(1);
    let embree = job.library.as_deref().map(|path| Embree::load(path, threads)).transpose()?;
    for path in &job.scenes {
        compare(&job, embree.as_ref(), path)?;
    }
    Ok(())
}

/// The triangles of a scene file, without cut-outs: Embree would need a callback for them.
fn load(path: &Path, room: bool) -> Result<Scene> {
    let mut builder = hplt_io::load_scene(path, &hplt_io::LoadOptions::default())?.scene;
    builder.materials_mut().iter_mut().for_each(|material| material.alpha = None);
    if room {
        add_room(&mut builder)?;
    }
    Ok(builder.build(BuildPolicy::default())?.0)
}

/// Puts everything on the floor of a closed room, about twice as large, whose walls face inwards.
fn add_room(builder: &mut SceneBuilder) -> Result<()> {
    let (min, max) = builder.bounds().context("the scene has no triangle")?;
    let size = (max - min).max_element();
    let (low, high) = (min - size * DVec3::new(0.6, 0.01, 0.6), max + size * DVec3::new(0.6, 0.8, 0.6));
    let corner = |i: usize| DVec3::from_array(std::array::from_fn(|a| if i >> a & 1 == 0 { low[a] } else { high[a] }));
    let positions: [DVec3; 8] = std::array::from_fn(corner);
    const WALLS: [[u32; 4]; 6] = [[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]];
    let triangles: Vec<[u32; 3]> = WALLS.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let material = builder.push_material(Material::diffuse("room", Rgb::splat(0.5)));
    let mesh =
        MeshInput { name: "room", positions: &positions, normals: &[], uvs: &[], triangles: &triangles, material };
    Ok(builder.push_mesh(mesh)?)
}

/// One way of tracing.
enum Caster<'a> {
    Ours(&'a Bvh),
    Embree(&'a EmbreeScene<'a>, Width),
}

impl Caster<'_> {
    fn nearest(&self, rays: &[Ray], hits: &mut [Hit]) {
        match self {
            Self::Ours(bvh) => bvh.trace_nearest(rays, hits),
            Self::Embree(scene, width) => scene.trace_nearest(*width, rays, hits),
        }
    }

    fn occluded(&self, rays: &[Ray], occluded: &mut [bool]) {
        match self {
            Self::Ours(bvh) => bvh.trace_occluded(rays, occluded),
            Self::Embree(scene, width) => scene.trace_occluded(*width, rays, occluded),
        }
    }
}

fn compare(job: &Job, embree: Option<&Embree>, path: &Path) -> Result<()> {
    let scene = load(path, job.room)?;
    println!("\n{}: {} triangles", path.file_name().unwrap_or_default().display(), scene.mesh().n_triangles());
    let start = Instant::now();
    let (bvh, report) = Bvh::build(&scene, job.options);
    println!("  hplt build {:.3} s, {report:?}", start.elapsed().as_secs_f64());
    let mut built = Vec::new();
    for robust in [true, false] {
        let start = Instant::now();
        if let Some(embree) = embree {
            built.push(embree.build(scene.mesh(), robust)?);
            println!("  Embree build {:.3} s, robust {robust}", start.elapsed().as_secs_f64());
        }
    }
    let mut casters = vec![("hplt", Caster::Ours(&bvh))];
    if let [robust, fast] = &built[..] {
        casters.push(("Embree robust", Caster::Embree(robust, Width::One)));
        casters.push(("Embree robust, 8 at once", Caster::Embree(robust, Width::Eight)));
        casters.push(("Embree robust, 16 at once", Caster::Embree(robust, Width::Sixteen)));
        casters.push(("Embree fast", Caster::Embree(fast, Width::One)));
    }
    let rays = rays::rays(&scene, &bvh, job.receivers, job.room);
    for &threads in &job.threads {
        print_rates(job, threads, &casters, &rays);
    }
    print_mismatches(&casters, &rays);
    Ok(())
}

/// Rates from the quietest of the repeats, receiver by receiver: whatever else the machine does hits some repeats of a
/// receiver, seldom all. Casters take turns; between two repeats of a receiver all others are traced, so that it finds the
/// caches as a long run leaves them.
fn print_rates(job: &Job, threads: usize, casters: &[(&str, Caster<'_>)], rays: &Rays) {
    let n = rays.gather.len() / N_RAYS;
    let mut best = vec![[vec![f64::INFINITY; n], vec![f64::INFINITY; n]]; casters.len()];
    for _ in 0..job.repeats {
        for ((_, caster), [nearest, occluded]) in casters.iter().zip(&mut best) {
            trace(threads, &rays.gather, Hit::MISS, nearest, |rays, hits| caster.nearest(rays, hits));
            trace(threads, &rays.shadow, false, occluded, |rays, answers| caster.occluded(rays, answers));
        }
    }
    let rate =
        |caster: usize, query: usize| (threads * n * N_RAYS) as f64 / best[caster][query].iter().sum::<f64>() / 1e6;
    println!("  {threads} thread(s)                  nearest Mray/s  hplt/it   occluded Mray/s  hplt/it");
    for (i, (name, _)) in casters.iter().enumerate() {
        let [nearest, occluded] = [0, 1].map(|query| (rate(i, query), rate(0, query) / rate(i, query)));
        println!("  {name:<28} {:>14.2} {:>8.2} {:>17.2} {:>8.2}", nearest.0, nearest.1, occluded.0, occluded.1);
    }
}

/// An answer per ray; `best` keeps the least seconds per receiver. Threads take 16 receivers at a time, in their order.
fn trace<T: Copy + Send>(
    threads: usize,
    rays: &[Ray],
    empty: T,
    best: &mut [f64],
    cast: impl Fn(&[Ray], &mut [T]) + Sync,
) -> Vec<T> {
    const RECEIVERS: usize = 16;
    let mut answers = vec![empty; rays.len()];
    let parts = rays.chunks(RECEIVERS * N_RAYS).zip(answers.chunks_mut(RECEIVERS * N_RAYS));
    let work: Vec<_> = parts.zip(best.chunks_mut(RECEIVERS)).map(|part| Mutex::new(Some(part))).collect();
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(part) = work.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let Some(((rays, answers), best)) = part.lock().expect("no thread panics").take() else { break };
                    for ((rays, answers), best) in rays.chunks(N_RAYS).zip(answers.chunks_mut(N_RAYS)).zip(best) {
                        let start = Instant::now();
                        cast(rays, answers);
                        *best = best.min(start.elapsed().as_secs_f64());
                    }
                }
            });
        }
    });
    answers
}

fn print_mismatches(casters: &[(&str, Caster<'_>)], rays: &Rays) {
    let results: Vec<_> = casters
        .iter()
        .map(|(_, caster)| {
            let mut seconds = vec![0.0; rays.gather.len() / N_RAYS];
            let hits = trace(2, &rays.gather, Hit::MISS, &mut seconds, |rays, hits| caster.nearest(rays, hits));
            let occluded = trace(2, &rays.shadow, false, &mut seconds, |rays, answers| caster.occluded(rays, answers));
            (hits, occluded)
        })
        .collect();
    let misses = results[0].0.iter().filter(|hit| hit.is_miss()).count();
    println!("  of {} rays: hplt misses {misses}, {}", rays.gather.len(), fingerprint(&results[0].0));
    for ((name, _), (hits, occluded)) in casters.iter().zip(&results).skip(1) {
        let pairs = || results[0].0.iter().zip(hits);
        let of_hit = pairs().filter(|(a, b)| a.is_miss() != b.is_miss()).count();
        let of_distance =
            pairs().filter(|(a, b)| !a.is_miss() && !b.is_miss() && (a.t - b.t).abs() > 1e-4 * a.t).count();
        let of_triangle = pairs().filter(|(a, b)| a.triangle != b.triangle).count();
        let of_occlusion = results[0].1.iter().zip(occluded).filter(|(a, b)| a != b).count();
        println!(
            "  {name}: differs in hit or miss {of_hit}, distance by > 1e-4 {of_distance}, triangle {of_triangle}, \
             occlusion {of_occlusion}"
        );
    }
}

/// A hash of all bits of all hits: the same for every build and thread count.
fn fingerprint(hits: &[Hit]) -> String {
    let words =
        hits.iter().flat_map(|h| [h.t.to_bits(), h.u.to_bits(), h.v.to_bits(), h.triangle.0, h.is_front.into()]);
    let hash = words.fold(0xcbf2_9ce4_8422_2325u64, |h, w| (h ^ u64::from(w)).wrapping_mul(0x100_0000_01b3));
    format!("hits {hash:016x}")
}
