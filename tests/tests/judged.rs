//! A23: the solver against the path tracer, which shares the scene with it and nothing else.

use hplt::geom::glam::{DVec3, Vec3};
use hplt::geom::radiometry::luminance;
use hplt::geom::{Material, NoProgress, OrientedPoint, Rgb, Scene, SceneBuilder};
use hplt::reference::path_tracer::{IrradianceOptions, PathTracer};
use hplt::reference::scenes::{self, Shape};
use hplt::reference::statistics::{
    MeanEstimate, Outcome, equivalence, kolmogorov_smirnov_uniform, mean_of_replicates, welch_t,
};
use hplt::sampling::random::{Stage, Stream, unit_f64};
use hplt::transport::{
    DirectLight, DirectOptions, FinalGatherOptions, LayeredNearestInSight, LinkOptions, Linked, Model, Sender,
    TransportOptions, direct_irradiance, final_gather,
};
use hplt_tests::{Prepared, Setup};

/// The mean irradiance of the Cornell box at random points by final gather, within 1 % of the path tracer's at the same points:
/// 99.9 % confidence, both noises counted.
#[test]
fn a23_cornell_against_the_path_tracer() {
    let transport = TransportOptions { n_rays: 512, ..TransportOptions::production() };
    let prepared = Prepared::new(scenes::build(scenes::cornell_box()), Setup { transport, ..Setup::default() });
    let solved = prepared.solve().unwrap();
    let points = hplt::sampling::random_surface_points(&prepared.scene, &prepared.bvh.bvh, &prepared.regions, 128, 9);
    let gathered = prepared.gather(&solved, &points, 1024);
    let direct = prepared.direct_at(&points);
    let places: Vec<_> = points.iter().map(|p| (p.position, p.normal)).collect();
    let options = IrradianceOptions { seed: 0xa23, samples_per_replicate: 256, ..IrradianceOptions::preview() };
    let reference = PathTracer::new(&prepared.scene).irradiance(&places, &options, &NoProgress).unwrap();
    let y = |rgb: Rgb| f64::from(luminance(rgb));
    let (mut sum, mut expected, mut variance) = (0.0, 0.0, 0.0);
    for ((g, d), r) in gathered.iter().zip(&direct).zip(&reference) {
        sum += y(g.irradiance) + y(*d);
        expected += y(r.total().as_vec3());
        variance += y(g.noise).powi(2) + r.luminance_standard_error.powi(2);
    }
    let (bias, half_width) = (sum / expected - 1.0, 3.3 * variance.sqrt() / expected);
    println!("bias {:+.3} %, half-width {:.3} %", 100.0 * bias, 100.0 * half_width);
    assert!(bias.abs() + half_width <= 0.01, "bias {bias}, half-width {half_width}");
    // Negative control: two per cent of light too much would not pass.
    assert!((1.02 * sum / expected - 1.0).abs() + half_width > 0.01);
}

/// Points of a tile.
const POINTS_PER_TILE: usize = 16;
/// Independent runs of either side.
const REPLICATES: u64 = 16;
/// Probability that a right solver fails one of the three tests.
const FAMILY_ALPHA: f64 = 1e-4;
/// Normal values standardised by the deviation of 16 of them have 2.6; beyond this the t-test is not to be trusted.
const MAX_KURTOSIS: f64 = 6.0;

/// A rectangle that irradiance is averaged over: corner and edges, its front along their cross product.
type Tile = [DVec3; 3];

/// A closed room of coloured walls with a lamp and two boxes in the air, and tiles on everything: 6 by 6 on each wall and 2 by 2 on
/// each side of the boxes.
fn room_with_boxes() -> (Scene, Vec<Tile>) {
    let mut builder = SceneBuilder::new();
    let mut tiles = Vec::new();
    let mut push = |shape: &Shape, material: Material, n: u32| {
        for quad in shape.positions.chunks(4) {
            let (u, v) = ((quad[1] - quad[0]) / f64::from(n), (quad[3] - quad[0]) / f64::from(n));
            tiles.extend((0..n * n).map(|k| [quad[0] + u * f64::from(k % n) + v * f64::from(k / n), u, v]));
        }
        let id = builder.push_material(material);
        shape.push_into(&mut builder, "part", id);
    };
    let room = Shape::new().room(DVec3::ZERO, DVec3::new(3.0, 2.5, 2.0)).clone();
    for (i, quad) in room.positions.chunks(4).enumerate() {
        let albedo = [[0.6, 0.1, 0.1], [0.1, 0.5, 0.1], [0.5, 0.5, 0.5]][i.min(2)];
        let wall = Shape::new().quad([quad[0], quad[1], quad[2], quad[3]]).clone();
        push(&wall, Material::diffuse("wall", Rgb::from_array(albedo)), 6);
    }
    let boxes = [[(0.5, 0.2, 0.4), (1.1, 1.4, 1.0)], [(1.7, 0.15, 1.0), (2.4, 0.7, 1.6)]];
    for [min, max] in boxes.map(|b| b.map(DVec3::from)) {
        push(Shape::new().cuboid(min, max), Material::diffuse("box", Rgb::splat(0.7)), 2);
    }
    let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::new(30.0, 25.0, 20.0)));
    let corners = [(1.3, 0.8), (1.7, 0.8), (1.7, 1.2), (1.3, 1.2)].map(|(x, z)| DVec3::new(x, 2.0, z));
    Shape::new().quad(corners).push_into(&mut builder, "lamp", lamp);
    (scenes::build(builder), tiles)
}

/// The means of both sides over one tile.
type Pair = [MeanEstimate; 2];

/// What the solver says of `points` in replicate `seed`: links and rays of its own.
fn solved_at(prepared: &Prepared, points: &[OrientedPoint], seed: u64) -> Vec<Rgb> {
    let linked: Linked = prepared.link(&LinkOptions { seed, n_levels: 3, ..LinkOptions::production() });
    let model = Model { basis: &linked.basis, ..prepared.model() };
    let reconstruction = LayeredNearestInSight { caster: model.caster };
    let sender = Sender { coefficients: &linked.indirect, reconstruction: &reconstruction, n_levels: usize::MAX };
    let light = DirectLight::new(&prepared.scene, DirectOptions { seed, ..DirectOptions::one_sample() });
    let options = FinalGatherOptions { n_rays: 64, stage: Stage::Error, seed, light: &light, contact: 1.0 };
    let gathered = final_gather(&model, &sender, points, options, &NoProgress).unwrap();
    let light = DirectLight::new(&prepared.scene, DirectOptions { seed, ..DirectOptions::projection() });
    let direct = direct_irradiance(&light, &prepared.bvh.bvh, points, Stage::Error, &NoProgress).unwrap();
    direct.iter().zip(&gathered).map(|(d, g)| *d + g.irradiance).collect()
}

/// Means of tiles, one row per replicate, of values at points in the order of tiles.
fn tile_means(values: &[f64]) -> Vec<f64> {
    values.chunks(POINTS_PER_TILE).map(|tile| tile.iter().sum::<f64>() / POINTS_PER_TILE as f64).collect()
}

/// The kurtosis of all replicates of all tiles, each less its tile's mean and over its tile's deviation.
fn pooled_kurtosis(rows: &[Vec<f64>]) -> f64 {
    let (mut fourth, mut n) = (0.0, 0.0);
    for tile in 0..rows[0].len() {
        let values: Vec<f64> = rows.iter().map(|row| row[tile]).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
        fourth += values.iter().map(|v| (v - mean).powi(4)).sum::<f64>() / variance.powi(2).max(f64::MIN_POSITIVE);
        n += values.len() as f64;
    }
    fourth / n
}

/// What is wrong with tiles of the solver (first) against those of the judge (second), by test: the worst tile, the uniformity of all
/// p-values, the mean within 1 %.
fn judge(solver: &[Vec<f64>], path_tracer: &[Vec<f64>]) -> [bool; 3] {
    let n_tiles = solver[0].len();
    let of = |rows: &[Vec<f64>], tile: usize| {
        mean_of_replicates(&rows.iter().map(|row| row[tile]).collect::<Vec<_>>()).unwrap()
    };
    let pairs: Vec<Pair> = (0..n_tiles).map(|tile| [of(solver, tile), of(path_tracer, tile)]).collect();
    let p: Vec<f64> = pairs.iter().map(|[a, b]| welch_t(a, b).p).collect();
    let least = p.iter().copied().fold(1.0, f64::min);
    let least_allowed = -((-FAMILY_ALPHA).ln_1p() / n_tiles as f64).exp_m1();
    let uniform = kolmogorov_smirnov_uniform(&p).unwrap();
    let whole = |rows: &[Vec<f64>]| {
        mean_of_replicates(&rows.iter().map(|row| row.iter().sum::<f64>() / n_tiles as f64).collect::<Vec<_>>())
            .unwrap()
    };
    let (a, b) = (whole(solver), whole(path_tracer));
    let difference = MeanEstimate {
        mean: a.mean,
        standard_error: a.standard_error.hypot(b.standard_error),
        degrees_of_freedom: welch_t(&a, &b).degrees_of_freedom,
    };
    let mean = equivalence(&difference, b.mean, 0.01, 1e-3);
    let noise =
        pairs.iter().map(|[a, b]| a.standard_error.hypot(b.standard_error) / b.mean).sum::<f64>() / n_tiles as f64;
    println!(
        "{n_tiles} tiles of {:.2} % noise: least p {least:.1e} (allowed {least_allowed:.1e}), uniformity {uniform:.1e}, mean off by \
         {:+.3} % ± {:.3} %",
        100.0 * noise,
        100.0 * mean.difference / b.mean,
        100.0 * mean.half_width / b.mean
    );
    [least < least_allowed, uniform < FAMILY_ALPHA, mean.outcome != Outcome::Pass]
}

/// A23: a room with boxes, tile by tile: no tile differs from the path tracer by more than both noises explain, all differences
/// together are distributed as noise is, and the mean is within 1 %. Both sides from 16 independent runs.
#[test]
#[ignore = "slow: hundreds of millions of rays"]
fn a23_tiles_of_a_room_against_the_path_tracer() {
    let (scene, tiles) = room_with_boxes();
    assert!(tiles.len() >= 256, "{}", tiles.len());
    let prepared = Prepared::new(scene, Setup { n_levels: 1, ..Setup::default() });
    let stream = Stream::new(0xa23, Stage::Error);
    let place = |(i, [corner, u, v]): (usize, &Tile)| {
        (0..POINTS_PER_TILE).map(move |k| (i, *corner, *u, *v, k)).collect::<Vec<_>>()
    };
    let places: Vec<(DVec3, Vec3)> = tiles
        .iter()
        .enumerate()
        .flat_map(place)
        .map(|(i, corner, u, v, k)| {
            let [a, b, c, d] = stream.words(i as u32, k as u32, 0);
            let (x, y) = ((k % 4) as f64 + unit_f64(a, b), (k / 4) as f64 + unit_f64(c, d));
            (corner + (u * x + v * y) / 4.0, u.cross(v).normalize().as_vec3())
        })
        .collect();
    let points = prepared.locate_world(&places);
    let in_scene: Vec<(Vec3, Vec3)> = points.iter().map(|p| (p.position, p.normal)).collect();
    let y = |rgb: Rgb| f64::from(luminance(rgb));
    let solver: Vec<Vec<f64>> = (0..REPLICATES)
        .map(|seed| tile_means(&solved_at(&prepared, &points, seed).into_iter().map(y).collect::<Vec<_>>()))
        .collect();
    let tracer = PathTracer::new(&prepared.scene);
    let path_tracer: Vec<Vec<f64>> = (0..REPLICATES)
        .map(|seed| {
            let options = IrradianceOptions {
                seed: 1000 + seed,
                replicates: 2,
                samples_per_replicate: 64,
                ..IrradianceOptions::preview()
            };
            let estimates = tracer.irradiance(&in_scene, &options, &NoProgress).unwrap();
            tile_means(&estimates.iter().map(|e| y(e.total().as_vec3())).collect::<Vec<_>>())
        })
        .collect();
    for (name, rows) in [("solver", &solver), ("path tracer", &path_tracer)] {
        let kurtosis = pooled_kurtosis(rows);
        println!("{name}: kurtosis {kurtosis:.2}");
        assert!(kurtosis <= MAX_KURTOSIS, "{name}: tails too heavy for a t-test: {kurtosis}");
    }
    assert_eq!(judge(&solver, &path_tracer), [false; 3], "a tile, the spread of all, the mean");
    // Negative controls: one tile six per cent too bright; one per cent everywhere, up and down in turn; two per cent too much.
    let changed = |factor: &dyn Fn(usize) -> f64| -> [bool; 3] {
        let rows = |row: &Vec<f64>| row.iter().enumerate().map(|(i, v)| v * factor(i)).collect();
        judge(&solver.iter().map(rows).collect::<Vec<_>>(), &path_tracer)
    };
    assert!(changed(&|tile| if tile == 100 { 1.06 } else { 1.0 })[0], "a tile that is off is not seen");
    assert!(changed(&|tile| if tile % 2 == 0 { 1.01 } else { 0.99 })[1], "small errors everywhere are not seen");
    assert!(changed(&|_| 1.0201)[2], "a mean that is off is not seen");
}
