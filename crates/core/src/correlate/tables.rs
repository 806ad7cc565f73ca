//! Which patterns share a table of partial sums, and the unit that its kernels need.
//!
//! Patterns that are `count` apart share a table, so that sums over tables are sums of vectors. A kernel
//! that keeps the sums of tables in bytes relies on `least_unit`, which `quantise` respects. Integer sums,
//! and so the scores, are the same for any choice of tables.

use crate::simd::{multiversion, Level};

/// Number of patterns of a table: 64 sums, which fill a register of bytes.
pub const PATTERNS: usize = 6;
/// Largest span of the sums of two tables, which a kernel adds in a byte.
const SPAN: f64 = 255.0;
/// Largest integer, for kernels that keep integers in signed bytes.
const LARGEST: f64 = 127.0;

/// The number of tables for `patterns`. It is even, as kernels read two tables at a time.
pub fn count(patterns: usize) -> usize {
    patterns.div_ceil(2 * PATTERNS) * 2
}

/// The smallest unit in which the values `e`, one for each pattern, are integers that all kernels can use,
/// if rounding changes each by up to `rounding` units.
pub fn least_unit(level: Level, e: &[f64], rounding: f64) -> f64 {
    let (span, largest) = extremes(level, e);
    (span / (SPAN - 2.0 * PATTERNS as f64 * rounding)).max(largest / LARGEST)
}

multiversion! {
    /// The largest span of the sums of two adjacent tables, and the largest value.
    fn extremes(e: &[f64]) -> (f64, f64) {
        const PART: usize = 32;
        let tables = count(e.len());
        let (mut widest, mut largest) = (0.0, [0.0; PART]);
        for first in (0..tables).step_by(PART) {
            let mut spans = [0.0; PART];
            for e in e.chunks(tables) {
                let e = &e[first.min(e.len())..(first + PART).min(e.len())];
                for ((span, largest), e) in spans.iter_mut().zip(&mut largest).zip(e) {
                    *span += e.abs();
                    *largest = if e.abs() > *largest { e.abs() } else { *largest };
                }
            }
            for [a, b] in spans.as_chunks::<2>().0 {
                widest = if a + b > widest { a + b } else { widest };
            }
        }
        (widest, largest.iter().copied().fold(0.0, f64::max))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::Level;

    #[test]
    fn integers_in_the_least_unit_fit_the_kernels() {
        for patterns in [1, 5, 12, 13, 100, 400] {
            let mut e: Vec<f64> = (0..patterns).map(|k| (k as f64 * 1.3).cos()).collect();
            for alone in [1.0, 100.0] {
                e[patterns / 2] *= alone;
                let tables = count(patterns);
                assert!(tables.is_multiple_of(2) && PATTERNS * tables >= patterns);
                for (level, rounding) in Level::available().into_iter().zip([0.0, 0.5].repeat(2)) {
                    let unit = least_unit(level, &e, rounding);
                    let size = |e: &f64| e.abs() / unit + rounding;
                    let sums: Vec<f64> = (0..tables)
                        .map(|t| e.iter().skip(t).step_by(tables).map(size).sum())
                        .collect();
                    let widest = sums
                        .as_chunks()
                        .0
                        .iter()
                        .map(|[a, b]| a + b)
                        .fold(0.0, f64::max);
                    let largest = e.iter().map(|e| e.abs() / unit).fold(0.0, f64::max);
                    assert!(widest <= SPAN + 1e-9 && largest <= LARGEST + 1e-9);
                    assert!(widest >= SPAN - 6.0 || largest >= LARGEST - 1e-9);
                }
            }
        }
    }
}
