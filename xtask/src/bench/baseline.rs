//! Is this binary slower or worse than an older one?
//!
//! Both run in turns on the same scenes and seeds, so that what the machine does otherwise hits both alike; every pair gives a ratio.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde::Serialize;

use super::answers::RunAnswer;
use super::cells::{figures, signed_percent, table};
use super::child::{Hplt, NOT_CONVERGED};
use super::engines::{ENGINES, Engine};
use super::evidence::{Interval, pseudo_median, ratio_of_means};
use super::lit::relative_errors;
use super::measure::{Bench, shown, strings};
use super::scenes::{Case, Source};
use super::stats::median;
use super::truth::Truth;

/// Changes up to this are none.
pub const THRESHOLD: f64 = 0.05;
/// Rays of the final gather.
const GATHER_RAYS: u32 = 256;

/// What became of a quantity of which less is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Verdict {
    /// More, beyond noise and threshold.
    Regression,
    /// Less, beyond noise.
    Improvement,
    /// At most the threshold more.
    NoRegression,
    /// The noise hides changes larger than the threshold.
    Undecided,
}

/// One quantity on one scene.
#[derive(Debug, Clone, Serialize)]
pub struct Finding {
    /// Name of the scene.
    pub scene: String,
    /// What was compared.
    pub quantity: &'static str,
    /// Median of the old binary; of an error its mean.
    pub old: f64,
    /// The same of the new one.
    pub new: f64,
    /// New over old, with its 99 % interval.
    pub ratio: Interval,
    /// What that means.
    pub verdict: Verdict,
}

/// One run of one binary.
#[derive(Debug, Clone, Default, PartialEq)]
struct Sample {
    wall_seconds: f64,
    processor_seconds: Option<f64>,
    peak_memory: Option<u64>,
    /// Relative error at every point.
    errors: Vec<f64>,
}

/// Which binary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Old,
    New,
}

/// Compares `bench`'s binary with `old` on all `cases`, in `n_pairs` pairs of runs each, and says so as Markdown and as findings.
///
/// # Errors
/// When a command fails.
pub fn findings(
    bench: &Bench<'_>,
    old: &Hplt,
    cases: &[(&Case, Source)],
    n_pairs: usize,
) -> Result<(String, Vec<Finding>)> {
    let mut all = Vec::new();
    for (case, source) in cases {
        let truth = bench.truth(case, source)?;
        for engine in ENGINES.iter().filter(|e| e.id == "production") {
            let mut run = |side, pair| {
                let hplt = if side == Side::Old { old } else { bench.hplt };
                sample(hplt, bench.folder, (case, source, engine), &truth, pair)
            };
            let pairs = interleaved(n_pairs, &mut run).with_context(|| format!("cannot compare on {}", case.title))?;
            all.extend(judged(&source.title, &pairs));
        }
    }
    Ok((markdown(&all, n_pairs), all))
}

/// Fails when anything got worse.
///
/// # Errors
/// With what did.
pub fn check(findings: &[Finding]) -> Result<()> {
    let worse: Vec<String> = findings
        .iter()
        .filter(|f| f.verdict == Verdict::Regression)
        .map(|f| format!("{} of {}: {}", f.quantity, f.scene, signed_percent(f.ratio.estimate - 1.0)))
        .collect();
    if worse.is_empty() { Ok(()) } else { bail!("worse than the baseline: {}", worse.join("; ")) }
}

/// Old, new, new, old, old, new ...: neither is always the first, and a machine that slows down slows both.
fn interleaved(n_pairs: usize, run: &mut dyn FnMut(Side, usize) -> Result<Sample>) -> Result<Vec<[Sample; 2]>> {
    let mut pairs = Vec::new();
    for pair in 0..n_pairs {
        let (old, new);
        if pair % 2 == 0 {
            old = run(Side::Old, pair)?;
            new = run(Side::New, pair)?;
        } else {
            new = run(Side::New, pair)?;
            old = run(Side::Old, pair)?;
        }
        pairs.push([old, new]);
    }
    Ok(pairs)
}

/// Lights a scene, reads the light at the points of the reference, and measures all that is compared. Every pair has a seed of its own.
fn sample(
    hplt: &Hplt,
    folder: &Path,
    (case, source, engine): (&Case, &Source, &Engine),
    truth: &Truth,
    pair: usize,
) -> Result<Sample> {
    let out = folder.join(format!("{}-baseline.csv", source.id));
    let mut command = strings(&["points", &source.argument, "--force", "--seed", &pair.to_string()]);
    command.extend(["--at".into(), shown(&truth.points), "--out".into(), shown(&out)]);
    command.extend(["--final-gather".into(), GATHER_RAYS.to_string()]);
    command.extend(engine.flags(case, true));
    let answer = hplt.ask(&command, Some(NOT_CONVERGED))?;
    if RunAnswer::parse(&answer.document)?.is_cut_short() {
        bail!("{}: cut short", source.title);
    }
    Ok(Sample {
        wall_seconds: answer.wall_seconds,
        processor_seconds: answer.usage.processor_seconds,
        peak_memory: answer.usage.peak_memory,
        errors: relative_errors(&out, &truth.table)?,
    })
}

fn judged(scene: &str, pairs: &[[Sample; 2]]) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut paired = |quantity, of: &dyn Fn(&Sample) -> Option<f64>| {
        let values: Vec<[f64; 2]> = pairs.iter().filter_map(|[old, new]| Some([of(old)?, of(new)?])).collect();
        if values.is_empty() || values.iter().flatten().any(|v| *v <= 0.0) {
            return;
        }
        let ratio = ratio_of_pairs(&values);
        let [old, new] = [0, 1].map(|side| median(&values.iter().map(|v| v[side]).collect::<Vec<_>>()));
        findings.push(Finding { scene: scene.into(), quantity, old, new, ratio, verdict: verdict(&ratio) });
    };
    paired("time to completion, s", &|s| Some(s.wall_seconds));
    paired("processor time, s", &|s| s.processor_seconds);
    paired("peak memory, MB", &|s| Some(s.peak_memory? as f64 / 1e6));
    let [old, new] = [0, 1].map(|side| mean_by_point(pairs.iter().map(|pair| pair[side].errors.as_slice())));
    let mean = |errors: &[f64]| 100.0 * errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    let ratio = ratio_of_means(&new, &old);
    let (old, new) = (mean(&old), mean(&new));
    findings.push(Finding {
        scene: scene.into(),
        quantity: "mean error, %",
        old,
        new,
        ratio,
        verdict: verdict(&ratio),
    });
    findings
}

/// The typical ratio of the second of each pair to the first.
fn ratio_of_pairs(pairs: &[[f64; 2]]) -> Interval {
    let logs: Vec<f64> = pairs.iter().map(|[old, new]| (new / old).ln()).collect();
    let Interval { estimate, low, high } = pseudo_median(&logs);
    Interval { estimate: estimate.exp(), low: low.exp(), high: high.exp() }
}

fn verdict(ratio: &Interval) -> Verdict {
    let limit = 1.0 + THRESHOLD;
    match ratio {
        r if r.low > 1.0 && r.estimate > limit => Verdict::Regression,
        r if r.high < 1.0 => Verdict::Improvement,
        r if r.high <= limit => Verdict::NoRegression,
        _ => Verdict::Undecided,
    }
}

/// Mean over all runs of the error at each point.
fn mean_by_point<'s>(runs: impl Iterator<Item = &'s [f64]>) -> Vec<f64> {
    let runs: Vec<&[f64]> = runs.collect();
    let n_points = runs.iter().map(|r| r.len()).min().unwrap_or(0);
    (0..n_points).map(|i| runs.iter().map(|r| r[i]).sum::<f64>() / runs.len() as f64).collect()
}

fn markdown(findings: &[Finding], n_pairs: usize) -> String {
    let row = |f: &Finding| {
        let change = |x: f64| if x.is_finite() { signed_percent(x - 1.0) } else { "unknown".into() };
        vec![
            f.scene.clone(),
            f.quantity.into(),
            figures(f.old),
            figures(f.new),
            format!("{} ({} to {})", change(f.ratio.estimate), change(f.ratio.low), change(f.ratio.high)),
            match f.verdict {
                Verdict::Regression => "**regression**",
                Verdict::Improvement => "improvement",
                Verdict::NoRegression => "no regression",
                Verdict::Undecided => "undecided",
            }
            .into(),
        ]
    };
    let head = ["scene", "quantity", "baseline", "now", "change (99 % interval)", "verdict"];
    let mut out = String::from("# Beside the baseline\n\n");
    out.push_str(&table(&head, &findings.iter().map(row).collect::<Vec<_>>()));
    let _ = write!(
        out,
        "\n{n_pairs} pairs of runs in turns, each pair with a seed of its own; links with the quick settings and a final gather of {GATHER_RAYS} rays. \
         Times and memory: Hodges and Lehmann's estimate and exact interval of the ratio. Error: bootstrap over points of the mean of all seeds. A \
         regression is more than {:.0} % and beyond noise; undecided where noise hides that much.\n",
        100.0 * THRESHOLD
    );
    out
}

#[cfg(test)]
mod tests {
    use super::super::evidence::tests::noise;
    use super::*;

    /// Verdicts on synthetic times: true ratio, noise of each run, a machine that slows down by half, now and then a run that takes
    /// twice as long.
    fn verdicts(ratio: f64, deviation: f64, with_wild_runs: bool) -> Vec<Verdict> {
        (0..400)
            .map(|trial| {
                let random = noise(1000 + trial, 64);
                let mut n_runs = 0;
                let mut run = |side, _| {
                    let r = [random[2 * n_runs], random[2 * n_runs + 1]];
                    let drift = 1.0 + 0.5 * n_runs as f64 / 16.0;
                    n_runs += 1;
                    let wild = if with_wild_runs && r[1] > 1.7 { 2.0 } else { 1.0 };
                    let own = if side == Side::New { ratio } else { 1.0 };
                    let wall_seconds = 10.0 * own * drift * wild * (deviation * r[0]).exp();
                    Ok(Sample { wall_seconds, ..Sample::default() })
                };
                let pairs = interleaved(8, &mut run).unwrap();
                judged("x", &pairs)[0].verdict
            })
            .collect()
    }

    fn share(verdicts: &[Verdict], of: Verdict) -> f64 {
        verdicts.iter().filter(|v| **v == of).count() as f64 / verdicts.len() as f64
    }

    #[test]
    fn real_regressions_are_found() {
        for (ratio, deviation) in [(1.10, 0.01), (1.15, 0.02), (1.4, 0.08)] {
            let found = share(&verdicts(ratio, deviation, false), Verdict::Regression);
            assert!(found > 0.95, "{ratio} at {deviation}: {found}");
        }
    }

    #[test]
    fn noise_drift_and_wild_runs_alone_are_no_regression() {
        for (deviation, with_wild_runs) in [(0.005, false), (0.03, false), (0.1, false), (0.03, true), (0.1, true)] {
            let found = share(&verdicts(1.0, deviation, with_wild_runs), Verdict::Regression);
            assert!(found <= 0.02, "{deviation} {with_wild_runs}: {found}");
        }
    }

    #[test]
    fn changes_below_the_threshold_are_none_and_noise_is_not_taken_for_proof() {
        assert_eq!(share(&verdicts(1.03, 0.005, false), Verdict::Regression), 0.0);
        assert!(share(&verdicts(1.0, 0.005, false), Verdict::NoRegression) > 0.9);
        let hidden = verdicts(1.2, 0.3, false);
        assert!(share(&hidden, Verdict::NoRegression) < 0.05 && share(&hidden, Verdict::Undecided) > 0.5, "{hidden:?}");
        assert!(share(&verdicts(0.8, 0.02, false), Verdict::Improvement) > 0.95);
    }

    #[test]
    fn too_few_pairs_prove_nothing() {
        let pairs: Vec<[f64; 2]> = (0..7).map(|_| [1.0, 2.0]).collect();
        assert_eq!(verdict(&ratio_of_pairs(&pairs)), Verdict::Undecided);
        assert_eq!(verdict(&ratio_of_pairs(&[pairs, vec![[1.0, 2.0]]].concat())), Verdict::Regression);
    }

    fn with_errors(errors: &[f64]) -> Sample {
        Sample { wall_seconds: 1.0, errors: errors.to_vec(), ..Sample::default() }
    }

    #[test]
    fn a_worse_field_is_a_regression_and_another_sample_of_the_same_is_none() {
        let errors = |seed, scale: f64| -> Vec<f64> { noise(seed, 200).iter().map(|e| scale * e.abs()).collect() };
        let pairs = |scale: f64| -> Vec<[Sample; 2]> {
            (0..8).map(|i| [with_errors(&errors(i, 0.01)), with_errors(&errors(100 + i, scale))]).collect()
        };
        let of =
            |pairs: &[[Sample; 2]]| judged("x", pairs).into_iter().find(|f| f.quantity == "mean error, %").unwrap();
        assert_eq!(of(&pairs(0.012)).verdict, Verdict::Regression);
        assert_ne!(of(&pairs(0.01)).verdict, Verdict::Regression);
        let same: Vec<[Sample; 2]> =
            (0..8).map(|i| [with_errors(&errors(i, 0.01)), with_errors(&errors(i, 0.01))]).collect();
        assert_eq!((of(&same).verdict, of(&same).ratio.estimate), (Verdict::NoRegression, 1.0));
    }

    #[test]
    fn a_regression_is_an_error_that_names_it() {
        let finding = |verdict| Finding {
            scene: "Cornell".into(),
            quantity: "processor time, s",
            old: 1.0,
            new: 1.2,
            ratio: Interval { estimate: 1.2, low: 1.1, high: 1.3 },
            verdict,
        };
        let error = check(&[finding(Verdict::NoRegression), finding(Verdict::Regression)]).unwrap_err().to_string();
        assert!(error.contains("processor time, s of Cornell: +20.00 %"), "{error}");
        assert!(check(&[finding(Verdict::Undecided), finding(Verdict::Improvement)]).is_ok());
        assert!(markdown(&[finding(Verdict::Regression)], 8).contains("+20.00 % (+10.00 % to +30.00 %)"));
    }

    #[test]
    fn neither_binary_is_always_the_first() {
        let mut order = Vec::new();
        interleaved(3, &mut |side, _| {
            order.push(side);
            Ok(Sample::default())
        })
        .unwrap();
        assert_eq!(order, [Side::Old, Side::New, Side::New, Side::Old, Side::Old, Side::New]);
    }
}
