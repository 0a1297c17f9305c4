use hplt_geom::glam::DVec3;
use hplt_geom::{Rgb, parallel};

use crate::LinearOperator;

/// A square sparse matrix in compressed rows, with one weight per channel and one sparsity for all.
///
/// A transport row holds (function, albedo-weighted share): the fraction of that function's irradiance that arrives.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseRows {
    n_columns: u32,
    starts: Vec<u64>,
    entries: Vec<Entry>,
    row_sums: Vec<DVec3>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Entry {
    column: u32,
    weight: [f32; 3],
}

impl SparseRows {
    /// A matrix of `n` columns without rows yet; it is an operator once it has `n` rows.
    pub fn new(n: usize) -> Self {
        let n_columns = u32::try_from(n).expect("at most 2^32 - 1 unknowns");
        Self { n_columns, starts: vec![0], entries: Vec::new(), row_sums: Vec::new() }
    }

    /// Makes room for `n_rows` rows of `n_entries` entries in all.
    pub fn reserve(&mut self, n_rows: usize, n_entries: usize) {
        self.starts.reserve(n_rows);
        self.row_sums.reserve(n_rows);
        self.entries.reserve(n_entries);
    }

    /// Appends a row: columns ascending, each once, weights finite and not negative.
    ///
    /// # Panics
    /// When they are not.
    pub fn push_row(&mut self, row: &[(u32, Rgb)]) {
        let mut sum = DVec3::ZERO;
        for (k, &(column, weight)) in row.iter().enumerate() {
            assert!(column < self.n_columns, "column {column} of {}", self.n_columns);
            assert!(k == 0 || row[k - 1].0 < column, "columns ascend, each once");
            assert!(weight.is_finite() && weight.min_element() >= 0.0, "weight {weight}: finite, not negative");
            self.entries.push(Entry { column, weight: weight.to_array() });
            sum += weight.as_dvec3();
        }
        self.starts.push(self.entries.len() as u64);
        self.row_sums.push(sum);
    }

    /// How many rows there are.
    pub fn n_rows(&self) -> usize {
        self.row_sums.len()
    }

    /// How many entries there are.
    pub fn n_entries(&self) -> usize {
        self.entries.len()
    }

    /// Bytes held.
    pub fn memory(&self) -> usize {
        self.entries.len() * size_of::<Entry>()
            + self.starts.len() * size_of::<u64>()
            + self.row_sums.len() * size_of::<DVec3>()
    }

    /// The sum of the weights of a row.
    pub fn row_sum(&self, row: usize) -> Rgb {
        self.row_sums[row].as_vec3()
    }

    /// The entries of a row: column and weight, columns ascending.
    pub fn row(&self, row: usize) -> impl ExactSizeIterator<Item = (u32, Rgb)> + '_ {
        self.entries_of(row).iter().map(|e| (e.column, Rgb::from_array(e.weight)))
    }

    /// `Σ_j G_ij x_j` of row `i`.
    pub(crate) fn row_times(&self, row: usize, x: &[DVec3]) -> DVec3 {
        let mut sum = DVec3::ZERO;
        for entry in self.entries_of(row) {
            sum += Rgb::from_array(entry.weight).as_dvec3() * x[entry.column as usize];
        }
        sum
    }

    /// The weight of an unknown on itself.
    pub(crate) fn diagonal(&self, row: usize) -> DVec3 {
        let entries = self.entries_of(row);
        let own = entries.binary_search_by_key(&(row as u32), |e| e.column);
        own.map_or(DVec3::ZERO, |k| Rgb::from_array(entries[k].weight).as_dvec3())
    }

    fn entries_of(&self, row: usize) -> &[Entry] {
        &self.entries[self.starts[row] as usize..self.starts[row + 1] as usize]
    }
}

impl LinearOperator for SparseRows {
    fn len(&self) -> usize {
        self.n_rows()
    }

    fn apply(&self, x: &[DVec3], out: &mut [DVec3]) {
        assert!(x.len() == self.n_columns as usize && out.len() == x.len() && self.n_rows() == x.len(), "square");
        // Each row is summed by one worker in its own order, so that bits do not depend on how rows are dealt out.
        out.copy_from_slice(&parallel::map(out.len(), || (), |(), row| self.row_times(row, x)));
    }

    fn row_sums(&self) -> Vec<DVec3> {
        self.row_sums.clone()
    }

    fn rows(&self) -> Option<&SparseRows> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn product_and_sums_of_a_small_matrix() {
        let mut g = SparseRows::new(3);
        g.push_row(&[(1, Rgb::new(0.5, 0.25, 0.0))]);
        g.push_row(&[]);
        g.push_row(&[(0, Rgb::splat(0.125)), (2, Rgb::splat(0.5))]);
        let mut out = [DVec3::ONE; 3];
        g.apply(&[DVec3::splat(8.0), DVec3::splat(4.0), DVec3::splat(2.0)], &mut out);
        assert_eq!(out, [DVec3::new(2.0, 1.0, 0.0), DVec3::ZERO, DVec3::splat(2.0)]);
        assert_eq!(g.row_sum(2), Rgb::splat(0.625));
        assert_eq!(g.n_entries(), 3);
        assert_eq!(g.row(2).collect::<Vec<_>>(), [(0, Rgb::splat(0.125)), (2, Rgb::splat(0.5))]);
    }

    #[test]
    #[should_panic(expected = "columns ascend")]
    fn unmerged_columns_are_refused() {
        SparseRows::new(2).push_row(&[(1, Rgb::ONE), (1, Rgb::ONE)]);
    }

    #[test]
    #[should_panic(expected = "not negative")]
    fn negative_weights_are_refused() {
        SparseRows::new(2).push_row(&[(1, Rgb::splat(-0.1))]);
    }
}
