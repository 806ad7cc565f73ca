//! Finding the places whose correlations may exceed a value.

use super::Scores;
use crate::simd::{multiversion, Level};

const BLOCK: usize = 64;
/// Halvings of the range of values when a threshold is sought; more would tell ties apart.
const HALVINGS: usize = 15;

impl Scores {
    /// Thresholds (below, above) between which, both included, no correlation exceeds `value`
    /// (with `both`, in absolute value).
    fn thresholds(&self, value: f64, both: bool) -> (i16, i16) {
        let above = (value / self.unit - self.offset - self.up).floor() as i16;
        let below = if both {
            (-value / self.unit - self.offset + self.down).ceil() as i16
        } else {
            i16::MIN
        };
        (below, above)
    }

    /// Collects, in ascending order, the places whose correlation may exceed `value`.
    pub fn collect(&self, level: Level, value: f64, both: bool, out: &mut Vec<u32>) {
        let (below, above) = self.thresholds(value, both);
        collect_outside(level, &self.values, below, above, out);
    }

    /// The smallest value >= `floor`, roughly, which at most `most` correlations may exceed.
    pub fn value_exceeded_by(&self, level: Level, most: usize, floor: f64, both: bool) -> f64 {
        let count = |value| {
            let (below, above) = self.thresholds(value, both);
            count_outside(level, &self.values, below, above)
        };
        if count(floor) <= most {
            return floor;
        }
        let (least, largest) = extremes(level, &self.values);
        let top = self.unit * (f64::from(largest) + self.offset + self.up);
        let bottom = self.unit * (f64::from(least) + self.offset - self.down);
        let (mut low, mut high) = (floor, if both { top.max(-bottom) } else { top });
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
        let mut total = 0usize;
        // The count of one lane fits 16 bits in stretches of this length.
        for stretch in scores.chunks(BLOCK * 16_384) {
            let mut lanes = [0i16; BLOCK];
            let groups = stretch.chunks_exact(BLOCK);
            for &score in groups.remainder() {
                total += usize::from(score > above || score < below);
            }
            for group in groups {
                for i in 0..BLOCK {
                    lanes[i] += i16::from((group[i] > above) | (group[i] < below));
                }
            }
            total += lanes.iter().map(|&c| c as usize).sum::<usize>();
        }
        total
    }
}

multiversion! {
    fn collect_outside(scores: &[i16], below: i16, above: i16, out: &mut Vec<u32>) {
        out.clear();
        for (block, group) in scores.chunks(BLOCK).enumerate() {
            let (mut most, mut least) = (i16::MIN, i16::MAX);
            for &score in group {
                most = most.max(score);
                least = least.min(score);
            }
            if most > above || least < below {
                for (i, &score) in group.iter().enumerate() {
                    if score > above || score < below {
                        out.push((block * BLOCK + i) as u32);
                    }
                }
            }
        }
    }
}

multiversion! {
    /// The smallest and the largest score.
    fn extremes(scores: &[i16]) -> (i16, i16) {
        let (mut most, mut least) = ([i16::MIN; BLOCK], [i16::MAX; BLOCK]);
        for group in scores.chunks(BLOCK) {
            for (i, &score) in group.iter().enumerate() {
                most[i] = most[i].max(score);
                least[i] = least[i].min(score);
            }
        }
        let least = least.into_iter().min().unwrap_or(0);
        (least, most.into_iter().max().unwrap_or(0))
    }
}
