//! The Cholesky factor of a small matrix, H = R'R with R upper triangular, and solutions with it.
//!
//! Rows of R lie in memory one after the other. The right-hand side is one more column, so that its
//! forward substitution is done with the factorisation.

use crate::octet::octets;
use crate::simd::{multiversion, Level};

/// Largest order of H, at which R takes 0.6 MB. Coordinate descent alone solves larger supports.
pub const LARGEST: usize = 256;
const LANES: usize = 8;
/// Distance of rows. It leaves space for the right-hand side and for one more octet, since octets are
/// processed in pairs. It is no power of two, which would put all rows into the same cache sets.
const STRIDE: usize = LARGEST + 2 * LANES;
/// If a pivot is below this share of its diagonal element, the column depends on those before it. Well
/// above the rounding of 256 subtractions (6e-14).
pub const DEPENDENT: f64 = 1e-10;
/// The same where inner products are summed in float32, and off by up to a millionth.
pub const QUICK_DEPENDENT: f64 = 1e-5;
/// Rows that are factorised together: with two octets each, their sums fill eight registers.
const PANEL: usize = 4;

pub struct Factor {
    level: Level,
    r: Vec<f64>,
}

impl Factor {
    pub fn new(level: Level) -> Self {
        Factor {
            level,
            r: Vec::new(),
        }
    }

    /// Solves H z = right in place, with H the columns `set` of the rows that begin at `places`. A pivot
    /// below the share `dependent` of its diagonal element is rounding.
    ///
    /// # Errors
    /// The place of a column that depends on those before it. `right` is unchanged then.
    ///
    /// # Panics
    /// If the order is above `LARGEST` or the lengths differ.
    pub fn solve(
        &mut self,
        rows: &[f64],
        places: &[usize],
        set: &[u32],
        right: &mut [f64],
        dependent: f64,
    ) -> Result<(), usize> {
        let size = set.len();
        assert!(size <= LARGEST && places.len() == size && right.len() == size);
        let needed = size.next_multiple_of(PANEL) * STRIDE;
        if self.r.len() < needed {
            self.r.resize(needed, 0.0);
        }
        gather(self.level, &mut self.r, rows, places, set, right);
        let order = factorise(self.level, &mut self.r, size, dependent);
        if order < size {
            return Err(order);
        }
        for (right, row) in right.iter_mut().zip(self.r.chunks_exact(STRIDE)) {
            *right = row[size];
        }
        backward(self.level, &self.r, right);
        Ok(())
    }

    /// After `solve` returned the place of a dependent column: the combination of columns that is zero,
    /// with factor 1 for this column.
    pub fn dependency(&self, place: usize, out: &mut Vec<f64>) {
        out.clear();
        let rows = self.r.chunks_exact(STRIDE).take(place);
        out.extend(rows.map(|row| -row[place]));
        backward(self.level, &self.r, out);
        out.push(1.0);
    }
}

multiversion! {
    /// Copies the upper triangle of H, with the right-hand side behind it.
    fn gather(r: &mut [f64], rows: &[f64], places: &[usize], set: &[u32], right: &[f64]) {
        let size = set.len();
        for (i, (place, r)) in places.iter().zip(r.chunks_exact_mut(STRIDE)).enumerate() {
            let row = &rows[*place..];
            for (r, &j) in r[i..size].iter_mut().zip(&set[i..]) {
                *r = row[j as usize];
            }
            r[size] = right[i];
        }
    }
}

octets! {
    /// Replaces H by R; returns the order, or the place of the first dependent column.
    fn factorise<O>(r: &mut [f64], size: usize, dependent: f64) -> usize {
        let mut squares = [0.0; LARGEST];
        for (k, square) in squares[..size].iter_mut().enumerate() {
            *square = r[k * STRIDE + k];
        }
        // Works on whole octets; what they hold left of the diagonal and behind the right-hand side does
        // not matter.
        let end = (size + 1).div_ceil(LANES);
        for first in (0..size).step_by(PANEL) {
            let count = PANEL.min(size - first);
            let (above, panel) = r.split_at_mut(first * STRIDE);
            let start = first / LANES;
            // Subtracts all rows above while the sums stay in registers; two octets share the loads of
            // factors.
            for column in (start..end).step_by(2) {
                let at = |row: usize, part: usize| row * STRIDE + (column + part) * LANES;
                let load = |from: &[f64], place: usize| {
                    O::load(from[place..].first_chunk().expect("whole octets"))
                };
                let mut sums: [[O; 2]; PANEL] =
                    std::array::from_fn(|k| std::array::from_fn(|part| load(panel, at(k, part))));
                for row in above.chunks_exact(STRIDE) {
                    let factors: &[f64; PANEL] = row[first..].first_chunk().expect("whole panels");
                    let octets = [0, 1].map(|part| load(row, at(0, part)));
                    for (sums, factor) in sums.iter_mut().zip(factors) {
                        let factor = O::splat(*factor);
                        for (sum, octet) in sums.iter_mut().zip(octets) {
                            *sum = sum.minus_product(factor, octet);
                        }
                    }
                }
                for (k, sums) in sums.into_iter().enumerate() {
                    for (part, sum) in sums.into_iter().enumerate() {
                        sum.store(panel[at(k, part)..].first_chunk_mut().expect("whole octets"));
                    }
                }
            }
            for k in 0..count {
                let (above, row) = panel.split_at_mut(k * STRIDE);
                let row = &mut row.as_chunks_mut().0[start..end];
                for above in above.chunks_exact(STRIDE) {
                    let factor = O::splat(above[first + k]);
                    for (row, above) in row.iter_mut().zip(&above.as_chunks().0[start..end]) {
                        O::load(row).minus_product(factor, O::load(above)).store(row);
                    }
                }
                let pivot = row[0][first + k - start * LANES];
                if pivot <= dependent * squares[first + k] {
                    return first + k;
                }
                let scale = O::splat(1.0 / pivot.sqrt());
                for row in row {
                    O::load(row).times(scale).store(row);
                }
            }
        }
        size
    }
}

octets! {
    /// values -= factor row, for the rows that begin at `places`.
    pub fn subtract_rows<O>(values: &mut [f64], rows: &[f64], places: &[usize], factors: &[f64]) {
        for (group, values) in values.as_chunks_mut().0.iter_mut().enumerate() {
            let (mut even, mut odd) = (O::load(values), O::splat(0.0));
            let row = |place: usize| {
                O::load(rows[place + group * LANES..].first_chunk().expect("whole octets"))
            };
            let ((pairs, place), (factor_pairs, factor)) = (places.as_chunks::<2>(), factors.as_chunks::<2>());
            for (places, factors) in pairs.iter().zip(factor_pairs) {
                even = even.minus_product(O::splat(factors[0]), row(places[0]));
                odd = odd.minus_product(O::splat(factors[1]), row(places[1]));
            }
            for (place, factor) in place.iter().zip(factor) {
                even = even.minus_product(O::splat(*factor), row(*place));
            }
            even.plus(odd).store(values);
        }
    }
}

multiversion! {
    /// Solves R z = z in place.
    fn backward(r: &[f64], z: &mut [f64]) {
        let size = z.len();
        for k in (0..size).rev() {
            let row = &r[k * STRIDE..][..size];
            z[k] = (z[k] - dot(&row[k + 1..], &z[k + 1..])) / row[k];
        }
    }
}

#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    for (a, b) in a.iter().zip(b) {
        for i in 0..LANES {
            sums[i] += a[i] * b[i];
        }
    }
    for half in [4, 2, 1] {
        for i in 0..half {
            sums[i] += sums[i + half];
        }
    }
    sums[0] + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns(count: usize, length: usize) -> Vec<Vec<f64>> {
        let mut state = 1u64;
        let mut next = move || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 40) as f64 / 1e7 - 0.5
        };
        (0..count)
            .map(|_| (0..length).map(|_| next()).collect())
            .collect()
    }

    fn gram(columns: &[Vec<f64>]) -> Vec<f64> {
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum();
        columns
            .iter()
            .flat_map(|a| columns.iter().map(move |b| product(a, b)))
            .collect()
    }

    #[test]
    fn solves_any_part_of_a_matrix() {
        for level in Level::available() {
            for count in [1, 2, 4, 7, 8, 9, 40] {
                let rows = gram(&columns(count, 60));
                let set: Vec<u32> = (0..count as u32).filter(|j| j % 3 != 1).collect();
                let places: Vec<usize> = set.iter().map(|&j| j as usize * count).collect();
                let right: Vec<f64> = (0..set.len()).map(|i| i as f64 - 3.0).collect();
                let mut z = right.clone();
                let mut factor = Factor::new(level);
                assert!(factor
                    .solve(&rows, &places, &set, &mut z, DEPENDENT)
                    .is_ok());
                for (place, right) in places.iter().zip(right) {
                    let terms = set.iter().zip(&z);
                    let left: f64 = terms.map(|(&j, z)| rows[place + j as usize] * z).sum();
                    assert!((left - right).abs() < 1e-8);
                }
            }
        }
    }

    #[test]
    fn names_the_combination_that_is_zero() {
        for level in Level::available() {
            let mut all = columns(7, 20);
            let sum = (0..20).map(|k| all[1][k] + 2.0 * all[3][k]).collect();
            all.insert(5, sum);
            let rows = gram(&all);
            let set: Vec<u32> = (0..8).collect();
            let places: Vec<usize> = (0..8).map(|j| 8 * j).collect();
            let mut factor = Factor::new(level);
            let solved = factor.solve(&rows, &places, &set, &mut [1.0; 8], DEPENDENT);
            assert_eq!(solved, Err(5));
            let mut way = Vec::new();
            factor.dependency(5, &mut way);
            for (way, expected) in way.iter().zip([0.0, -1.0, 0.0, -2.0, 0.0, 1.0]) {
                assert!((way - expected).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn subtracts_rows() {
        for level in Level::available() {
            let rows: Vec<f64> = (0..5 * 16).map(f64::from).collect();
            let mut values = vec![1.0; 16];
            subtract_rows(level, &mut values, &rows, &[16, 0, 48], &[2.0, -1.0, 0.5]);
            for (i, value) in values.iter().enumerate() {
                let i = i as f64;
                let expected = 1.0 - 2.0 * (16.0 + i) + i - 0.5 * (48.0 + i);
                assert!((value - expected).abs() < 1e-12);
            }
        }
    }
}
