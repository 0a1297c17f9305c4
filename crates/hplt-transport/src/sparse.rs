mod parts;

use hplt_geom::glam::{DVec3, Vec4};
use hplt_geom::{Rgb, parallel};

pub use parts::SparseParts;

use crate::LinearOperator;

/// A square sparse matrix in compressed rows, with one weight per channel and one sparsity for all.
///
/// A transport row holds (function, albedo-weighted share): the fraction of that function's irradiance that arrives.
///
/// An entry takes 8 bytes: the distance to the column before it and, per channel, a 16-bit multiple of a scale that the row
/// has. A weight is off by at most 1/131,070 of the largest of its row and channel, and black stays black. A common factor
/// per row and channel then makes row sums exact: an albedo of 0.9999 is not blurred.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseRows {
    n_columns: u32,
    starts: Vec<u64>,
    /// Two for each [`Entry`], as files keep them.
    words: Vec<u32>,
    scales: Vec<DVec3>,
    row_sums: Vec<DVec3>,
    /// Which columns hold any weight.
    is_read: Vec<bool>,
}

/// A step to the right, and a weight there in units of the scale of its row. A gap that 16 bits cannot hold is several
/// entries, all but the last one without weight.
///
/// Two words, the low half of each first: step and red, green and blue.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Entry([u32; 2]);

impl Entry {
    fn new(step: u16, [r, g, b]: [u16; 3]) -> Self {
        let word = |low: u16, high: u16| u32::from(low) | u32::from(high) << 16;
        Self([word(step, r), word(g, b)])
    }

    /// The step, and red, green and blue.
    fn halves(self) -> [u16; 4] {
        let [a, b] = self.0;
        [a as u16, (a >> 16) as u16, b as u16, (b >> 16) as u16]
    }

    fn step(self) -> u16 {
        self.halves()[0]
    }

    fn has_weight(self) -> bool {
        self.0[0] >> 16 | self.0[1] != 0
    }

    fn weight(self) -> DVec3 {
        let [_, r, g, b] = self.halves();
        DVec3::new(f64::from(r), f64::from(g), f64::from(b))
    }

    /// Step and weight at once: one conversion of four numbers.
    fn lanes(self) -> Vec4 {
        Vec4::from_array(self.halves().map(f32::from))
    }
}

impl SparseRows {
    /// A matrix of `n` columns without rows yet; it is an operator once it has `n` rows.
    ///
    /// # Panics
    /// When `n` does not fit in 32 bits.
    pub fn new(n: usize) -> Self {
        let n_columns = u32::try_from(n).expect("at most 2^32 - 1 unknowns");
        let (words, scales, row_sums) = (Vec::new(), Vec::new(), Vec::new());
        Self { n_columns, starts: vec![0], words, scales, row_sums, is_read: vec![false; n] }
    }

    /// Makes room for `n_rows` rows of `n_entries` entries in all.
    pub fn reserve(&mut self, n_rows: usize, n_entries: usize) {
        self.starts.reserve(n_rows);
        self.scales.reserve(n_rows);
        self.row_sums.reserve(n_rows);
        self.words.reserve(2 * n_entries);
    }

    /// Appends a row: columns ascending, each once, weights finite and not negative.
    ///
    /// # Panics
    /// When they are not.
    pub fn push_row(&mut self, row: &[(u32, Rgb)]) {
        const STEPS: f64 = u16::MAX as f64;
        let (mut sum, mut max) = (DVec3::ZERO, DVec3::ZERO);
        for (k, &(column, weight)) in row.iter().enumerate() {
            assert!(column < self.n_columns, "column {column} of {}", self.n_columns);
            assert!(k == 0 || row[k - 1].0 < column, "columns ascend, each once");
            assert!(weight.is_finite() && weight.min_element() >= 0.0, "weight {weight}: finite, not negative");
            sum += weight.as_dvec3();
            max = max.max(weight.as_dvec3());
        }
        let per_weight = max.map(|max| if max > 0.0 { STEPS / max } else { 0.0 });
        let (mut stored, mut last) = (DVec3::ZERO, 0);
        for &(column, weight) in row {
            while column - last > u32::from(u16::MAX) {
                self.words.extend(Entry::new(u16::MAX, [0; 3]).0);
                last += u32::from(u16::MAX);
            }
            let weight = (weight.as_dvec3() * per_weight).round().to_array().map(|w| w as u16);
            let entry = Entry::new((column - last) as u16, weight);
            (stored, last) = (stored + entry.weight(), column);
            self.words.extend(entry.0);
            self.is_read[column as usize] |= entry.has_weight();
        }
        self.starts.push(self.n_entries() as u64);
        self.scales.push(DVec3::select(stored.cmpgt(DVec3::ZERO), sum / stored, DVec3::ZERO));
        self.row_sums.push(sum);
    }

    /// How many rows there are.
    pub fn n_rows(&self) -> usize {
        self.row_sums.len()
    }

    /// How many entries are stored.
    pub fn n_entries(&self) -> usize {
        self.words.len() / 2
    }

    /// Bytes held.
    pub fn memory(&self) -> usize {
        Self::memory_of(self.n_rows(), self.n_entries())
    }

    /// Bytes that `n_rows` rows of `n_entries` entries in all will take.
    pub fn memory_of(n_rows: usize, n_entries: usize) -> usize {
        let per_row = size_of::<u64>() + 2 * size_of::<DVec3>() + size_of::<bool>();
        n_entries * size_of::<Entry>() + n_rows * per_row + size_of::<u64>()
    }

    /// The sum of the weights of a row.
    pub fn row_sum(&self, row: usize) -> Rgb {
        self.row_sums[row].as_vec3()
    }

    /// The entries of a row: column and weight as stored, columns ascending.
    pub fn row(&self, row: usize) -> impl Iterator<Item = (u32, DVec3)> + '_ {
        let scale = self.scales[row];
        self.multiples(row).map(move |(column, weight)| (column, scale * weight))
    }

    /// What multiplies the [`multiples`](Self::multiples) of a row.
    pub(crate) fn scale(&self, row: usize) -> DVec3 {
        self.scales[row]
    }

    /// The entries of a row in units of its scale.
    pub(crate) fn multiples(&self, row: usize) -> impl Iterator<Item = (u32, DVec3)> + '_ {
        self.entries(row).iter().scan(0, |column, &entry| {
            let entry = Entry(entry);
            *column += u32::from(entry.step());
            Some((*column, entry.weight()))
        })
    }

    /// Which columns hold any weight: whose unknowns others read.
    pub(crate) fn read_columns(&self) -> &[bool] {
        &self.is_read
    }

    /// The words of the entries of a row.
    fn entries(&self, row: usize) -> &[[u32; 2]] {
        let range = 2 * self.starts[row] as usize..2 * self.starts[row + 1] as usize;
        self.words[range].as_chunks().0
    }

    /// `Σ_j G_ij x_j` of row `i`.
    pub(crate) fn row_times(&self, row: usize, x: &[DVec3]) -> DVec3 {
        let (mut even, mut odd, mut column) = (DVec3::ZERO, DVec3::ZERO, 0);
        // Two sums in turn: one alone would wait for each addition.
        let (pairs, rest) = self.entries(row).as_chunks();
        for &[a, b] in pairs {
            let (a, b) = (Entry(a), Entry(b));
            let first = column + usize::from(a.step());
            column = first + usize::from(b.step());
            even += a.weight() * x[first];
            odd += b.weight() * x[column];
        }
        for &last in rest {
            let last = Entry(last);
            even += last.weight() * x[column + usize::from(last.step())];
        }
        self.scales[row] * (even + odd)
    }
}

/// Single precision, for speed.
impl SparseRows {
    /// `Σ_j G_ij x_j` of row `i`, each `x` behind a zero: that lane takes the steps.
    fn row_times_f32(&self, row: usize, x: &[Vec4]) -> Vec4 {
        let (mut even, mut odd, mut column) = (Vec4::ZERO, Vec4::ZERO, 0);
        let (pairs, rest) = self.entries(row).as_chunks();
        for &[a, b] in pairs {
            let (a, b) = (Entry(a), Entry(b));
            let first = column + usize::from(a.step());
            column = first + usize::from(b.step());
            even += a.lanes() * x[first];
            odd += b.lanes() * x[column];
        }
        for &last in rest {
            let last = Entry(last);
            even += last.lanes() * x[column + usize::from(last.step())];
        }
        even + odd
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

    fn apply_roughly(&self, x: &[DVec3], is_wanted: &[bool], out: &mut [DVec3]) {
        assert!(x.len() == self.n_columns as usize && out.len() == x.len() && self.n_rows() == x.len(), "square");
        let x: Vec<Vec4> = x.iter().map(|x| Vec4::new(0.0, x.x as f32, x.y as f32, x.z as f32)).collect();
        let row = |row: usize| {
            if !is_wanted[row] {
                return DVec3::ZERO;
            }
            let [_, r, g, b] = self.row_times_f32(row, &x).to_array();
            self.scales[row] * DVec3::new(f64::from(r), f64::from(g), f64::from(b))
        };
        out.copy_from_slice(&parallel::map(out.len(), || (), |(), i| row(i)));
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
        assert_eq!(out[..2], [DVec3::new(2.0, 1.0, 0.0), DVec3::ZERO]);
        assert!((out[2] - 2.0).abs().max_element() < 1e-5, "{}", out[2]);
        assert_eq!(g.row_sum(2), Rgb::splat(0.625));
        assert_eq!((g.n_entries(), g.row(2).map(|(j, _)| j).collect::<Vec<_>>()), (3, vec![0, 2]));
    }

    #[test]
    fn gaps_beyond_16_bits_take_one_more_entry() {
        for (gap, n_entries) in [(65_535, 2), (65_536, 3), (131_070, 3), (131_071, 4)] {
            let mut g = SparseRows::new(200_000);
            g.push_row(&[(1, Rgb::ONE), (1 + gap, Rgb::splat(0.5))]);
            let last = g.row(0).last().unwrap();
            assert!(last.0 == 1 + gap && (last.1 - 0.5).abs().max_element() < 1e-4, "{gap}: {last:?}");
            assert_eq!(g.n_entries(), n_entries, "{gap}");
        }
    }

    #[test]
    fn the_rough_product_is_near() {
        let n = 3000u32;
        let mut g = SparseRows::new(n as usize);
        for i in 0..n {
            let weight = |j: u32| Rgb::new(1.0, 2.0, 3.0) * (1e-4 * f32::from((i * 7 + j * 13) as u8));
            g.push_row(&(0..300).map(|j| (10 * j + i % 10, weight(j))).collect::<Vec<_>>());
        }
        let x: Vec<DVec3> = (0..n).map(|i| DVec3::new(f64::from(i % 17) - 8.0, 1e-9, f64::from(i))).collect();
        let (mut exact, mut rough) = (vec![DVec3::ZERO; n as usize], vec![DVec3::ONE; n as usize]);
        g.apply(&x, &mut exact);
        g.apply_roughly(&x, &vec![true; n as usize], &mut rough);
        let scale = exact.iter().fold(DVec3::ZERO, |max, e| max.max(e.abs()));
        let error = exact.iter().zip(&rough).map(|(e, r)| ((*e - *r) / scale).abs().max_element()).fold(0.0, f64::max);
        assert!(error < 1e-6 && error > 0.0, "{error}");
    }

    #[test]
    fn weights_are_kept_to_16_bits_of_the_largest_and_row_sums_exactly() {
        let mut g = SparseRows::new(2000);
        let row: Vec<(u32, Rgb)> =
            (0..1000).map(|i| (2 * i, Rgb::new(1e-3, 1e-9, 0.0) * (1 + i * i % 97) as f32)).collect();
        g.push_row(&row);
        let mut sum = DVec3::ZERO;
        for ((column, weight), (expected_column, expected)) in g.row(0).zip(&row) {
            assert_eq!(column, *expected_column);
            let error = (weight - expected.as_dvec3()).abs() / DVec3::new(97e-3, 97e-9, 1.0);
            assert!(error.max_element() <= 1.1 * 0.5 / 65535.0, "{error}");
            sum += expected.as_dvec3();
        }
        let stored: DVec3 = g.row(0).map(|(_, weight)| weight).sum();
        assert!((stored / sum - 1.0).abs().truncate().max_element() < 1e-13 && stored.z == 0.0);
    }

    #[test]
    fn gaps_of_any_width_are_bridged() {
        let mut g = SparseRows::new(1_000_000);
        let columns = [0, 65_535, 131_071, 200_000, 999_999];
        g.push_row(&columns.map(|j| (j, Rgb::ONE)));
        let kept: Vec<u32> = g.row(0).filter(|(_, w)| *w != DVec3::ZERO).map(|(j, _)| j).collect();
        assert_eq!(kept, columns);
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
