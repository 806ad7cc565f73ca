//! One row, from its samples to its certificate.

use super::certificate::{dual_value, orthogonal_to_means};
use super::point::Point;
use super::pricing::{self, Look, Pricing};
use super::restricted::Restricted;
use crate::correlate::{Scores, Wanted};
use crate::problem::{Dictionary, Fidelity, Rows, Settings, Solution, Values};
use crate::vector::{dot, free_energy, invert, one_sided, residual, signed_sums, DataTerm};

/// New pixels taken in after the first pass, and after each later one.
const NEW_PIXELS: [usize; 2] = [8, 16];
/// The same where a pass reads its patterns from memory: it takes longer than a row of many pixels.
const MANY_NEW_PIXELS: [usize; 2] = [64, 128];
/// The restricted solve goes to this share of the violation that was found outside,
const INNER_SHARE: f64 = 0.25;
/// and no rougher than this share of lambda.
const ROUGH: f64 = 1.0;
/// On up to so many pixels being exact is cheaper than another pass: there violations below this
/// share of lambda are taken for the last ones, and the restricted solve is as fine as can be.
const FEW: usize = 12;
const NEARLY: f64 = 1.0;
/// On more pixels violations are taken for the last ones below this.
const VERY_NEARLY: f64 = 0.03;
/// But no finer than this share of the tolerance, until the gap asks for it.
const FINEST_SHARE: f64 = 0.2;
/// A dual point this share of lambda off the residual's slope along the means counts as the residual.
const NEGLIGIBLE: f64 = 1e-9;
/// Predictions follow the steps of x, whose rounding adds up, and are made afresh after so many passes.
const AFRESH: u32 = 8;
/// The gap is relative to at least this share of ||y||^2 / 2.
const FLOOR_SHARE: f64 = 1e-6;

pub enum Next {
    /// A pass with `RowSolver::dual` is needed.
    Pass,
    Done,
}

/// What a row is solved on, and how.
#[derive(Clone, Copy)]
pub struct Problem<'a> {
    pub dictionary: &'a Dictionary,
    pub settings: &'a Settings,
}

/// Solves one row after the other, each of a problem of its own if need be, in the same memory.
pub struct RowSolver {
    data: DataTerm,
    /// ||y||^2 / 2
    energy: f64,
    /// Energy of the means over two-sided samples.
    free_energy: f64,
    point: Point,
    /// Whether b = 0 held the last step of the restricted solve.
    held: bool,
    dual: Vec<f64>,
    wanted: Wanted,
    passes: u32,
    objective: f64,
    dual_value: f64,
    /// Finest accuracy of the restricted solve so far.
    finest: f64,
    pricing: Pricing,
    /// Correlations of the point's pixels.
    gradient: Vec<f64>,
    /// Whether `dual` is the residual, but for rounding.
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
            wanted: Wanted::All,
            passes: 0,
            objective: 0.0,
            dual_value: f64::NEG_INFINITY,
            finest: 0.0,
            pricing: Pricing::default(),
            gradient: Vec::new(),
            dual_is_residual: false,
        }
    }

    /// The scores that the next pass is to give.
    pub fn wanted(&self) -> Wanted {
        self.wanted
    }

    /// The dual point that the next pass correlates.
    pub fn dual(&self) -> &[f64] {
        &self.dual
    }

    /// The solution as it stands.
    pub fn solution(&self, problem: Problem) -> Solution {
        let mut support: Vec<(u32, f64)> = self.point.support().collect();
        support.sort_unstable_by_key(|&(pixel, _)| pixel);
        let mut numbers = support
            .iter()
            .map(|&(_, x)| x)
            .chain([self.point.background]);
        if !numbers.all(f64::is_finite) {
            // Samples and weights so large that squares of them overflow: nothing was found.
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

    /// Starts on a row, from the given start or from nothing.
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
            return self.prepare_pass(problem, Look::First);
        }
        self.solve_restricted(problem, restricted, self.finest, false);
        self.prepare_pass(problem, Look::Closely)
    }

    /// Goes on with the scores of `dual`.
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
        let found = self.pricing.run(
            dictionary,
            settings,
            scores,
            &self.dual,
            &self.point.pixels,
            new,
        );
        self.certify(problem, found.largest);
        if self.gap() <= settings.tolerance || self.passes >= settings.max_passes {
            return Next::Done;
        }
        if !found.enough {
            self.want(problem, Look::Closely);
            return Next::Pass;
        }
        let before = self.point.pixels.len();
        self.gradient.clear();
        self.gradient.extend_from_slice(self.pricing.known());
        let lambda = settings.regularization;
        for (pixel, correlation) in self.pricing.violators(lambda) {
            self.point.push(pixel, 0.0);
            self.gradient.push(correlation);
        }
        let violation = (found.exact / lambda - 1.0).max(0.0);
        if violation < settings.tolerance {
            // Few pixels are left to find: what keeps the gap open is the accuracy within.
            self.finest *= 0.3;
        }
        let last = if before <= FEW { NEARLY } else { VERY_NEARLY };
        let (accuracy, look) = if violation < last {
            (self.finest, Look::Closely)
        } else {
            (ROUGH.min(INNER_SHARE * violation), Look::Again)
        };
        self.solve_restricted(problem, restricted, accuracy, self.dual_is_residual);
        self.prepare_pass(problem, look)
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
        restricted.load(&self.data, self.held);
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
        if self.passes.is_multiple_of(AFRESH) {
            self.update_prediction(problem);
        }
    }

    /// Makes the dual point of the current residual; done at once if it is sure to be feasible.
    fn prepare_pass(&mut self, problem: Problem, look: Look) -> Next {
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
        // No correlation with values in [0, 1] exceeds the sum of the positive residuals: what rules
        // dark rows out. Of pixels that hold light it is about lambda.
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
        self.want(problem, look);
        Next::Pass
    }

    fn want(&mut self, problem: Problem, look: Look) {
        let Problem {
            dictionary,
            settings,
        } = problem;
        let look = if dictionary.correlator.is_lookup() {
            look
        } else {
            Look::Closely
        };
        let (level, dual) = (dictionary.level, &self.dual);
        self.wanted = pricing::wanted(settings, look, || {
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
