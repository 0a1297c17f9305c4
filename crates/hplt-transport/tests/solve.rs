//! Solvers of `f = d + G f` against direct elimination and closed forms.

use std::sync::atomic::{AtomicU64, Ordering};

use hplt_geom::glam::DVec3;
use hplt_geom::{NoProgress, Progress, Rgb};
use hplt_transport::{
    Error, Gain, LinearOperator, Method, SolveOptions, SolveReport, SolveStop, SparseRows, Unknowns, solve, solve_many,
};

const METHODS: [Method; 7] = [
    Method::Bounces,
    Method::GaussSeidel,
    Method::Southwell,
    Method::BiCgStab,
    Method::Gmres { restart: 20 },
    Method::CoarseGmres { restart: 20 },
    Method::Auto,
];
const KRYLOV: [Method; 3] = [Method::BiCgStab, Method::Gmres { restart: 20 }, Method::CoarseGmres { restart: 20 }];

/// A splitmix64 sequence of numbers in [0, 1).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() * n as f64) as usize
    }
}

/// Rows of `per_row` random entries within blocks of `block` unknowns, `albedo(i)` being the sum of row `i`.
fn random_rows(
    n: usize,
    block: usize,
    per_row: usize,
    random: &mut Random,
    albedo: impl Fn(usize) -> DVec3,
) -> SparseRows {
    let mut g = SparseRows::new(n);
    for i in 0..n {
        let first = i / block * block;
        let mut columns: Vec<u32> = (0..per_row).map(|_| (first + random.below(block)) as u32).collect();
        columns.sort_unstable();
        columns.dedup();
        let weights: Vec<f64> = columns.iter().map(|_| random.next() + 0.1).collect();
        let total: f64 = weights.iter().sum();
        let entry = |(&j, &w): (&u32, &f64)| (j, (albedo(i) * (w / total)).as_vec3());
        g.push_row(&columns.iter().zip(&weights).map(entry).collect::<Vec<_>>());
    }
    g
}

fn random_light(n: usize, random: &mut Random) -> Vec<Rgb> {
    // Few unknowns are lit, and not alike: a lamp, not a glow.
    (0..n)
        .map(|i| if i % 7 == 0 { Rgb::new(random.next() as f32, 1.0, 0.1 + random.next() as f32) } else { Rgb::ZERO })
        .collect()
}

/// One channel of `f = d + G f` by Gaussian elimination with row exchanges.
fn eliminate(g: &SparseRows, d: &[Rgb], channel: usize) -> Vec<f64> {
    let n = d.len();
    let mut a = vec![vec![0.0f64; n + 1]; n];
    for i in 0..n {
        a[i][i] = 1.0;
        g.row(i).for_each(|(j, w)| a[i][j as usize] -= w[channel]);
        a[i][n] = f64::from(d[i][channel]);
    }
    for k in 0..n {
        let pivot = (k..n).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs())).unwrap();
        a.swap(k, pivot);
        let (above, below) = a.split_at_mut(k + 1);
        for row in below {
            let factor = row[k] / above[k][k];
            (k..=n).for_each(|j| row[j] -= factor * above[k][j]);
        }
    }
    let mut x = vec![0.0; n];
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|j| a[i][j] * x[j]).sum();
        x[i] = (a[i][n] - known) / a[i][i];
    }
    x
}

/// The largest error relative to the mean, of the worst component and channel; and whether it is within the bounds told.
fn error(x: &[Rgb], truth: &[DVec3], components: &[u32], report: &SolveReport) -> (f64, bool) {
    let (mut worst, mut is_bounded) = (0.0f64, true);
    for (c, told) in report.components.iter().enumerate() {
        let of: Vec<usize> = (0..x.len()).filter(|&i| components[i] as usize == c).collect();
        for k in 0..3 {
            let mean = of.iter().map(|&i| truth[i][k]).sum::<f64>() / of.len() as f64;
            let largest = of.iter().map(|&i| (f64::from(x[i][k]) - truth[i][k]).abs()).fold(0.0, f64::max);
            if mean > 0.0 {
                worst = worst.max(largest / mean);
                is_bounded &= largest / mean <= f64::from(told.bound[k]) * (1.0 + 1e-6);
            } else {
                is_bounded &= largest == 0.0;
            }
        }
    }
    (worst, is_bounded && worst <= f64::from(report.bound) * (1.0 + 1e-6))
}

fn options(method: Method, tolerance: f32) -> SolveOptions {
    SolveOptions { method, tolerance, max_sweeps: 200_000 }
}

fn one_room(n: usize) -> (Vec<u32>, Vec<f32>) {
    (vec![0; n], vec![1.0; n])
}

fn run(g: &SparseRows, d: &[Rgb], method: Method, tolerance: f32) -> (Vec<Rgb>, SolveReport) {
    let (components, areas) = one_room(d.len());
    let unknowns = Unknowns { components: &components, n_components: 1, areas: &areas };
    solve(g, d, &unknowns, &options(method, tolerance), &NoProgress).unwrap()
}

fn truth(g: &SparseRows, d: &[Rgb]) -> Vec<DVec3> {
    let channels = [0, 1, 2].map(|k| eliminate(g, d, k));
    (0..d.len()).map(|i| DVec3::new(channels[0][i], channels[1][i], channels[2][i])).collect()
}

#[test]
fn every_method_finds_what_elimination_finds() {
    for seed in 0..4 {
        let mut random = Random(seed);
        let (n, top) = (40 + 30 * seed as usize, [0.5, 0.9, 0.99, 0.999][seed as usize]);
        let colours: Vec<DVec3> =
            (0..n).map(|_| top * DVec3::new(random.next(), 0.5 + 0.5 * random.next(), 1.0)).collect();
        let g = random_rows(n, n, 12, &mut random, |i| colours[i]);
        let d = random_light(n, &mut random);
        let truth = truth(&g, &d);
        for method in METHODS {
            for tolerance in [1e-2, 1e-4, 1e-6] {
                let (x, report) = run(&g, &d, method, tolerance);
                let (error, is_bounded) = error(&x, &truth, &vec![0; n], &report);
                assert!(is_bounded, "{method:?} {tolerance}: error {error:e}, {report:?}");
                assert_eq!(report.stop, SolveStop::Converged, "{method:?} {tolerance}: {report:?}");
                assert!(error <= f64::from(tolerance), "{method:?} {tolerance}: {error:e}");
                assert_eq!(report.fell_back_after, None, "{method:?} {tolerance}");
                assert_eq!(report.residual_history.len(), report.sweeps, "{method:?} {tolerance}");
            }
        }
    }
}

#[test]
fn a_wrong_solution_is_outside_its_bound() {
    let mut random = Random(5);
    let g = random_rows(60, 60, 12, &mut random, |_| DVec3::splat(0.9));
    let d = random_light(60, &mut random);
    let (mut x, report) = run(&g, &d, Method::BiCgStab, 1e-4);
    let truth = truth(&g, &d);
    assert!(error(&x, &truth, &[0; 60], &report).1);
    x[17].y += 3e-4 * report.components[0].mean.y;
    assert!(!error(&x, &truth, &[0; 60], &report).1);
}

#[test]
fn furnaces_reach_their_closed_form() {
    for albedo in [0.5, 0.9, 0.99, 0.999, 0.9999] {
        let mut random = Random(7);
        let n = 200;
        let g = random_rows(n, n, 30, &mut random, |_| DVec3::splat(albedo));
        let d = vec![Rgb::ONE; n];
        for method in METHODS {
            let (x, report) = run(&g, &d, method, 1e-3);
            let exact = 1.0 / (1.0 - albedo);
            // The rows are rounded to f32, which moves the closed form by 6e-8/(1 - albedo); the bound knows the stored rows.
            let error = x.iter().map(|x| (x.as_dvec3() / exact - 1.0).abs().max_element()).fold(0.0, f64::max);
            println!(
                "furnace {albedo:<6} {method:?}: {:>6} sweeps, error {error:.1e}, bound {:.1e}",
                report.sweeps, report.bound
            );
            assert_eq!(report.stop, SolveStop::Converged, "{albedo} {method:?} {report:?}");
            assert!(error <= f64::from(report.bound) + 1e-7 / (1.0 - albedo), "{albedo} {method:?}: {error:e}");
        }
    }
}

/// A lamp in a closed furnace: the spectrum is that of the links, and the light is not uniform.
#[test]
fn lit_furnaces_need_few_krylov_sweeps() {
    for (albedo, n_sweeps) in [(0.5, 12), (0.9, 12), (0.99, 12), (0.999, 15), (0.9999, 15)] {
        let mut random = Random(9);
        let n = 300;
        let g = random_rows(n, n, 40, &mut random, |_| DVec3::splat(albedo));
        let d = random_light(n, &mut random);
        let truth = truth(&g, &d);
        for method in METHODS {
            let (x, report) = run(&g, &d, method, 1e-3);
            let (error, is_bounded) = error(&x, &truth, &vec![0; n], &report);
            println!(
                "lamp    {albedo:<6} {method:?}: {:>6} sweeps, error {error:.1e}, bound {:.1e}",
                report.sweeps, report.bound
            );
            assert!(is_bounded && report.is_converged(), "{albedo} {method:?}: {error:e} {:?}", report.bound);
            if KRYLOV.contains(&method) {
                assert!(report.sweeps <= n_sweeps, "{albedo} {method:?}: {} sweeps", report.sweeps);
            }
        }
    }
}

#[test]
fn bounces_are_the_partial_sums_of_the_neumann_series() {
    let mut random = Random(3);
    let g = random_rows(50, 50, 10, &mut random, |_| DVec3::splat(0.7));
    for k in 1..6 {
        let (components, areas) = one_room(50);
        let unknowns = Unknowns { components: &components, n_components: 1, areas: &areas };
        let options = SolveOptions { method: Method::Bounces, tolerance: 0.0, max_sweeps: k };
        let (x, report) = solve(&g, &[Rgb::ONE; 50], &unknowns, &options, &NoProgress).unwrap();
        let exact = (1.0 - 0.7f32.powi(k as i32 + 1)) / 0.3;
        assert!(x.iter().all(|x| (*x / exact - 1.0).abs().max_element() < 1e-6), "{k} bounces");
        assert_eq!((report.sweeps, report.stop), (k, SolveStop::MaxSweeps));
        assert!(report.bound >= 0.999 * 0.7f32.powi(k as i32 + 1), "{k} bounces: bound {}", report.bound);
    }
}

#[test]
fn rooms_of_any_brightness_are_equally_exact() {
    let (n, block) = (90, 45);
    let mut random = Random(11);
    let g = random_rows(n, block, 10, &mut random, |_| DVec3::new(0.3, 0.9, 0.99));
    let mut d = random_light(n, &mut random);
    for (i, d) in d.iter_mut().enumerate() {
        *d *= if i < block { 1e12 } else { 1e-12 };
    }
    let components: Vec<u32> = (0..n).map(|i| (i / block) as u32).collect();
    let unknowns = Unknowns { components: &components, n_components: 2, areas: &vec![1.0; n] };
    let truth = truth(&g, &d);
    for method in METHODS {
        let (x, report) = solve(&g, &d, &unknowns, &options(method, 1e-5), &NoProgress).unwrap();
        let (error, is_bounded) = error(&x, &truth, &components, &report);
        assert!(is_bounded && report.is_converged() && error <= 1e-5, "{method:?}: {error:e} {report:?}");
    }
}

#[test]
fn of_a_thousand_rooms_the_lit_one_alone_is_bright() {
    let n = 4000;
    let g = random_rows(n, 4, 4, &mut Random(13), |_| DVec3::splat(0.9));
    let mut d = vec![Rgb::ZERO; n];
    d[2001] = Rgb::new(1.0, 0.5, 0.0);
    let components: Vec<u32> = (0..n).map(|i| (i / 4) as u32).collect();
    let unknowns = Unknowns { components: &components, n_components: 1000, areas: &vec![1.0; n] };
    for method in METHODS {
        let (x, report) = solve(&g, &d, &unknowns, &options(method, 1e-4), &NoProgress).unwrap();
        assert!(report.is_converged(), "{method:?}");
        for (i, x) in x.iter().enumerate() {
            assert_eq!(*x != Rgb::ZERO, (2000..2004).contains(&i), "{method:?} {i}: {x}");
            assert_eq!(x.z, 0.0);
        }
    }
}

#[test]
fn dead_channels_stay_exactly_black() {
    let mut random = Random(17);
    let g = random_rows(50, 50, 10, &mut random, |_| DVec3::new(0.9, 0.0, 1.0));
    let d = vec![Rgb::X; 50];
    for method in METHODS {
        let (x, report) = run(&g, &d, method, 1e-5);
        assert!(report.is_converged(), "{method:?} {report:?}");
        assert!(x.iter().all(|x| (x.x - 10.0).abs() < 1e-4 && x.y == 0.0 && x.z == 0.0), "{method:?}");
        assert_eq!(report.components[0].bound.y, 0.0);
    }
}

#[test]
fn darkness_takes_no_sweep() {
    let g = random_rows(50, 50, 10, &mut Random(19), |_| DVec3::ONE);
    for method in METHODS {
        let (x, report) = run(&g, &[Rgb::ZERO; 50], method, 1e-5);
        assert_eq!((report.stop, report.sweeps, report.bound), (SolveStop::NoLight, 0, 0.0));
        assert!(x.iter().all(|x| *x == Rgb::ZERO));
    }
}

/// Unknowns without area are fine functions: where they alone are lit, the error is relative to the mean over all.
#[test]
fn light_on_unknowns_that_no_mean_counts_is_solved_too() {
    let mut g = SparseRows::new(4);
    // Two coarse unknowns that see nothing, two fine ones that see each other.
    for row in [&[][..], &[], &[(3, Rgb::splat(0.5))], &[(2, Rgb::splat(0.5))]] {
        g.push_row(row);
    }
    let unknowns = Unknowns { components: &[0; 4], n_components: 1, areas: &[1.0, 1.0, 0.0, 0.0] };
    let d = [Rgb::ZERO, Rgb::ZERO, Rgb::ONE, Rgb::ZERO];
    for method in METHODS {
        let (x, report) = solve(&g, &d, &unknowns, &options(method, 1e-4), &NoProgress).unwrap();
        assert!(report.is_converged() && report.bound <= 1e-4, "{method:?}: {report:?}");
        for (x, exact) in x.iter().zip([0.0, 0.0, 4.0 / 3.0, 2.0 / 3.0]) {
            assert!((x.y - exact).abs() <= 1e-4, "{method:?}: {x} for {exact}");
        }
    }
}

#[test]
fn a_white_closed_room_with_light_is_refused() {
    let g = random_rows(80, 40, 10, &mut Random(23), |i| DVec3::new(0.5, 0.5, if i < 40 { 0.5 } else { 1.0 }));
    let components: Vec<u32> = (0..80).map(|i| (i / 40) as u32).collect();
    let unknowns = Unknowns { components: &components, n_components: 2, areas: &[1.0; 80] };
    for method in METHODS {
        let refused = solve(&g, &[Rgb::ONE; 80], &unknowns, &options(method, 1e-3), &NoProgress);
        assert_eq!(refused.unwrap_err(), Error::NoFiniteSolution { region: 1 });
        // Without light in the channel that never dies, there is a solution.
        let red = solve(&g, &[Rgb::X; 80], &unknowns, &options(method, 1e-3), &NoProgress);
        assert!(red.unwrap().1.is_converged());
    }
}

#[test]
fn white_surfaces_beside_an_opening_are_legal_and_bounded() {
    let mut random = Random(29);
    let n = 60;
    // Two rows in three return all their light; the others lose a tenth.
    let g = random_rows(n, n, 12, &mut random, |i| DVec3::splat(if i % 3 == 0 { 0.9 } else { 1.0 }));
    let d = random_light(n, &mut random);
    let truth = truth(&g, &d);
    for method in METHODS {
        let (x, report) = run(&g, &d, method, 1e-3);
        let (error, is_bounded) = error(&x, &truth, &vec![0; n], &report);
        assert!(is_bounded && report.is_converged() && error <= 1e-3, "{method:?}: {error:e} {report:?}");
    }
}

#[test]
fn the_gain_is_tight_where_few_rows_are_nearly_white() {
    let n = 200;
    let g = random_rows(n, n, 20, &mut Random(31), |i| DVec3::splat(if i == 5 { 0.9999 } else { 0.5 }));
    let (components, areas) = one_room(n);
    let unknowns = Unknowns { components: &components, n_components: 1, areas: &areas };
    let gain = Gain::build(&g, &unknowns, &NoProgress).unwrap();
    let exact = truth(&g, &vec![Rgb::ONE; n]).iter().map(|z| z.x).fold(0.0, f64::max);
    let told = f64::from(gain.norm(0).x);
    assert!(told >= exact && told <= 1.7 * exact, "{told} against {exact}");
    assert!(gain.sweeps() <= 6, "{}", gain.sweeps());
}

#[test]
fn albedos_of_almost_one_are_within_what_is_told_or_refused() {
    for albedo in [1.0 - 1e-4, 1.0 - 1e-5, 1.0 - 2e-6, 1.0 - 1e-6, 1.0 - 1e-7] {
        let mut random = Random(37);
        let n = 80;
        let g = random_rows(n, n, 16, &mut random, |_| DVec3::splat(albedo));
        let d = random_light(n, &mut random);
        let (components, areas) = one_room(n);
        let unknowns = Unknowns { components: &components, n_components: 1, areas: &areas };
        for method in KRYLOV {
            match solve(&g, &d, &unknowns, &options(method, 1e-4), &NoProgress) {
                Ok((x, report)) => {
                    let (error, is_bounded) = error(&x, &truth(&g, &d), &vec![0; n], &report);
                    assert!(is_bounded, "{albedo} {method:?}: {error:e}, told {:e}", report.bound);
                }
                Err(refused) => {
                    assert!(albedo > 1.0 - 2e-6, "{albedo}");
                    assert_eq!(refused, Error::NoFiniteSolution { region: 0 });
                }
            }
        }
    }
}

#[test]
fn several_lights_add_up_to_one() {
    let mut random = Random(41);
    let g = random_rows(100, 100, 12, &mut random, |_| DVec3::new(0.8, 0.5, 0.9));
    let groups = [random_light(100, &mut random), vec![Rgb::new(0.1, 0.0, 0.3); 100]];
    let sum: Vec<Rgb> = groups[0].iter().zip(&groups[1]).map(|(a, b)| *a + *b).collect();
    let (components, areas) = one_room(100);
    let unknowns = Unknowns { components: &components, n_components: 1, areas: &areas };
    let all = [&groups[0][..], &groups[1][..], &sum[..]];
    let solved = solve_many(&g, &all, &unknowns, &options(Method::BiCgStab, 1e-6), &NoProgress).unwrap();
    for i in 0..100 {
        let parts = solved[0].0[i] + solved[1].0[i];
        assert!((parts / solved[2].0[i] - 1.0).abs().max_element() < 1e-5, "{i}");
    }
}

#[test]
fn the_tolerance_that_f32_cannot_hold_ends_in_rounding() {
    let mut random = Random(43);
    let g = random_rows(60, 60, 12, &mut random, |_| DVec3::splat(0.9));
    let d = random_light(60, &mut random);
    for method in METHODS {
        let (x, report) = run(&g, &d, method, 0.0);
        assert_eq!(report.stop, SolveStop::Rounding, "{method:?} {report:?}");
        assert!(report.sweeps < 300, "{method:?}: {} sweeps", report.sweeps);
        assert!(report.bound < 1e-6 && error(&x, &truth(&g, &d), &[0; 60], &report).1, "{method:?}");
    }
}

#[test]
fn a_method_that_stands_still_hands_over_and_says_so() {
    let n = 100;
    let mut g = SparseRows::new(n);
    // Light goes round in a circle: restarted Krylov spaces are far too small for it.
    for i in 0..n {
        g.push_row(&[(((i + n - 1) % n) as u32, Rgb::splat(0.999))]);
    }
    let mut d = vec![Rgb::ZERO; n];
    d[0] = Rgb::ONE;
    let (x, report) = run(&g, &d, Method::Gmres { restart: 3 }, 1e-3);
    let (error, is_bounded) = error(&x, &truth(&g, &d), &vec![0; n], &report);
    assert!(report.fell_back_after.is_some_and(|n| n > 0 && n < report.sweeps), "{report:?}");
    assert!(report.is_converged() && is_bounded && error <= 1e-3, "{error:e} {report:?}");
}

/// Rooms in a row: every row has 24 links in its room and, most of them, one through a door.
fn rooms_in_a_row(n_rooms: usize, per_room: usize, albedo: f64) -> SparseRows {
    let (mut random, n) = (Random(71), n_rooms * per_room);
    let mut g = SparseRows::new(n);
    for i in 0..n {
        let room = i / per_room;
        let next = if random.next() < 0.5 { room.saturating_sub(1) } else { (room + 1).min(n_rooms - 1) };
        let mut row: Vec<(u32, f64)> =
            (0..24).map(|_| ((room * per_room + random.below(per_room)) as u32, 1.0)).collect();
        row.push(((next * per_room + random.below(per_room)) as u32, 0.2));
        row.sort_unstable_by_key(|(j, _)| *j);
        row.dedup_by_key(|(j, _)| *j);
        let total: f64 = row.iter().map(|(_, w)| w).sum();
        let colour = Rgb::new(1.0, 0.99, 0.5) * albedo as f32;
        g.push_row(&row.iter().map(|&(j, w)| (j, colour * (w / total) as f32)).collect::<Vec<_>>());
    }
    g
}

#[test]
fn a_coarse_level_halves_the_sweeps_in_white_rooms_and_is_chosen_there_alone() {
    let g = rooms_in_a_row(8, 40, 0.998);
    let n = g.n_rows();
    let d: Vec<Rgb> = (0..n).map(|i| if i < 4 { Rgb::ONE } else { Rgb::ZERO }).collect();
    let truth = truth(&g, &d);
    let solved = [Method::Gmres { restart: 20 }, Method::CoarseGmres { restart: 20 }, Method::Auto].map(|method| {
        let (x, report) = run(&g, &d, method, 1e-4);
        let (error, is_bounded) = error(&x, &truth, &vec![0; n], &report);
        assert!(report.is_converged() && is_bounded && error <= 1e-4, "{method:?}: {error:e} {report:?}");
        (report.sweeps, report.method)
    });
    let [(plain, _), (coarse, method), auto] = solved;
    assert!(2 * coarse <= plain && coarse <= 20, "{coarse} of {plain}");
    assert_eq!(auto, (coarse, method));
    let dull = rooms_in_a_row(8, 40, 0.8);
    assert_eq!(run(&dull, &d, Method::Auto, 1e-4).1.method, Method::Gmres { restart: 20 });
}

#[test]
fn running_out_of_sweeps_leaves_a_bound_that_holds() {
    let mut random = Random(67);
    let n = 80;
    let g = random_rows(n, n, 8, &mut random, |_| DVec3::splat(0.99));
    let d = random_light(n, &mut random);
    let truth = truth(&g, &d);
    let (components, areas) = one_room(n);
    let unknowns = Unknowns { components: &components, n_components: 1, areas: &areas };
    for method in METHODS {
        for max_sweeps in 1..12 {
            let options = SolveOptions { method, tolerance: 1e-6, max_sweeps };
            let (x, report) = solve(&g, &d, &unknowns, &options, &NoProgress).unwrap();
            assert_eq!((report.stop, report.sweeps), (SolveStop::MaxSweeps, max_sweeps), "{method:?}");
            let (error, is_bounded) = error(&x, &truth, &components, &report);
            assert!(is_bounded, "{method:?} after {max_sweeps}: {error:e}, told {:e}", report.bound);
        }
    }
}

/// Cancels after a number of sweeps.
struct Patience(u64, AtomicU64);

impl Progress for Patience {
    fn advance(&self, _stage: &'static str, done: u64, _total: u64) {
        self.1.store(done, Ordering::Relaxed);
    }

    fn is_cancelled(&self) -> bool {
        self.1.load(Ordering::Relaxed) >= self.0
    }
}

#[test]
fn an_interrupted_solve_keeps_what_it_has() {
    let mut random = Random(71);
    let g = random_rows(50, 50, 8, &mut random, |_| DVec3::splat(0.99));
    let d = random_light(50, &mut random);
    let (components, areas) = one_room(50);
    let unknowns = Unknowns { components: &components, n_components: 1, areas: &areas };
    for method in METHODS {
        let progress = Patience(5, AtomicU64::new(0));
        let (x, report) = solve(&g, &d, &unknowns, &options(method, 1e-6), &progress).unwrap();
        assert_eq!(report.stop, SolveStop::Interrupted, "{method:?}");
        assert!((5..=6).contains(&report.sweeps), "{method:?}: {}", report.sweeps);
        assert!(error(&x, &truth(&g, &d), &components, &report).1, "{method:?}");
    }
}

#[test]
fn the_same_bits_at_any_thread_count() {
    let mut random = Random(47);
    let g = random_rows(3000, 1000, 40, &mut random, |i| DVec3::splat(if i % 2 == 0 { 0.95 } else { 0.6 }));
    let d = random_light(3000, &mut random);
    let components: Vec<u32> = (0..3000).map(|i| i / 1000).collect();
    let unknowns = Unknowns { components: &components, n_components: 3, areas: &vec![1.0; 3000] };
    for method in METHODS {
        let solve = |n_threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
            pool.install(|| solve(&g, &d, &unknowns, &options(method, 1e-4), &NoProgress).unwrap())
        };
        let one = solve(1);
        for n_threads in [2, 3, 8] {
            assert_eq!(solve(n_threads), one, "{method:?} on {n_threads} threads");
        }
    }
}

#[test]
fn an_operator_without_rows_is_solved_too() {
    struct Opaque(SparseRows);
    impl LinearOperator for Opaque {
        fn len(&self) -> usize {
            self.0.len()
        }
        fn apply(&self, x: &[DVec3], out: &mut [DVec3]) {
            self.0.apply(x, out);
        }
    }
    let mut random = Random(53);
    let g = random_rows(60, 60, 12, &mut random, |_| DVec3::splat(0.9));
    let d = random_light(60, &mut random);
    let truth = truth(&g, &d);
    let (components, areas) = one_room(60);
    let unknowns = Unknowns { components: &components, n_components: 1, areas: &areas };
    let opaque = Opaque(g);
    for method in METHODS {
        let (x, report) = solve(&opaque, &d, &unknowns, &options(method, 1e-4), &NoProgress).unwrap();
        assert!(report.is_converged() && error(&x, &truth, &components, &report).1, "{method:?}");
    }
}

#[test]
fn options_and_light_out_of_range_are_refused() {
    let g = random_rows(4, 4, 2, &mut Random(59), |_| DVec3::splat(0.5));
    let unknowns = Unknowns { components: &[0; 4], n_components: 1, areas: &[1.0; 4] };
    let with = |options: SolveOptions, d: [Rgb; 4]| solve(&g, &d, &unknowns, &options, &NoProgress).map(|_| ());
    for bad in [
        SolveOptions { tolerance: -1.0, ..SolveOptions::default() },
        SolveOptions { tolerance: f32::NAN, ..SolveOptions::default() },
        SolveOptions { max_sweeps: 0, ..SolveOptions::default() },
        SolveOptions { method: Method::Gmres { restart: 0 }, ..SolveOptions::default() },
        SolveOptions { method: Method::CoarseGmres { restart: 0 }, ..SolveOptions::default() },
    ] {
        assert!(matches!(with(bad.clone(), [Rgb::ONE; 4]), Err(Error::Option { .. })), "{bad:?}");
    }
    let d = [Rgb::ONE, Rgb::ONE, Rgb::NAN, Rgb::ONE];
    assert_eq!(with(SolveOptions::default(), d), Err(Error::NotFinite { bounce: 0, level: 0, function: 2 }));
}

#[test]
#[should_panic(expected = "does not pass between components")]
fn links_between_components_are_refused() {
    let g = random_rows(40, 40, 10, &mut Random(61), |_| DVec3::splat(0.5));
    let components: Vec<u32> = (0..40).map(|i| i / 20).collect();
    let unknowns = Unknowns { components: &components, n_components: 2, areas: &[1.0; 40] };
    let _ = solve(&g, &[Rgb::ONE; 40], &unknowns, &SolveOptions::default(), &NoProgress);
}
