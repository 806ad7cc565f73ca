//! Coordinate descent on the pixels that move, side by side in memory.
//!
//! Within a block of eight, slopes stay in one register and a move is a permutation away from the
//! next, which takes half the time of going through memory; the other slopes learn of eight moves
//! at once.

#[cfg(target_arch = "x86_64")]
mod avx512;

use super::model::Model;
use crate::octet::WIDTH;
use crate::simd::{multiversion, Kind, Level};

/// A part of a quadratic model: some pixels' rows and columns, padded to whole blocks.
///
/// In units of each pixel's own diagonal, so that a pixel's best move is max(pull, -x).
#[derive(Default)]
pub struct Packed {
    /// Columns over their diagonals.
    matrix: Vec<f64>,
    inverse: Vec<f64>,
    diagonal: Vec<f64>,
    /// 2 lambda over the diagonal.
    band: Vec<f64>,
    pub x: Vec<f64>,
    /// (slope - lambda) over the diagonal.
    pull: Vec<f64>,
    /// Which pixels of each octet take part.
    groups: Vec<u8>,
}

impl Packed {
    pub fn load(&mut self, model: &Model, set: &[u32], lambda: f64, target: &[f64], slope: &[f64]) {
        let size = set.len().next_multiple_of(WIDTH);
        for buffer in [
            &mut self.inverse,
            &mut self.diagonal,
            &mut self.band,
            &mut self.x,
            &mut self.pull,
        ] {
            buffer.clear();
            buffer.resize(size, 0.0);
        }
        // Room for one octet behind the last row.
        self.matrix.resize(size * size + WIDTH, 0.0);
        for (i, &j) in set.iter().enumerate() {
            let j = j as usize;
            let inverse = model.inverse[j];
            self.inverse[i] = inverse;
            self.diagonal[i] = model.diagonal[j];
            self.band[i] = 2.0 * lambda * inverse;
            self.x[i] = target[j];
            self.pull[i] = (slope[j] - lambda) * inverse;
        }
        self.gather(model, set);
    }

    fn gather(&mut self, model: &Model, set: &[u32]) {
        #[cfg(target_arch = "x86_64")]
        if model.level.kind() == Kind::Avx512 {
            self.groups.clear();
            self.groups.resize(model.stride / WIDTH, 0);
            for &j in set {
                self.groups[j as usize / WIDTH] |= 1 << (j as usize % WIDTH);
            }
            let size = self.inverse.len();
            for (i, &j) in set.iter().enumerate() {
                let (row, out) = (
                    model.row(j as usize),
                    &mut self.matrix[i * size..][..size + WIDTH],
                );
                assert!(row.len() == WIDTH * self.groups.len() && model.inverse.len() == row.len());
                // SAFETY: the level proves the instructions; a row has eight values a group, and
                // the groups have `set.len()` <= size bits.
                unsafe { avx512::compress(row, &model.inverse, &self.groups, size, out) };
            }
            return;
        }
        gather_plain(
            model.level,
            &mut self.matrix,
            &model.rows,
            &model.slot,
            model.stride,
            set,
            &self.inverse,
        );
    }

    /// Sweeps until no slope changes by more than `settled`, at most `most` times; returns the last
    /// change.
    pub fn sweep(&mut self, level: Level, signed: bool, settled: f64, most: usize) -> f64 {
        let size = self.x.len();
        assert!(self.matrix.len() >= size * size && self.pull.len() == size);
        assert!(self.band.len() == size && self.diagonal.len() == size);
        let mut change = f64::INFINITY;
        for _ in 0..most {
            change = match level.kind() {
                #[cfg(target_arch = "x86_64")]
                // SAFETY: the level proves the instructions; the lengths were just compared.
                Kind::Avx512 => unsafe {
                    avx512::sweep(
                        &self.matrix,
                        &self.diagonal,
                        &self.band,
                        signed,
                        &mut self.x,
                        &mut self.pull,
                    )
                },
                _ => sweep_plain(
                    level,
                    &self.matrix,
                    &self.diagonal,
                    &self.band,
                    signed,
                    &mut self.x,
                    &mut self.pull,
                ),
            };
            if change <= settled {
                break;
            }
        }
        change
    }
}

multiversion! {
    fn gather_plain(
        matrix: &mut [f64],
        rows: &[f64],
        slot: &[u32],
        stride: usize,
        set: &[u32],
        inverse: &[f64],
    ) {
        let size = inverse.len();
        // No pixel may take part.
        for (i, out) in matrix.chunks_exact_mut(size.max(1)).enumerate() {
            let Some(&j) = set.get(i) else {
                break;
            };
            let row = &rows[slot[j as usize] as usize * stride..][..stride];
            for (out, &j) in out.iter_mut().zip(set) {
                *out = row[j as usize];
            }
            for (out, inverse) in out.iter_mut().zip(inverse) {
                *out *= inverse;
            }
        }
    }
}

multiversion! {
    fn sweep_plain(
        matrix: &[f64],
        diagonal: &[f64],
        band: &[f64],
        signed: bool,
        x: &mut [f64],
        pull: &mut [f64],
    ) -> f64 {
        let size = x.len();
        let mut change: f64 = 0.0;
        for j in 0..size {
            let back = -x[j];
            let back = if signed { back.min(pull[j] + band[j]) } else { back };
            let moved = back.max(pull[j]);
            if moved != 0.0 {
                x[j] += moved;
                change = change.max(moved.abs() * diagonal[j]);
                for (pull, row) in pull.iter_mut().zip(&matrix[j * size..][..size]) {
                    *pull -= moved * row;
                }
            }
        }
        change
    }
}

#[cfg(test)]
mod tests;
