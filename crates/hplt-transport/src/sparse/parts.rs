use std::sync::atomic::{AtomicBool, Ordering};

use hplt_geom::glam::DVec3;
use hplt_geom::parallel;

use super::{Entry, SparseRows};
use crate::Error;

/// Row sums beyond this are no albedo, rounding of the rays' shares counted.
const MAX_ROW_SUM: f64 = 1.0 + 1e-4;

/// The numbers of a [`SparseRows`], as files keep them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SparseParts {
    /// Columns of the matrix.
    pub n_columns: u32,
    /// Entries of each row.
    pub lengths: Vec<u32>,
    /// Two words an entry, the low half of each first: step to the right and weight in red, weight in green and in blue.
    pub entries: Vec<u32>,
    /// Sums of each row, red, green, blue.
    pub sums: Vec<f64>,
}

impl SparseRows {
    /// The numbers of the matrix.
    ///
    /// # Panics
    /// When a row has more than 2³² - 1 entries.
    pub fn into_parts(self) -> SparseParts {
        let length = |ends: &[u64]| u32::try_from(ends[1] - ends[0]).expect("at most 2^32 - 1 entries a row");
        SparseParts {
            n_columns: self.n_columns,
            lengths: self.starts.windows(2).map(length).collect(),
            sums: self.row_sums.iter().flat_map(|s| s.to_array()).collect(),
            entries: self.words,
        }
    }

    /// The matrix of those numbers, to the bit.
    ///
    /// # Errors
    /// [`Error::Links`] when lengths do not agree, a column does not exist or comes twice, or a sum is not one of albedos.
    pub fn from_parts(parts: SparseParts) -> Result<Self, Error> {
        let n_rows = parts.lengths.len();
        let mut starts = Vec::with_capacity(n_rows + 1);
        starts.push(0u64);
        for &length in &parts.lengths {
            starts.push(starts[starts.len() - 1] + u64::from(length));
        }
        let fail = |row, problem| Err(Error::Links { row, problem });
        if 2 * starts[n_rows] != parts.entries.len() as u64 {
            return fail(n_rows, "their entries are not as many as the rows say");
        }
        if parts.sums.len() != 3 * n_rows {
            return fail(n_rows, "their sums are not one per row and channel");
        }
        let mut rows = Self {
            n_columns: parts.n_columns,
            starts,
            words: parts.entries,
            scales: Vec::new(),
            row_sums: parts.sums.chunks_exact(3).map(DVec3::from_slice).collect(),
            is_read: Vec::new(),
        };
        let is_read: Vec<AtomicBool> = (0..rows.n_columns).map(|_| AtomicBool::new(false)).collect();
        rows.scales = parallel::try_map(n_rows, || (), |(), row| rows.checked_scale(row, &is_read))?;
        rows.is_read = is_read.into_iter().map(AtomicBool::into_inner).collect();
        Ok(rows)
    }

    /// The scale of a row that has none yet; marks the columns in which it has weight.
    fn checked_scale(&self, row: usize, is_read: &[AtomicBool]) -> Result<DVec3, Error> {
        let fail = |problem| Err(Error::Links { row, problem });
        let sum = self.row_sums[row];
        if !(sum.is_finite() && sum.min_element() >= 0.0 && sum.max_element() <= MAX_ROW_SUM) {
            return fail("a row sum is not in [0, 1]");
        }
        let (mut stored, mut column) = ([0u64; 3], 0);
        for (k, &entry) in self.entries(row).iter().enumerate() {
            let entry = Entry(entry);
            let [step, weight @ ..] = entry.halves();
            if k > 0 && step == 0 {
                return fail("a function comes twice");
            }
            column += usize::from(step);
            let Some(is_read) = is_read.get(column) else {
                return fail("there is no such function");
            };
            // Written once: what all threads write is in no cache for long.
            if entry.has_weight() && !is_read.load(Ordering::Relaxed) {
                is_read.store(true, Ordering::Relaxed);
            }
            (0..3).for_each(|c| stored[c] += u64::from(weight[c]));
        }
        let stored = DVec3::from(stored.map(|sum| sum as f64));
        let is_empty = stored.cmple(DVec3::ZERO);
        if (is_empty & sum.cmpgt(DVec3::ZERO)).any() {
            return fail("a row sum is of no entry");
        }
        Ok(DVec3::select(is_empty, DVec3::ZERO, sum / stored))
    }
}

#[cfg(test)]
mod tests {
    use hplt_geom::Rgb;

    use super::*;

    fn example() -> SparseRows {
        let mut g = SparseRows::new(100_000);
        g.push_row(&[(0, Rgb::new(0.5, 0.1, 0.0)), (7, Rgb::splat(0.3)), (99_999, Rgb::new(0.01, 0.0, 1e-6))]);
        g.push_row(&[]);
        g.push_row(&[(70_000, Rgb::new(0.0, 0.7, 0.0))]);
        g
    }

    #[test]
    fn a_matrix_returns_to_the_bit() {
        let g = example();
        assert_eq!(SparseRows::from_parts(g.clone().into_parts()).unwrap(), g);
    }

    #[test]
    fn parts_that_are_no_links_are_refused() {
        let refused = |change: &dyn Fn(&mut SparseParts)| {
            let mut parts = example().into_parts();
            change(&mut parts);
            match SparseRows::from_parts(parts) {
                Err(Error::Links { row, .. }) => row,
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(refused(&|p| p.lengths[0] += 1), 3);
        assert_eq!(refused(&|p| p.lengths.push(0)), 4);
        assert_eq!(refused(&|p| p.entries.truncate(p.entries.len() - 1)), 3);
        assert_eq!(refused(&|p| p.sums.truncate(8)), 3);
        assert_eq!(refused(&|p| p.n_columns = 99_999), 0);
        assert_eq!(refused(&|p| p.n_columns = 0), 0);
        assert_eq!(refused(&|p| p.entries[2] &= 0xffff_0000), 0, "a step of 0");
        for bad in [f64::NAN, f64::INFINITY, -0.1, 1.01] {
            assert_eq!(refused(&|p| p.sums[7] = bad), 2, "{bad}");
        }
        assert_eq!(refused(&|p| p.sums[6] = 0.1), 2, "red light from no entry");
        assert_eq!(refused(&|p| p.sums[3] = 0.1), 1, "light from an empty row");
    }
}
