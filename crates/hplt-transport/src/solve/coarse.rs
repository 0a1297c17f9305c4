use hplt_geom::glam::DVec3;
use hplt_geom::parallel;

use crate::SparseRows;

/// A level of more unknowns is not worth its elimination.
const MAX_AGGREGATES: usize = 256;
/// The label of an unknown in no aggregate.
const NONE: u32 = u32::MAX;

/// The coarse level of a two-level method: `M⁻¹ r = r + P ((I - R G P)⁻¹ - I) R r`.
///
/// Its unknowns are aggregates of functions, `R` takes their means, `P` gives each function the value of its aggregate. What is slow
/// to converge is light that is even within a room and differs between rooms, so that an aggregate is what has most of its links
/// in common: about a room.
#[derive(Debug, Clone)]
pub(crate) struct Coarse {
    /// The aggregate of each unknown, or [`NONE`].
    labels: Vec<u32>,
    /// One over the size of each aggregate.
    shares: Vec<f64>,
    /// `I - R G P` as `L U`, row by row; `L` has ones on its diagonal.
    factors: Vec<DVec3>,
}

impl Coarse {
    /// The coarse level of the unknowns that are read; `None` where it would be empty or too large.
    pub fn build(rows: &SparseRows, is_read: &[bool]) -> Option<Self> {
        let labels = Labels { rows, is_read }.build()?;
        let n = labels.iter().filter(|&&l| l != NONE).max().map_or(0, |&l| l as usize + 1);
        let mut members = vec![Vec::new(); n];
        labels.iter().enumerate().filter(|(_, l)| **l != NONE).for_each(|(i, &l)| members[l as usize].push(i));
        let shares: Vec<f64> = members.iter().map(|m| 1.0 / m.len() as f64).collect();
        let row = |a: usize| {
            let mut row = vec![DVec3::ZERO; n];
            row[a] = DVec3::ONE;
            for &i in &members[a] {
                let scale = rows.scale(i) * shares[a];
                for (j, weight) in rows.multiples(i).filter(|(j, _)| labels[*j as usize] != NONE) {
                    row[labels[j as usize] as usize] -= weight * scale;
                }
            }
            row
        };
        let mut factors = parallel::map(n, || (), |(), a| row(a)).concat();
        factorize(&mut factors, n);
        (n > 0).then_some(Self { labels, shares, factors })
    }

    /// Replaces `r` by `M⁻¹ r`.
    pub fn apply(&self, r: &mut [DVec3]) {
        let n = self.shares.len();
        let mut means = vec![DVec3::ZERO; n];
        for (&label, r) in self.labels.iter().zip(&*r).filter(|(l, _)| **l != NONE) {
            means[label as usize] += *r;
        }
        means.iter_mut().zip(&self.shares).for_each(|(mean, share)| *mean *= *share);
        let mut solution = means.clone();
        for i in 0..n {
            let row = &self.factors[i * n..i * n + i];
            let known: DVec3 = row.iter().zip(&solution).map(|(f, x)| *f * *x).sum();
            solution[i] -= known;
        }
        for i in (0..n).rev() {
            let row = &self.factors[i * n..(i + 1) * n];
            let known: DVec3 = (i + 1..n).map(|j| row[j] * solution[j]).sum();
            solution[i] = (solution[i] - known) / row[i];
        }
        for (&label, r) in self.labels.iter().zip(r).filter(|(l, _)| **l != NONE) {
            *r += solution[label as usize] - means[label as usize];
        }
    }
}

/// Elimination without pivoting, which rows that sum to less than 1 do not need. A pivot that is rounding belongs to light that never
/// dies: it is left alone.
fn factorize(matrix: &mut [DVec3], n: usize) {
    for k in 0..n {
        let (above, below) = matrix.split_at_mut((k + 1) * n);
        let pivots = &mut above[k * n..];
        pivots[k] = pivots[k].map(|p| if p.abs() < 1e-12 { 1.0 } else { p });
        for row in below.chunks_exact_mut(n) {
            row[k] /= pivots[k];
            let factor = row[k];
            (k + 1..n).for_each(|j| row[j] -= factor * pivots[j]);
        }
    }
}

/// Tells aggregates apart by what links to what.
struct Labels<'a> {
    rows: &'a SparseRows,
    is_read: &'a [bool],
}

impl Labels<'_> {
    fn build(&self) -> Option<Vec<u32>> {
        let (mut labels, n) = self.seeds()?;
        // What was first come is now by majority.
        for _ in 0..2 {
            labels = self.by_majority(&labels, n);
        }
        let mut new = vec![NONE; n];
        let mut n_used = 0;
        for label in labels.iter_mut().filter(|l| **l != NONE) {
            let new = &mut new[*label as usize];
            if *new == NONE {
                (*new, n_used) = (n_used, n_used + 1);
            }
            *label = *new;
        }
        Some(labels)
    }

    /// A label for every unknown most of whose links have none yet, and for all that it links to; and how many there are.
    fn seeds(&self) -> Option<(Vec<u32>, usize)> {
        let (mut labels, mut n) = (vec![NONE; self.is_read.len()], 0);
        for i in (0..labels.len()).filter(|&i| self.is_read[i]) {
            let (mut labelled, mut all) = (0.0, 0.0);
            for (j, weight) in self.rows.multiples(i) {
                let weight = weight.element_sum();
                all += weight;
                labelled += if labels[j as usize] == NONE { 0.0 } else { weight };
            }
            if all == 0.0 || labelled >= 0.5 * all {
                continue;
            }
            if n == MAX_AGGREGATES {
                return None;
            }
            for j in self.rows.multiples(i).map(|(j, _)| j as usize).filter(|&j| self.is_read[j]) {
                if labels[j] == NONE {
                    labels[j] = n as u32;
                }
            }
            n += 1;
        }
        Some((labels, n))
    }

    /// For every unknown the label of most of its links, the least one of several.
    fn by_majority(&self, labels: &[u32], n: usize) -> Vec<u32> {
        let majority = |weights: &mut Vec<f64>, i: usize| {
            weights.fill(0.0);
            if !self.is_read[i] {
                return NONE;
            }
            for (j, weight) in self.rows.multiples(i).filter(|(j, _)| labels[*j as usize] != NONE) {
                weights[labels[j as usize] as usize] += weight.element_sum();
            }
            let best = (0..n).fold(None, |best, l| {
                let is_more = weights[l] > best.map_or(0.0, |b: usize| weights[b]);
                if is_more { Some(l) } else { best }
            });
            best.map_or(NONE, |l| l as u32)
        };
        parallel::map(labels.len(), || vec![0.0; n], majority)
    }
}

#[cfg(test)]
mod tests {
    use hplt_geom::Rgb;

    use super::*;

    /// Two rooms of `n` unknowns, every one linked to its room and a little to the other.
    fn rooms(n: usize, within: f32, between: f32) -> SparseRows {
        let mut g = SparseRows::new(2 * n);
        for i in 0..2 * n {
            let weight = |j: usize| if i / n == j / n { within } else { between } / n as f32;
            g.push_row(&(0..2 * n).map(|j| (j as u32, Rgb::splat(weight(j)))).collect::<Vec<_>>());
        }
        g
    }

    #[test]
    fn light_that_is_even_in_rooms_is_solved_at_once() {
        let n = 10;
        // Links between rooms are fewer than half of all: a sparse row that holds none of them is what tells the rooms apart.
        let mut g = SparseRows::new(2 * n);
        let of_room = |room: usize| (0..n).map(move |j| ((room * n + j) as u32, Rgb::splat(0.098)));
        g.push_row(&of_room(0).collect::<Vec<_>>());
        for i in 1..2 * n {
            let mut row: Vec<_> = of_room(i / n).collect();
            row.push((if i < n { n + i } else { i - n } as u32, Rgb::splat(0.01)));
            row.sort_unstable_by_key(|(j, _)| *j);
            g.push_row(&row);
        }
        let coarse = Coarse::build(&g, &vec![true; 2 * n]).unwrap();
        assert_eq!(coarse.labels, [vec![0; n], vec![1; n]].concat());
        // A uniform light of the coarse operator: R (I - G) P x returns to x.
        let x: Vec<DVec3> = (0..2 * n).map(|i| DVec3::splat(if i < n { 3.0 } else { 5.0 })).collect();
        let mut r: Vec<DVec3> = (0..2 * n).map(|i| x[i] - g.row_times(i, &x)).collect();
        for room in r.chunks_exact_mut(n) {
            let mean = room.iter().sum::<DVec3>() / n as f64;
            room.fill(mean);
        }
        coarse.apply(&mut r);
        assert!(r.iter().zip(&x).all(|(r, x)| (*r - *x).abs().max_element() < 1e-9), "{r:?}");
    }

    #[test]
    fn one_place_is_one_aggregate_and_what_nobody_reads_is_in_none() {
        let g = rooms(6, 0.5, 0.4);
        let is_read: Vec<bool> = (0..12).map(|i| i != 3).collect();
        let coarse = Coarse::build(&g, &is_read).unwrap();
        assert!((0..12).all(|i| coarse.labels[i] == if i == 3 { NONE } else { 0 }));
        let mut r = vec![DVec3::ONE; 12];
        coarse.apply(&mut r);
        let expected = 1.0 / (1.0 - received(&g, &is_read));
        assert!(r[3] == DVec3::ONE && (r[0].x - expected).abs() < 1e-9, "{}", r[0]);
    }

    /// The mean over the unknowns that are read of what they receive from each other.
    fn received(g: &SparseRows, is_read: &[bool]) -> f64 {
        let x: Vec<DVec3> = is_read.iter().map(|&r| if r { DVec3::ONE } else { DVec3::ZERO }).collect();
        let read: Vec<f64> = (0..x.len()).filter(|&i| is_read[i]).map(|i| g.row_times(i, &x).x).collect();
        read.iter().sum::<f64>() / read.len() as f64
    }

    #[test]
    fn nothing_to_link_and_too_many_places_have_no_coarse_level() {
        let mut empty = SparseRows::new(3);
        (0..3).for_each(|_| empty.push_row(&[]));
        assert!(Coarse::build(&empty, &[true; 3]).is_none());
        let islands = |n: usize| {
            let mut g = SparseRows::new(n);
            (0..n).for_each(|i| g.push_row(&[(i as u32, Rgb::splat(0.5))]));
            Coarse::build(&g, &vec![true; n])
        };
        assert!(islands(MAX_AGGREGATES).is_some() && islands(MAX_AGGREGATES + 1).is_none());
    }
}
