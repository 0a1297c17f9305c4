//! Verdicts on noisy numbers: equivalence with a margin, from independent replicates. Too noisy to tell is a failure.

use hplt::geom::radiometry::luminance;
use hplt::geom::{OrientedPoint, Rgb};
use hplt::reference::statistics::{Equivalence, MeanEstimate, Outcome, equivalence, mean_of_replicates};

/// Confidence that a passing test is right about its margin: 1 - α.
const ALPHA: f64 = 1e-3;

/// The mean of what `value` gives for so many seeds, with the standard error of their spread.
///
/// # Panics
/// When a value is not finite.
pub fn replicated(n: u64, value: impl Fn(u64) -> f64) -> MeanEstimate {
    let values: Vec<f64> = (0..n).map(value).collect();
    mean_of_replicates(&values).expect("two finite values or more")
}

/// Asserts that an estimate is within `margin` (relative) of its exact value, and that the test could have failed: a value
/// wrong by twice the margin does not pass.
///
/// # Panics
/// When it is not, or when that cannot be told.
#[track_caller]
pub fn assert_equivalent(what: &str, estimate: &MeanEstimate, exact: f64, margin: f64) {
    let verdict: Equivalence = equivalence(estimate, exact, margin, ALPHA);
    println!(
        "{what}: {:.7} for {exact:.7}, off by {:+.3} %, half-width {:.3} %, margin {:.2} %",
        estimate.mean,
        100.0 * verdict.difference / exact,
        100.0 * verdict.half_width / exact,
        100.0 * margin
    );
    assert_eq!(verdict.outcome, Outcome::Pass, "{what}: {verdict:?}");
    let wrong = equivalence(estimate, exact * (1.0 + 2.01 * margin), margin, ALPHA);
    assert_ne!(wrong.outcome, Outcome::Pass, "{what}: passes anything");
}

/// The mean of values at points, weighted by the areas that the points stand for.
pub fn area_mean(points: &[OrientedPoint], values: &[Rgb]) -> f64 {
    let area: f64 = points.iter().map(|p| f64::from(p.area)).sum();
    points.iter().zip(values).map(|(p, v)| f64::from(p.area) * f64::from(luminance(*v))).sum::<f64>() / area
}

/// The plain mean luminance.
pub fn mean_luminance(values: &[Rgb]) -> f64 {
    values.iter().map(|v| f64::from(luminance(*v))).sum::<f64>() / values.len() as f64
}

/// The slope of `ln y` over `ln x`, least squares.
pub fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let logs: Vec<(f64, f64)> = points.iter().map(|&(x, y)| (x.ln(), y.ln())).collect();
    let (mx, my) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    logs.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>() / logs.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[should_panic(expected = "Inconclusive")]
    fn what_is_too_noisy_to_tell_fails() {
        assert_equivalent("noise", &replicated(8, |i| if i % 2 == 0 { 0.9 } else { 1.1 }), 1.0, 0.01);
    }

    #[test]
    #[should_panic(expected = "Fail")]
    fn what_is_off_fails() {
        assert_equivalent("off", &replicated(8, |i| 1.05 + 1e-4 * i as f64), 1.0, 0.01);
    }
}
