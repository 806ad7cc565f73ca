//! Predicts the samples of a row from its neighbours' rows.
//!
//! A neighbour's footprint, moved back and scaled, is a guess at the row's own. A guess has more weight the
//! better it explains the row's known samples. The mean of the guesses is the expected sample, their
//! variance its uncertainty.

use super::camera_window::{self, Footprint};
use crate::problem::{Dictionary, Rows, Sparse};
use crate::simd::{multiversion, Level};
use crate::vector::{fold, padded, SUMS};
use rayon::prelude::*;

/// Rows that one thread handles at a time, enough to hide the cost of starting a task.
const TASK: usize = 64;

// The constants below were chosen by hand.

/// A neighbour may be brighter or darker than the row by at most this factor.
const BRIGHTEST: f32 = 2.0;
/// The prior that a neighbour is as bright as the row, with the weight of this many samples at the clip
/// level.
const EQUAL_BRIGHTNESS: f32 = 1.0;
/// Standard error of a perfect guess, in shares of the clip level: better fits gain no more weight.
const PRECISION: f32 = 0.01;
/// The mean guess may miss the known samples by this share of the brightest expected sample or of the clip
/// level. A larger misfit raises the variance. With 0.05, clipping rows lose help that they need.
const TOLERATED_MISFIT: f32 = 0.15;
/// A neighbour's light may have moved to several places. Where samples are known they distinguish the
/// places; where all samples clip, each place has the weight of its share to this power.
const SHARE_POWER: f32 = 4.0;

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
///
/// Float32 is enough: a variance that rounding adds is a millionth of the squared sample, and the error
/// that neighbours share is at least some ten thousandths.
struct Guesses {
    level: Level,
    /// Samples, padded, and their weights.
    y: Vec<f32>,
    weights: Vec<f32>,
    /// The weights, but 0 for samples that clip.
    known: Vec<f32>,
    /// 0 for samples that clip, minus infinity for others.
    lower: Vec<f32>,
    /// The power of the shares of places: `SHARE_POWER` times the share of clipped samples.
    share_power: f32,
    /// The row of a neighbour, and its atoms after moving them back.
    footprint: Footprint,
    terms: Vec<(u32, f32)>,
    /// One guess, under the patterns shown and the unseen ones.
    shown: Vec<f32>,
    unseen: Vec<f32>,
    patterns: [usize; 2],
    sums: Vec<f32>,
    squares: Vec<f32>,
    total: f32,
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
            footprint: Footprint::default(),
            terms: Vec::new(),
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
        rows.samples.copy_f32(row * n, &mut self.y[..n]);
        if let Some(weights) = rows.weights {
            let start = if weights.len() == n { 0 } else { row * n };
            weights.copy_f32(start, &mut self.weights[..n]);
        }
        let clipped = &rows.clipped[row * n..][..n];
        let count = clipped.iter().filter(|&&clipped| clipped).count();
        self.share_power = SHARE_POWER * count as f32 / n.max(1) as f32;
        self.known.copy_from_slice(&self.weights);
        let bounds = self.known.iter_mut().zip(&mut self.lower);
        for ((known, lower), clipped) in bounds.zip(clipped) {
            (*known, *lower) = if *clipped {
                (0.0, 0.0)
            } else {
                (*known, f32::NEG_INFINITY)
            };
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
            let (atoms, values) = neighbours.matrix.row(other);
            self.footprint.load(neighbours.projector, atoms, values);
            for (displacement, share) in places {
                if self.guess(shown, unseen, neighbours, other, displacement) {
                    self.add_weighted(level, share);
                }
            }
        }
    }

    /// Computes the samples of the row `other`, moved back. Returns false if it then has no light.
    fn guess(
        &mut self,
        shown: &Dictionary,
        unseen: &Dictionary,
        neighbours: Neighbours,
        other: usize,
        displacement: [i32; 2],
    ) -> bool {
        self.terms.clear();
        let moved = (self.footprint).moved_back(neighbours.projector, displacement);
        self.terms.extend(moved);
        let [k, e] = self.patterns;
        let background = &neighbours.background[(other - neighbours.first) * (k + e)..][..k + e];
        self.shown[..k].copy_from_slice(&background[..k]);
        self.unseen[..e].copy_from_slice(&background[k..]);
        (shown.columns).add_all_f32(shown.level, &self.terms, &mut self.shown);
        (unseen.columns).add_all_f32(unseen.level, &self.terms, &mut self.unseen);
        !self.terms.is_empty()
    }

    /// Scales the guess to the known samples and adds it to the sums. Its weight is the inverse square of
    /// its misfit, times a power of the share of its place that grows with the share of clipped samples.
    fn add_weighted(&mut self, level: f64, share: f32) {
        let (cpu, [n, _]) = (self.level, self.patterns);
        let square_level = (level * level) as f32;
        let prior = EQUAL_BRIGHTNESS * square_level;
        let (product, square) = products(cpu, &self.known, &self.y, &self.shown);
        let scale = ((product + prior) / (square + prior)).clamp(1.0 / BRIGHTEST, BRIGHTEST);
        let misfit = misfit(cpu, &self.weights, &self.y, &self.lower, &self.shown, scale);
        let error = misfit / (n as f32 * square_level) + PRECISION * PRECISION;
        let weight = share.powf(self.share_power) / (error * error);
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
                *value = mean;
                *variance = common + (square / self.total - mean * mean).max(0.0);
            }
        }
    }

    /// The squared misfit of the mean guess to the known samples, beyond the tolerated one. Neighbours may
    /// agree and still be wrong, for instance if all are moved by a pixel too many.
    fn common_error(&self, level: f64) -> f32 {
        let (mut misfit, mut total) = (0.0, 0.0);
        for k in 0..self.patterns[0] {
            let off = self.y[k] - self.sums[k] / self.total;
            misfit += self.known[k] * off * off;
            total += self.known[k];
        }
        let brightest = self.sums.iter().fold(0f32, |most, sum| sum.max(most)) / self.total;
        let tolerated = (TOLERATED_MISFIT * brightest.max(level as f32)).powi(2);
        (misfit / total.max(f32::MIN_POSITIVE) - tolerated).max(0.0)
    }
}

multiversion! {
    /// sum w y u and sum w u^2
    fn products(weights: &[f32], y: &[f32], u: &[f32]) -> (f32, f32) {
        let (mut product, mut square) = ([0f32; SUMS], [0f32; SUMS]);
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
    fn misfit(weights: &[f32], y: &[f32], lower: &[f32], u: &[f32], scale: f32) -> f32 {
        let mut sums = [0f32; SUMS];
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
    fn add_guess(u: &[f32], scale: f32, weight: f32, sums: &mut [f32], squares: &mut [f32]) {
        for ((sum, square), u) in sums.iter_mut().zip(squares).zip(u) {
            let u = scale * u;
            *sum += weight * u;
            *square += weight * u * u;
        }
    }
}
