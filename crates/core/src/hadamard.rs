//! The fast Walsh-Hadamard transform, natural (Sylvester) order, not normalised.

use crate::float::Float;
use rayon::prelude::*;

/// Transforms every row of `values` in place; rows have `length` values, a power of two.
///
/// # Panics
/// If `length` is not a power of two or does not divide the number of values.
pub fn transform<T: Float>(values: &mut [T], length: usize) {
    assert!(length.is_power_of_two());
    assert_eq!(values.len() % length, 0);
    values.par_chunks_mut(length).for_each(transform_row);
}

fn transform_row<T: Float>(row: &mut [T]) {
    let mut half = 1;
    while half < row.len() {
        for pair in row.chunks_exact_mut(2 * half) {
            let (low, high) = pair.split_at_mut(half);
            for (a, b) in low.iter_mut().zip(high) {
                let (sum, difference) = (*a + *b, *a - *b);
                *a = sum;
                *b = difference;
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_the_matrix() {
        for length in [1usize, 2, 8, 64] {
            let values: Vec<f64> = (0..length).map(|i| (i * i % 17) as f64 - 5.0).collect();
            let mut fast = values.clone();
            transform(&mut fast, length);
            for (row, &got) in fast.iter().enumerate() {
                let expected: f64 = values
                    .iter()
                    .enumerate()
                    .map(|(col, v)| {
                        if (row & col).count_ones() % 2 == 0 {
                            *v
                        } else {
                            -*v
                        }
                    })
                    .sum();
                assert!((got - expected).abs() < 1e-9);
            }
        }
    }
}
