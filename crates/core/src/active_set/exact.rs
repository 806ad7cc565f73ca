//! The exact minimum of the quadratic model: pixels enter and leave the support until none should.

use super::factor::{subtract_rows, Factor, LARGEST};
use super::model::Model;
use super::progress::Progress;
use crate::problem::{Dictionary, Settings};
use crate::simd::Level;

/// Limit of exact solutions, each on one support. Rows that need more return to coordinate descent.
/// Chosen by hand.
const ROUNDS: usize = 60;
/// The support may grow by a quarter (one in `ENTERING`) at a time, and by at least one pixel: many of
/// the pixels that violate their condition at first no longer do once the strongest have entered. Chosen
/// by hand.
const ENTERING: usize = 4;

/// The support and the buffers of a round.
pub struct Exact {
    level: Level,
    factor: Factor,
    /// Pixels of the support, where their rows of the model begin, and the change of each.
    set: Vec<u32>,
    places: Vec<usize>,
    change: Vec<f64>,
    /// Whether a pixel is in the support or was removed because its column depends on others.
    tried: Vec<bool>,
    full_change: Vec<f64>,
    entering: Vec<(f64, u32)>,
}

impl Exact {
    pub fn new(level: Level) -> Self {
        Exact {
            level,
            factor: Factor::new(level),
            set: Vec::new(),
            places: Vec::new(),
            change: Vec::new(),
            tried: Vec::new(),
            full_change: Vec::new(),
            entering: Vec::new(),
        }
    }

    /// Continues from the result of coordinate descent until the optimality conditions hold within
    /// `accuracy`; returns whether they do. The model's value never rises.
    ///
    /// Each round moves to the minimum for the pixels that differ from zero. Pixels that would change
    /// sign stop at zero and leave: all at once where that still lowers the model's value (projected
    /// Newton, Bertsekas 1982), else only the first one on the way (Lawson & Hanson 1974). At a minimum
    /// the pixels that violate their conditions most enter.
    pub fn run(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        model: &mut Model,
        pixels: &[u32],
        progress: &mut Progress,
        accuracy: f64,
    ) -> bool {
        if progress.order.len() > LARGEST {
            return false;
        }
        let lambda = settings.regularization;
        self.tried.clear();
        self.tried.resize(pixels.len(), false);
        self.set.clear();
        self.places.clear();
        for &j in &progress.order {
            self.enter(model, j);
        }
        let Progress { target, slope, .. } = progress;
        let mut most = LARGEST;
        for _ in 0..ROUNDS {
            self.change.clear();
            let changes = self.set.iter().map(|&j| {
                let j = j as usize;
                slope[j] - lambda.copysign(side(target[j], slope[j]))
            });
            self.change.extend(changes);
            let (rows, places, set) = (&model.rows, &self.places, &self.set);
            let solved = self
                .factor
                .solve(rows, places, set, &mut self.change, model.dependent);
            if let Err(place) = solved {
                self.move_along_dependency(model, lambda, place, target, slope);
                continue;
            }
            let wrong = self.set.iter().zip(&self.change).any(|(&j, change)| {
                let (x, g) = (target[j as usize], slope[j as usize]);
                (x + change) * side(x, g) <= 0.0
            });
            if wrong {
                if !self.project(model, lambda, target, slope) {
                    self.go_to_first_zero(model, target, slope);
                    most = 1;
                }
                self.leave(target);
                continue;
            }
            self.apply_change(model, target, slope);
            if !self.find_violators(settings, pixels, lambda + accuracy, target, slope) {
                return true;
            }
            let room = LARGEST - self.set.len();
            let most = (self.set.len() / ENTERING).max(1).min(most).min(room);
            if most == 0 {
                return false;
            }
            if most < self.entering.len() {
                self.entering
                    .sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
                self.entering.truncate(most);
            }
            for i in 0..self.entering.len() {
                let j = self.entering[i].1;
                model.make_row(dictionary, pixels, j as usize);
                self.enter(model, j);
            }
        }
        false
    }

    fn enter(&mut self, model: &Model, j: u32) {
        self.tried[j as usize] = true;
        if model.inverse[j as usize] > 0.0 {
            self.set.push(j);
            self.places.push(model.place(j));
        }
    }

    /// Removes pixels at zero from the support.
    fn leave(&mut self, target: &[f64]) {
        let mut kept = 0;
        for i in 0..self.set.len() {
            let j = self.set[i];
            if target[j as usize] == 0.0 {
                self.tried[j as usize] = false;
            } else {
                self.set[kept] = j;
                self.places[kept] = self.places[i];
                kept += 1;
            }
        }
        self.set.truncate(kept);
        self.places.truncate(kept);
    }

    /// Moves by `change`. A pixel that returns to zero becomes exactly zero.
    fn apply_change(&mut self, model: &Model, target: &mut [f64], slope: &mut [f64]) {
        for (&j, change) in self.set.iter().zip(&self.change) {
            let x = &mut target[j as usize];
            *x = if *change == -*x { 0.0 } else { *x + change };
        }
        subtract_rows(self.level, slope, &model.rows, &self.places, &self.change);
    }

    /// Moves by the full change, with pixels that would change sign stopped at zero, if that lowers
    /// the model's value. Returns whether it does.
    fn project(
        &mut self,
        model: &Model,
        lambda: f64,
        target: &mut [f64],
        slope: &mut [f64],
    ) -> bool {
        self.full_change.clone_from(&self.change);
        let mut rise = 0.0;
        for (&j, change) in self.set.iter().zip(&mut self.change) {
            let (x, g) = (target[j as usize], slope[j as usize]);
            if (x + *change) * side(x, g) <= 0.0 {
                *change = -x;
            }
            rise += lambda * ((x + *change).abs() - x.abs()) - 0.5 * *change * g;
        }
        // The change of a quadratic is the step times the mean of its slopes at both ends.
        subtract_rows(self.level, slope, &model.rows, &self.places, &self.change);
        for (&j, change) in self.set.iter().zip(&self.change) {
            rise -= 0.5 * change * slope[j as usize];
        }
        if rise < 0.0 {
            for (&j, change) in self.set.iter().zip(&self.change) {
                let x = &mut target[j as usize];
                *x = if *change == -*x { 0.0 } else { *x + change };
            }
            return true;
        }
        self.change.iter_mut().for_each(|change| *change = -*change);
        subtract_rows(self.level, slope, &model.rows, &self.places, &self.change);
        std::mem::swap(&mut self.change, &mut self.full_change);
        false
    }

    /// Moves towards the minimum until the first pixel becomes zero. Pixels at zero that would move
    /// to the wrong side stay.
    fn go_to_first_zero(&mut self, model: &Model, target: &mut [f64], slope: &mut [f64]) {
        let mut limit: f64 = 1.0;
        for (&j, &change) in self.set.iter().zip(&self.change) {
            let x = target[j as usize];
            if x != 0.0 && x * (x + change) <= 0.0 {
                limit = limit.min(-x / change);
            }
        }
        for (&j, change) in self.set.iter().zip(&mut self.change) {
            let (x, g) = (target[j as usize], slope[j as usize]);
            *change = if x == 0.0 && *change * g <= 0.0 {
                0.0
            } else if x != 0.0 && -x / *change == limit {
                -x
            } else {
                limit * *change
            };
        }
        self.apply_change(model, target, slope);
    }

    /// Handles a column that is a linear combination of those before it. Along this combination only
    /// the l1 norm changes, so moves the way that lowers it until a pixel becomes zero and leaves.
    /// Where no way lowers it, removes the column from the support.
    fn move_along_dependency(
        &mut self,
        model: &Model,
        lambda: f64,
        place: usize,
        target: &mut [f64],
        slope: &mut [f64],
    ) {
        self.factor.dependency(place, &mut self.change);
        self.change.resize(self.set.len(), 0.0);
        let rise: f64 = (self.set.iter().zip(&self.change))
            .map(|(&j, way)| {
                let (x, g) = (target[j as usize], slope[j as usize]);
                way * (lambda.copysign(side(x, g)) - g)
            })
            .sum();
        if rise > 0.0 {
            self.change.iter_mut().for_each(|way| *way = -*way);
        }
        let mut limit = f64::INFINITY;
        for (&j, way) in self.set.iter().zip(&self.change) {
            let (x, g) = (target[j as usize], slope[j as usize]);
            if x == 0.0 && way * g < 0.0 {
                limit = 0.0;
            } else if x * way < 0.0 {
                limit = limit.min(-x / way);
            }
        }
        if limit == 0.0 || limit == f64::INFINITY {
            self.set.remove(place);
            self.places.remove(place);
            return;
        }
        for (&j, way) in self.set.iter().zip(&mut self.change) {
            let x = target[j as usize];
            *way = if x != 0.0 && -x / *way == limit {
                -x
            } else {
                limit * *way
            };
        }
        self.apply_change(model, target, slope);
        self.leave(target);
    }

    /// Lists the pixels outside the support that are pulled by more than `limit`; returns whether there
    /// are any.
    fn find_violators(
        &mut self,
        settings: &Settings,
        pixels: &[u32],
        limit: f64,
        target: &[f64],
        slope: &[f64],
    ) -> bool {
        self.entering.clear();
        for j in (0..pixels.len()).filter(|&j| !self.tried[j] && target[j] == 0.0) {
            let g = slope[j];
            let pull = if settings.nonnegative { g } else { g.abs() };
            if pull > limit {
                self.entering.push((pull, j as u32));
            }
        }
        !self.entering.is_empty()
    }
}

/// A number whose sign is the side of zero on which a pixel lies or to which it is pulled.
fn side(x: f64, pull: f64) -> f64 {
    if x == 0.0 {
        pull
    } else {
        x
    }
}
