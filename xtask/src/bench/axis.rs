//! Logarithmic axes whose ticks can be read: 1, 2 and 5 of every decade, fewer where they would touch.

use std::ops::Range;

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};

/// What a pixel axis shows, and where its ticks are.
#[derive(Debug, Clone, PartialEq)]
pub struct LogAxis {
    range: Range<f64>,
    /// Where there is a line and a label.
    ticks: Vec<f64>,
}

impl LogAxis {
    /// A little more than `values` take, with at most `most_ticks` ticks; `None` where no value is positive.
    pub fn around(values: impl Iterator<Item = f64>, most_ticks: usize) -> Option<Self> {
        let [least, most] = values
            .filter(|v| v.is_finite() && *v > 0.0)
            .fold([f64::INFINITY, 0.0], |[least, most]: [f64; 2], v| [least.min(v), most.max(v)]);
        if most <= 0.0 {
            return None;
        }
        // Never less than a factor 4 in all, so that noise does not fill the picture.
        let margin = 1.25_f64.max((4.0 * least / most).sqrt());
        let range = least / margin..most * margin;
        Some(Self { ticks: ticks(&range, most_ticks), range })
    }
}

/// The finest of the usual series that has at most `most` members in the range.
fn ticks(range: &Range<f64>, most: usize) -> Vec<f64> {
    const SERIES: [(&[f64], usize); 6] = [
        (&[1.0, 2.0, 3.0, 5.0, 7.0], 1),
        (&[1.0, 2.0, 5.0], 1),
        (&[1.0, 3.0], 1),
        (&[1.0], 1),
        (&[1.0], 2),
        (&[1.0], 3),
    ];
    let of = |(steps, every): (&[f64], usize)| -> Vec<f64> {
        let [first, last] = [range.start, range.end].map(|x| x.log10().floor() as i32);
        let decades = (first..=last).filter(|d| d.rem_euclid(every as i32) == 0);
        let all = decades.flat_map(|d| steps.iter().map(move |step| step * 10.0_f64.powi(d)));
        all.filter(|tick| range.contains(tick)).collect()
    };
    SERIES.into_iter().map(of).find(|found| found.len() <= most).unwrap_or_default()
}

impl Ranged for LogAxis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let part = (value / self.range.start).ln() / (self.range.end / self.range.start).ln();
        limit.0 + (f64::from(limit.1 - limit.0) * part).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.ticks.clone()
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

/// As few digits as tell `0.05`, `0.5`, `5` and `500` apart; large numbers as `20k` and `10M`.
pub fn plain(value: f64) -> String {
    match value {
        v if v >= 0.95e6 => return format!("{}M", plain(v / 1e6)),
        v if v >= 9.5e3 => return format!("{}k", plain(v / 1e3)),
        _ => {}
    }
    let digits = (-value.log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_short() {
        assert_eq!([0.05, 0.5, 5.0, 500.0, 0.30000000000000004].map(plain), ["0.05", "0.5", "5", "500", "0.3"]);
        assert_eq!([1e3, 5e3, 1e4, 2e5, 1e6, 1e7].map(plain), ["1000", "5000", "10k", "200k", "1M", "10M"]);
    }

    #[test]
    fn ticks_are_as_many_as_fit_and_two_at_least() {
        for (least, most) in [(0.003, 0.004), (0.002, 0.08), (0.1, 900.0), (36.0, 1e7), (1e-3, 1e9)] {
            let axis = LogAxis::around([least, most].into_iter(), 10).unwrap();
            assert!((2..=10).contains(&axis.ticks.len()), "{least} to {most}: {:?}", axis.ticks);
            assert!(axis.ticks.iter().all(|t| axis.range.contains(t)));
        }
        assert_eq!(ticks(&(0.9..6.0), 10), [1.0, 2.0, 3.0, 5.0]);
    }

    #[test]
    fn equal_factors_are_equal_distances() {
        let axis = LogAxis::around([1.0, 100.0].into_iter(), 10).unwrap();
        let [a, b, c] = [1.0, 10.0, 100.0].map(|v| axis.map(&v, (0, 1000)));
        assert!((b - a - (c - b)).abs() <= 1 && a > 0 && c < 1000, "{a} {b} {c}");
        assert_eq!(axis.map(&10.0, (1000, 0)), 500);
    }

    #[test]
    fn what_is_not_positive_has_no_place() {
        assert_eq!(LogAxis::around([0.0, f64::NAN].into_iter(), 8), None);
        assert_eq!(LogAxis::around([2.0, 8.0, 0.0].into_iter(), 8).unwrap().range, 1.6..10.0);
    }
}
