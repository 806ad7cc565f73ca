//! The problem restricted to the working set, solved by Newton steps.
//!
//! A one-sided sample counts while the prediction lies below its value; its clip state says whether it
//! does. While no clip state changes, the restricted problem is a quadratic (`model`), which `descent`
//! minimises. A line search makes sure that the objective falls even if a step changes clip states.

use super::descent::Descent;
use super::model::Model;
use super::point::Point;
use super::search;
use crate::problem::{Dictionary, Settings};
use crate::simd::Level;
use crate::vector::{add_scaled, curvature, dot, residual, DataTerm};

/// Limit of Newton steps. The row's next pass continues where they stop. Chosen by hand.
const NEWTON_STEPS: usize = 12;
/// A step is solved until its violation is this share of the violation before. Clip states change
/// anyway, so a more accurate step would be wasted. Chosen by hand.
const STEP_SHARE: f64 = 0.1;
/// If a step leaves more than this share of the violation, the next one uses the exact method.
/// Chosen by hand: at this rate coordinate descent would need 22 steps for what one should do.
const SLOW_PROGRESS: f64 = 0.9;

/// How a Newton step ended.
#[derive(PartialEq)]
enum Step {
    /// The optimality conditions hold within the required accuracy.
    Solved,
    /// The objective did not fall.
    Stuck,
    /// Another step may be needed.
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
    /// The pixels that move, and how far.
    moves: Vec<(u32, f64)>,
    /// Whether the constraint b = 0 was active in the last step.
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

    /// Loads a row's data, and `held` of its last restricted solve. With `exact`, inner products are
    /// those of float64, whatever the columns allow.
    pub fn load(&mut self, data: &DataTerm, held: bool, exact: bool) {
        self.held = held;
        self.model.exact = exact;
        self.model.load_row(data);
        self.theta.resize(data.y.len(), 0.0);
        self.direction.resize(data.y.len(), 0.0);
    }

    fn target(&self) -> &[f64] {
        &self.descent.progress.target
    }

    /// Improves `point` until every pixel's optimality condition holds within `accuracy` lambda.
    ///
    /// `known` may hold the weighted residual at `point` and the columns' correlations with it.
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
            // Coordinate descent is slow where columns are nearly dependent.
            self.descent.exactly = !self.descent.settled && violation > SLOW_PROGRESS * before;
            before = violation;
            if self.step(dictionary, settings, data, point, accuracy) != Step::Open {
                return;
            }
        }
    }

    /// The largest violation of a pixel's optimality condition.
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
        let required = accuracy * settings.regularization;
        let accuracy = required.max(STEP_SHARE * self.violation(settings, point));
        // Every step descends on the model, so the line search always lowers the objective.
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
            // b stays at 0 while x moves. If m' theta is positive then, the next step frees b.
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
        // If a full step changed no clip state, the model was exact and the step solved the problem.
        if t == 1.0 && accuracy == required && self.descent.settled {
            let (u, d) = (&point.prediction, &mut self.direction);
            curvature(level, &data.y, &data.weights, &data.lower, u, d);
            if self.model.has_curvature(d) {
                return Step::Solved;
            }
        }
        Step::Open
    }

    /// Minimises the model, with the background eliminated (`per_mean` = 1 / m' D m) or held fixed
    /// (`per_mean` = 0).
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

    /// Lowers pixels that are so bright that all their samples are beyond the clip level. The model has
    /// no curvature along them, so each gets a line search of its own. Returns whether there were any.
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

    /// How much the change from `point.x` to `target` lowers m' theta, in the model.
    fn coupled_change(&self, point: &Point) -> f64 {
        let changes = self.target().iter().zip(&point.x).zip(&self.model.coupling);
        changes.map(|((target, x), c)| c * (target - x)).sum()
    }

    /// Moves towards `target` while the objective falls; returns the share of the way.
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
