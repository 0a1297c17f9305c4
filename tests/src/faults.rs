//! Faults to plant: one wrong stage each, everything else the product's own.

use hplt::basis::{Absolute, Coefficients, Coverage, ShepardBasis, Weight};
use hplt::geom::glam::{Vec2, Vec3};
use hplt::geom::radiometry::radiosity;
use hplt::geom::{
    Bvh, Environment, Hit, Material, OrientedPoint, PointHierarchy, Ray, RayCaster, Rgb, Scene, SceneBuilder,
    offset_origin,
};
use hplt::transport::{Error, Solution, StopReason, TransportOptions};

use crate::Stages;

/// A wrong pipeline with a name.
pub struct Fault {
    /// What is wrong, in words.
    pub name: &'static str,
    /// The pipeline.
    pub stages: Stages,
}

/// All faults.
pub fn all() -> Vec<Fault> {
    let mut faults = ray_faults();
    faults.extend(reading_faults());
    faults.extend(value_faults());
    faults
}

fn ray_faults() -> Vec<Fault> {
    let sound = Stages::SOUND;
    vec![
        Fault {
            name: "uniform instead of cosine rays",
            // A cosine has the distribution function z², a uniform direction z.
            stages: Stages { nearest: |b, r, h| bent(b, r, h, |z| z * z), ..sound },
        },
        Fault {
            name: "cosine twice",
            // Density cos²: distribution function z³.
            stages: Stages { nearest: |b, r, h| bent(b, r, h, |z| z.powf(2.0 / 3.0)), ..sound },
        },
        Fault { name: "normal flipped", stages: Stages { nearest: |b, r, h| bent(b, r, h, |z| -z), ..sound } },
        Fault { name: "occlusion off", stages: Stages { occluded: |_, _, occluded| occluded.fill(false), ..sound } },
        Fault {
            name: "only the far wall occludes",
            stages: Stages { nearest: farthest, occluded: |_, _, occluded| occluded.fill(false), ..sound },
        },
        Fault { name: "last ray dropped", stages: Stages { nearest: last_ray_dropped, ..sound } },
        Fault {
            name: "ray epsilon of 1e-3",
            stages: Stages { nearest: from_a_thousandth, occluded: occluded_from_a_thousandth, ..sound },
        },
    ]
}

fn reading_faults() -> Vec<Fault> {
    let sound = Stages::SOUND;
    vec![
        Fault {
            name: "kernel without its 1/π",
            stages: Stages { senders: |b, f, n, q, o| changed(b, f, n, q, o, |v| v * std::f32::consts::PI), ..sound },
        },
        Fault {
            name: "rows too large by 1e-3",
            stages: Stages { senders: |b, f, n, q, o| changed(b, f, n, q, o, |v| v * 1.001), ..sound },
        },
        Fault {
            name: "red and blue swapped",
            stages: Stages { senders: |b, f, n, q, o| changed(b, f, n, q, o, |v| Rgb::new(v.z, v.y, v.x)), ..sound },
        },
        Fault {
            name: "16-bit coefficients",
            stages: Stages { senders: |b, f, n, q, o| changed(b, f, n, q, o, half_precision), ..sound },
        },
        Fault {
            name: "weights not renormalised",
            stages: Stages { senders: not_renormalised, display: not_renormalised, ..sound },
        },
        Fault { name: "kernel ignores the side", stages: Stages { display: ignoring_sides, ..sound } },
        Fault { name: "sum in the order of the threads", stages: Stages { senders: summed_by_thread, ..sound } },
    ]
}

fn value_faults() -> Vec<Fault> {
    let sound = Stages::SOUND;
    vec![
        Fault {
            name: "radiance taken for exitance",
            stages: Stages { input: |b| with_materials(b, |m| m.exitance *= std::f32::consts::PI), ..sound },
        },
        Fault {
            name: "albedo applied twice",
            stages: Stages { input: |b| with_materials(b, |m| m.albedo *= m.albedo), ..sound },
        },
        Fault { name: "radiosity and irradiance swapped", stages: Stages { output: radiosity_instead, ..sound } },
        Fault { name: "one point duplicated", stages: Stages { points: one_point_twice, ..sound } },
        Fault { name: "area weights times 1.01", stages: Stages { points: larger_areas, ..sound } },
        Fault {
            name: "sRGB decoding skipped",
            stages: Stages { input: |b| with_materials(b, albedo_texture_undecoded), ..sound },
        },
        Fault { name: "sky weight halved", stages: Stages { input: half_the_sky, ..sound } },
        Fault { name: "stops on a small step", stages: Stages { run: step_size_stop, ..sound } },
    ]
}

/// Traces rays whose cosines to their common normal are changed; that normal is the mean of a whole batch of gather rays.
fn bent(bvh: &Bvh, rays: &[Ray], hits: &mut [Hit], bend: fn(f32) -> f32) {
    let normal = rays.iter().map(|ray| ray.direction).sum::<Vec3>().normalize_or_zero();
    let bent = |ray: &Ray| {
        let z = ray.direction.dot(normal);
        let across = (ray.direction - normal * z).normalize_or_zero();
        let z = bend(z.max(0.0));
        Ray { direction: normal * z + across * (1.0 - z * z).max(0.0).sqrt(), ..*ray }
    };
    let rays: Vec<Ray> = if rays.len() < 8 { rays.to_vec() } else { rays.iter().map(bent).collect() };
    bvh.trace_nearest(&rays, hits);
}

/// The last surface along a ray instead of the first.
fn farthest(bvh: &Bvh, rays: &[Ray], hits: &mut [Hit]) {
    for (ray, hit) in rays.iter().zip(hits) {
        // A ray from outside the scene (which is one unit large) back to the origin meets the last surface first, from behind.
        let back = Ray { origin: ray.origin + ray.direction * 4.0, direction: -ray.direction, t_max: 4.0 };
        *hit = bvh.nearest(back);
        (hit.t, hit.is_front) = (4.0 - hit.t, !hit.is_front);
    }
}

fn last_ray_dropped(bvh: &Bvh, rays: &[Ray], hits: &mut [Hit]) {
    bvh.trace_nearest(rays, hits);
    if let Some(last) = hits.last_mut() {
        *last = Hit::MISS;
    }
}

const EPSILON: f32 = 1e-3;

fn from_a_thousandth(bvh: &Bvh, rays: &[Ray], hits: &mut [Hit]) {
    let moved: Vec<Ray> = rays.iter().map(|ray| Ray { origin: ray.origin + ray.direction * EPSILON, ..*ray }).collect();
    bvh.trace_nearest(&moved, hits);
}

/// Shortened at both ends, as code with an absolute epsilon does.
fn occluded_from_a_thousandth(bvh: &Bvh, rays: &[Ray], occluded: &mut [bool]) {
    let moved: Vec<Ray> = rays
        .iter()
        .map(|ray| {
            let unit = ray.direction.normalize_or_zero();
            Ray { origin: ray.origin + unit * EPSILON, direction: ray.direction - unit * (2.0 * EPSILON), ..*ray }
        })
        .collect();
    bvh.trace_occluded(&moved, occluded);
}

/// What the product reads, changed.
fn changed(
    basis: &ShepardBasis,
    field: &Coefficients<Absolute>,
    n_levels: usize,
    queries: &[OrientedPoint],
    out: &mut [Rgb],
    change: fn(Rgb) -> Rgb,
) -> Coverage {
    let coverage = (Stages::SOUND.senders)(basis, field, n_levels, queries, out);
    out.iter_mut().for_each(|value| *value = change(*value));
    coverage
}

fn half_precision(value: Rgb) -> Rgb {
    // Ten bits of fraction, rounded.
    let round = |x: f32| f32::from_bits(x.to_bits().wrapping_add(0x1000) & !0x1fff);
    Rgb::new(round(value.x), round(value.y), round(value.z))
}

/// A sum over functions of the finest level read, by a rule of its own.
fn summed(
    basis: &ShepardBasis,
    (field, n_levels): (&Coefficients<Absolute>, usize),
    queries: &[OrientedPoint],
    out: &mut [Rgb],
    sum: impl Fn(&ShepardBasis, &OrientedPoint, &[Rgb]) -> Rgb,
) -> Coverage {
    let values = field.level(n_levels - 1);
    queries.iter().zip(out).for_each(|(query, out)| *out = sum(basis, query, values));
    Coverage { queries: queries.len() as u64, ..Coverage::default() }
}

fn not_renormalised(
    basis: &ShepardBasis,
    field: &Coefficients<Absolute>,
    n_levels: usize,
    queries: &[OrientedPoint],
    out: &mut [Rgb],
) -> Coverage {
    summed(basis, (field, n_levels), queries, out, |basis, query, values| {
        let mut weights = Vec::new();
        basis.raw_weights(n_levels - 1, query, &mut weights);
        weights.iter().map(|w| values[w.function as usize] * w.weight).sum()
    })
}

fn ignoring_sides(
    basis: &ShepardBasis,
    field: &Coefficients<Absolute>,
    n_levels: usize,
    queries: &[OrientedPoint],
    out: &mut [Rgb],
) -> Coverage {
    let level = n_levels - 1;
    summed(basis, (field, n_levels), queries, out, |basis, query, values| {
        let support = basis.support(level);
        let (mut sum, mut total) = (Rgb::ZERO, 0.0);
        basis.tree(level).within(query.position, support, |id, distance_squared| {
            let weight = hplt::basis::smoothstep(distance_squared.sqrt() / support);
            sum += values[id as usize] * weight;
            total += weight;
        });
        if total > 0.0 { sum / total } else { Rgb::ZERO }
    })
}

/// Partial sums, one per thread of the pool, as a careless parallel sum makes them.
fn summed_by_thread(
    basis: &ShepardBasis,
    field: &Coefficients<Absolute>,
    n_levels: usize,
    queries: &[OrientedPoint],
    out: &mut [Rgb],
) -> Coverage {
    let n_threads = rayon::current_num_threads();
    summed(basis, (field, n_levels), queries, out, |basis, query, values| {
        let mut weights: Vec<Weight> = Vec::new();
        basis.weights(n_levels - 1, query, &mut weights);
        let share = weights.len().div_ceil(n_threads).max(1);
        let partial = |part: &[Weight]| part.iter().map(|w| values[w.function as usize] * w.weight).sum::<Rgb>();
        weights.chunks(share).map(partial).sum()
    })
}

fn with_materials(mut builder: SceneBuilder, change: fn(&mut Material)) -> SceneBuilder {
    builder.materials_mut().iter_mut().for_each(change);
    builder
}

fn albedo_texture_undecoded(material: &mut Material) {
    if let Some(slot) = material.albedo_texture.take() {
        let linear = slot.texture.sample(Vec2::splat(0.5), slot.wrap).truncate();
        let stored = linear.to_array().map(|x| 1.055 * x.powf(1.0 / 2.4) - 0.055);
        material.albedo *= Rgb::from_array(stored);
    }
}

fn half_the_sky(mut builder: SceneBuilder) -> SceneBuilder {
    if let Ok(sky) = Environment::constant(Rgb::splat(0.5)) {
        builder.set_environment(sky);
    }
    builder
}

fn radiosity_instead(scene: &Scene, bvh: &Bvh, point: &OrientedPoint, irradiance: Rgb) -> Rgb {
    let hit = bvh.nearest(Ray::new(offset_origin(point.position, point.normal), -point.normal));
    if hit.is_miss() {
        return irradiance;
    }
    let surface = scene.surface_at(&hit);
    radiosity(scene.exitance(&surface), scene.albedo(&surface), irradiance)
}

fn one_point_twice(mut points: PointHierarchy) -> PointHierarchy {
    for level in &mut points.levels {
        if let Some(&first) = level.points.first() {
            level.points.push(first);
            level.is_refined.extend(level.is_refined.first().copied());
        }
    }
    points
}

fn larger_areas(mut points: PointHierarchy) -> PointHierarchy {
    points.levels.iter_mut().flat_map(|level| &mut level.points).for_each(|point| point.area *= 1.01);
    points
}

/// Takes a bounce that adds less than the tolerance for the end.
fn step_size_stop(
    options: &TransportOptions,
    transport: &dyn Fn(&TransportOptions) -> Result<Solution<Absolute>, Error>,
) -> Result<Solution<Absolute>, Error> {
    let all = transport(options)?;
    let mut mean = 0.0;
    let small = |bounce: &hplt::transport::BounceReport| {
        mean += bounce.mean.max_element();
        bounce.unshot.max_element() <= options.tolerance * mean
    };
    let Some(last) = all.report.bounces.iter().position(small) else { return Ok(all) };
    let mut short = transport(&TransportOptions { max_bounces: last + 1, tolerance: 0.0, ..options.clone() })?;
    short.report.stop = StopReason::Converged;
    short.report.truncation_bound = options.tolerance;
    Ok(short)
}
