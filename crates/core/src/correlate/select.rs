//! Finding the places whose correlations may exceed a value.

use super::{Scores, GROUP};
use crate::simd::{multiversion, Kind, Level};

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
        for stretch in scores.chunks(GROUP * 16_384) {
            let mut lanes = [0i16; GROUP];
            for group in stretch.chunks_exact(GROUP) {
                for i in 0..GROUP {
                    lanes[i] += i16::from((group[i] > above) | (group[i] < below));
                }
            }
            total += lanes.iter().map(|&c| c as usize).sum::<usize>();
        }
        total
    }
}

fn collect_outside(level: Level, scores: &[i16], below: i16, above: i16, out: &mut Vec<u32>) {
    out.clear();
    match level.kind() {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the level proves the instructions.
        Kind::Avx512 => unsafe { avx512::collect(scores, below, above, out) },
        _ => collect_plain(level, scores, below, above, out),
    }
}

multiversion! {
    fn collect_plain(scores: &[i16], below: i16, above: i16, out: &mut Vec<u32>) {
        for (block, group) in scores.chunks_exact(GROUP).enumerate() {
            let mut most = [i16::MIN; 16];
            let mut least = [i16::MAX; 16];
            for part in group.chunks_exact(16) {
                for i in 0..16 {
                    most[i] = most[i].max(part[i]);
                    least[i] = least[i].min(part[i]);
                }
            }
            let outside = |(m, l): (&i16, &i16)| *m > above || *l < below;
            if most.iter().zip(&least).any(outside) {
                for (i, &score) in group.iter().enumerate() {
                    if score > above || score < below {
                        out.push((block * GROUP + i) as u32);
                    }
                }
            }
        }
    }
}

multiversion! {
    /// The smallest and the largest score.
    fn extremes(scores: &[i16]) -> (i16, i16) {
        let (mut most, mut least) = ([i16::MIN; GROUP], [i16::MAX; GROUP]);
        for group in scores.chunks_exact(GROUP) {
            for i in 0..GROUP {
                most[i] = most[i].max(group[i]);
                least[i] = least[i].min(group[i]);
            }
        }
        let least = least.into_iter().min().unwrap_or(0);
        (least, most.into_iter().max().unwrap_or(0))
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx512f,avx512bw")]
    pub fn collect(scores: &[i16], below: i16, above: i16, out: &mut Vec<u32>) {
        let (lowest, highest) = (_mm512_set1_epi16(below), _mm512_set1_epi16(above));
        for (block, group) in scores.chunks_exact(32).enumerate() {
            // SAFETY: a group holds one register.
            let values = unsafe { _mm512_loadu_si512(group.as_ptr().cast()) };
            let mut mask =
                _mm512_cmpgt_epi16_mask(values, highest) | _mm512_cmplt_epi16_mask(values, lowest);
            while mask != 0 {
                out.push(32 * block as u32 + mask.trailing_zeros());
                mask &= mask - 1;
            }
        }
    }
}
