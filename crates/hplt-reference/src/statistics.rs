//! Statistics that cannot pass wrongly: equivalence instead of "no significant difference", standard errors from
//! replicates, thresholds for families of tests.

use crate::Error;

/// A mean with its standard error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanEstimate {
    /// The mean.
    pub mean: f64,
    /// Its standard error.
    pub standard_error: f64,
    /// Degrees of freedom of the standard error.
    pub degrees_of_freedom: f64,
}

/// What an equivalence test says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The value is within the margin, at the confidence asked for.
    Pass,
    /// The value is outside the margin, at the confidence asked for.
    Fail,
    /// Too noisy to tell. A test must treat this as a failure.
    Inconclusive,
}

/// The result of [`equivalence`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Equivalence {
    /// The verdict.
    pub outcome: Outcome,
    /// Estimate minus reference.
    pub difference: f64,
    /// Half-width of the confidence interval, `t·SE`.
    pub half_width: f64,
    /// The margin, in the units of the estimate.
    pub margin: f64,
}

/// The result of [`welch_t`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Welch {
    /// The statistic.
    pub t: f64,
    /// Degrees of freedom (Welch & Satterthwaite).
    pub degrees_of_freedom: f64,
    /// Two-sided p-value.
    pub p: f64,
}

/// Mean and standard error of independent replicates.
///
/// Not for the samples of one scrambled or stratified point set: those are not independent.
///
/// # Errors
/// With fewer than two values, or one that is not finite.
pub fn mean_of_replicates(values: &[f64]) -> Result<MeanEstimate, Error> {
    if values.len() < 2 {
        return Err(Error::TooFew { what: "replicates", found: values.len(), expected: 2 });
    }
    if let Some(index) = values.iter().position(|v| !v.is_finite()) {
        return Err(Error::NotFinite { what: "replicate", index, value: values[index] });
    }
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    Ok(MeanEstimate { mean, standard_error: (squares / (n * (n - 1.0))).sqrt(), degrees_of_freedom: n - 1.0 })
}

/// Two one-sided tests (Schuirmann 1987): passes when `|m - ref| + t·SE ≤ margin·|ref|` with `t` the `1-α` quantile.
/// Noise, too few samples or a broken estimate make it fail, never pass.
pub fn equivalence(estimate: &MeanEstimate, reference: f64, relative_margin: f64, alpha: f64) -> Equivalence {
    let margin = relative_margin * reference.abs();
    let half_width = student_t_quantile(1.0 - alpha, estimate.degrees_of_freedom) * estimate.standard_error;
    let difference = estimate.mean - reference;
    let outcome = if difference.abs() + half_width <= margin {
        Outcome::Pass
    } else if difference.abs() - half_width > margin {
        Outcome::Fail
    } else {
        Outcome::Inconclusive
    };
    Equivalence { outcome, difference, half_width, margin }
}

/// The test of Welch (1947) for a difference of two means. Two estimates without any spread give `t = 0` when they are
/// equal and an infinite `t` otherwise.
pub fn welch_t(a: &MeanEstimate, b: &MeanEstimate) -> Welch {
    let (va, vb) = (a.standard_error.powi(2), b.standard_error.powi(2));
    let difference = a.mean - b.mean;
    if va + vb == 0.0 {
        let degrees_of_freedom = a.degrees_of_freedom + b.degrees_of_freedom;
        let (t, p) = if difference == 0.0 { (0.0, 1.0) } else { (f64::INFINITY.copysign(difference), 0.0) };
        return Welch { t, degrees_of_freedom, p };
    }
    let t = difference / (va + vb).sqrt();
    let degrees_of_freedom = (va + vb).powi(2) / (va * va / a.degrees_of_freedom + vb * vb / b.degrees_of_freedom);
    Welch { t, degrees_of_freedom, p: 2.0 * student_t_tail(t.abs(), degrees_of_freedom) }
}

/// The p-value of the hypothesis that `values` are independent and uniform in `[0, 1]` (Kolmogorov & Smirnov, with the
/// small-sample correction of Stephens 1970).
///
/// # Errors
/// With fewer than five values, or one that is not finite.
pub fn kolmogorov_smirnov_uniform(values: &[f64]) -> Result<f64, Error> {
    if values.len() < 5 {
        return Err(Error::TooFew { what: "p-values", found: values.len(), expected: 5 });
    }
    if let Some(index) = values.iter().position(|v| !v.is_finite()) {
        return Err(Error::NotFinite { what: "p-value", index, value: values[index] });
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len() as f64;
    let gap = |(i, &x): (usize, &f64)| (x - i as f64 / n).max((i as f64 + 1.0) / n - x);
    let distance = sorted.iter().enumerate().map(gap).fold(0.0, f64::max);
    let lambda = (n.sqrt() + 0.12 + 0.11 / n.sqrt()) * distance;
    Ok(kolmogorov_tail(lambda))
}

/// The |z| beyond which one of `n_tests` two-sided normal tests may go with probability `family_alpha` in all (Šidák 1967).
pub fn sidak_z(family_alpha: f64, n_tests: usize) -> f64 {
    // 1 - (1-α)^(1/n) without cancellation.
    let alpha = -((-family_alpha).ln_1p() / n_tests.max(1) as f64).exp_m1();
    normal_upper_quantile(0.5 * alpha)
}

/// The `z` with `P(Z > z) = tail` of a standard normal `Z`, for `tail` in (0, ½].
pub fn normal_upper_quantile(tail: f64) -> f64 {
    bisect(0.0, 40.0, |z| normal_tail(z) > tail)
}

/// `P(Z > z)` of a standard normal `Z`, `z ≥ 0`.
pub fn normal_tail(z: f64) -> f64 {
    0.5 * gamma_tail_half(0.5 * z * z)
}

/// The `t` with `P(T ≤ t) = p` of Student's distribution, for `p` in (0, 1).
pub fn student_t_quantile(p: f64, degrees_of_freedom: f64) -> f64 {
    if p < 0.5 {
        return -student_t_quantile(1.0 - p, degrees_of_freedom);
    }
    let tail = 1.0 - p;
    let mut upper = 1.0;
    while student_t_tail(upper, degrees_of_freedom) > tail && upper < 1e300 {
        upper *= 2.0;
    }
    bisect(0.0, upper, |t| student_t_tail(t, degrees_of_freedom) > tail)
}

/// `P(T > t)` of Student's distribution, `t ≥ 0`.
pub fn student_t_tail(t: f64, degrees_of_freedom: f64) -> f64 {
    let nu = degrees_of_freedom;
    0.5 * incomplete_beta(nu / (nu + t * t), 0.5 * nu, 0.5)
}

/// The last point of `[low, high]` where `holds` is true, for a predicate that turns false once.
fn bisect(mut low: f64, mut high: f64, holds: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            break;
        }
        if holds(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// `Q(½, x) = erfc(√x)`: series below 2, continued fraction above (Lentz).
fn gamma_tail_half(x: f64) -> f64 {
    if x <= 0.0 {
        return 1.0;
    }
    let scale = (0.5 * x.ln() - x).exp() / std::f64::consts::PI.sqrt();
    if x < 2.0 {
        let (mut term, mut sum) = (2.0, 2.0);
        let mut a = 0.5;
        while term > sum * 1e-17 {
            a += 1.0;
            term *= x / a;
            sum += term;
        }
        return 1.0 - sum * scale;
    }
    let fraction = lentz(x + 0.5, |i| (-i * (i - 0.5), x + 0.5 + 2.0 * i));
    scale / fraction
}

/// The regularised incomplete beta function `I_x(a, b)` (DLMF 8.17.22).
fn incomplete_beta(x: f64, a: f64, b: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    if x >= 1.0 {
        return 1.0;
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(1.0 - x, b, a);
    }
    let front = (ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b) + a * x.ln() + b * (-x).ln_1p()).exp() / a;
    let term = |i: f64| {
        let m = (0.5 * i).floor();
        let d = if i % 2.0 == 0.0 {
            m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m))
        } else {
            -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0))
        };
        (d, 1.0)
    };
    front / lentz(1.0, term)
}

/// The continued fraction `b0 + a1/(b1 + a2/(b2 + …))`, `term(i) = (a_i, b_i)` (Lentz, Thompson & Barnett).
fn lentz(first: f64, term: impl Fn(f64) -> (f64, f64)) -> f64 {
    const TINY: f64 = 1e-300;
    let (mut value, mut c, mut d) = (first.max(TINY), first.max(TINY), 0.0);
    for i in 1..10_000 {
        let (a, b) = term(f64::from(i));
        d = b + a * d;
        d = 1.0 / if d == 0.0 { TINY } else { d };
        c = b + a / c;
        c = if c == 0.0 { TINY } else { c };
        value *= c * d;
        if (c * d - 1.0).abs() < 1e-16 {
            break;
        }
    }
    value
}

/// `ln Γ(x)` for `x > 0`: Stirling's series after shifting `x` above 16.
fn ln_gamma(x: f64) -> f64 {
    let (mut shifted, mut product) = (x, 1.0f64);
    while shifted < 16.0 {
        product *= shifted;
        shifted += 1.0;
    }
    let r = 1.0 / shifted;
    let r2 = r * r;
    let series = r * (1.0 / 12.0 - r2 * (1.0 / 360.0 - r2 * (1.0 / 1260.0 - r2 * (1.0 / 1680.0 - r2 / 1188.0))));
    (shifted - 0.5) * shifted.ln() - shifted + 0.5 * std::f64::consts::TAU.ln() + series - product.ln()
}

/// `P(K > λ)` of the Kolmogorov distribution.
fn kolmogorov_tail(lambda: f64) -> f64 {
    if lambda < 0.3 {
        return 1.0;
    }
    let term = |k: i32| {
        let sign = if k % 2 == 1 { 2.0 } else { -2.0 };
        sign * (-2.0 * f64::from(k * k) * lambda * lambda).exp()
    };
    (1..60).map(term).sum::<f64>().clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(value: f64, expected: f64, tolerance: f64) {
        assert!((value - expected).abs() <= tolerance * expected.abs(), "{value} instead of {expected}");
    }

    #[test]
    fn student_quantiles_are_those_of_the_tables() {
        for (p, nu, expected) in [
            (0.975, 1.0, 12.7062047361747),
            (0.975, 10.0, 2.228138851986275),
            (0.95, 15.0, 1.753050355692574),
            (0.975, 15.0, 2.131449545559776),
            (0.995, 23.0, 2.807335683770),
            (0.9995, 5.0, 6.86882662588111),
        ] {
            close(student_t_quantile(p, nu), expected, 1e-11);
            close(student_t_quantile(1.0 - p, nu), -expected, 1e-11);
        }
        close(student_t_quantile(0.975, 1e7), 1.959964, 1e-6);
        assert!(student_t_quantile(0.5, 3.0).abs() < 1e-15);
    }

    #[test]
    fn normal_quantiles_and_sidak_thresholds_are_those_of_the_tables() {
        close(normal_upper_quantile(0.025), 1.959963984540, 1e-12);
        close(normal_upper_quantile(0.158655253931457), 1.0, 1e-12);
        close(normal_tail(6.0), 9.865876450377e-10, 1e-11);
        let table = [
            (1e-2, [2.58, 3.89, 4.42, 4.89, 5.33]),
            (1e-4, [3.89, 4.89, 5.33, 5.73, 6.11]),
            (1e-6, [4.89, 5.73, 6.11, 6.47, 6.81]),
        ];
        for (alpha, row) in table {
            for (n, expected) in [1, 100, 1000, 10_000, 100_000].into_iter().zip(row) {
                assert!((sidak_z(alpha, n) - expected).abs() < 0.006, "{alpha} {n}: {}", sidak_z(alpha, n));
            }
        }
    }

    #[test]
    fn equivalence_passes_fails_and_does_not_know() {
        let estimate = |mean, standard_error| MeanEstimate { mean, standard_error, degrees_of_freedom: 15.0 };
        let verdict = |e| equivalence(&e, 2.0, 0.01, 0.01).outcome;
        assert_eq!(verdict(estimate(2.001, 0.001)), Outcome::Pass);
        assert_eq!(verdict(estimate(2.04, 0.001)), Outcome::Fail);
        assert_eq!(verdict(estimate(2.0, 0.1)), Outcome::Inconclusive);
        assert_eq!(verdict(estimate(f64::NAN, 0.001)), Outcome::Inconclusive);
    }

    #[test]
    fn welch_agrees_with_a_worked_example() {
        let a = mean_of_replicates(&[
            27.5, 21.0, 19.0, 23.6, 17.0, 17.9, 16.9, 20.1, 21.9, 22.6, 23.1, 19.6, 19.0, 21.7, 21.4,
        ])
        .unwrap();
        let b = mean_of_replicates(&[
            27.1, 22.0, 20.8, 23.4, 23.4, 23.5, 25.8, 22.0, 24.8, 20.2, 21.9, 22.1, 22.9, 30.1, 24.4,
        ])
        .unwrap();
        let welch = welch_t(&a, &b);
        assert!(
            (welch.t + 2.863169618153).abs() < 1e-11 && (welch.degrees_of_freedom - 27.766759168206).abs() < 1e-10,
            "{welch:?}"
        );
        assert!(welch.p > 0.005 && welch.p < 0.012, "{welch:?}");
        assert_eq!(welch_t(&a, &a).p, 1.0);
    }

    #[test]
    fn kolmogorov_smirnov_sees_what_is_not_uniform() {
        let even: Vec<f64> = (0..200).map(|i| (f64::from(i) + 0.5) / 200.0).collect();
        assert!(kolmogorov_smirnov_uniform(&even).unwrap() > 0.99);
        let squared: Vec<f64> = even.iter().map(|x| x * x).collect();
        assert!(kolmogorov_smirnov_uniform(&squared).unwrap() < 1e-6);
        close(kolmogorov_tail(1.3581), 0.05, 1e-3);
        close(kolmogorov_tail(1.6276), 0.01, 1e-3);
    }

    #[test]
    fn too_few_or_bad_replicates_are_errors() {
        assert!(mean_of_replicates(&[1.0]).is_err());
        assert!(mean_of_replicates(&[1.0, f64::INFINITY]).is_err());
        let three = mean_of_replicates(&[1.0, 2.0, 3.0]).unwrap();
        close(three.standard_error, (1.0f64 / 3.0).sqrt(), 1e-15);
    }
}
