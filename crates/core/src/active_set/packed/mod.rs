//! Coordinate descent on the pixels that move, side by side in memory.
//!
//! Within a block of eight, slopes stay in one register and a move is a permutation away from the
//! next, which takes half the time of going through memory; the other slopes learn of eight moves
//! at once.

#[cfg(target_arch = "x86_64")]
mod avx512;

use super::model::Model;
use crate::octet::{set_bits, WIDTH};
use crate::simd::{multiversion, Kind, Level};

/// How far beyond its best value a pixel goes: where columns nearly depend on each other that takes
/// fewer sweeps. Any factor below 2 lowers the model's value at every move; where x may have
/// both signs, moves that end at zero are no longer one maximum, so there it is 1.
const RELAXATION: f64 = 1.3;
/// So few pixels come to their best values at once, one pixel in one move.
const FEW: usize = 16;

/// A part of a quadratic model: some pixels' rows and columns, padded to whole blocks.
///
/// In units of each pixel's own diagonal, so that a pixel's move is max(pull, -x).
#[derive(Default)]
pub struct Packed {
    /// The pixels, ascending,
    pub set: Vec<u32>,
    /// and their bits.
    chosen: Vec<u8>,
    /// Columns over their relaxed diagonals.
    matrix: Vec<f64>,
    /// The inverse diagonals, times the relaxation: of the model, and of the pixels.
    relaxed: Vec<f64>,
    inverse: Vec<f64>,
    diagonal: Vec<f64>,
    /// 2 lambda over the relaxed diagonal.
    band: Vec<f64>,
    pub x: Vec<f64>,
    /// (slope - lambda) over the relaxed diagonal.
    pull: Vec<f64>,
}

impl Packed {
    /// Takes on the pixels whose bits are set.
    pub fn load(
        &mut self,
        model: &Model,
        chosen: &[u8],
        lambda: f64,
        signed: bool,
        target: &[f64],
        slope: &[f64],
    ) {
        self.chosen.clear();
        self.chosen.extend_from_slice(chosen);
        self.set.clear();
        for (group, &bits) in chosen.iter().enumerate() {
            let first = (group * WIDTH) as u32;
            self.set.extend(set_bits(bits).map(|place| first + place));
        }
        let relaxation = if signed || self.set.len() <= FEW {
            1.0
        } else {
            RELAXATION
        };
        self.relaxed.clear();
        self.relaxed
            .extend(model.inverse.iter().map(|inverse| relaxation * inverse));
        for (values, out) in [
            (&self.relaxed[..], &mut self.inverse),
            (&model.diagonal, &mut self.diagonal),
            (target, &mut self.x),
            (slope, &mut self.pull),
        ] {
            pick(model.level, values, &self.chosen, &self.set, out);
        }
        self.band.resize(self.inverse.len(), 0.0);
        let (pull, band) = (&mut self.pull, &mut self.band);
        in_units(model.level, &self.inverse, lambda, pull, band);
        self.gather(model);
    }

    /// Drops pixels that are at zero, as in `target`, and would stay there, if that saves a block.
    pub fn shrink(&mut self, model: &Model, target: &[f64]) {
        let stays = (0..self.set.len()).filter(|&i| self.counts(i, target));
        let size = stays.count().next_multiple_of(WIDTH);
        if size == self.x.len() {
            return;
        }
        let mut kept = 0;
        for i in 0..self.set.len() {
            let j = self.set[i];
            if self.counts(i, target) {
                self.set[kept] = j;
                for values in self.values() {
                    values[kept] = values[i];
                }
                kept += 1;
            } else {
                self.chosen[j as usize / WIDTH] &= !(1 << (j as usize % WIDTH));
            }
        }
        self.set.truncate(kept);
        for values in self.values() {
            values.truncate(kept);
            values.resize(size, 0.0);
        }
        self.gather(model);
    }

    /// One number for each pixel, padded.
    fn values(&mut self) -> [&mut Vec<f64>; 5] {
        [
            &mut self.inverse,
            &mut self.diagonal,
            &mut self.band,
            &mut self.x,
            &mut self.pull,
        ]
    }

    fn counts(&self, i: usize, target: &[f64]) -> bool {
        self.x[i] != 0.0
            || target[self.set[i] as usize] != 0.0
            || self.pull[i] > 0.0
            || self.pull[i] + self.band[i] < 0.0
    }

    fn gather(&mut self, model: &Model) {
        let size = self.inverse.len();
        // Room for one octet behind the last row.
        if self.matrix.len() < size * size + WIDTH {
            self.matrix.resize(size * size + WIDTH, 0.0);
        }
        #[cfg(target_arch = "x86_64")]
        if model.level.kind() == Kind::Avx512 {
            for (&j, out) in self.set.iter().zip(0..) {
                let row = model.row(j as usize);
                let out = &mut self.matrix[out * size..][..size + WIDTH];
                assert!(row.len() == WIDTH * self.chosen.len() && self.relaxed.len() == row.len());
                // SAFETY: the level proves the instructions; a row has eight values a group, and
                // the groups have `set.len()` <= size bits.
                unsafe { avx512::compress(row, &self.relaxed, &self.chosen, size, out) };
            }
            return;
        }
        gather_plain(
            model.level,
            &mut self.matrix,
            &model.rows,
            &model.slot,
            model.stride,
            &self.set,
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

/// The values of the pixels of `set`, whose bits `chosen` has, then zeros up to a whole block.
fn pick(level: Level, values: &[f64], chosen: &[u8], set: &[u32], out: &mut Vec<f64>) {
    let size = set.len().next_multiple_of(WIDTH);
    #[cfg(target_arch = "x86_64")]
    if level.kind() == Kind::Avx512 {
        assert!(values.len() == WIDTH * chosen.len());
        out.resize(size + WIDTH, 0.0);
        // SAFETY: the level proves the instructions; there are eight values a group, and the groups
        // have `set.len()` <= size bits.
        unsafe { avx512::pick(values, chosen, size, out) };
        out.truncate(size);
        return;
    }
    out.clear();
    out.extend(set.iter().map(|&j| values[j as usize]));
    out.resize(size, 0.0);
}

multiversion! {
    /// Slopes become pulls.
    fn in_units(inverse: &[f64], lambda: f64, pull: &mut [f64], band: &mut [f64]) {
        for ((pull, band), inverse) in pull.iter_mut().zip(band).zip(inverse) {
            *pull = (*pull - lambda) * inverse;
            *band = 2.0 * lambda * inverse;
        }
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
