//! A point of the restricted problem: pixels that may differ from zero, and what they predict.

use super::search;
use crate::problem::{Dictionary, Settings};
use crate::vector::{add_scaled, DataTerm};

/// A point: pixels that may differ from zero, their x, b, and the prediction u.
#[derive(Default)]
pub struct Point {
    pub pixels: Vec<u32>,
    pub x: Vec<f64>,
    pub background: f64,
    pub prediction: Vec<f64>,
    /// A buffer for the support.
    terms: Vec<(u32, f64)>,
}

impl Point {
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
        let mut terms = std::mem::take(&mut self.terms);
        terms.clear();
        terms.extend(self.support());
        let columns = &dictionary.columns;
        columns.add_all(level, &terms, &mut self.prediction);
        self.terms = terms;
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
