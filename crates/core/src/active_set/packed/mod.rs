//! Coordinate descent on the pixels that move, packed side by side in float32.
//!
//! In units of its own diagonal, a pixel's best move is max(pull, -x). The moves of a block of eight
//! pixels are computed one after the other in registers; then the slopes of all other pixels are updated
//! for the eight moves at once.

#[cfg(target_arch = "x86_64")]
mod avx512;

use super::model::Model;
use crate::octet::{set_bits, PAIR, WIDTH};
use crate::simd::{multiversion, Kind, Level};

/// Over-relaxation: a pixel moves this many times as far as its minimum, which saves sweeps where columns
/// are nearly dependent. Any factor below 2 lowers the model's value at every move. Where x may have
/// both signs it is 1, as an over-relaxed move that stops at zero would not be a single maximum there.
/// Chosen by hand.
const RELAXATION: f64 = 1.3;
/// Up to this many pixels are not over-relaxed: they converge in a few sweeps anyway. Chosen by hand.
const FEW: usize = 16;

/// A part of a quadratic model: the rows and columns of the pixels that take part, padded to whole blocks.
///
/// It is in float32, which takes half the time of float64 and keeps the matrix of a hundred pixels in the
/// first-level cache. That costs no accuracy in the end: it holds changes only, which are added to x in
/// float64, and slopes are computed anew from the float64 model.
#[derive(Default)]
pub struct Packed {
    /// The pixels, ascending.
    pub set: Vec<u32>,
    /// The bits of these pixels.
    chosen: Vec<u8>,
    /// The unit of x: it keeps float32 numbers near 1, whatever the samples' unit is.
    unit: f64,
    /// The unit of slopes.
    lambda: f64,
    signed: bool,
    /// Columns divided by their relaxed diagonals.
    matrix: Vec<f32>,
    /// The inverse diagonals of all pixels of the model, times the relaxation.
    relaxed: Vec<f64>,
    /// The inverse diagonals of the pixels, times the relaxation, in these units.
    inverse: Vec<f64>,
    /// The diagonals of the pixels, in these units.
    diagonal: Vec<f32>,
    /// 2 lambda divided by the relaxed diagonal.
    band: Vec<f32>,
    /// -x, the move that ends at zero.
    room: Vec<f32>,
    /// How far x has moved since it was loaded.
    delta: Vec<f32>,
    /// (slope - lambda) divided by the relaxed diagonal.
    pull: Vec<f32>,
    /// Buffer.
    picked: Vec<f64>,
}

impl Packed {
    /// Loads the pixels whose bits are set.
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

    /// Loads x and slopes again, for the same pixels.
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

    /// The new x of the pixel at a place, which was `x` before.
    pub fn moved(&self, place: usize, x: f64) -> f64 {
        if self.room[place] == 0.0 {
            return 0.0;
        }
        let x = x + self.unit * f64::from(self.delta[place]);
        // Rounding may move it to the wrong side of zero.
        if self.signed {
            x
        } else {
            x.max(0.0)
        }
    }

    /// Removes pixels that are zero, also in `target`, and would stay so, if that saves a block.
    pub fn shrink(&mut self, model: &Model, target: &[f64]) {
        let moving = (0..self.set.len()).filter(|&i| self.may_move(i, target));
        let size = moving.count().next_multiple_of(PAIR);
        if size == self.room.len() {
            return;
        }
        let mut kept = 0;
        for i in 0..self.set.len() {
            let j = self.set[i];
            if self.may_move(i, target) {
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

    /// The vectors with one number for each pixel, padded.
    fn values(&mut self) -> [&mut Vec<f32>; 5] {
        [
            &mut self.diagonal,
            &mut self.band,
            &mut self.room,
            &mut self.delta,
            &mut self.pull,
        ]
    }

    fn may_move(&self, i: usize, target: &[f64]) -> bool {
        self.room[i] != 0.0
            || target[self.set[i] as usize] != 0.0
            || self.pull[i] > 0.0
            || self.pull[i] + self.band[i] < 0.0
    }

    fn gather(&mut self, model: &Model) {
        let size = self.room.len();
        // Whole octets are written, also behind the last row.
        if self.matrix.len() < size * size + WIDTH {
            self.matrix.resize(size * size + WIDTH, 0.0);
        }
        #[cfg(target_arch = "x86_64")]
        if model.level.kind() == Kind::Avx512 {
            for (&j, out) in self.set.iter().zip(0..) {
                let row = model.row(j as usize);
                let out = &mut self.matrix[out * size..][..size + WIDTH];
                assert!(row.len() == WIDTH * self.chosen.len() && self.relaxed.len() == row.len());
                // SAFETY: the level proves the instructions; a row has eight values per group, and
                // `set.len()` <= size bits are set.
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

    /// Sweeps until no slope changes by more than `settled`, at most `most` times; returns the largest
    /// change of the last sweep.
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

/// Writes the values of the pixels of `set`, whose bits are `chosen`, then zeros up to a whole block.
fn pick(level: Level, values: &[f64], chosen: &[u8], set: &[u32], out: &mut Vec<f64>) {
    let size = set.len().next_multiple_of(PAIR);
    #[cfg(target_arch = "x86_64")]
    if level.kind() == Kind::Avx512 {
        assert!(values.len() == WIDTH * chosen.len());
        out.resize(size + WIDTH, 0.0);
        // SAFETY: the level proves the instructions; there are eight values per group, and
        // `set.len()` <= size bits are set.
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
    /// Computes the pulls from the slopes.
    fn pulls(slope: &[f64], lambda: f64, inverse: &[f64], out: &mut [f32]) {
        let per_lambda = 1.0 / lambda;
        for ((out, slope), inverse) in out.iter_mut().zip(slope).zip(inverse) {
            *out = ((slope - lambda) * per_lambda * inverse) as f32;
        }
    }
}

multiversion! {
    // The arguments are parts of the model; a struct would only name them again.
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
        // There may be no pixel at all.
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
