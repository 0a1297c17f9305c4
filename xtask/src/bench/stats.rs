//! Statistics of repeated measurements.

use serde::Serialize;

/// Repeated measurements of one quantity.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Spread {
    /// The middle value.
    pub median: f64,
    /// The least.
    pub least: f64,
    /// The most.
    pub most: f64,
    /// How many.
    pub runs: usize,
}

impl Spread {
    /// Of all values; zeros of none.
    pub fn of(values: &[f64]) -> Self {
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        Self {
            median: median(values),
            least: if values.is_empty() { 0.0 } else { least },
            most: values.iter().copied().fold(0.0, f64::max),
            runs: values.len(),
        }
    }
}

/// The middle value, of an even number the mean of the two middle ones; 0 of none.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match (sorted.len(), sorted.len() / 2) {
        (0, _) => 0.0,
        (n, middle) if n % 2 == 1 => sorted[middle],
        (_, middle) => 0.5 * (sorted[middle - 1] + sorted[middle]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_ignore_one_slow_run() {
        assert_eq!(median(&[9.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0]), 2.5);
        assert_eq!(median(&[]), 0.0);
        assert_eq!(Spread::of(&[9.0, 1.0, 2.0]), Spread { median: 2.0, least: 1.0, most: 9.0, runs: 3 });
        assert_eq!(Spread::of(&[]), Spread::default());
    }
}
