//! The problem restricted to a few pixels: Newton steps on the clip state.
//!
//! While no sample changes between clipped-above and not, the restricted problem is a quadratic
//! (`model`), which coordinate descent solves, or exchanges of pixels where that is slow. A line
//! search guards the step where the clip state changes.

use super::descent::Descent;
use super::model::Model;
use super::point::Point;
use super::search;
use crate::problem::{Dictionary, Settings};
use crate::simd::Level;
use crate::vector::{add_scaled, curvature, dot, residual, DataTerm};

/// Steps between which the clip state may change.
const NEWTON_STEPS: usize = 12;
/// A step is solved to this share of the violation it starts from.
const STEP_SHARE: f64 = 0.1;

/// Steps that leave more than this share of the violation call for exact solution.
const CRAWLING: f64 = 0.9;

/// How a Newton step ended.
#[derive(PartialEq)]
enum Step {
    /// The conditions hold as accurately as they should.
    Solved,
    /// It led nowhere.
    Stuck,
    /// Another one may be needed.
    Open,
}

/// Buffers of the restricted solve.
pub struct Restricted {
    model: Model,
    descent: Descent,
    theta: Vec<f64>,
    /// a_j . theta
    gradient: Vec<f64>,
    direction: Vec<f64>,
    /// Pixels that move, and how far.
    moves: Vec<(u32, f64)>,
    /// Whether b = 0 held the last step of the row.
    pub held: bool,
}

impl Restricted {
    pub fn new(level: Level) -> Self {
        Restricted {
            model: Model::new(level),
            descent: Descent::new(level),
            theta: Vec::new(),
            gradient: Vec::new(),
            direction: Vec::new(),
            moves: Vec::new(),
            held: false,
        }
    }

    /// Turns to a row: its data, and how its last solve ended.
    pub fn load(&mut self, data: &DataTerm, held: bool) {
        self.held = held;
        self.model.load_row(data);
        self.theta.resize(data.y.len(), 0.0);
        self.direction.resize(data.y.len(), 0.0);
    }

    fn target(&self) -> &[f64] {
        &self.descent.progress.target
    }

    /// Improves `point` until every pixel's optimality condition holds within `accuracy` lambda.
    ///
    /// `known` may hold the weighted residual at `point` and its correlations.
    pub fn solve(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        data: &DataTerm,
        point: &mut Point,
        known: Option<(&[f64], &[f64])>,
        accuracy: f64,
    ) {
        let level = dictionary.level;
        self.model.load_pixels(dictionary, &point.pixels);
        self.gradient.resize(point.pixels.len(), 0.0);
        let mut before = f64::INFINITY;
        for step in 0..NEWTON_STEPS {
            match known {
                Some((theta, gradient)) if step == 0 => {
                    self.theta.copy_from_slice(theta);
                    self.gradient.copy_from_slice(gradient);
                }
                _ => {
                    residual(
                        level,
                        &data.y,
                        &data.weights,
                        &data.lower,
                        &point.prediction,
                        &mut self.theta,
                    );
                    let (theta, gradient) = (&self.theta, &mut self.gradient);
                    self.model
                        .correlate(dictionary, &point.pixels, theta, gradient);
                }
            }
            let violation = self.violation(settings, point);
            if violation <= accuracy * settings.regularization {
                return;
            }
            // Coordinate descent may crawl where columns nearly depend on each other.
            self.descent.exactly = !self.descent.settled && violation > CRAWLING * before;
            before = violation;
            if self.step(dictionary, settings, data, point, accuracy) != Step::Open {
                return;
            }
        }
    }

    /// How far the optimality conditions of the pixels are from holding.
    fn violation(&self, settings: &Settings, point: &Point) -> f64 {
        let lambda = settings.regularization;
        let mut most: f64 = 0.0;
        for (&x, &g) in point.x.iter().zip(&self.gradient) {
            most = most.max(if x != 0.0 {
                (g - lambda * x.signum()).abs()
            } else if settings.nonnegative {
                g - lambda
            } else {
                g.abs() - lambda
            });
        }
        most
    }

    /// One Newton step.
    fn step(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        data: &DataTerm,
        point: &mut Point,
        accuracy: f64,
    ) -> Step {
        let level = dictionary.level;
        let means = &dictionary.means;
        let u = &point.prediction;
        let d = &mut self.direction;
        curvature(level, &data.y, &data.weights, &data.lower, u, d);
        self.model.set_curvature(means, d);
        let along_means = self.model.along_means(means);
        let excess = dot(level, &self.theta, means);
        let centred = settings.background
            && along_means > 0.0
            && (!settings.nonnegative || point.background > 0.0 || excess > 0.0);
        self.model.couple(dictionary, &point.pixels, centred);
        // A step that the clip state will make inexact anyway need not be solved well.
        let wanted = accuracy * settings.regularization;
        let accuracy = wanted.max(STEP_SHARE * self.violation(settings, point));
        // Every step is one of descent on the model, so the line search always finds progress.
        let b = point.background;
        let (mut rise, mut limit) = (0.0, 1.0);
        let mut free = centred && (b > 0.0 || !self.held);
        if free {
            let per_mean = 1.0 / along_means;
            self.descend(dictionary, settings, point, excess, per_mean, accuracy);
            rise = (excess - self.coupled_change(point)) * per_mean;
            if settings.nonnegative && b + rise < 0.0 {
                limit = b / -rise;
                free = limit > 0.0;
                self.held = true;
            } else {
                self.held = false;
            }
        }
        if !free {
            // b stays at 0 while x moves; if m' theta then calls for more, b follows.
            rise = 0.0;
            limit = 1.0;
            self.descend(dictionary, settings, point, 0.0, 0.0, accuracy);
            self.held = excess - self.coupled_change(point) <= 0.0;
        }
        let t = self.advance(dictionary, settings, data, point, rise, limit);
        if self.lower_flat(dictionary, settings, data, point) {
            return Step::Open;
        }
        if t <= 0.0 {
            return Step::Stuck;
        }
        // After a whole step within one clip state the model was the truth.
        if t == 1.0 && accuracy == wanted && self.descent.settled {
            let (u, d) = (&point.prediction, &mut self.direction);
            curvature(level, &data.y, &data.weights, &data.lower, u, d);
            if self.model.has_curvature(d) {
                return Step::Solved;
            }
        }
        Step::Open
    }

    /// Finds the model's minimum, with the background eliminated (`per_mean` = 1 / m' D m) or held
    /// (0).
    fn descend(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        point: &Point,
        excess: f64,
        per_mean: f64,
        accuracy: f64,
    ) {
        self.model.centre(per_mean);
        self.descent.run(
            dictionary,
            settings,
            &mut self.model,
            &point.pixels,
            &point.x,
            &self.gradient,
            excess * per_mean,
            accuracy,
        );
    }

    /// Pixels that lie beyond the clip level of all their samples see no curvature, only lambda:
    /// each goes down by itself to its minimum; false if there was none.
    fn lower_flat(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        data: &DataTerm,
        point: &mut Point,
    ) -> bool {
        let level = dictionary.level;
        for &j in &self.descent.flat {
            let x = point.x[j];
            self.direction.fill(0.0);
            let columns = &dictionary.columns;
            columns.add(level, point.pixels[j], -x, &mut self.direction);
            let linear = -settings.regularization * x.abs();
            let t = search::line(level, data, &point.prediction, &self.direction, linear, 1.0);
            point.x[j] = if t == 1.0 { 0.0 } else { x - t * x };
            add_scaled(level, &mut point.prediction, t, &self.direction);
        }
        if !self.descent.flat.is_empty() {
            point.exact_background(dictionary, settings, data);
        }
        !self.descent.flat.is_empty()
    }

    /// What the change from `point.x` to `target` does to m' theta, in the model.
    fn coupled_change(&self, point: &Point) -> f64 {
        let changes = self.target().iter().zip(&point.x).zip(&self.model.coupling);
        changes.map(|((target, x), c)| c * (target - x)).sum()
    }

    /// Goes towards `target` as far as the objective falls; returns the share of the way.
    fn advance(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        data: &DataTerm,
        point: &mut Point,
        rise: f64,
        limit: f64,
    ) -> f64 {
        let level = dictionary.level;
        let mut growth = 0.0;
        self.direction.fill(0.0);
        let target = &self.descent.progress.target;
        self.moves.clear();
        for ((&target, &x), &pixel) in target.iter().zip(&point.x).zip(&point.pixels) {
            let moved = target - x;
            if moved != 0.0 {
                growth += target.abs() - x.abs();
                self.moves.push((pixel, moved));
            }
        }
        let columns = &dictionary.columns;
        columns.add_all(level, &self.moves, &mut self.direction);
        if rise != 0.0 {
            add_scaled(level, &mut self.direction, rise, &dictionary.means);
        }
        let linear = settings.regularization * growth;
        let t = search::line(
            level,
            data,
            &point.prediction,
            &self.direction,
            linear,
            limit,
        );
        if t <= 0.0 {
            return t;
        }
        for (x, target) in point.x.iter_mut().zip(target) {
            *x = if t == 1.0 {
                *target
            } else {
                *x + t * (target - *x)
            };
        }
        let to_zero = t == limit && limit < 1.0;
        point.background = if to_zero {
            0.0
        } else {
            point.background + t * rise
        };
        add_scaled(level, &mut point.prediction, t, &self.direction);
        point.exact_background(dictionary, settings, data);
        t
    }
}
