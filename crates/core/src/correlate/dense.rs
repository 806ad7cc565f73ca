//! The pass over patterns of any values: float32 products, rounded to scores.

use super::quantise::{largest, MAGIC};
use super::scores::Scores;
use crate::columns::Columns;
use crate::simd::{multiversion, Level};
use crate::vector::{signed_sums, summed};

pub struct Dense;

/// The buffers of one thread: rows and their products, in float32.
#[derive(Default)]
pub struct Buffers {
    rows: Vec<f32>,
    values: Vec<f32>,
}

/// Number of independent partial sums: one AVX-512 register of float32.
const SUMS: usize = 16;
/// Number of columns that all rows are multiplied with before the next ones, while these are in the cache.
const BLOCK: usize = 64;
/// Largest score. It leaves room for rounding within 16 bits (32,767).
const LARGEST: f64 = 32_000.0;
/// Largest rounding error of a score, in units: a half, and 2 % for the rounding of the quotient.
const HALF: f64 = 0.51;

impl Dense {
    /// # Panics
    /// If the columns are not dense.
    #[allow(clippy::too_many_arguments)]
    pub fn run(
        &self,
        level: Level,
        columns: &Columns,
        patterns: usize,
        pixels: usize,
        e: &[&[f64]],
        out: &mut [&mut Scores],
        buffers: &mut Buffers,
    ) {
        let Columns::Dense(columns) = columns else {
            panic!("a dense pass needs dense columns");
        };
        let Buffers { rows, values } = buffers;
        rows.clear();
        rows.extend(e.iter().flat_map(|e| e.iter()).map(|&v| v as f32));
        values.resize(e.len() * pixels, 0.0);
        let length = e.first().map_or(1, |e| e.len());
        for first in (0..pixels).step_by(BLOCK) {
            let block = first..pixels.min(first + BLOCK);
            for (row, values) in rows
                .chunks_exact(length)
                .zip(values.chunks_exact_mut(pixels))
            {
                let columns = columns.block(block.clone());
                products(level, columns, row, &mut values[block.clone()]);
            }
        }
        for (row, ((out, e), values)) in out
            .iter_mut()
            .zip(e)
            .zip(values.chunks_exact(pixels.max(1)))
            .enumerate()
        {
            debug_assert!(e.len() >= summed(patterns), "row {row}");
            score(level, columns.largest(), patterns, e, values, out);
        }
    }
}

multiversion! {
    /// Inner products of a row with columns of its length.
    fn products(columns: &[f32], row: &[f32], out: &mut [f32]) {
        let (fours, rest) = out.as_chunks_mut::<4>();
        let (columns, last) = columns.split_at(4 * fours.len() * row.len());
        for (columns, out) in columns.chunks_exact(4 * row.len()).zip(fours) {
            *out = dots(columns, row);
        }
        for (column, out) in last.chunks_exact(row.len()).zip(rest) {
            [*out] = dots(column, row);
        }
    }
}

/// Inner products of columns side by side that share each reading of the row.
#[inline(always)]
fn dots<const C: usize>(columns: &[f32], row: &[f32]) -> [f32; C] {
    let each: [&[[f32; SUMS]]; C] =
        std::array::from_fn(|c| columns[c * row.len()..][..row.len()].as_chunks().0);
    let mut sums = [[0f32; SUMS]; C];
    for (place, e) in row.as_chunks::<SUMS>().0.iter().enumerate() {
        for (sums, column) in sums.iter_mut().zip(&each) {
            let a = &column[place];
            for i in 0..SUMS {
                sums[i] += a[i] * e[i];
            }
        }
    }
    sums.map(|mut sums| {
        for half in [8, 4, 2, 1] {
            for i in 0..half {
                sums[i] += sums[i + half];
            }
        }
        sums[0]
    })
}

multiversion! {
    fn to_nearest(values: &[f32], scale: f64, out: &mut [i16]) {
        for (out, value) in out.iter_mut().zip(values) {
            *out = (f64::from(*value) * scale + MAGIC).to_bits() as i16;
        }
    }
}

fn score(level: Level, most: f64, patterns: usize, e: &[f64], values: &[f32], out: &mut Scores) {
    let top = f64::from(largest(level, values));
    let (negative, positive) = signed_sums(level, e);
    let total = positive - negative;
    // Bound on the error of a float32 sum of products in any order (Higham 2002, Eq. 3.5), enlarged for
    // the rounding of e and for terms below the normal range.
    let error = most * total * (patterns + 4) as f64 * f64::from(f32::EPSILON) + 1e-30;
    out.unit = (top / LARGEST).max(error / LARGEST);
    out.offset = 0.0;
    (out.up, out.down) = (HALF + error / out.unit, HALF + error / out.unit);
    out.values[values.len()..].fill(0);
    to_nearest(level, values, 1.0 / out.unit, &mut out.values);
}
