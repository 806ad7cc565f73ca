//! Which pixels violate their condition most: scores of all, then exact correlations of the few
//! that may.

use crate::correlate::{Scores, Wanted};
use crate::problem::{Dictionary, Settings};

/// Pixels whose correlation lies this share below lambda may soon exceed it: they come along.
const LOOK_AHEAD: f64 = 0.02;
/// A violation by this share of lambda rules out that the row is solved.
const CLEARLY: f64 = 0.01;

/// Where patterns are random, correlations lie about those of the means with a deviation of at most
/// half the norm of what is correlated: few are beyond so many deviations in a row's first pass,
const FIRST_DEVIATIONS: f64 = 3.0;
/// and in a later one, which takes in more pixels.
const DEVIATIONS: f64 = 2.5;

/// How closely scores are looked at.
#[derive(Clone, Copy)]
pub enum Look {
    First,
    Again,
    /// At all that may exceed lambda, or nearly: the few largest do not tell whether a row is
    /// solved, which it may be.
    Closely,
}

/// The scores that `Pricing` looks at. `sums` gives the dual point's correlation with the means and
/// the sum of its squares, where they are needed.
pub fn wanted(settings: &Settings, look: Look, sums: impl FnOnce() -> (f64, f64)) -> Wanted {
    let both = !settings.nonnegative;
    let few = |deviations: f64| {
        let (of_means, square) = sums();
        let means = if both { of_means.abs() } else { of_means };
        means + deviations * (square.sqrt() / 2.0)
    };
    let few = match look {
        Look::First => few(FIRST_DEVIATIONS),
        Look::Again => few(DEVIATIONS),
        Look::Closely => 0.0,
    };
    Wanted::Beyond {
        value: few.max(settings.regularization * (1.0 - LOOK_AHEAD)),
        both,
    }
}

/// Exact correlations of the pixels that matter.
#[derive(Default)]
pub struct Pricing {
    places: Vec<u32>,
    /// Those that scores point at beside the working set, then this.
    candidates: Vec<u32>,
    correlations: Vec<f64>,
    /// How many of the candidates are the working set.
    known: usize,
}

/// What a pass found.
pub struct Found {
    /// Whether that is all there is to know: else scores have to be looked at closely.
    pub enough: bool,
    /// No correlation of any pixel exceeds this.
    pub largest: f64,
    /// The largest correlation known exactly.
    pub exact: f64,
}

impl Pricing {
    /// Looks at the working set `pixels` and at about `new` others.
    pub fn run(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        scores: &Scores,
        dual: &[f64],
        pixels: &[u32],
        new: usize,
    ) -> Found {
        let lambda = settings.regularization;
        let (level, both) = (dictionary.level, !settings.nonnegative);
        let mut most = new + pixels.len();
        self.known = pixels.len();
        loop {
            let (bound, all) = scores.collect_largest(level, most, &mut self.places);
            let exact = self.correlate(dictionary, dual, pixels, both);
            // Correlations that were not collected do not exceed the bound. Where rounding hides
            // which is the largest and little is violated, look at more pixels exactly.
            let enough = bound <= exact.max(lambda) || exact > (1.0 + CLEARLY) * lambda;
            if enough || all {
                return Found {
                    enough,
                    largest: exact.max(bound),
                    exact,
                };
            }
            most *= 4;
        }
    }

    /// Correlations of the working set, in its order.
    pub fn known(&self) -> &[f64] {
        &self.correlations[self.candidates.len() - self.known..]
    }

    /// Pixels outside the working set that violate their condition, or nearly, with correlations.
    pub fn violators(&self, lambda: f64) -> impl Iterator<Item = (u32, f64)> + '_ {
        let others = &self.candidates[..self.candidates.len() - self.known];
        others
            .iter()
            .zip(&self.correlations)
            .map(|(&pixel, &correlation)| (pixel, correlation))
            .filter(move |(_, correlation)| correlation.abs() > lambda * (1.0 - LOOK_AHEAD))
    }

    /// Correlates what was collected and the working set; returns the largest.
    fn correlate(
        &mut self,
        dictionary: &Dictionary,
        dual: &[f64],
        pixels: &[u32],
        both: bool,
    ) -> f64 {
        self.candidates.clear();
        // Most of what was collected is told from the working set by its last bits.
        let mut last = [0u64; 64];
        for pixel in pixels {
            last[(pixel / 64 % 64) as usize] |= 1 << (pixel % 64);
        }
        let alike = |pixel: u32| last[(pixel / 64 % 64) as usize] >> (pixel % 64) & 1 != 0;
        let collected = self
            .places
            .iter()
            .filter_map(|&p| dictionary.correlator.pixel(p as usize))
            .filter(|&pixel| !(alike(pixel) && pixels.contains(&pixel)));
        self.candidates.extend(collected);
        self.candidates.extend_from_slice(pixels);
        self.correlations.resize(self.candidates.len(), 0.0);
        dictionary.columns.correlate(
            dictionary.level,
            &self.candidates,
            dual,
            &mut self.correlations,
        );
        self.correlations.iter().fold(0.0, |most: f64, &c| {
            most.max(if both { c.abs() } else { c })
        })
    }
}
