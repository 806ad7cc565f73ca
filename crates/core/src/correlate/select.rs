//! Finding the places whose correlations may exceed a value.

use super::scores::{Scores, Wanted};
use crate::simd::{multiversion, Level};

/// Halvings of the range of values when a threshold is sought; more would tell ties apart.
const HALVINGS: usize = 15;

impl Scores {
    /// Collects places whose correlations may exceed a value, about `most` of them or fewer; returns
    /// the value, which all others do not exceed, and whether it is that beyond which the pass was
    /// asked for: then no more can be had.
    ///
    /// # Panics
    /// If the pass was asked for all scores.
    pub fn collect_largest(&self, level: Level, most: usize, out: &mut Vec<u32>) -> (f64, bool) {
        let Wanted::Beyond { value: least, both } = self.wanted else {
            panic!("a pass that was asked for all scores collects none");
        };
        let value = self.value_exceeded_by(level, most, least, both);
        let (below, above) = self.thresholds(value, both);
        let outside = |&(_, &score): &(&u32, &i16)| score > above || score < below;
        let found = self.places.iter().zip(&self.found).filter(outside);
        out.clear();
        out.extend(found.map(|(place, _)| place));
        (value, value <= least)
    }

    /// A value >= `floor` that about `most` of the correlations may exceed, or fewer.
    fn value_exceeded_by(&self, level: Level, most: usize, floor: f64, both: bool) -> f64 {
        if self.found.len() <= most {
            return floor;
        }
        let count = |value| {
            let (below, above) = self.thresholds(value, both);
            count_outside(level, &self.found, below, above)
        };
        let (least, largest) = extremes(level, &self.found);
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
        // Lanes of 16 bits hold the number of so many.
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
