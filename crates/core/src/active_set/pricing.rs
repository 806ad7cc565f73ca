//! Finds the pixels that violate their optimality condition most: a pass gives approximate scores of
//! all pixels, then the few that may violate it are correlated exactly.

use crate::correlate::{ScoreFilter, Scores};
use crate::problem::{Dictionary, Settings};

/// Pixels whose correlation lies less than this share of lambda below lambda join the working set too,
/// as they may soon exceed it. Chosen by hand.
const LOOK_AHEAD: f64 = 0.02;
/// A violation above this share of lambda proves that the row is not solved yet. Chosen by hand, well
/// above the rounding of scores.
const CLEAR_VIOLATION: f64 = 0.01;

/// Pixels that join the working set after a pass, at most. Under few patterns of many pixels thousands
/// may violate their condition by about as much; the Gram matrix of all of them took gigabytes. Chosen
/// by hand: usually up to 128 join.
const MOST_NEW: usize = 1024;

// Under random patterns, correlations scatter about the one with the means; their standard deviation
// is at most half the norm of the dual point. Few pixels without light lie beyond these thresholds.

/// Threshold of a row's first pass, in standard deviations.
const FIRST_DEVIATIONS: f64 = 3.0;
/// Threshold of a later pass, which adds more pixels, in standard deviations.
const DEVIATIONS: f64 = 2.5;

/// The correlation above which a pass returns the scores of pixels.
#[derive(Clone, Copy)]
pub enum Threshold {
    /// `FIRST_DEVIATIONS`: a row's first pass, whose violations are large.
    FirstPass,
    /// `DEVIATIONS`: a later pass, while the row is far from solved.
    LaterPass,
    /// Just below lambda: all pixels that matter, to decide whether the row is solved.
    Lambda,
}

/// The filter of a pass for this threshold. `sums` returns the dual point's correlation with the means
/// and the sum of its squares; it is called only where they are needed.
pub fn filter(
    settings: &Settings,
    threshold: Threshold,
    sums: impl FnOnce() -> (f64, f64),
) -> ScoreFilter {
    let both = !settings.nonnegative;
    let beyond_noise = |deviations: f64| {
        let (of_means, square) = sums();
        let means = if both { of_means.abs() } else { of_means };
        means + deviations * (square.sqrt() / 2.0)
    };
    let value: f64 = match threshold {
        Threshold::FirstPass => beyond_noise(FIRST_DEVIATIONS),
        Threshold::LaterPass => beyond_noise(DEVIATIONS),
        Threshold::Lambda => 0.0,
    };
    ScoreFilter::Beyond {
        value: value.max(settings.regularization * (1.0 - LOOK_AHEAD)),
        both,
    }
}

/// The exact correlations of candidate pixels.
#[derive(Default)]
pub struct Pricing {
    places: Vec<u32>,
    /// The pixels outside the working set that scores point at, then the working set.
    candidates: Vec<u32>,
    correlations: Vec<f64>,
    violators: Vec<(u32, f64)>,
    /// Number of candidates that form the working set.
    set_size: usize,
}

/// What pricing says about the optimality of a row.
pub struct Outcome {
    /// Whether the bound is tight or a violation is clear. If not, a pass with `Threshold::Lambda` must
    /// decide.
    pub conclusive: bool,
    /// No correlation of any pixel exceeds this.
    pub bound: f64,
    /// The largest correlation that was computed exactly.
    pub exact: f64,
}

impl Pricing {
    /// Correlates the working set `pixels` and about `new` other pixels exactly.
    pub fn run(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        scores: &Scores,
        dual: &[f64],
        pixels: &[u32],
        new: usize,
    ) -> Outcome {
        let lambda = settings.regularization;
        let (level, both) = (dictionary.level, !settings.nonnegative);
        let mut most = new + pixels.len();
        self.set_size = pixels.len();
        loop {
            let (bound, all) = scores.collect_largest(level, most, &mut self.places);
            let exact = self.correlate(dictionary, dual, pixels, both);
            // Correlations that were not collected do not exceed the bound. If rounding hides which
            // one is the largest and no violation is clear, correlate more pixels exactly.
            let conclusive = bound <= exact.max(lambda) || exact > (1.0 + CLEAR_VIOLATION) * lambda;
            if conclusive || all {
                return Outcome {
                    conclusive,
                    bound: exact.max(bound),
                    exact,
                };
            }
            most *= 4;
        }
    }

    /// The correlations of the working set, in its order.
    pub fn working_set(&self) -> &[f64] {
        &self.correlations[self.candidates.len() - self.set_size..]
    }

    /// Pixels outside the working set that violate their condition, or nearly do, and their correlations;
    /// `MOST_NEW` of them at most, which violate it most.
    pub fn violators(&mut self, lambda: f64) -> &[(u32, f64)] {
        let others = &self.candidates[..self.candidates.len() - self.set_size];
        let pairs = others
            .iter()
            .copied()
            .zip(self.correlations.iter().copied());
        self.violators.clear();
        self.violators.extend(
            pairs.filter(|(_, correlation)| correlation.abs() > lambda * (1.0 - LOOK_AHEAD)),
        );
        if self.violators.len() > MOST_NEW {
            let largest = |a: &(u32, f64), b: &(u32, f64)| {
                b.1.abs().total_cmp(&a.1.abs()).then(a.0.cmp(&b.0))
            };
            self.violators.select_nth_unstable_by(MOST_NEW, largest);
            self.violators.truncate(MOST_NEW);
            self.violators.sort_unstable_by_key(|&(pixel, _)| pixel);
        }
        &self.violators
    }

    /// Correlates the collected pixels and the working set; returns the largest correlation.
    fn correlate(
        &mut self,
        dictionary: &Dictionary,
        dual: &[f64],
        pixels: &[u32],
        both: bool,
    ) -> f64 {
        self.candidates.clear();
        // A bit set of the pixels' lowest 12 bits rules most collected pixels out of the working set.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_violators_join_if_there_are_too_many() {
        let count = 2 * MOST_NEW;
        // Pixel i violates its condition by (7 i mod count), an order of its own for each pixel.
        let size = |pixel: u32| 1.0 + f64::from(7 * pixel % count as u32);
        let mut pricing = Pricing {
            candidates: (0..=count as u32).collect(),
            correlations: (0..=count as u32).map(size).collect(),
            set_size: 1,
            ..Pricing::default()
        };
        let mut joined: Vec<f64> = pricing.violators(0.5).iter().map(|pair| pair.1).collect();
        joined.sort_by(f64::total_cmp);
        let largest: Vec<f64> = (MOST_NEW..count).map(|rank| 1.0 + rank as f64).collect();
        assert_eq!(joined, largest);
        // If all violate it equally, those of the lowest numbers join.
        pricing.correlations.fill(1.0);
        let equal: Vec<u32> = pricing.violators(0.5).iter().map(|pair| pair.0).collect();
        assert_eq!(equal, (0..MOST_NEW as u32).collect::<Vec<_>>());
        // Few violators all join, in their order, without the working set.
        pricing.candidates.truncate(10);
        pricing.correlations.truncate(10);
        let few: Vec<u32> = pricing.violators(0.5).iter().map(|pair| pair.0).collect();
        assert_eq!(few, (0..9).collect::<Vec<_>>());
    }
}
