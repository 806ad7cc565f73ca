//! The problem restricted to a few pixels: Newton steps on the clip state, coordinate descent within.
//!
//! While no sample changes between clipped-above and not, the restricted problem is a quadratic
//! with the Gram matrix of the columns over the samples that count. Coordinate descent runs on it
//! with the background eliminated (the 'centred' Gram matrix), whose rows are made when their
//! coordinate first moves: most never do. A line search guards the step where the clip state changes.

use super::factor::{Factor, LARGEST};
use super::{search, Dictionary, Settings};
use crate::columns::GramSource;
use crate::simd::Level;
use crate::vector::{add_scaled, curvature, dot, residual, DataTerm};

/// Steps between which the clip state may change.
const NEWTON_STEPS: usize = 12;
/// Sweeps of coordinate descent a step.
const SWEEPS: usize = 20;
/// Accuracy, in lambda, from which exact pivoting can pay.
const PIVOT_ACCURACY: f64 = 0.01;
/// Coordinate descent that has not settled after so many sweeps gives way to exact pivoting,
const SWEEPS_BEFORE_PIVOTS: usize = 5;
/// of at most so many pixels in and out.
const PIVOTS: usize = 400;
/// A step is solved to this share of the violation it starts from.
const STEP_SHARE: f64 = 0.05;
/// Coordinate descent has settled when no coordinate's slope changes by this share of the accuracy.
const SETTLED_SHARE: f64 = 0.3;
/// Columns with less curvature than this share of the samples are combinations of the background.
const FLAT: f64 = 1e-9;
const UNSET: u32 = u32::MAX;

/// A point: pixels that may differ from zero, their x, b, and the prediction u.
pub struct Point {
    pub pixels: Vec<u32>,
    pub x: Vec<f64>,
    pub background: f64,
    pub prediction: Vec<f64>,
}

impl Point {
    pub fn new(samples: usize) -> Self {
        Point {
            pixels: Vec::new(),
            x: Vec::new(),
            background: 0.0,
            prediction: vec![0.0; samples],
        }
    }

    pub fn clear(&mut self) {
        self.pixels.clear();
        self.x.clear();
        self.background = 0.0;
    }

    pub fn push(&mut self, pixel: u32, x: f64) {
        self.pixels.push(pixel);
        self.x.push(x);
    }

    /// Pixels that differ from zero.
    pub fn support(&self) -> impl Iterator<Item = (u32, f64)> + '_ {
        self.pixels
            .iter()
            .copied()
            .zip(self.x.iter().copied())
            .filter(|&(_, x)| x != 0.0)
    }

    /// Drops pixels at zero.
    pub fn prune(&mut self) {
        let mut kept = 0;
        for i in 0..self.x.len() {
            if self.x[i] != 0.0 {
                self.pixels[kept] = self.pixels[i];
                self.x[kept] = self.x[i];
                kept += 1;
            }
        }
        self.pixels.truncate(kept);
        self.x.truncate(kept);
    }

    /// Makes a start feasible.
    pub fn restrict_to(&mut self, settings: &Settings) {
        if settings.nonnegative {
            self.x.iter_mut().for_each(|x| *x = x.max(0.0));
            self.background = self.background.max(0.0);
        }
        if !settings.background {
            self.background = 0.0;
        }
        self.prune();
    }

    /// u = A x + b m
    pub fn predict(&mut self, dictionary: &Dictionary) {
        let level = dictionary.level;
        self.prediction.fill(0.0);
        for (&pixel, &x) in self.pixels.iter().zip(&self.x) {
            if x != 0.0 {
                dictionary
                    .columns
                    .add(level, pixel, x, &mut self.prediction);
            }
        }
        if self.background != 0.0 {
            add_scaled(
                level,
                &mut self.prediction,
                self.background,
                &dictionary.means,
            );
        }
    }

    /// Moves b to its best value for these x.
    pub fn exact_background(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        data: &DataTerm,
    ) {
        if !settings.background {
            return;
        }
        let floor = if settings.nonnegative {
            -self.background
        } else {
            f64::NEG_INFINITY
        };
        let level = dictionary.level;
        let negligible = 1e-6 * settings.tolerance * settings.regularization;
        let means = &dictionary.means;
        let step = search::background(level, data, &self.prediction, means, floor, negligible);
        if step != 0.0 {
            self.background = if step == floor {
                0.0
            } else {
                self.background + step
            };
            add_scaled(level, &mut self.prediction, step, means);
        }
    }
}

/// Buffers of the restricted solve.
pub struct Restricted {
    level: Level,
    gram: GramSource,
    /// Whether weights are 0 or 1 only.
    unit_weights: bool,
    theta: Vec<f64>,
    curvature: Vec<f64>,
    active: Vec<u64>,
    /// d m
    means: Vec<f64>,
    /// a_j . theta
    gradient: Vec<f64>,
    /// a_j . d m
    coupling: Vec<f64>,
    target: Vec<f64>,
    slope: Vec<f64>,
    /// Rows of the centred Gram matrix made so far, and where each pixel's is.
    rows: Vec<f64>,
    slot: Vec<u32>,
    /// The `per_mean` they are centred with.
    rows_per_mean: f64,
    /// Whether `coupling` is up to date.
    coupled: bool,
    direction: Vec<f64>,
    /// One over the diagonal; 0 where there is no curvature.
    inverse: Vec<f64>,
    /// Pixels that differ from zero, in two generations.
    order: Vec<u32>,
    moving: Vec<u32>,
    factor: Factor,
    /// Pixels that the exact solution has considered, and its change of those in play.
    taken: Vec<bool>,
    solution: Vec<f64>,
    /// Whether b = 0 held the last step.
    held: bool,
    /// Pixels without curvature.
    flat: Vec<usize>,
}

impl Restricted {
    pub fn new(level: Level) -> Self {
        Restricted {
            level,
            gram: GramSource::default(),
            unit_weights: false,
            theta: Vec::new(),
            curvature: Vec::new(),
            active: Vec::new(),
            means: Vec::new(),
            gradient: Vec::new(),
            coupling: Vec::new(),
            target: Vec::new(),
            slope: Vec::new(),
            rows: Vec::new(),
            slot: Vec::new(),
            rows_per_mean: 0.0,
            coupled: false,
            direction: Vec::new(),
            inverse: Vec::new(),
            order: Vec::new(),
            moving: Vec::new(),
            factor: Factor::new(level),
            taken: Vec::new(),
            solution: Vec::new(),
            held: false,
            flat: Vec::new(),
        }
    }

    /// Takes note of a new row's data.
    pub fn load(&mut self, data: &DataTerm) {
        self.held = false;
        self.unit_weights = data.weights.iter().all(|&w| w == 0.0 || w == 1.0);
        let n = data.y.len();
        for buffer in [
            &mut self.theta,
            &mut self.curvature,
            &mut self.means,
            &mut self.direction,
        ] {
            buffer.resize(n, 0.0);
        }
        // Nothing known of the last row holds for this one.
        self.curvature.fill(f64::NAN);
    }

    /// Improves `point` until every pixel's optimality condition holds within `accuracy` lambda.
    pub fn solve(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        data: &DataTerm,
        point: &mut Point,
        accuracy: f64,
    ) {
        let level = dictionary.level;
        let n = point.pixels.len();
        self.gram.load(&dictionary.columns, &point.pixels);
        for buffer in [&mut self.gradient, &mut self.coupling, &mut self.inverse] {
            buffer.clear();
            buffer.resize(n, 0.0);
        }
        self.slot.clear();
        self.slot.resize(n, UNSET);
        self.rows.clear();
        self.coupled = false;
        for _ in 0..NEWTON_STEPS {
            residual(
                level,
                &data.y,
                &data.weights,
                &data.lower,
                &point.prediction,
                &mut self.theta,
            );
            let columns = &dictionary.columns;
            columns.correlate(level, &point.pixels, &self.theta, &mut self.gradient);
            if self.violation(settings, point) <= accuracy * settings.regularization {
                return;
            }
            if !self.step(dictionary, settings, data, point, accuracy) {
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

    /// One Newton step; false if it led nowhere.
    fn step(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        data: &DataTerm,
        point: &mut Point,
        accuracy: f64,
    ) -> bool {
        let level = dictionary.level;
        let means = &dictionary.means;
        let u = &point.prediction;
        self.direction.resize(self.theta.len(), 0.0);
        let d = &mut self.direction;
        curvature(level, &data.y, &data.weights, &data.lower, u, d);
        if self.direction != self.curvature {
            std::mem::swap(&mut self.direction, &mut self.curvature);
            self.curvature_changed(means);
        }
        let along_means = dot(level, &self.means, means);
        let excess = dot(level, &self.theta, means);
        let centred = settings.background
            && along_means > 0.0
            && (!settings.nonnegative || point.background > 0.0 || excess > 0.0);
        if !centred {
            self.coupling.fill(0.0);
            self.coupled = false;
        } else if !self.coupled {
            let columns = &dictionary.columns;
            columns.correlate(level, &point.pixels, &self.means, &mut self.coupling);
            self.coupled = true;
        }
        // A step that the clip state will make inexact anyway need not be solved well.
        let accuracy = accuracy * settings.regularization;
        let accuracy = accuracy.max(STEP_SHARE * self.violation(settings, point));
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
        let advanced = self.advance(dictionary, settings, data, point, rise, limit);
        self.lower_flat(dictionary, settings, data, point) || advanced
    }

    /// What follows from the samples that count, and makes known rows of the Gram matrix useless.
    fn curvature_changed(&mut self, means: &[f64]) {
        self.active.clear();
        if self.unit_weights {
            let words = self.curvature.chunks_exact(64).map(|d| {
                d.iter()
                    .enumerate()
                    .fold(0u64, |word, (i, &d)| word | u64::from(d > 0.0) << i)
            });
            self.active.extend(words);
        }
        for ((dm, d), m) in self.means.iter_mut().zip(&self.curvature).zip(means) {
            *dm = d * m;
        }
        self.coupled = false;
        self.forget_rows();
    }

    fn forget_rows(&mut self) {
        self.slot.fill(UNSET);
        self.inverse.fill(0.0);
        self.rows.clear();
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
        for &j in &self.flat {
            let x = point.x[j];
            self.direction.fill(0.0);
            let columns = &dictionary.columns;
            columns.add(level, point.pixels[j], -x, &mut self.direction);
            let linear = -settings.regularization * x.abs();
            let t = search::line(level, data, &point.prediction, &self.direction, linear, 1.0);
            point.x[j] = if t == 1.0 { 0.0 } else { x - t * x };
            add_scaled(level, &mut point.prediction, t, &self.direction);
        }
        if !self.flat.is_empty() {
            point.exact_background(dictionary, settings, data);
        }
        !self.flat.is_empty()
    }

    /// What the change from `point.x` to `target` does to m' theta, in the model.
    fn coupled_change(&self, point: &Point) -> f64 {
        let changes = self.target.iter().zip(&point.x).zip(&self.coupling);
        changes.map(|((target, x), c)| c * (target - x)).sum()
    }

    /// Coordinate descent on the quadratic model from `point.x` to `target`, with the background
    /// eliminated (`per_mean` = 1 / m' D m) or held (0).
    fn descend(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        point: &Point,
        excess: f64,
        per_mean: f64,
        accuracy: f64,
    ) {
        let level = dictionary.level;
        let n = point.pixels.len();
        let lambda = settings.regularization;
        self.target.clear();
        self.target.extend_from_slice(&point.x);
        self.slope.clear();
        let centred = self.gradient.iter().zip(&self.coupling);
        self.slope
            .extend(centred.map(|(g, c)| g - c * excess * per_mean));
        if per_mean != self.rows_per_mean {
            self.forget_rows();
            self.rows_per_mean = per_mean;
        }
        self.flat.clear();
        let mut full = true;
        for sweep in 0..SWEEPS {
            let mut change: f64 = 0.0;
            self.moving.clear();
            for i in 0..if full { n } else { self.order.len() } {
                let j = if full { i } else { self.order[i] as usize };
                let (x, g) = (self.target[j], self.slope[j]);
                // Nothing pulls a pixel at zero away from it.
                if x == 0.0 && (g <= lambda && (settings.nonnegative || g >= -lambda)) {
                    continue;
                }
                if self.slot[j] == UNSET {
                    self.make_row(dictionary, point, j, per_mean);
                }
                let inverse = self.inverse[j];
                if inverse == 0.0 {
                    if x != 0.0 && g.abs() < lambda && !self.flat.contains(&j) {
                        self.flat.push(j);
                    }
                    continue;
                }
                let free = x + g * inverse;
                let reach = lambda * inverse;
                let next = if free > reach {
                    free - reach
                } else if !settings.nonnegative && free < -reach {
                    free + reach
                } else {
                    0.0
                };
                if next != 0.0 {
                    self.moving.push(j as u32);
                }
                let moved = next - x;
                if moved != 0.0 {
                    self.target[j] = next;
                    let start = self.slot[j] as usize * n;
                    add_scaled(level, &mut self.slope, -moved, &self.rows[start..start + n]);
                    change = change.max(moved.abs() / inverse);
                }
            }
            std::mem::swap(&mut self.order, &mut self.moving);
            if change <= SETTLED_SHARE * accuracy {
                if full {
                    break;
                }
                // Settled on the pixels that move: look at all again.
                full = true;
            } else {
                full = false;
                let fine = accuracy <= PIVOT_ACCURACY * lambda;
                if fine && sweep + 1 >= SWEEPS_BEFORE_PIVOTS && self.order.len() <= LARGEST / 2 {
                    self.pivot(
                        dictionary,
                        settings,
                        point,
                        per_mean,
                        SETTLED_SHARE * accuracy,
                    );
                    break;
                }
            }
        }
    }

    /// Solves the quadratic model exactly, from where coordinate descent has come to: go to the
    /// solution for the pixels that differ from zero; whenever one becomes zero on the way, leave it
    /// out; once there, take in the pixel that violates its condition most (Lawson & Hanson 1974).
    fn pivot(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        point: &Point,
        per_mean: f64,
        accuracy: f64,
    ) {
        let n = self.target.len();
        let lambda = settings.regularization;
        self.factor.clear();
        self.moving.clear();
        // Pixels in play, and those that depend on them.
        self.taken.clear();
        self.taken.resize(n, false);
        for i in 0..self.order.len() {
            self.take_in(self.order[i] as usize);
        }
        for _ in 0..PIVOTS {
            self.solution.clear();
            let sloping = self.moving.iter().map(|&j| {
                let (g, x) = (self.slope[j as usize], self.target[j as usize]);
                // A pixel taken in at zero moves to the side it is pulled to.
                let sign = if x == 0.0 { g.signum() } else { x.signum() };
                g - lambda * sign
            });
            self.solution.extend(sloping);
            self.factor.solve(&mut self.solution);
            let mut limit: f64 = 1.0;
            let mut first = None;
            for (place, (&j, &change)) in self.moving.iter().zip(&self.solution).enumerate() {
                let x = self.target[j as usize];
                if x * (x + limit * change) < 0.0 {
                    (limit, first) = (-x / change, Some(place));
                }
            }
            for (&j, &change) in self.moving.iter().zip(&self.solution) {
                self.target[j as usize] += limit * change;
                let row = &self.rows[self.slot[j as usize] as usize * n..][..n];
                add_scaled(self.level, &mut self.slope, -limit * change, row);
            }
            if let Some(place) = first {
                let j = self.moving.remove(place) as usize;
                self.target[j] = 0.0;
                self.taken[j] = false;
                self.factor.remove(place);
                continue;
            }
            // Dependent pixels are skipped; what they lack shows in the next step's slopes.
            let taken_in = loop {
                let mut worst = None;
                let mut most = lambda + accuracy;
                for j in (0..n).filter(|&j| !self.taken[j]) {
                    let g = self.slope[j];
                    let pull = if settings.nonnegative { g } else { g.abs() };
                    if pull > most {
                        (most, worst) = (pull, Some(j));
                    }
                }
                let Some(j) = worst else { break false };
                if self.slot[j] == UNSET {
                    self.make_row(dictionary, point, j, per_mean);
                }
                if self.take_in(j) {
                    break true;
                }
            };
            if !taken_in {
                break;
            }
        }
    }

    /// Lets a pixel take part in the exact solution; false if it depends on those that do.
    fn take_in(&mut self, j: usize) -> bool {
        let n = self.target.len();
        self.taken[j] = true;
        let row = &self.rows[self.slot[j] as usize * n..][..n];
        let products = self.moving.iter().map(|&i| row[i as usize]);
        let independent = self.inverse[j] > 0.0 && self.factor.push(products, row[j]);
        if independent {
            self.moving.push(j as u32);
        }
        independent
    }

    fn make_row(&mut self, dictionary: &Dictionary, point: &Point, j: usize, per_mean: f64) {
        let level = dictionary.level;
        let n = point.pixels.len();
        let start = self.rows.len();
        self.slot[j] = (start / n) as u32;
        self.rows.resize(start + n, 0.0);
        let row = &mut self.rows[start..];
        self.gram.row(
            level,
            &dictionary.columns,
            &point.pixels,
            j,
            &self.curvature,
            &self.active,
            row,
        );
        if per_mean != 0.0 {
            add_scaled(level, row, -self.coupling[j] * per_mean, &self.coupling);
        }
        if row[j] > FLAT * self.theta.len() as f64 {
            self.inverse[j] = 1.0 / row[j];
        }
    }

    /// Goes towards `target` as far as the objective falls; false if it does not.
    fn advance(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        data: &DataTerm,
        point: &mut Point,
        rise: f64,
        limit: f64,
    ) -> bool {
        let level = dictionary.level;
        let mut growth = 0.0;
        self.direction.fill(0.0);
        for j in 0..point.pixels.len() {
            let moved = self.target[j] - point.x[j];
            if moved != 0.0 {
                growth += self.target[j].abs() - point.x[j].abs();
                let columns = &dictionary.columns;
                columns.add(level, point.pixels[j], moved, &mut self.direction);
            }
        }
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
            return false;
        }
        for (x, target) in point.x.iter_mut().zip(&self.target) {
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
        true
    }
}
