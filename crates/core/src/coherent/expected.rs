//! Predicts the samples of a row from its neighbours' rows.
//!
//! A neighbour's footprint, moved back and scaled, is a guess at the row's own. A guess has more weight the
//! better it explains the row's known samples. The mean of the guesses is the expected sample, their
//! variance its uncertainty.

use super::camera_window::{self, moved_back};
use crate::problem::{Dictionary, Rows, Sparse};
use crate::simd::{multiversion, Level};
use crate::vector::{fold, one_sided, padded, SUMS};
use rayon::prelude::*;

/// Rows that one thread handles at a time, enough to hide the cost of starting a task.
const TASK: usize = 64;

// The constants below were chosen by hand.

/// A neighbour may be brighter or darker than the row by at most this factor.
const BRIGHTEST: f64 = 2.0;
/// The prior that a neighbour is as bright as the row, with the weight of this many samples at the clip
/// level.
const EQUAL_BRIGHTNESS: f64 = 1.0;
/// Standard error of a perfect guess, in shares of the clip level: better fits gain no more weight.
const PRECISION: f64 = 0.01;
/// The mean guess may miss the known samples by this share of the brightest expected sample or of the clip
/// level. A larger misfit raises the variance. With 0.05, clipping rows lose help that they need.
const TOLERATED_MISFIT: f64 = 0.15;
/// A neighbour's light may have moved to several places. Where samples are known they distinguish the
/// places; where all samples clip, each place has the weight of its share to this power.
const SHARE_POWER: f64 = 4.0;

/// All rows, and the grids of camera and projector.
#[derive(Clone, Copy)]
pub struct Neighbours<'a> {
    /// All rows.
    pub matrix: Sparse<'a, f32>,
    /// Rows, columns and channels of the camera.
    pub camera: [usize; 3],
    /// Planes of atoms, rows and columns of the projector.
    pub projector: [usize; 3],
    /// Half width of the camera window.
    pub reach: usize,
    /// The Jacobian of the correspondence, four numbers for each row: (projector row, projector column) by
    /// (camera row, camera column), in pixels.
    pub jacobian: &'a [f32],
    /// The samples of the background of some rows, from row `first` on: under the patterns shown, then
    /// under the unseen ones.
    pub background: &'a [f32],
    pub first: usize,
}

/// The expected samples of some rows under all patterns, and their variances (infinite where no neighbour
/// holds light).
#[derive(Debug, Default, PartialEq)]
pub struct Expected {
    pub values: Vec<f32>,
    pub variances: Vec<f32>,
}

/// Predicts the samples of the rows `selected` under the patterns `shown` and `unseen`. `rows` are their
/// samples under the patterns shown, `level` is the clip level.
///
/// # Panics
/// If the lengths of the arrays do not match.
pub fn expected(
    shown: &Dictionary,
    unseen: &Dictionary,
    neighbours: Neighbours,
    rows: Rows,
    level: f64,
    selected: &[usize],
) -> Expected {
    let all = shown.patterns + unseen.patterns;
    assert_eq!(rows.count, selected.len());
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
            guesses.gather(shown, unseen, neighbours, selected[i], level);
            guesses.write(values, variances, level);
        },
    );
    result
}

/// One row's samples and the sums over its neighbours' guesses: the buffers of one thread.
struct Guesses {
    level: Level,
    /// Samples, padded, and their weights.
    y: Vec<f64>,
    weights: Vec<f64>,
    /// The weights, but 0 for samples that clip.
    known: Vec<f64>,
    /// 0 for samples that clip, minus infinity for others.
    lower: Vec<f64>,
    /// The power of the shares of places: `SHARE_POWER` times the share of clipped samples.
    share_power: f64,
    /// One guess, under the patterns shown and the unseen ones.
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
            share_power: 0.0,
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
        self.share_power = SHARE_POWER * count as f64 / n.max(1) as f64;
        one_sided(self.level, clipped, &mut self.lower[..n]);
        self.known.copy_from_slice(&self.weights);
        for (known, clipped) in self.known.iter_mut().zip(clipped) {
            *known = if *clipped { 0.0 } else { *known };
        }
        self.sums.fill(0.0);
        self.squares.fill(0.0);
        self.total = 0.0;
    }

    /// Adds the guesses of all neighbours of `row`.
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
            jacobian,
            reach,
            ..
        } = neighbours;
        for (other, places) in camera_window::neighbours(camera, jacobian, row, reach) {
            if other == row {
                continue;
            }
            for (moved, share) in places {
                if self.guess(shown, unseen, neighbours, other, moved) {
                    self.add_weighted(level, share);
                }
            }
        }
    }

    /// Computes the samples of the row `other`, moved back by `moved`. Returns false if it has no light.
    fn guess(
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

    /// Scales the guess to the known samples and adds it to the sums. Its weight is the inverse square of
    /// its misfit, times a power of the share of its place that grows with the share of clipped samples.
    fn add_weighted(&mut self, level: f64, share: f32) {
        let (cpu, [n, _]) = (self.level, self.patterns);
        let prior = EQUAL_BRIGHTNESS * level * level;
        let (product, square) = products(cpu, &self.known, &self.y, &self.shown);
        let scale = ((product + prior) / (square + prior)).clamp(1.0 / BRIGHTEST, BRIGHTEST);
        let misfit = misfit(cpu, &self.weights, &self.y, &self.lower, &self.shown, scale);
        let error = misfit / (n as f64 * level * level) + PRECISION * PRECISION;
        let weight = f64::from(share).powf(self.share_power) / (error * error);
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

    /// The squared misfit of the mean guess to the known samples, beyond the tolerated one. Neighbours may
    /// agree and still be wrong, for instance if all are moved by a pixel too many.
    fn common_error(&self, level: f64) -> f64 {
        let (mut misfit, mut total) = (0.0, 0.0);
        for k in 0..self.patterns[0] {
            let off = self.y[k] - self.sums[k] / self.total;
            misfit += self.known[k] * off * off;
            total += self.known[k];
        }
        let brightest = self.sums.iter().fold(0.0, |most, sum| sum.max(most)) / self.total;
        let tolerated = (TOLERATED_MISFIT * brightest.max(level)).powi(2);
        (misfit / total.max(f64::MIN_POSITIVE) - tolerated).max(0.0)
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
