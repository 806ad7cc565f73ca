//! Finds the largest of the collected scores.

use super::scores::{ScoreFilter, Scores};
use crate::simd::{multiversion, Level};

/// Halvings of the range of values in the search for a threshold. 15 resolve the scores, which have 16 bits.
const HALVINGS: usize = 15;

impl Scores {
    /// Collects the places with the largest correlations, about `most` of them or fewer. Returns a value
    /// that no other correlation exceeds, and whether it is the filter's own, so that the pass kept no
    /// more scores.
    ///
    /// # Panics
    /// If the filter was `ScoreFilter::All`.
    pub fn collect_largest(&self, level: Level, most: usize, out: &mut Vec<u32>) -> (f64, bool) {
        let ScoreFilter::Beyond { value: least, both } = self.filter else {
            panic!("a pass that keeps all scores collects none");
        };
        let value = self.value_exceeded_by(level, most, least, both);
        let (below, above) = self.thresholds(value, both);
        let outside = |&(_, &score): &(&u32, &i16)| score > above || score < below;
        let largest = self.places.iter().zip(&self.collected).filter(outside);
        out.clear();
        out.extend(largest.map(|(place, _)| place));
        (value, value <= least)
    }

    /// A value >= `floor` that about `most` correlations or fewer may exceed.
    fn value_exceeded_by(&self, level: Level, most: usize, floor: f64, both: bool) -> f64 {
        if self.collected.len() <= most {
            return floor;
        }
        let count = |value| {
            let (below, above) = self.thresholds(value, both);
            count_outside(level, &self.collected, below, above)
        };
        let (least, largest) = extremes(level, &self.collected);
        let mut high = self.unit * (f64::from(largest) + self.offset + self.up);
        if both {
            high = high.max(-self.unit * (f64::from(least) + self.offset - self.down));
        }
        let mut low = floor;
        for _ in 0..HALVINGS {
            let middle = (low + high) / 2.0;
            let count = count(middle);
            if count > most {
                low = middle;
            } else {
                high = middle;
                if 2 * count >= most {
                    break;
                }
            }
        }
        high
    }
}

multiversion! {
    fn count_outside(scores: &[i16], below: i16, above: i16) -> usize {
        // Parts of 2^14 scores, so that a count fits 16 bits.
        let counts = scores.chunks(1 << 14).map(|scores| {
            let outside = |&s: &i16| i16::from((s > above) | (s < below));
            scores.iter().map(outside).sum::<i16>() as usize
        });
        counts.sum()
    }
}

multiversion! {
    fn extremes(scores: &[i16]) -> (i16, i16) {
        scores.iter().fold((i16::MAX, i16::MIN), |(least, most), &s| (least.min(s), most.max(s)))
    }
}
