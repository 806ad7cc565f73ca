//! A Cholesky factor that gains and loses columns: H = R'R with R upper triangular.
//!
//! Rows of R lie in memory one after the other. Gaining a column is a triangular solve, losing one
//! a sequence of Givens rotations (Golub & Van Loan 2013, 6.5.2); both are quadratic in the order.

use crate::simd::{multiversion, Level};

/// Largest order.
pub const LARGEST: usize = 256;
/// Rows are this far apart: no power of two, which would crowd one cache set.
const STRIDE: usize = LARGEST + 8;
/// Pivots below this share of their diagonal mean that a column depends on the others.
const DEPENDENT: f64 = 1e-10;
const SUMS: usize = 8;

pub struct Factor {
    level: Level,
    r: Vec<f64>,
    size: usize,
    column: Vec<f64>,
}

impl Factor {
    pub fn new(level: Level) -> Self {
        Factor {
            level,
            r: Vec::new(),
            size: 0,
            column: Vec::new(),
        }
    }

    pub fn clear(&mut self) {
        self.size = 0;
    }

    /// Takes in a column: its inner products with those there, in their order, and its own square.
    /// False, and nothing changes, if it depends on them or there is no room.
    pub fn push(&mut self, products: impl Iterator<Item = f64>, square: f64) -> bool {
        let size = self.size;
        if size == LARGEST {
            return false;
        }
        if self.r.len() < (size + 1) * STRIDE {
            self.r.resize((size + 1) * STRIDE, 0.0);
        }
        self.column.clear();
        self.column.extend(products);
        assert_eq!(self.column.len(), size);
        let rest = square - forward(self.level, &self.r, &mut self.column);
        if rest <= DEPENDENT * square {
            return false;
        }
        for (k, value) in self.column.iter().enumerate() {
            self.r[k * STRIDE + size] = *value;
        }
        self.r[size * STRIDE + size] = rest.sqrt();
        self.size += 1;
        true
    }

    /// Loses the column at a place; those after it move up.
    pub fn remove(&mut self, place: usize) {
        assert!(place < self.size);
        remove(self.level, &mut self.r, self.size, place);
        self.size -= 1;
    }

    /// Solves H z = right, in place.
    pub fn solve(&self, right: &mut [f64]) {
        assert_eq!(right.len(), self.size);
        forward(self.level, &self.r, right);
        backward(self.level, &self.r, right);
    }
}

multiversion! {
    /// Solves R' z = z in place and returns the sum of squares.
    fn forward(r: &[f64], z: &mut [f64]) -> f64 {
        let mut square = 0.0;
        for k in 0..z.len() {
            let row = &r[k * STRIDE..][..z.len()];
            let value = z[k] / row[k];
            z[k] = value;
            square += value * value;
            for (z, r) in z[k + 1..].iter_mut().zip(&row[k + 1..]) {
                *z -= value * r;
            }
        }
        square
    }
}

multiversion! {
    /// Solves R z = z in place.
    fn backward(r: &[f64], z: &mut [f64]) {
        for k in (0..z.len()).rev() {
            let row = &r[k * STRIDE..][..z.len()];
            z[k] = (z[k] - dot(&row[k + 1..], &z[k + 1..])) / row[k];
        }
    }
}

multiversion! {
    fn remove(r: &mut [f64], size: usize, place: usize) {
        for k in 0..size {
            let from = k.max(place + 1);
            r.copy_within(k * STRIDE + from..k * STRIDE + size, k * STRIDE + from - 1);
        }
        for k in place..size - 1 {
            let (upper, lower) = r[k * STRIDE..].split_at_mut(STRIDE);
            let (upper, lower) = (&mut upper[k..size - 1], &mut lower[k..size - 1]);
            let (a, b) = (upper[0], lower[0]);
            let length = (a * a + b * b).sqrt();
            let (cosine, sine) = (a / length, b / length);
            for (upper, lower) in upper.iter_mut().zip(lower) {
                let (a, b) = (*upper, *lower);
                *upper = cosine * a + sine * b;
                *lower = cosine * b - sine * a;
            }
        }
    }
}

#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; SUMS];
    let (a, b) = (a.chunks_exact(SUMS), b.chunks_exact(SUMS));
    let tail = a.remainder().iter().zip(b.remainder());
    let rest: f64 = tail.map(|(a, b)| a * b).sum();
    for (a, b) in a.zip(b) {
        for i in 0..SUMS {
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

    fn product(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    }

    #[test]
    fn solves_after_gains_and_losses() {
        for level in Level::available() {
            let all = columns(40, 60);
            let mut factor = Factor::new(level);
            let mut kept: Vec<usize> = Vec::new();
            for j in 0..40 {
                let products = kept.iter().map(|&i| product(&all[i], &all[j]));
                assert!(factor.push(products, product(&all[j], &all[j])));
                kept.push(j);
                if j % 3 == 2 {
                    let place = j * 7 % kept.len();
                    factor.remove(place);
                    kept.remove(place);
                }
            }
            let right: Vec<f64> = (0..kept.len()).map(|i| i as f64 - 3.0).collect();
            let mut z = right.clone();
            factor.solve(&mut z);
            for (i, right) in kept.iter().zip(right) {
                let left: f64 = kept
                    .iter()
                    .zip(&z)
                    .map(|(j, z)| product(&all[*i], &all[*j]) * z)
                    .sum();
                assert!((left - right).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn refuses_a_dependent_column() {
        let mut factor = Factor::new(Level::detect());
        assert!(factor.push(std::iter::empty(), 4.0));
        assert!(!factor.push(std::iter::once(6.0), 9.0));
        let mut z = [8.0];
        factor.solve(&mut z);
        assert_eq!(z, [2.0]);
    }
}
