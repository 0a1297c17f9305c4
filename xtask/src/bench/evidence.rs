//! What repeated and paired measurements prove.

use serde::Serialize;

use super::stats::median;

/// Pairs beyond which the exact distribution of the signed ranks is not enumerated.
pub const MAX_PAIRS: usize = 20;

/// An estimate and the interval that holds the truth with about 99 % confidence.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// The estimate.
    pub estimate: f64,
    /// Lower end; minus infinity where the sample is too small for one.
    pub low: f64,
    /// Upper end; infinity where the sample is too small for one.
    pub high: f64,
}

/// Pseudo-median of `values`, symmetric about an unknown centre, and an exact interval of that centre: Hodges & Lehmann 1963, from
/// the signed ranks of Wilcoxon. One wild value moves neither far.
///
/// The confidence is at least 99 %, which takes eight values; of fewer the interval is without bounds. Values beyond
/// [`MAX_PAIRS`] are left out.
pub fn pseudo_median(values: &[f64]) -> Interval {
    let values = &values[..values.len().min(MAX_PAIRS)];
    let mut walsh: Vec<f64> =
        (0..values.len()).flat_map(|i| (i..values.len()).map(move |j| 0.5 * (values[i] + values[j]))).collect();
    walsh.sort_by(f64::total_cmp);
    let estimate = median(&walsh);
    match critical_rank(values.len()) {
        Some(k) => Interval { estimate, low: walsh[k], high: walsh[walsh.len() - 1 - k] },
        None => Interval { estimate, low: f64::NEG_INFINITY, high: f64::INFINITY },
    }
}

/// The largest sum of signed ranks k with P(W <= k) of at most 0.5 % under symmetry; that many averages lie outside on either side.
fn critical_rank(n: usize) -> Option<usize> {
    let most = n * (n + 1) / 2;
    // How many of the 2^n choices of signs have each sum of positive ranks.
    let mut ways = vec![0u64; most + 1];
    ways[0] = 1;
    for rank in 1..=n {
        for sum in (rank..=most).rev() {
            ways[sum] += ways[sum - rank];
        }
    }
    let allowed = 0.005 * (1u64 << n) as f64;
    let mut below = 0;
    let within = ways.iter().take_while(|&&w| {
        below += w;
        below as f64 <= allowed
    });
    within.count().checked_sub(1)
}

/// Ratio of the means of `new` and `old`, which belong together value by value, with the percentile bootstrap's interval: whole pairs
/// are drawn again, so that what both have in common (hard points) does not count as noise.
///
/// The same values give the same interval: the draws come from a fixed sequence.
pub fn ratio_of_means(new: &[f64], old: &[f64]) -> Interval {
    const DRAWS: usize = 2000;
    let n = new.len().min(old.len());
    let ratio = |[new, old]: [f64; 2]| if new == old { 1.0 } else { new / old };
    let sums =
        |indices: &mut dyn Iterator<Item = usize>| indices.fold([0.0, 0.0], |[a, b], i| [a + new[i], b + old[i]]);
    let estimate = ratio(sums(&mut (0..n)));
    let mut random = SplitMix(0x1234_5678);
    let mut draws: Vec<f64> = (0..DRAWS).map(|_| ratio(sums(&mut (0..n).map(|_| random.below(n))))).collect();
    draws.sort_by(f64::total_cmp);
    Interval { estimate, low: draws[DRAWS / 200], high: draws[DRAWS - 1 - DRAWS / 200] }
}

/// Steele, Lea & Flood 2014.
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: usize) -> usize {
        (((self.next() >> 32) * n as u64) >> 32) as usize
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// Independent values that are about normal with deviation 1.
    pub fn noise(seed: u64, n: usize) -> Vec<f64> {
        let mut random = SplitMix(seed.wrapping_mul(0x5851_f42d_4c95_7f2d));
        let mut uniform = || (random.next() >> 11) as f64 / (1u64 << 53) as f64;
        (0..n).map(|_| (0..12).map(|_| uniform()).sum::<f64>() - 6.0).collect()
    }

    #[test]
    fn critical_ranks_are_those_of_the_tables() {
        // Wilcoxon's two-sided 1 %.
        let expected =
            [(7, None), (8, Some(0)), (9, Some(1)), (10, Some(3)), (12, Some(7)), (15, Some(15)), (20, Some(37))];
        for (n, k) in expected {
            assert_eq!(critical_rank(n), k, "{n}");
        }
    }

    #[test]
    fn the_interval_holds_the_centre_as_often_as_it_says() {
        let held = (0..2000).filter(|&seed| {
            let interval = pseudo_median(&noise(seed, 8));
            interval.low <= 0.0 && 0.0 <= interval.high
        });
        let share = held.count() as f64 / 2000.0;
        // 99.2 % exactly for eight values; 2000 trials have a standard error of 0.2 %.
        assert!((0.984..1.0).contains(&share), "{share}");
    }

    #[test]
    fn one_wild_value_does_not_move_the_pseudo_median() {
        let mut values = vec![0.98, 0.99, 1.0, 1.0, 1.01, 1.01, 1.02, 1.03];
        values[7] = 50.0;
        let interval = pseudo_median(&values);
        assert!((0.98..1.05).contains(&interval.estimate) && interval.low > 0.97, "{interval:?}");
        let few = pseudo_median(&values[..7]);
        assert!(
            few.low == f64::NEG_INFINITY && few.high == f64::INFINITY && (few.estimate - 1.0).abs() < 0.02,
            "{few:?}"
        );
    }

    #[test]
    fn what_both_tables_have_in_common_is_no_noise() {
        // A few points are a hundred times worse than the rest, in both.
        let old: Vec<f64> = (0..400).map(|i| if i % 100 == 0 { 3.0 } else { 0.01 }).collect();
        let scaled = |factor: f64| old.iter().map(|e| factor * e).collect::<Vec<_>>();
        let same = ratio_of_means(&old, &old);
        assert_eq!((same.estimate, same.low, same.high), (1.0, 1.0, 1.0));
        let worse = ratio_of_means(&scaled(1.1), &old);
        assert!((worse.low - 1.1).abs() < 1e-9 && (worse.high - 1.1).abs() < 1e-9, "{worse:?}");
        // With noise of its own at every point, the interval is as wide as that noise makes it.
        let noisy: Vec<f64> = noise(1, 400).iter().map(|e| (0.01 + 0.005 * e).abs()).collect();
        let other: Vec<f64> = noise(2, 400).iter().map(|e| (0.01 + 0.005 * e).abs()).collect();
        let apart = ratio_of_means(&noisy, &other);
        assert!(apart.low < 1.0 && apart.high > 1.0 && apart.high - apart.low < 0.2, "{apart:?}");
        assert_eq!(ratio_of_means(&[0.0; 9], &[0.0; 9]).high, 1.0);
    }
}
