//! Columns of values in [0, 1] as 16-bit fixed-point numbers: half the memory of float32.
//!
//! The rounding error is at most half a step of 1/65535, far below any camera's noise.

use crate::simd::{multiversion, Level};
use crate::vector::{add_terms, fold, LANES, SUMS};

/// The 16-bit number that stands for 1.
const STEPS: f32 = 65_535.0;

/// Columns side by side, each padded to `stride` values.
pub struct WordColumns {
    values: Vec<u16>,
    stride: usize,
}

impl WordColumns {
    /// The largest rounding error of a value: half a step, and 2 % more for the rounding of the product
    /// with the step.
    pub const LOST: f64 = 0.51 / STEPS as f64;

    /// From words side by side, each column padded to `stride` of them.
    ///
    /// # Panics
    /// If `values` does not hold whole columns.
    pub fn from_padded(values: Vec<u16>, stride: usize) -> Self {
        assert!(values.len().is_multiple_of(stride.max(1)));
        WordColumns { values, stride }
    }

    pub fn column(&self, pixel: u32) -> &[u16] {
        &self.values[pixel as usize * self.stride..][..self.stride]
    }

    /// a_j . e
    pub fn correlate(&self, level: Level, pixel: u32, e: &[f64]) -> f64 {
        word_dot(level, self.column(pixel), e) / f64::from(STEPS)
    }

    /// out = factor a_j
    pub fn copy_scaled(&self, level: Level, pixel: u32, factor: f32, out: &mut [f32]) {
        word_copy(level, self.column(pixel), factor / STEPS, out);
    }

    /// u += factor a_j
    pub fn add(&self, level: Level, pixel: u32, factor: f64, u: &mut [f64]) {
        word_add(level, self.column(pixel), factor / f64::from(STEPS), u);
    }

    /// u += factor a_j for all `terms` (j, factor), in their order.
    pub fn add_all_f32(&self, level: Level, terms: &[(u32, f32)], u: &mut [f32]) {
        word_sums(level, &self.values, self.stride, terms, u);
    }

    /// out = d a_j, element by element.
    pub fn scaled(&self, level: Level, pixel: u32, d: &[f64], out: &mut [f64]) {
        word_product(level, self.column(pixel), d, out);
    }
}

multiversion! {
    /// Rounds values in [0, 1] to the nearest 16-bit numbers.
    pub fn to_words(values: &[f32], out: &mut [u16]) {
        for (out, value) in out.iter_mut().zip(values) {
            // Numbers beside 2^23 have a step of 1, so that the last bits of this sum are the nearest
            // number. Conversions that look for overflows take three times as long.
            *out = (value.clamp(0.0, 1.0) * STEPS + 8_388_608.0).to_bits() as u16;
        }
    }
}

multiversion! {
    fn word_dot(column: &[u16], e: &[f64]) -> f64 {
        let mut sums = [0.0; SUMS];
        for (a, e) in column.chunks_exact(SUMS).zip(e.chunks_exact(SUMS)) {
            for i in 0..SUMS {
                sums[i] += f64::from(a[i]) * e[i];
            }
        }
        fold(sums)
    }
}

multiversion! {
    fn word_copy(column: &[u16], factor: f32, out: &mut [f32]) {
        for (out, a) in out.iter_mut().zip(column) {
            *out = factor * f32::from(*a);
        }
    }
}

multiversion! {
    fn word_add(column: &[u16], factor: f64, u: &mut [f64]) {
        for (a, u) in column.iter().zip(u) {
            *u += f64::from(*a) * factor;
        }
    }
}

multiversion! {
    fn word_sums(words: &[u16], stride: usize, terms: &[(u32, f32)], u: &mut [f32]) {
        for (block, u) in u.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            let sums = add_terms(words, stride, block, terms, [0.0; LANES]);
            for i in 0..LANES {
                u[i] += sums[i] * (1.0 / STEPS);
            }
        }
    }
}

multiversion! {
    fn word_product(column: &[u16], d: &[f64], out: &mut [f64]) {
        for ((a, d), out) in column.iter().zip(d).zip(out) {
            *out = f64::from(*a) / f64::from(STEPS) * d;
        }
    }
}
