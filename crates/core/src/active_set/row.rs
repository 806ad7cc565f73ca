//! The solution of one row, from its samples to its certificate.

use super::certificate::{dual_value, orthogonal_to_means};
use super::point::Point;
use super::pricing::{self, Pricing, Threshold};
use super::restricted::Restricted;
use crate::correlate::{ScoreFilter, Scores};
use crate::problem::{Dictionary, Fidelity, Rows, Settings, Solution, Values};
use crate::vector::{dot, free_energy, invert, one_sided, residual, signed_sums, DataTerm};

// The constants below trade passes over all pixels for time in the restricted solve. They do not
// affect what a row converges to, only how fast. They were chosen by hand for speed; measure it with
// `python -m benchmarks`.

/// Number of pixels that join the working set after the first pass, and after each later pass.
const NEW_PIXELS: [usize; 2] = [8, 16];
/// The same numbers where a pass reads its patterns from memory: there a pass costs more than solving
/// a row on many pixels.
const MANY_NEW_PIXELS: [usize; 2] = [64, 128];
/// The restricted solve stops when its own violation falls below this share of the largest violation
/// that the pass found outside the working set.
const INNER_SHARE: f64 = 0.25;
/// The restricted solve always reaches this violation, in units of lambda.
const COARSEST: f64 = 1.0;
/// On a working set of up to this many pixels a precise restricted solve costs less than another pass.
const SMALL_SET: usize = 12;
/// On a small working set, the restricted solve is precise once no violation outside exceeds this, in
/// units of lambda.
const PRECISE_BELOW_SMALL: f64 = 1.0;
/// On a larger working set, it is precise once no violation outside exceeds this, in units of lambda.
const PRECISE_BELOW: f64 = 0.03;
/// A precise solve goes to this share of the tolerance at first. It goes further only where accuracy
/// within the working set keeps the gap open.
const FINEST_SHARE: f64 = 0.2;
/// Factor by which the precise accuracy then shrinks after each pass.
const REFINEMENT: f64 = 0.3;
/// The dual point counts as equal to the residual if m' theta was off by less than this, in units of
/// lambda.
const NEGLIGIBLE: f64 = 1e-9;
/// The prediction u is updated by steps whose rounding errors add up. It is computed afresh after this
/// many passes.
const REFRESH_PASSES: u32 = 8;
/// The gap is relative to the objective, but at least to this share of ||y||^2 / 2, so that rows
/// without light can converge.
const FLOOR_SHARE: f64 = 1e-6;
/// Rows that need more passes have columns that quick inner products cannot tell apart. Most rows need two
/// or three.
const QUICK_PASSES: u32 = 8;

pub enum Next {
    /// A pass with `RowSolver::dual` is needed.
    Pass,
    Done,
}

/// The patterns and settings that a row is solved with.
#[derive(Clone, Copy)]
pub struct Problem<'a> {
    pub dictionary: &'a Dictionary,
    pub settings: &'a Settings,
}

/// Solves one row after the other in the same memory. Each row may have a problem of its own.
pub struct RowSolver {
    data: DataTerm,
    /// ||y||^2 / 2
    energy: f64,
    /// Sum of the squared means over the two-sided samples.
    free_energy: f64,
    point: Point,
    /// Whether the constraint b = 0 was active at the end of the last restricted solve.
    held: bool,
    dual: Vec<f64>,
    filter: ScoreFilter,
    passes: u32,
    objective: f64,
    dual_value: f64,
    /// Accuracy of a precise restricted solve, in units of lambda.
    finest: f64,
    pricing: Pricing,
    /// Correlations of the working set's columns with `dual`.
    gradient: Vec<f64>,
    /// Whether `dual` equals the residual up to rounding.
    dual_is_residual: bool,
}

impl RowSolver {
    pub fn new() -> Self {
        RowSolver {
            data: DataTerm::default(),
            energy: 0.0,
            free_energy: 0.0,
            point: Point::default(),
            held: false,
            dual: Vec::new(),
            filter: ScoreFilter::All,
            passes: 0,
            objective: 0.0,
            dual_value: f64::NEG_INFINITY,
            finest: 0.0,
            pricing: Pricing::default(),
            gradient: Vec::new(),
            dual_is_residual: false,
        }
    }

    /// Which scores the next pass must return.
    pub fn filter(&self) -> ScoreFilter {
        self.filter
    }

    /// The dual point, which the next pass correlates with all columns.
    pub fn dual(&self) -> &[f64] {
        &self.dual
    }

    /// The current solution.
    pub fn solution(&self, problem: Problem) -> Solution {
        let mut support: Vec<(u32, f64)> = self.point.support().collect();
        support.sort_unstable_by_key(|&(pixel, _)| pixel);
        let mut numbers = support
            .iter()
            .map(|&(_, x)| x)
            .chain([self.point.background]);
        if !numbers.all(f64::is_finite) {
            // Squares of very large samples or weights overflow: return a row without light.
            return Solution {
                objective: self.energy,
                gap: f64::INFINITY,
                passes: self.passes,
                ..Solution::default()
            };
        }
        let gap = self.gap();
        Solution {
            pixels: support.iter().map(|&(pixel, _)| pixel).collect(),
            x: support.iter().map(|&(_, x)| x).collect(),
            background: self.point.background,
            objective: self.objective,
            gap,
            passes: self.passes,
            converged: gap <= problem.settings.tolerance,
        }
    }

    /// Begins a row, from `rows.start` or from zero.
    pub fn begin(
        &mut self,
        problem: Problem,
        rows: Rows,
        row: usize,
        restricted: &mut Restricted,
    ) -> Next {
        self.load(problem, rows, row);
        self.passes = 0;
        self.dual_value = f64::NEG_INFINITY;
        self.finest = FINEST_SHARE * problem.settings.tolerance;
        self.point.clear();
        if let Some(start) = rows.start {
            let (pixels, values) = start.rows.row(row);
            for (&pixel, &x) in pixels.iter().zip(values) {
                self.point.push(pixel as u32, x);
            }
            self.point.background = start.background[row];
            self.point.restrict_to(problem.settings);
        }
        self.update_prediction(problem);
        if self.point.pixels.is_empty() {
            return self.prepare_pass(problem, Threshold::FirstPass);
        }
        self.solve_restricted(problem, restricted, self.finest, false);
        self.prepare_pass(problem, Threshold::Lambda)
    }

    /// Continues the row with the scores of `dual`.
    pub fn after_pass(
        &mut self,
        problem: Problem,
        scores: &Scores,
        restricted: &mut Restricted,
    ) -> Next {
        let Problem {
            dictionary,
            settings,
        } = problem;
        self.passes += 1;
        let [first, later] = if dictionary.correlator.reads_memory() {
            MANY_NEW_PIXELS
        } else {
            NEW_PIXELS
        };
        let new = if self.passes == 1 { first } else { later };
        let outcome = self.pricing.run(
            dictionary,
            settings,
            scores,
            &self.dual,
            &self.point.pixels,
            new,
        );
        self.certify(problem, outcome.bound);
        let last = self.passes >= settings.max_passes;
        if self.gap() <= settings.tolerance || (last && !outcome.conclusive) {
            return Next::Done;
        }
        if !outcome.conclusive {
            self.set_filter(problem, Threshold::Lambda);
            return Next::Pass;
        }
        let before = self.point.pixels.len();
        self.gradient.clear();
        self.gradient.extend_from_slice(self.pricing.working_set());
        let lambda = settings.regularization;
        for &(pixel, correlation) in self.pricing.violators(lambda) {
            self.point.push(pixel, 0.0);
            self.gradient.push(correlation);
        }
        let violation = (outcome.exact / lambda - 1.0).max(0.0);
        if violation < settings.tolerance {
            // Hardly any pixel is missing, so it is accuracy within the working set that keeps the
            // gap open.
            self.finest *= REFINEMENT;
        }
        let precise_below = if before <= SMALL_SET {
            PRECISE_BELOW_SMALL
        } else {
            PRECISE_BELOW
        };
        let (accuracy, threshold) = if violation < precise_below {
            (self.finest, Threshold::Lambda)
        } else {
            let accuracy = COARSEST.min(INNER_SHARE * violation);
            (accuracy, Threshold::LaterPass)
        };
        self.solve_restricted(problem, restricted, accuracy, self.dual_is_residual);
        // What the last pass found is used; its dual value bounds the objective of any point.
        match self.prepare_pass(problem, threshold) {
            Next::Pass if !last => Next::Pass,
            _ => Next::Done,
        }
    }

    fn gap(&self) -> f64 {
        let scale = self.objective.max(FLOOR_SHARE * self.energy);
        if scale > 0.0 {
            (self.objective - self.dual_value) / scale
        } else {
            0.0
        }
    }

    fn load(&mut self, problem: Problem, rows: Rows, row: usize) {
        let Problem {
            dictionary,
            settings,
        } = problem;
        let (n, padded) = (dictionary.patterns, dictionary.means.len());
        let DataTerm {
            y,
            weights,
            inverse,
            lower,
        } = &mut self.data;
        let prediction = &mut self.point.prediction;
        for vector in [y, weights, inverse, &mut self.dual, prediction] {
            vector.clear();
            vector.resize(padded, 0.0);
        }
        lower.clear();
        lower.resize(padded, f64::NEG_INFINITY);
        let first = row * n;
        rows.samples.copy(first, &mut self.data.y[..n]);
        match rows.weights {
            None => self.data.weights[..n].fill(1.0),
            Some(values) if values.len() == n => {
                Values::copy(&values, 0, &mut self.data.weights[..n]);
            }
            Some(values) => Values::copy(&values, first, &mut self.data.weights[..n]),
        }
        let clipped = &rows.clipped[first..first + n];
        let level = dictionary.level;
        match settings.fidelity {
            Fidelity::Linear => {}
            Fidelity::OneSided => one_sided(level, clipped, &mut self.data.lower[..n]),
            Fidelity::Rejection => {
                for (weight, &clipped) in self.data.weights.iter_mut().zip(clipped) {
                    *weight = if clipped { 0.0 } else { *weight };
                }
            }
        }
        invert(level, &self.data.weights, &mut self.data.inverse);
        self.energy = dot(level, &self.data.y, &self.data.y) / 2.0;
        let (weights, lower) = (&self.data.weights, &self.data.lower);
        self.free_energy = free_energy(level, &dictionary.means, weights, lower);
        self.held = false;
    }

    fn update_prediction(&mut self, problem: Problem) {
        self.point.predict(problem.dictionary);
        self.point
            .exact_background(problem.dictionary, problem.settings, &self.data);
    }

    fn solve_restricted(
        &mut self,
        problem: Problem,
        restricted: &mut Restricted,
        accuracy: f64,
        gradient_known: bool,
    ) {
        restricted.load(&self.data, self.held, self.passes > QUICK_PASSES);
        restricted.solve(
            problem.dictionary,
            problem.settings,
            &self.data,
            &mut self.point,
            gradient_known.then_some((&self.dual[..], &self.gradient[..])),
            accuracy,
        );
        self.held = restricted.held;
        self.point.prune();
        if self.passes.is_multiple_of(REFRESH_PASSES) {
            self.update_prediction(problem);
        }
    }

    /// Computes the dual point from the residual. No pass is needed where the row is certainly dark.
    fn prepare_pass(&mut self, problem: Problem, threshold: Threshold) -> Next {
        let Problem {
            dictionary,
            settings,
        } = problem;
        let level = dictionary.level;
        let loss = residual(
            level,
            &self.data.y,
            &self.data.weights,
            &self.data.lower,
            &self.point.prediction,
            &mut self.dual,
        );
        let norm: f64 = self.point.x.iter().map(|x| x.abs()).sum();
        self.objective = settings.regularization * norm + loss;
        let moved = orthogonal_to_means(
            level,
            settings,
            &self.data,
            &dictionary.means,
            self.free_energy,
            &mut self.dual,
        );
        self.dual_is_residual = moved <= NEGLIGIBLE * settings.regularization;
        // Pattern values lie in [0, 1], so no correlation exceeds the sum of the positive residuals.
        // That alone certifies dark rows. In lit rows correlations are about lambda, so do not try.
        if self.point.pixels.is_empty() {
            let (low, high) = signed_sums(level, &self.dual);
            let most = if settings.nonnegative {
                high
            } else {
                high.max(-low)
            };
            if most <= settings.regularization {
                self.certify(problem, most);
                if self.gap() <= settings.tolerance {
                    return Next::Done;
                }
            }
        }
        self.set_filter(problem, threshold);
        Next::Pass
    }

    fn set_filter(&mut self, problem: Problem, threshold: Threshold) {
        let Problem {
            dictionary,
            settings,
        } = problem;
        let threshold = if dictionary.correlator.is_lookup() {
            threshold
        } else {
            Threshold::Lambda
        };
        let (level, dual) = (dictionary.level, &self.dual);
        self.filter = pricing::filter(settings, threshold, || {
            let of_means = dot(level, dual, &dictionary.means);
            (of_means, dot(level, dual, dual))
        });
    }

    fn certify(&mut self, problem: Problem, largest: f64) {
        let Problem {
            dictionary,
            settings,
        } = problem;
        self.dual_value = dual_value(
            dictionary.level,
            settings.regularization,
            &self.data,
            &self.dual,
            largest,
        );
    }
}
