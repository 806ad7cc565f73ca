//! Which pixels violate their condition most: scores of all, then exact correlations of the few
//! that may.

use crate::correlate::Scores;
use crate::problem::{Dictionary, Settings};

/// Pixels whose correlation lies this share below lambda may soon exceed it: they come along.
const LOOK_AHEAD: f64 = 0.02;
/// A violation by this share of lambda rules out that the row is solved.
const CLEARLY: f64 = 0.01;

/// Exact correlations of the pixels that matter.
#[derive(Default)]
pub struct Pricing {
    places: Vec<u32>,
    /// Those that scores point at, then the working set.
    candidates: Vec<u32>,
    correlations: Vec<f64>,
    /// How many of the candidates are the working set.
    known: usize,
}

/// What a pass found.
pub struct Found {
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
        let floor = lambda * (1.0 - LOOK_AHEAD);
        loop {
            let bound = scores.collect_largest(level, most, floor, both, &mut self.places);
            let exact = self.correlate(dictionary, dual, pixels, both);
            // Correlations that were not collected do not exceed the bound. Where rounding hides
            // which is the largest and little is violated, look at more pixels exactly.
            if bound <= exact.max(lambda) || exact > (1.0 + CLEARLY) * lambda {
                return Found {
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
        let (others, known) = self.candidates.split_at(self.candidates.len() - self.known);
        others
            .iter()
            .zip(&self.correlations)
            .map(|(&pixel, &correlation)| (pixel, correlation))
            .filter(move |(pixel, correlation)| {
                correlation.abs() > lambda * (1.0 - LOOK_AHEAD) && !known.contains(pixel)
            })
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
        let collected = self
            .places
            .iter()
            .filter_map(|&p| dictionary.correlator.pixel(p as usize));
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
