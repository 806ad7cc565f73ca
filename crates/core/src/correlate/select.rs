//! Finding the places whose correlations may exceed a value.

use super::scores::{Scores, GROUP, PEAKS};
use crate::simd::{multiversion, Kind, Level};

/// Halvings of the range of values when a threshold is sought; more would tell ties apart.
const HALVINGS: usize = 15;
/// Up to so many groups are cheaper to look at than all scores.
const FEW: usize = 48;

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

    /// Collects places whose correlations may exceed a value >= `floor`, about `most` of them or
    /// fewer; returns the value. All others do not exceed it.
    ///
    /// The value is found among the extremes of groups of places, so that all scores are read only
    /// once; places of one group that exceed it together make the number larger.
    pub fn collect_largest(
        &self,
        level: Level,
        most: usize,
        floor: f64,
        both: bool,
        out: &mut Vec<u32>,
    ) -> f64 {
        let mut bottoms = [i16::MAX; PEAKS];
        if both {
            dips(level, &self.values, &mut bottoms);
        }
        let value = self.value_exceeded_by(level, &bottoms, most, floor, both);
        let (below, above) = self.thresholds(value, both);
        if both || !self.collect_from_groups(level, above, out) {
            collect_outside(level, &self.values, below, above, out);
        }
        value
    }

    /// Collects the scores above a threshold, if few groups have any: those are read sooner.
    fn collect_from_groups(&self, level: Level, above: i16, out: &mut Vec<u32>) -> bool {
        collect_outside(level, &self.tops, i16::MIN, above, out);
        let groups = out.len();
        if groups > FEW {
            return false;
        }
        for i in 0..groups {
            let places = (out[i] as usize..self.values.len()).step_by(PEAKS);
            out.extend(places.filter(|&p| self.values[p] > above).map(|p| p as u32));
        }
        out.drain(..groups);
        out.sort_unstable();
        true
    }

    fn value_exceeded_by(
        &self,
        level: Level,
        bottoms: &[i16; PEAKS],
        most: usize,
        floor: f64,
        both: bool,
    ) -> f64 {
        let count = |value| {
            let (below, above) = self.thresholds(value, both);
            let low = if both {
                count_below(level, bottoms, below)
            } else {
                0
            };
            count_above(level, &self.tops, above) + low
        };
        if count(floor) <= most {
            return floor;
        }
        let largest = f64::from(largest_of(level, &self.tops));
        let mut high = self.unit * (largest + self.offset + self.up);
        if both {
            let least = f64::from(smallest_of(level, bottoms));
            high = high.max(-self.unit * (least + self.offset - self.down));
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
    /// The smallest score of each group.
    fn dips(scores: &[i16], least: &mut [i16; PEAKS]) {
        for scores in scores.chunks(PEAKS) {
            for (least, score) in least.iter_mut().zip(scores) {
                *least = (*least).min(*score);
            }
        }
    }
}

multiversion! {
    fn count_above(scores: &[i16; PEAKS], above: i16) -> usize {
        scores.iter().map(|&s| i16::from(s > above)).sum::<i16>() as usize
    }
}

multiversion! {
    fn count_below(scores: &[i16; PEAKS], below: i16) -> usize {
        scores.iter().map(|&s| i16::from(s < below)).sum::<i16>() as usize
    }
}

multiversion! {
    fn largest_of(scores: &[i16; PEAKS]) -> i16 {
        scores.iter().fold(i16::MIN, |most, &s| most.max(s))
    }
}

multiversion! {
    fn smallest_of(scores: &[i16; PEAKS]) -> i16 {
        scores.iter().fold(i16::MAX, |least, &s| least.min(s))
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

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx512f,avx512bw")]
    pub fn collect(scores: &[i16], below: i16, above: i16, out: &mut Vec<u32>) {
        let (lowest, highest) = (_mm512_set1_epi16(below), _mm512_set1_epi16(above));
        // Few scores lie outside, so first see in which of 64 registers any does.
        for (stretch, scores) in scores.chunks(64 * 32).enumerate() {
            let mut masks = [0u32; 64];
            let mut any = 0u64;
            for (i, (group, mask)) in scores.chunks_exact(32).zip(&mut masks).enumerate() {
                // SAFETY: a group holds one register.
                let values = unsafe { _mm512_loadu_si512(group.as_ptr().cast()) };
                *mask = _mm512_cmpgt_epi16_mask(values, highest)
                    | _mm512_cmplt_epi16_mask(values, lowest);
                any |= u64::from(*mask != 0) << i;
            }
            while any != 0 {
                let group = any.trailing_zeros();
                let mut mask = masks[group as usize];
                while mask != 0 {
                    out.push(2048 * stretch as u32 + 32 * group + mask.trailing_zeros());
                    mask &= mask - 1;
                }
                any &= any - 1;
            }
        }
    }
}
