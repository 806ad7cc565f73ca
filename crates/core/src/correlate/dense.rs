//! Patterns of any values: float32 products, then scores.

use super::scores::Scores;
use crate::columns::{Columns, DenseColumns};
use crate::simd::{multiversion, Level};
use crate::vector::padded;

pub struct Dense;

const SUMS: usize = 16;
/// Scores go up to this, so that rounding cannot leave 16 bits.
const LARGEST: f64 = 32_000.0;

impl Dense {
    /// # Panics
    /// If the columns are not dense.
    pub fn run(
        &self,
        level: Level,
        columns: &Columns,
        patterns: usize,
        pixels: usize,
        e: &[&[f64]],
        out: &mut [&mut Scores],
    ) {
        let Columns::Dense(columns) = columns else {
            panic!("a dense pass needs dense columns");
        };
        let rows: Vec<Vec<f32>> = e
            .iter()
            .map(|e| e.iter().map(|&v| v as f32).collect())
            .collect();
        let mut values = vec![0f32; rows.len() * pixels];
        match &rows[..] {
            [a] => products(level, columns, [a], &mut values),
            [a, b] => products(level, columns, [a, b], &mut values),
            [a, b, c] => products(level, columns, [a, b, c], &mut values),
            _ => return,
        }
        for (row, ((out, e), values)) in out
            .iter_mut()
            .zip(e)
            .zip(values.chunks_exact(pixels.max(1)))
            .enumerate()
        {
            debug_assert_eq!(e.len(), padded(patterns), "row {row}");
            score(columns.largest(), patterns, e, values, out);
        }
    }
}

fn products<const R: usize>(
    level: Level,
    columns: &DenseColumns,
    rows: [&Vec<f32>; R],
    out: &mut [f32],
) {
    let pixels = out.len() / R;
    for pixel in 0..pixels {
        let mut sums = [[0f32; SUMS]; R];
        let column = columns.column(pixel as u32);
        for (r, sums) in sums.iter_mut().enumerate() {
            dot(level, column, rows[r], sums);
            out[r * pixels + pixel] = sums.iter().sum();
        }
    }
}

multiversion! {
    fn dot(column: &[f32], row: &[f32], sums: &mut [f32; SUMS]) {
        let mut total = *sums;
        for (a, e) in column.chunks_exact(SUMS).zip(row.chunks_exact(SUMS)) {
            for i in 0..SUMS {
                total[i] += a[i] * e[i];
            }
        }
        *sums = total;
    }
}

fn score(largest: f64, patterns: usize, e: &[f64], values: &[f32], out: &mut Scores) {
    let top = f64::from(values.iter().fold(0f32, |m, v| m.max(v.abs())));
    let total: f64 = e.iter().map(|v| v.abs()).sum();
    // The error of a float32 sum of products, whatever their order (Higham 2002, Eq. 3.5), with
    // room for the rounding of e and for terms below the normal range.
    let error = largest * total * (patterns + 4) as f64 * f64::from(f32::EPSILON) + 1e-30;
    out.unit = (top / LARGEST).max(error / LARGEST);
    out.offset = 0.0;
    (out.up, out.down) = (0.51 + error / out.unit, 0.51 + error / out.unit);
    let scale = 1.0 / out.unit;
    out.values.fill(0);
    for (out, value) in out.values.iter_mut().zip(values) {
        *out = (f64::from(*value) * scale).round() as i16;
    }
}
