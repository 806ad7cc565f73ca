//! A point of the restricted problem: the working set, its x and b, and the samples that they predict.

use super::search;
use crate::problem::{Dictionary, Settings};
use crate::vector::{add_scaled, DataTerm};

/// The slope along b counts as zero below this share of tolerance times lambda, so that its error does
/// not matter for the gap. Chosen by hand.
const SLOPE_SHARE: f64 = 1e-6;

/// The pixels that may differ from zero (the working set), their x, the background b, and u = A x + b m.
#[derive(Default)]
pub struct Point {
    pub pixels: Vec<u32>,
    pub x: Vec<f64>,
    pub background: f64,
    pub prediction: Vec<f64>,
    /// Buffer for the support.
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

    /// The pixels that differ from zero, and their x.
    pub fn support(&self) -> impl Iterator<Item = (u32, f64)> + '_ {
        self.pixels
            .iter()
            .copied()
            .zip(self.x.iter().copied())
            .filter(|&(_, x)| x != 0.0)
    }

    /// Removes pixels at zero from the working set.
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

    /// Makes a starting point feasible.
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

    /// Computes u = A x + b m.
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

    /// Sets b to its optimum for these x.
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
        let negligible = SLOPE_SHARE * settings.tolerance * settings.regularization;
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
