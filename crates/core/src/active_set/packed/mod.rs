//! Coordinate descent on the pixels that move, side by side in memory.
//!
//! Within a block of eight, moves follow each other as numbers in registers; the other slopes learn of
//! eight moves at once.

#[cfg(target_arch = "x86_64")]
mod avx512;

use super::model::Model;
use crate::octet::{set_bits, PAIR, WIDTH};
use crate::simd::{multiversion, Kind, Level};

/// How far beyond its best value a pixel goes: where columns nearly depend on each other that takes
/// fewer sweeps. Any factor below 2 lowers the model's value at every move; where x may have
/// both signs, moves that end at zero are no longer one maximum, so there it is 1.
const RELAXATION: f64 = 1.3;
/// So few pixels come to their best values at once, one pixel in one move.
const FEW: usize = 16;

/// A part of a quadratic model: some pixels' rows and columns, padded to whole blocks.
///
/// In units of each pixel's own diagonal, so that a pixel's move is max(pull, -x). In float32, which
/// takes half the time and leaves the matrix of a hundred pixels in the first cache: it holds what
/// changes, which goes back into the float64 of the model, whence slopes are taken anew.
#[derive(Default)]
pub struct Packed {
    /// The pixels, ascending,
    pub set: Vec<u32>,
    /// and their bits.
    chosen: Vec<u8>,
    /// The x that counts as 1: numbers stay near it, whatever the samples' own unit is.
    unit: f64,
    /// The slope that counts as 1.
    lambda: f64,
    signed: bool,
    /// Columns over their relaxed diagonals.
    matrix: Vec<f32>,
    /// The inverse diagonals, times the relaxation.
    relaxed: Vec<f64>,
    /// Of the pixels: their inverse diagonals, times the relaxation and over the unit,
    inverse: Vec<f64>,
    diagonal: Vec<f32>,
    /// 2 lambda over the relaxed diagonal.
    band: Vec<f32>,
    /// -x
    room: Vec<f32>,
    /// How far x has come from where it was taken on.
    delta: Vec<f32>,
    /// (slope - lambda) over the relaxed diagonal.
    pull: Vec<f32>,
    /// A buffer.
    picked: Vec<f64>,
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
        (self.lambda, self.signed) = (lambda, signed);
        let scale = self
            .set
            .first()
            .map_or(1.0, |&j| model.diagonal[j as usize]);
        self.unit = lambda / scale;
        self.relaxed.clear();
        let inverse = model.inverse.iter().map(|inverse| relaxation * inverse);
        self.relaxed.extend(inverse);
        let (level, chosen, set) = (model.level, &self.chosen, &self.set);
        pick(level, &self.relaxed, chosen, set, &mut self.inverse);
        times(level, scale, &mut self.inverse);
        pick(level, &model.diagonal, chosen, set, &mut self.picked);
        self.diagonal.resize(self.picked.len(), 0.0);
        single(level, &self.picked, 1.0 / scale, &mut self.diagonal);
        self.band.resize(self.inverse.len(), 0.0);
        single(level, &self.inverse, 2.0, &mut self.band);
        self.renew(level, target, slope);
        self.gather(model);
    }

    /// Takes x and the slopes anew.
    pub fn renew(&mut self, level: Level, target: &[f64], slope: &[f64]) {
        let size = self.inverse.len();
        pick(level, target, &self.chosen, &self.set, &mut self.picked);
        self.room.resize(size, 0.0);
        single(level, &self.picked, -1.0 / self.unit, &mut self.room);
        pick(level, slope, &self.chosen, &self.set, &mut self.picked);
        self.pull.resize(size, 0.0);
        pulls(
            level,
            &self.picked,
            self.lambda,
            &self.inverse,
            &mut self.pull,
        );
        self.delta.clear();
        self.delta.resize(size, 0.0);
    }

    /// Where the pixel at a place has come to, from `x`.
    pub fn moved(&self, place: usize, x: f64) -> f64 {
        if self.room[place] == 0.0 {
            return 0.0;
        }
        let x = x + self.unit * f64::from(self.delta[place]);
        // Rounding may take it to the wrong side.
        if self.signed {
            x
        } else {
            x.max(0.0)
        }
    }

    /// Drops pixels that are at zero, as in `target`, and would stay there, if that saves a block.
    pub fn shrink(&mut self, model: &Model, target: &[f64]) {
        let stays = (0..self.set.len()).filter(|&i| self.counts(i, target));
        let size = stays.count().next_multiple_of(PAIR);
        if size == self.room.len() {
            return;
        }
        let mut kept = 0;
        for i in 0..self.set.len() {
            let j = self.set[i];
            if self.counts(i, target) {
                self.set[kept] = j;
                self.inverse[kept] = self.inverse[i];
                for values in self.values() {
                    values[kept] = values[i];
                }
                kept += 1;
            } else {
                self.chosen[j as usize / WIDTH] &= !(1 << (j as usize % WIDTH));
            }
        }
        self.set.truncate(kept);
        self.inverse.truncate(kept);
        self.inverse.resize(size, 0.0);
        for values in self.values() {
            values.truncate(kept);
            values.resize(size, 0.0);
        }
        self.gather(model);
    }

    /// One number for each pixel, padded.
    fn values(&mut self) -> [&mut Vec<f32>; 5] {
        [
            &mut self.diagonal,
            &mut self.band,
            &mut self.room,
            &mut self.delta,
            &mut self.pull,
        ]
    }

    fn counts(&self, i: usize, target: &[f64]) -> bool {
        self.room[i] != 0.0
            || target[self.set[i] as usize] != 0.0
            || self.pull[i] > 0.0
            || self.pull[i] + self.band[i] < 0.0
    }

    fn gather(&mut self, model: &Model) {
        let size = self.room.len();
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
            &self.relaxed,
            size,
        );
    }

    /// Sweeps until no slope changes by more than `settled`, at most `most` times; returns the last
    /// change.
    pub fn sweep(&mut self, level: Level, settled: f64, most: usize) -> f64 {
        let size = self.room.len();
        assert!(size.is_multiple_of(PAIR) && self.matrix.len() >= size * size);
        assert!(self.pull.len() == size && self.delta.len() == size);
        assert!(self.band.len() == size && self.diagonal.len() == size);
        let mut change = f64::INFINITY;
        for _ in 0..most {
            let largest = match level.kind() {
                #[cfg(target_arch = "x86_64")]
                // SAFETY: the level proves the instructions; the lengths were just compared.
                Kind::Avx512 => unsafe {
                    avx512::sweep(
                        &self.matrix,
                        &self.diagonal,
                        &self.band,
                        self.signed,
                        &mut self.room,
                        &mut self.delta,
                        &mut self.pull,
                    )
                },
                _ => sweep_plain(
                    level,
                    &self.matrix,
                    &self.diagonal,
                    &self.band,
                    self.signed,
                    &mut self.room,
                    &mut self.delta,
                    &mut self.pull,
                ),
            };
            change = self.lambda * f64::from(largest);
            if change <= settled {
                break;
            }
        }
        change
    }
}

/// The values of the pixels of `set`, whose bits `chosen` has, then zeros up to a whole block.
fn pick(level: Level, values: &[f64], chosen: &[u8], set: &[u32], out: &mut Vec<f64>) {
    let size = set.len().next_multiple_of(PAIR);
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
    fn times(factor: f64, values: &mut [f64]) {
        for value in values {
            *value *= factor;
        }
    }
}

multiversion! {
    fn single(values: &[f64], factor: f64, out: &mut [f32]) {
        for (out, value) in out.iter_mut().zip(values) {
            *out = (factor * value) as f32;
        }
    }
}

multiversion! {
    /// Slopes become pulls.
    fn pulls(slope: &[f64], lambda: f64, inverse: &[f64], out: &mut [f32]) {
        let per_lambda = 1.0 / lambda;
        for ((out, slope), inverse) in out.iter_mut().zip(slope).zip(inverse) {
            *out = ((slope - lambda) * per_lambda * inverse) as f32;
        }
    }
}

multiversion! {
    // A row's parts, which a struct would only name again.
    #[allow(clippy::too_many_arguments)]
    fn gather_plain(
        matrix: &mut [f32],
        rows: &[f64],
        slot: &[u32],
        stride: usize,
        set: &[u32],
        relaxed: &[f64],
        size: usize,
    ) {
        // No pixel may take part.
        for (&j, out) in set.iter().zip(matrix.chunks_exact_mut(size.max(1))) {
            let row = &rows[slot[j as usize] as usize * stride..][..stride];
            let (out, rest) = out.split_at_mut(set.len());
            for (out, &k) in out.iter_mut().zip(set) {
                *out = (row[k as usize] * relaxed[k as usize]) as f32;
            }
            rest.fill(0.0);
        }
    }
}

multiversion! {
    #[allow(clippy::too_many_arguments)]
    fn sweep_plain(
        matrix: &[f32],
        diagonal: &[f32],
        band: &[f32],
        signed: bool,
        room: &mut [f32],
        delta: &mut [f32],
        pull: &mut [f32],
    ) -> f32 {
        let size = room.len();
        let mut change: f32 = 0.0;
        for j in 0..size {
            let back = room[j];
            let back = if signed { back.min(pull[j] + band[j]) } else { back };
            let by = back.max(pull[j]);
            if by != 0.0 {
                room[j] -= by;
                delta[j] += by;
                change = change.max(by.abs() * diagonal[j]);
                for (pull, factor) in pull.iter_mut().zip(&matrix[j * size..][..size]) {
                    *pull -= by * factor;
                }
            }
        }
        change
    }
}

#[cfg(test)]
mod tests;
