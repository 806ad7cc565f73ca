//! Which patterns share a table of partial sums.
//!
//! Patterns that are `count` apart do, so that sums over tables are sums of vectors. A kernel that
//! keeps a table's sums in bytes relies on what rounding promises of them (`quantise`); to all others
//! the sums of integers are the same whatever the tables are.

use crate::simd::multiversion;

/// Patterns a table.
pub const PATTERNS: usize = 6;
/// Most that the sums of a table may span.
pub const SPAN: f64 = 255.0;

/// Tables of so many patterns: an even number, for kernels take two at a time.
pub fn count(patterns: usize) -> usize {
    patterns.div_ceil(2 * PATTERNS) * 2
}

multiversion! {
    /// The largest span that the sums of any table have, of values `e`, one a pattern.
    pub fn largest_span(e: &[f64]) -> f64 {
        const PART: usize = 32;
        let tables = count(e.len());
        let mut most = 0.0;
        for first in (0..tables).step_by(PART) {
            let mut spans = [0.0; PART];
            for e in e.chunks(tables) {
                let e = &e[first.min(e.len())..(first + PART).min(e.len())];
                for (span, e) in spans.iter_mut().zip(e) {
                    *span += e.abs();
                }
            }
            most = spans.iter().fold(most, |most, &span| if span > most { span } else { most });
        }
        most
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::Level;

    #[test]
    fn spans_are_those_of_patterns_that_share_a_table() {
        for patterns in [1, 5, 12, 13, 100, 400] {
            let e: Vec<f64> = (0..patterns).map(|k| (k as f64 * 1.3).sin()).collect();
            let tables = count(patterns);
            assert!(tables.is_multiple_of(2) && PATTERNS * tables >= patterns);
            let span = |t: usize| e.iter().skip(t).step_by(tables).map(|e| e.abs()).sum();
            let expected = (0..tables).map(span).fold(0.0, f64::max);
            for level in Level::available() {
                assert!((largest_span(level, &e) - expected).abs() < 1e-12);
            }
        }
    }
}
