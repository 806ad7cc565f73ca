//! What a row's samples probably are, by what its neighbours' rows would give in its place.
//!
//! A neighbour's footprint, moved along with it and scaled, is a guess at the row's own. How well
//! it explains the samples that are known says how much it counts; how far the guesses lie apart
//! says how little is known.

use super::around::{self, moved_back};
use crate::problem::{Dictionary, Rows, Sparse};
use crate::simd::{multiversion, Level};
use crate::vector::{fold, one_sided, padded, SUMS};
use rayon::prelude::*;

/// Rows that one thread takes on at a time.
const TASK: usize = 64;
/// A neighbour's brightness may differ by this factor, and
const BRIGHTEST: f64 = 2.0;
/// is taken to be the row's own as if one more sample of the clip level said so.
const LIKENESS: f64 = 1.0;
/// Misfits below this share of the clip level, per sample, count alike.
const PRECISION: f64 = 0.01;
/// So far, as a share of the brightest guess or of the clip level, guesses may miss what is known
/// together without being doubted. (With 0.05 rows that clip lose help that they need.)
const COMMON: f64 = 0.15;

/// Of the places that a neighbour's light may have moved to, each is a guess. Samples tell them
/// apart, and where all samples clip the shares of the places do, by this power.
const PLACES: f64 = 4.0;

/// The rows around, on their grids.
#[derive(Clone, Copy)]
pub struct Neighbours<'a> {
    /// All rows.
    pub matrix: Sparse<'a, f32>,
    /// Rows, columns and channels of the camera.
    pub camera: [usize; 3],
    /// Planes of atoms, one for each size, and rows and columns of the projector.
    pub projector: [usize; 3],
    /// Half width of the camera window.
    pub reach: usize,
    /// How far footprints move, in projector rows and columns, a camera row and a camera column
    /// on: four numbers for each row.
    pub movement: &'a [f32],
    /// What the background of some rows, the first of which is `first`, gives under all patterns:
    /// those shown, then the unseen ones.
    pub background: &'a [f32],
    pub first: usize,
}

/// Expected samples of each row asked for, under all patterns, and their variances.
#[derive(Debug, Default, PartialEq)]
pub struct Expected {
    pub values: Vec<f32>,
    pub variances: Vec<f32>,
}

/// Expected samples of the rows `asked` under the patterns `shown` and the `unseen` ones, with
/// `rows` the samples that are known and `level` the clip level.
///
/// # Panics
/// If the lengths of the arrays do not match.
pub fn expected(
    shown: &Dictionary,
    unseen: &Dictionary,
    neighbours: Neighbours,
    rows: Rows,
    level: f64,
    asked: &[usize],
) -> Expected {
    let all = shown.patterns + unseen.patterns;
    assert_eq!(rows.count, asked.len());
    let mut result = Expected {
        values: vec![0.0; rows.count * all],
        variances: vec![f32::INFINITY; rows.count * all],
    };
    let out =
        (result.values.par_chunks_mut(all.max(1))).zip(result.variances.par_chunks_mut(all.max(1)));
    out.enumerate().with_min_len(TASK).for_each_init(
        || Guesses::new(shown.level, shown.patterns, unseen.patterns),
        |guesses, (i, (values, variances))| {
            guesses.load(rows, i);
            guesses.gather(shown, unseen, neighbours, asked[i], level);
            guesses.write(values, variances, level);
        },
    );
    result
}

/// One row's samples, and sums over its neighbours' guesses at them. Buffers of one thread.
struct Guesses {
    level: Level,
    /// Samples, padded, and their weights.
    y: Vec<f64>,
    weights: Vec<f64>,
    /// Weights of the samples that do not clip, 0 for those that do.
    known: Vec<f64>,
    /// 0 for samples that clip, minus infinity for others.
    lower: Vec<f64>,
    /// The power of places' shares.
    unsure: f64,
    /// A neighbour's guess, under the patterns shown and the unseen ones.
    shown: Vec<f64>,
    unseen: Vec<f64>,
    patterns: [usize; 2],
    sums: Vec<f64>,
    squares: Vec<f64>,
    total: f64,
}

impl Guesses {
    fn new(level: Level, shown: usize, unseen: usize) -> Self {
        let samples = |value| {
            let mut values = vec![0.0; padded(shown)];
            values[..shown].fill(value);
            values
        };
        Guesses {
            level,
            y: samples(0.0),
            weights: samples(1.0),
            known: samples(0.0),
            lower: samples(0.0),
            unsure: 0.0,
            shown: vec![0.0; padded(shown)],
            unseen: vec![0.0; padded(unseen)],
            patterns: [shown, unseen],
            sums: vec![0.0; shown + unseen],
            squares: vec![0.0; shown + unseen],
            total: 0.0,
        }
    }

    fn load(&mut self, rows: Rows, row: usize) {
        let [n, _] = self.patterns;
        rows.samples.copy(row * n, &mut self.y[..n]);
        if let Some(weights) = rows.weights {
            let start = if weights.len() == n { 0 } else { row * n };
            weights.copy(start, &mut self.weights[..n]);
        }
        let clipped = &rows.clipped[row * n..][..n];
        let count = clipped.iter().filter(|&&clipped| clipped).count();
        self.unsure = PLACES * count as f64 / n.max(1) as f64;
        one_sided(self.level, clipped, &mut self.lower[..n]);
        self.known.copy_from_slice(&self.weights);
        for (known, clipped) in self.known.iter_mut().zip(clipped) {
            *known = if *clipped { 0.0 } else { *known };
        }
        self.sums.fill(0.0);
        self.squares.fill(0.0);
        self.total = 0.0;
    }

    /// Asks all neighbours of `row`.
    fn gather(
        &mut self,
        shown: &Dictionary,
        unseen: &Dictionary,
        neighbours: Neighbours,
        row: usize,
        level: f64,
    ) {
        let Neighbours {
            camera,
            movement,
            reach,
            ..
        } = neighbours;
        for (other, places) in around::neighbours(camera, movement, row, reach) {
            if other == row {
                continue;
            }
            for (moved, share) in places {
                if self.ask(shown, unseen, neighbours, other, moved) {
                    self.weigh(level, share);
                }
            }
        }
    }

    /// What the row `other` would give, moved back by `moved`. False if that is nothing.
    fn ask(
        &mut self,
        shown: &Dictionary,
        unseen: &Dictionary,
        neighbours: Neighbours,
        other: usize,
        moved: [isize; 2],
    ) -> bool {
        let [k, e] = self.patterns;
        let background = &neighbours.background[(other - neighbours.first) * (k + e)..][..k + e];
        for (out, b) in self.shown.iter_mut().zip(&background[..k]) {
            *out = f64::from(*b);
        }
        for (out, b) in self.unseen.iter_mut().zip(&background[k..]) {
            *out = f64::from(*b);
        }
        let mut any = false;
        let (pixels, values) = neighbours.matrix.row(other);
        for (&pixel, &value) in pixels.iter().zip(values) {
            if value <= 0.0 {
                continue;
            }
            if let Some(place) = moved_back(neighbours.projector, pixel, moved) {
                let (place, value) = (place as u32, f64::from(value));
                (shown.columns).add(shown.level, place, value, &mut self.shown);
                (unseen.columns).add(unseen.level, place, value, &mut self.unseen);
                any = true;
            }
        }
        any
    }

    /// Scales the guess to the samples that are known and adds it by how well it explains them,
    /// and by the share of the place that it is for as far as samples clip.
    fn weigh(&mut self, level: f64, share: f32) {
        let (cpu, [n, _]) = (self.level, self.patterns);
        let prior = LIKENESS * level * level;
        let (product, square) = products(cpu, &self.known, &self.y, &self.shown);
        let scale = ((product + prior) / (square + prior)).clamp(1.0 / BRIGHTEST, BRIGHTEST);
        let misfit = misfit(cpu, &self.weights, &self.y, &self.lower, &self.shown, scale);
        let off = misfit / (n as f64 * level * level) + PRECISION * PRECISION;
        let weight = f64::from(share).powf(self.unsure) / (off * off);
        let (shown, unseen) = self.sums.split_at_mut(n);
        let (shown_squares, unseen_squares) = self.squares.split_at_mut(n);
        add_guess(cpu, &self.shown, scale, weight, shown, shown_squares);
        add_guess(cpu, &self.unseen, scale, weight, unseen, unseen_squares);
        self.total += weight;
    }

    fn write(&self, values: &mut [f32], variances: &mut [f32], level: f64) {
        if self.total > 0.0 {
            let common = self.common_error(level);
            let sums = self.sums.iter().zip(&self.squares);
            for ((value, variance), (sum, square)) in values.iter_mut().zip(variances).zip(sums) {
                let mean = sum / self.total;
                *value = mean as f32;
                *variance = (common + (square / self.total - mean * mean).max(0.0)) as f32;
            }
        }
    }

    /// How far the mean guess misses the samples that are known, squared, beyond what is borne:
    /// neighbours may agree and err together, as where all are moved by a pixel too many.
    fn common_error(&self, level: f64) -> f64 {
        let (mut misfit, mut whole) = (0.0, 0.0);
        for k in 0..self.patterns[0] {
            let off = self.y[k] - self.sums[k] / self.total;
            misfit += self.known[k] * off * off;
            whole += self.known[k];
        }
        let brightest = self.sums.iter().fold(0.0, |most, sum| sum.max(most)) / self.total;
        let borne = (COMMON * brightest.max(level)).powi(2);
        (misfit / whole.max(f64::MIN_POSITIVE) - borne).max(0.0)
    }
}

multiversion! {
    /// sum w y u and sum w u^2
    fn products(weights: &[f64], y: &[f64], u: &[f64]) -> (f64, f64) {
        let (mut product, mut square) = ([0.0; SUMS], [0.0; SUMS]);
        let samples = weights.as_chunks::<SUMS>().0.iter().zip(y.as_chunks::<SUMS>().0);
        for ((weights, y), u) in samples.zip(u.as_chunks::<SUMS>().0) {
            for i in 0..SUMS {
                let weighted = weights[i] * u[i];
                product[i] += weighted * y[i];
                square[i] += weighted * u[i];
            }
        }
        (fold(product), fold(square))
    }
}

multiversion! {
    /// sum w max(y - scale u, lower)^2
    fn misfit(weights: &[f64], y: &[f64], lower: &[f64], u: &[f64], scale: f64) -> f64 {
        let mut sums = [0.0; SUMS];
        let samples = weights.as_chunks::<SUMS>().0.iter().zip(y.as_chunks::<SUMS>().0);
        let guesses = lower.as_chunks::<SUMS>().0.iter().zip(u.as_chunks::<SUMS>().0);
        for ((weights, y), (lower, u)) in samples.zip(guesses) {
            for i in 0..SUMS {
                let off = y[i] - scale * u[i];
                let off = if off > lower[i] { off } else { lower[i] };
                sums[i] += weights[i] * off * off;
            }
        }
        fold(sums)
    }
}

multiversion! {
    fn add_guess(u: &[f64], scale: f64, weight: f64, sums: &mut [f64], squares: &mut [f64]) {
        for ((sum, square), u) in sums.iter_mut().zip(squares).zip(u) {
            let u = scale * u;
            *sum += weight * u;
            *square += weight * u * u;
        }
    }
}
