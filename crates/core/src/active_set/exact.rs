//! The exact minimum of the quadratic model, by letting pixels enter and leave the support.

use super::factor::{subtract_rows, Factor, LARGEST};
use super::model::Model;
use super::progress::Progress;
use crate::problem::{Dictionary, Settings};
use crate::simd::Level;

/// Exact solutions on one support after another.
const ROUNDS: usize = 60;
/// Of the pixels there, one in so many may enter at a time, and at least one.
const ENTERING: usize = 4;

/// The pixels in play and what a round does with them.
pub struct Exact {
    level: Level,
    factor: Factor,
    /// Pixels in play, where their rows begin, and how far each is to go.
    set: Vec<u32>,
    places: Vec<usize>,
    change: Vec<f64>,
    /// Whether a pixel is in play, or out of it because it depends on others.
    taken: Vec<bool>,
    whole: Vec<f64>,
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
            taken: Vec::new(),
            whole: Vec::new(),
            entering: Vec::new(),
        }
    }

    /// From where coordinate descent has come to, to slopes within `accuracy`; whether it got there.
    /// The model's value never rises.
    ///
    /// Goes to the solution for the pixels that differ from zero. Those that would change sign stop
    /// at zero and leave: all at once where that still lowers the model's value (projected Newton,
    /// Bertsekas 1982), else the first one on the way (Lawson & Hanson 1974). At a solution the
    /// pixels that violate their conditions most enter.
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
        self.taken.clear();
        self.taken.resize(pixels.len(), false);
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
            let solved = self
                .factor
                .solve(&model.rows, &self.places, &self.set, &mut self.change);
            if let Err(place) = solved {
                self.slide(model, lambda, place, target, slope);
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
            self.go(model, target, slope);
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
        self.taken[j as usize] = true;
        if model.inverse[j as usize] > 0.0 {
            self.set.push(j);
            self.places.push(model.place(j));
        }
    }

    /// Pixels at zero leave.
    fn leave(&mut self, target: &[f64]) {
        let mut kept = 0;
        for i in 0..self.set.len() {
            let j = self.set[i];
            if target[j as usize] == 0.0 {
                self.taken[j as usize] = false;
            } else {
                self.set[kept] = j;
                self.places[kept] = self.places[i];
                kept += 1;
            }
        }
        self.set.truncate(kept);
        self.places.truncate(kept);
    }

    /// Moves by `change`; what goes back to zero lands on it.
    fn go(&mut self, model: &Model, target: &mut [f64], slope: &mut [f64]) {
        for (&j, change) in self.set.iter().zip(&self.change) {
            let x = &mut target[j as usize];
            *x = if *change == -*x { 0.0 } else { *x + change };
        }
        subtract_rows(self.level, slope, &model.rows, &self.places, &self.change);
    }

    /// Goes the whole way, with those that would change sign stopped at zero, if that lowers the
    /// model's value.
    fn project(
        &mut self,
        model: &Model,
        lambda: f64,
        target: &mut [f64],
        slope: &mut [f64],
    ) -> bool {
        self.whole.clone_from(&self.change);
        let mut rise = 0.0;
        for (&j, change) in self.set.iter().zip(&mut self.change) {
            let (x, g) = (target[j as usize], slope[j as usize]);
            if (x + *change) * side(x, g) <= 0.0 {
                *change = -x;
            }
            rise += lambda * ((x + *change).abs() - x.abs()) - 0.5 * *change * g;
        }
        // A quadratic falls by the mean of its slopes at both ends.
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
        std::mem::swap(&mut self.change, &mut self.whole);
        false
    }

    /// Goes towards the solution until the first pixel becomes zero; those that would leave zero to
    /// the wrong side stay.
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
        self.go(model, target, slope);
    }

    /// The column at `place` is a combination of those before it: along that combination nothing
    /// changes but lambda's share. Goes the way that lowers it until a pixel becomes zero and
    /// leaves, or, where there is no such way, leaves the column out of play.
    fn slide(
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
        self.go(model, target, slope);
        self.leave(target);
    }

    /// Lists the pixels out of play that are pulled by more than `limit`; whether there are any.
    fn find_violators(
        &mut self,
        settings: &Settings,
        pixels: &[u32],
        limit: f64,
        target: &[f64],
        slope: &[f64],
    ) -> bool {
        self.entering.clear();
        for j in (0..pixels.len()).filter(|&j| !self.taken[j] && target[j] == 0.0) {
            let g = slope[j];
            let pull = if settings.nonnegative { g } else { g.abs() };
            if pull > limit {
                self.entering.push((pull, j as u32));
            }
        }
        !self.entering.is_empty()
    }
}

/// The side of zero that a pixel is on, or is pulled to.
fn side(x: f64, pull: f64) -> f64 {
    if x == 0.0 {
        pull
    } else {
        x
    }
}
