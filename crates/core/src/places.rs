//! Sparse rows whose entries lie at fixed places: their samples under patterns, and the adjoint.

use crate::simd::{multiversion, Level};
use rayon::prelude::*;

/// Rows that one thread works on at a time, enough to hide the cost of starting a task.
const TASK: usize = 64;

/// The places of m rows, and the patterns at them.
#[derive(Clone, Copy)]
pub struct Places<'a> {
    /// Where each row begins among the places, (m + 1).
    starts: &'a [i64],
    /// The pixel of each place.
    pixels: &'a [u32],
    /// The patterns by pixel, (N, K).
    columns: &'a [f32],
    count: usize,
}

impl<'a> Places<'a> {
    /// # Panics
    /// If starts descend, or do not fit the pixels; if pixels do not fit the columns.
    pub fn new(starts: &'a [i64], pixels: &'a [u32], columns: &'a [f32], count: usize) -> Self {
        assert!(count > 0 && columns.len().is_multiple_of(count));
        assert_eq!(starts.first(), Some(&0));
        assert_eq!(starts.last(), Some(&(pixels.len() as i64)));
        assert!(starts.windows(2).all(|pair| pair[0] <= pair[1]));
        let most = columns.len() / count;
        assert!(pixels.iter().all(|&pixel| (pixel as usize) < most));
        Places {
            starts,
            pixels,
            columns,
            count,
        }
    }

    fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    fn column(&self, place: usize) -> &'a [f32] {
        let first = self.pixels[place] as usize * self.count;
        &self.columns[first..first + self.count]
    }

    fn places(&self, row: usize) -> std::ops::Range<usize> {
        self.starts[row] as usize..self.starts[row + 1] as usize
    }

    /// The light of each row under each pattern, (m, K), of light at the places.
    ///
    /// # Panics
    /// If the lengths do not fit.
    pub fn shown(&self, light: &[f32], out: &mut [f32]) {
        assert_eq!(light.len(), self.pixels.len());
        assert_eq!(out.len(), self.rows() * self.count);
        let level = Level::detect();
        let tasks = out.par_chunks_mut(TASK * self.count).enumerate();
        tasks.for_each(|(task, out)| {
            for (row, out) in out.chunks_exact_mut(self.count).enumerate() {
                out.fill(0.0);
                for place in self.places(task * TASK + row) {
                    if light[place] != 0.0 {
                        add(level, out, light[place], self.column(place));
                    }
                }
            }
        });
    }

    /// The adjoint: what each place has of samples of each row, (m, K).
    ///
    /// # Panics
    /// If the lengths do not fit.
    pub fn gathered(&self, samples: &[f32], out: &mut [f32]) {
        assert_eq!(samples.len(), self.rows() * self.count);
        assert_eq!(out.len(), self.pixels.len());
        let level = Level::detect();
        let (mut rest, mut tasks) = (out, Vec::with_capacity(self.rows().div_ceil(TASK)));
        for first in (0..self.rows()).step_by(TASK) {
            let rows = first..(first + TASK).min(self.rows());
            let length = (self.starts[rows.end] - self.starts[first]) as usize;
            let (own, others) = std::mem::take(&mut rest).split_at_mut(length);
            tasks.push((rows, own));
            rest = others;
        }
        tasks.into_par_iter().for_each(|(rows, out)| {
            let first = self.starts[rows.start] as usize;
            for row in rows {
                let samples = &samples[row * self.count..(row + 1) * self.count];
                for place in self.places(row) {
                    out[place - first] = dot(level, samples, self.column(place));
                }
            }
        });
    }
}

multiversion! {
    /// out += factor column
    fn add(out: &mut [f32], factor: f32, column: &[f32]) {
        for (out, value) in out.iter_mut().zip(column) {
            *out += factor * value;
        }
    }
}

multiversion! {
    /// sum a b
    fn dot(a: &[f32], b: &[f32]) -> f32 {
        let mut sums = [0f32; 16];
        let (whole, rest) = a.split_at(a.len() / 16 * 16);
        for (a, b) in whole.chunks_exact(16).zip(b.chunks_exact(16)) {
            for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
                *sum += a * b;
            }
        }
        let rest: f32 = rest.iter().zip(&b[whole.len()..]).map(|(a, b)| a * b).sum();
        sums.iter().sum::<f32>() + rest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(i: usize) -> f32 {
        ((i * 37 + 11) % 23) as f32 / 10.0 - 0.9
    }

    #[test]
    fn samples_and_the_adjoint_are_those_of_the_definition() {
        for (pixels, count, rows) in [(5, 3, 1), (40, 37, 150), (7, 16, 64), (3, 1, 2)] {
            let columns: Vec<f32> = (0..pixels * count).map(value).collect();
            let own: Vec<Vec<u32>> = (0..rows)
                .map(|row| {
                    (0..pixels as u32)
                        .filter(|p| !(p + row as u32).is_multiple_of(3))
                        .collect()
                })
                .collect();
            let mut starts = vec![0i64];
            starts.extend(own.iter().scan(0, |sum, places| {
                *sum += places.len() as i64;
                Some(*sum)
            }));
            let at: Vec<u32> = own.concat();
            let places = Places::new(&starts, &at, &columns, count);
            let light: Vec<f32> = (0..at.len()).map(|i| value(i).max(0.0)).collect();
            let mut shown = vec![f32::NAN; rows * count];
            places.shown(&light, &mut shown);
            let samples: Vec<f32> = (0..rows * count).map(value).collect();
            let mut gathered = vec![f32::NAN; at.len()];
            places.gathered(&samples, &mut gathered);
            let column = |place: usize, k: usize| columns[at[place] as usize * count + k];
            for row in 0..rows {
                for k in 0..count {
                    let sum: f32 = places.places(row).map(|p| light[p] * column(p, k)).sum();
                    assert!((shown[row * count + k] - sum).abs() < 1e-4);
                }
                for p in places.places(row) {
                    let sum: f32 = (0..count)
                        .map(|k| samples[row * count + k] * column(p, k))
                        .sum();
                    assert!((gathered[p] - sum).abs() < 1e-4);
                }
            }
        }
    }
}
