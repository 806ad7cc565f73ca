//! Rows times a matrix. The result for a row does not depend on the other rows, bit for bit, which BLAS
//! does not guarantee.

use crate::simd::{multiversion, Level};
use rayon::prelude::*;

/// Rows that one thread multiplies at a time, enough to hide the cost of starting a task.
const TASK: usize = 64;

/// out = rows matrix, with rows (m, n), matrix (n, `width`) and out (m, `width`).
///
/// # Panics
/// If the lengths do not fit.
pub fn rows_times(rows: &[f32], matrix: &[f32], width: usize, out: &mut [f32]) {
    let inner = matrix.len().checked_div(width).unwrap_or(0);
    assert_eq!(matrix.len(), inner * width);
    out.fill(0.0);
    if inner == 0 {
        return;
    }
    assert_eq!(rows.len() * width, out.len() * inner);
    let level = Level::detect();
    (rows
        .par_chunks(TASK * inner)
        .zip(out.par_chunks_mut(TASK * width)))
    .for_each(|(rows, out)| {
        for (row, out) in rows.chunks_exact(inner).zip(out.chunks_exact_mut(width)) {
            row_times(level, row, matrix, out);
        }
    });
}

multiversion! {
    /// out += row matrix
    fn row_times(row: &[f32], matrix: &[f32], out: &mut [f32]) {
        for (factor, line) in row.iter().zip(matrix.chunks_exact(out.len())) {
            for (out, value) in out.iter_mut().zip(line) {
                *out += factor * value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_the_sum_over_the_inner_side_whatever_the_other_rows() {
        let value = |i: usize| ((i * 37 + 11) % 23) as f32 - 9.0;
        for (count, inner, width) in [(1, 1, 1), (3, 5, 2), (130, 7, 9), (2, 0, 4), (0, 3, 2)] {
            let rows: Vec<f32> = (0..count * inner).map(value).collect();
            let matrix: Vec<f32> = (0..inner * width).map(value).collect();
            let mut out = vec![f32::NAN; count * width];
            rows_times(&rows, &matrix, width, &mut out);
            for i in 0..count {
                for k in 0..width {
                    let sum: f32 = (0..inner)
                        .map(|j| rows[i * inner + j] * matrix[j * width + k])
                        .sum();
                    assert_eq!(out[i * width + k], sum);
                }
            }
        }
    }
}
