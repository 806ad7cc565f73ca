//! The problem restricted to a few pixels: Newton steps on the clip state, coordinate descent within.
//!
//! While no sample changes between clipped-above and not, the restricted problem is a quadratic
//! with the Gram matrix of the columns over the samples that count. Coordinate descent runs on it
//! with the background eliminated (the 'centred' Gram matrix), whose rows are made when their
//! coordinate first moves: most never do. A line search guards the step where the clip state changes.

use super::{search, Dictionary, Settings};
use crate::columns::GramSource;
use crate::vector::{add_scaled, curvature, dot, residual, DataTerm};

/// Steps between which the clip state may change.
const NEWTON_STEPS: usize = 12;
/// Sweeps of coordinate descent a step.
const SWEEPS: usize = 30;
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
#[derive(Default)]
pub struct Restricted {
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
    direction: Vec<f64>,
    /// Pixels without curvature.
    flat: Vec<usize>,
}

impl Restricted {
    /// Takes note of a new row's data.
    pub fn load(&mut self, data: &DataTerm) {
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
        for buffer in [&mut self.gradient, &mut self.coupling] {
            buffer.clear();
            buffer.resize(n, 0.0);
        }
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
        curvature(
            level,
            &data.y,
            &data.weights,
            &data.lower,
            u,
            &mut self.curvature,
        );
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
        let along_means = dot(level, &self.means, means);
        let excess = dot(level, &self.theta, means);
        let centred = settings.background
            && along_means > 0.0
            && (!settings.nonnegative || point.background > 0.0 || excess > 0.0);
        if centred {
            let columns = &dictionary.columns;
            columns.correlate(level, &point.pixels, &self.means, &mut self.coupling);
        } else {
            self.coupling.fill(0.0);
        }
        let mut rise = 0.0;
        if centred {
            let per_mean = 1.0 / along_means;
            self.descend(
                dictionary,
                settings,
                point,
                -excess * per_mean,
                per_mean,
                accuracy,
            );
            rise = (excess - self.coupled_change(point)) * per_mean;
        }
        if !centred || (settings.nonnegative && point.background + rise < 0.0) {
            // By convexity b = 0 in the model's solution.
            let surplus = if settings.nonnegative {
                point.background
            } else {
                0.0
            };
            rise = -surplus;
            self.descend(dictionary, settings, point, surplus, 0.0, accuracy);
        }
        let advanced = self.advance(dictionary, settings, data, point, rise);
        self.lower_flat(dictionary, settings, data, point) || advanced
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
            let t = search::line(level, data, &point.prediction, &self.direction, linear);
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

    /// Coordinate descent on the quadratic model from `point.x` to `target`: with the background
    /// moved by `-shift` and then eliminated (`per_mean` > 0) or held.
    fn descend(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        point: &Point,
        shift: f64,
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
        self.slope.extend(centred.map(|(g, c)| g + c * shift));
        self.slot.clear();
        self.slot.resize(n, UNSET);
        self.rows.clear();
        self.flat.clear();
        let flat = FLAT * self.theta.len() as f64;
        for _ in 0..SWEEPS {
            let mut change: f64 = 0.0;
            for j in 0..n {
                let (x, g) = (self.target[j], self.slope[j]);
                // Nothing pulls a pixel at zero away from it.
                if x == 0.0 && (g <= lambda && (settings.nonnegative || g >= -lambda)) {
                    continue;
                }
                if self.slot[j] == UNSET {
                    self.make_row(dictionary, point, j, per_mean);
                }
                let start = self.slot[j] as usize * n;
                let row = &self.rows[start..start + n];
                let diagonal = row[j];
                if diagonal <= flat {
                    if x != 0.0 && g.abs() < lambda && !self.flat.contains(&j) {
                        self.flat.push(j);
                    }
                    continue;
                }
                let free = x + g / diagonal;
                let reach = lambda / diagonal;
                let next = if free > reach {
                    free - reach
                } else if !settings.nonnegative && free < -reach {
                    free + reach
                } else {
                    0.0
                };
                let moved = next - x;
                if moved != 0.0 {
                    self.target[j] = next;
                    add_scaled(level, &mut self.slope, -moved, row);
                    change = change.max(moved.abs() * diagonal);
                }
            }
            if change <= 0.3 * accuracy * lambda {
                break;
            }
        }
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
    }

    /// Goes towards `target` as far as the objective falls; false if it does not.
    fn advance(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        data: &DataTerm,
        point: &mut Point,
        rise: f64,
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
        let t = search::line(level, data, &point.prediction, &self.direction, linear);
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
        point.background = if t == 1.0 && rise == -point.background {
            0.0
        } else {
            point.background + t * rise
        };
        add_scaled(level, &mut point.prediction, t, &self.direction);
        point.exact_background(dictionary, settings, data);
        true
    }
}
