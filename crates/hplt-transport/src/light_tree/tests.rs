use glam::Vec3;
use hplt_geom::{OrientedPoint, RegionId};
use hplt_sampling::random::{Stage, Stream, unit_f32, unit_f64};

use super::*;
use crate::emitters::tests::triangle_light;
use crate::emitters::{Emitters, Guides};

/// Random numbers of a test.
struct Draws(Stream, u32);

impl Draws {
    fn new(seed: u64) -> Self {
        Self(Stream::new(seed, Stage::Probe), 0)
    }

    fn unit(&mut self) -> Vec3 {
        self.1 += 1;
        let [a, b, c, _] = self.0.words(self.1, 0, 0);
        Vec3::new(unit_f32(a), unit_f32(b), unit_f32(c))
    }

    fn direction(&mut self) -> Vec3 {
        (self.unit() - 0.5).normalize()
    }
}

fn lamp(at: Vec3, edges: [Vec3; 2], exitance: f32) -> Emitter {
    triangle_light([at, at + edges[0], at + edges[1]], exitance)
}

/// Lamps of all sizes, orientations and powers.
fn mixed(n: usize, seed: u64) -> Vec<Emitter> {
    let mut draws = Draws::new(seed);
    (0..n)
        .map(|_| {
            let size = 0.2 * draws.unit().x.powi(4) + 1e-4;
            let (at, along, across) = (draws.unit(), draws.direction(), draws.direction());
            lamp(at, [along * size, across * size], 10f32.powf(6.0 * draws.unit().x - 3.0))
        })
        .collect()
}

/// Rows of lamps on a ceiling, facing down.
fn ceiling(across: u32) -> Vec<Emitter> {
    let size = 0.25 / across as f32;
    let at = |i: u32| Vec3::new((i % across) as f32, across as f32, (i / across) as f32) / across as f32;
    (0..across * across).map(|i| lamp(at(i), [Vec3::X * size, Vec3::Z * size], 1.0)).collect()
}

fn moved(emitter: Emitter, by: Vec3) -> Emitter {
    Emitter { corners: emitter.corners.map(|c| c + by), ..emitter }
}

/// The probability of each leaf, with its emitters.
fn leaves(tree: &LightTree, emitters: &[Emitter], point: (Vec3, Vec3)) -> Vec<(std::ops::Range<usize>, f64)> {
    let (mut all, mut cut) = (Vec::new(), Cut::new());
    tree.cut(emitters, point, 1, &mut cut);
    let total: f64 = cut.iter().map(|(_, importance)| importance).sum();
    let mut todo: Vec<(u32, f64)> = cut.iter().map(|&(at, importance)| (at, importance / total)).collect();
    while let Some((at, probability)) = todo.pop() {
        let node = tree.nodes[at as usize];
        if node.count > 0 {
            all.push((node.emitters(), probability));
            continue;
        }
        if let Some([first, second]) = tree.shares(emitters, at, point) {
            todo.push((at + node.next, probability * second));
            todo.push((at + 1, probability * first));
        }
    }
    all
}

/// The probability that a point chooses each emitter.
fn probabilities(tree: &LightTree, emitters: &[Emitter], position: Vec3, normal: Vec3) -> Vec<f64> {
    let mut all = vec![0.0; emitters.len()];
    for (range, of_leaf) in leaves(tree, emitters, (position, normal)) {
        let total: f64 = emitters[range.clone()].iter().map(|e| e.guide(position, normal)).sum();
        for i in range.filter(|_| total > 0.0) {
            all[i] = of_leaf * emitters[i].guide(position, normal) / total;
        }
    }
    all
}

/// The variance of one draw, the visible ones exact: `Σ F²/p - (ΣF)²`, over `(ΣF)²`.
fn variance(emitters: &[Emitter], probabilities: &[f64], position: Vec3, normal: Vec3) -> Option<f64> {
    let (mut sum, mut squares) = (0.0, 0.0);
    for (e, p) in emitters.iter().zip(probabilities).filter(|(e, _)| e.can_light(position, normal)) {
        let brings = f64::from(e.form_factor(position, normal)) * f64::from(e.power / e.area);
        sum += brings;
        squares += if brings > 0.0 { brings * brings / p } else { 0.0 };
    }
    (sum > 0.0).then(|| squares / (sum * sum) - 1.0)
}

fn by_power(emitters: &[Emitter]) -> Vec<f64> {
    let total: f64 = emitters.iter().map(|e| f64::from(e.power)).sum();
    emitters.iter().map(|e| f64::from(e.power) / total).collect()
}

#[test]
fn every_emitter_is_in_one_leaf_and_in_its_bounds() {
    for n in [1, 3, 4, 5, 33, 1000, 40_000] {
        let mut emitters = mixed(n, 5);
        let tree = LightTree::build(&mut emitters);
        let mut next = 0;
        for node in tree.nodes.iter().filter(|node| node.count > 0) {
            assert_eq!(node.next, next);
            next += node.count;
            for e in &emitters[node.emitters()] {
                assert!(e.corners.iter().all(|c| c.cmpge(node.min).all() && c.cmple(node.max).all()));
                assert!(e.normal.dot(node.axis) >= node.cos_spread);
            }
        }
        assert_eq!(next as usize, n);
        assert!(tree.nodes.len() < n.max(2), "{} nodes", tree.nodes.len());
    }
}

/// No emitter that can light a point has probability 0; all are 1 together but for few draws that find none.
#[test]
fn what_can_light_a_point_can_be_chosen() {
    let mut draws = Draws::new(1);
    for (name, mut emitters, most_dead) in [("mixed", mixed(3000, 2), 0.4), ("ceiling", ceiling(50), 0.05)] {
        let tree = LightTree::build(&mut emitters);
        let (mut n_lit, mut dead, mut n_points) = (0, 0.0, 0);
        for k in 0..200 {
            // Points on lamps, in their planes and elsewhere.
            let on = &emitters[k * 7];
            let (position, normal) = match k % 4 {
                0 => (on.corners[1] + on.normal * 1e-4, on.normal),
                1 => (2.0 * on.corners[2] - on.corners[0], draws.direction()),
                _ => (draws.unit() * 1.4 - 0.2, draws.direction()),
            };
            let chosen = probabilities(&tree, &emitters, position, normal);
            for (e, p) in emitters.iter().zip(&chosen) {
                assert!(*p > 0.0 || !e.can_light(position, normal), "{name} {k}: {e:?} at {position} {normal}");
                n_lit += u32::from(*p > 0.0);
            }
            let sum = chosen.iter().sum::<f64>();
            assert!(sum <= 1.0 + 1e-9, "{name} {k}: {sum}");
            if sum > 0.0 {
                (dead, n_points) = (dead + 1.0 - sum, n_points + 1);
            }
        }
        let dead = dead / f64::from(n_points);
        println!("{name}: {n_points} points see {n_lit} lamps, {dead:.4} of their draws find none");
        assert!(n_lit > 10_000 && dead < most_dead, "{name}: {n_lit} {dead}");
    }
}

/// Draws follow those probabilities, and what is drawn over them is the exact sum on average.
#[test]
fn draws_are_unbiased() {
    let mut emitters = mixed(500, 3);
    let tree = LightTree::build(&mut emitters);
    let of = emitters.clone();
    let all = Emitters { all: emitters, tree: Some(tree) };
    let (tree, mut guides) = (all.tree.as_ref().unwrap(), Guides::default());
    let (position, normal) = (Vec3::new(0.4, 0.3, 0.6), Vec3::new(0.3, 0.9, 0.2).normalize());
    let point = OrientedPoint::new(position, normal, RegionId(0));
    let chosen = probabilities(tree, &of, position, normal);
    let n = 1 << 20;
    let (mut counts, mut sum, mut again) = (vec![0u32; of.len()], 0.0, 0.0);
    let mut chooser = all.at(&point, 1, &mut guides);
    for k in 0..n {
        // One draw in each of n equal parts: counts are within a few of their means.
        let u = (f64::from(k) + unit_f64(hplt_sampling::random::hash(7, Stage::Probe, k, 0, 0), 0)) / f64::from(n);
        let Some(choice) = chooser.choose(u) else { continue };
        let i = (choice.emitter as *const Emitter as usize - all.all.as_ptr() as usize) / size_of::<Emitter>();
        counts[i] += 1;
        assert!((f64::from(choice.probability) / chosen[i] - 1.0).abs() < 1e-5);
        let exitance = f64::from(choice.emitter.power / choice.emitter.area);
        sum += f64::from(choice.emitter.form_factor(position, normal)) * exitance / f64::from(choice.probability);
        again += f64::from(choice.again);
    }
    for (count, p) in counts.iter().zip(&chosen) {
        assert!((f64::from(*count) - p * f64::from(n)).abs() <= 4.0, "{count} {}", p * f64::from(n));
    }
    let exact: f64 = of.iter().map(|e| f64::from(e.form_factor(position, normal) * (e.power / e.area))).sum();
    assert!((sum / f64::from(n) / exact - 1.0).abs() < 2e-3, "{} {exact}", sum / f64::from(n));
    let again = again / f64::from(counts.iter().sum::<u32>());
    assert!((again - 0.5).abs() < 1e-2, "{again}");
}

/// Lamps spread out: far less variance than a choice by power. Least is won where powers and orientations are random.
#[test]
fn points_choose_what_is_near() {
    let mut draws = Draws::new(4);
    let street: Vec<Emitter> = ceiling(100).into_iter().map(|e| moved(e, Vec3::NEG_Y * 0.97)).collect();
    let cases =
        [("street", street, 0.03, 0.05), ("ceiling", ceiling(100), 0.95, 0.2), ("mixed", mixed(10_000, 6), 1.0, 0.8)];
    for (name, mut emitters, height, limit) in cases {
        let tree = LightTree::build(&mut emitters);
        let power = by_power(&emitters);
        let (mut by_tree, mut plain) = (0.0, 0.0);
        for _ in 0..100 {
            let position = draws.unit() * Vec3::new(1.0, height, 1.0);
            let normal = if name == "street" { Vec3::Y } else { draws.direction() };
            let chosen = probabilities(&tree, &emitters, position, normal);
            let Some(v) = variance(&emitters, &chosen, position, normal) else { continue };
            by_tree += v.ln_1p();
            plain += variance(&emitters, &power, position, normal).unwrap().ln_1p();
        }
        let variances = [by_tree, plain].map(|sum| (sum / 100.0).exp_m1());
        println!("{name}: relative variance {:.3} by the tree, {:.3} by power", variances[0], variances[1]);
        assert!(variances[0] < limit * variances[1], "{name}: {variances:?}");
    }
}

/// Any arrangement makes a tree: all in one place, powers over 24 orders of magnitude, distances that shrink without end.
#[test]
fn no_arrangement_breaks_the_tree() {
    let edges = [Vec3::X * 1e-3, Vec3::Z * 1e-3];
    let same: Vec<Emitter> = (0..50_000).map(|_| lamp(Vec3::splat(0.5), edges, 1.0)).collect();
    let range: Vec<Emitter> = (0..100).map(|i| lamp(Vec3::X * (i as f32), edges, 10f32.powi(i % 25 - 12))).collect();
    let shrinking: Vec<Emitter> = (0..120).map(|i| lamp(Vec3::X * 0.5f32.powi(i), edges, 1.0)).collect();
    for (name, mut emitters) in [("same", same), ("range", range), ("shrinking", shrinking)] {
        let n = emitters.len();
        let tree = LightTree::build(&mut emitters);
        let (position, normal) = (Vec3::new(0.2, -0.3, 0.1), Vec3::Y);
        let chosen = probabilities(&tree, &emitters, position, normal);
        assert!(chosen.iter().all(|p| *p > 0.0 && p.is_finite()), "{name}");
        assert!((chosen.iter().sum::<f64>() - 1.0).abs() < 1e-6, "{name}");
        assert!(size_of_val(&tree.nodes[..]) <= 2 * 52 * n, "{name}");
    }
}

#[test]
fn the_same_tree_at_any_thread_count() {
    let build = |n_threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| {
            let mut emitters = mixed(3 * PARALLEL, 8);
            let tree = LightTree::build(&mut emitters);
            (format!("{:?}", tree.nodes), emitters.iter().map(|e| e.power.to_bits()).collect::<Vec<_>>())
        })
    };
    let one = build(1);
    assert!(one == build(3));
}
