//! Sums of the scores of several passes, such as those of patterns that were shown and of others.

use super::scores::Scores;
use crate::simd::{multiversion, Level};
use std::borrow::Cow;

/// Scores that are added together: their sums stay in the nearest cache.
const BLOCK: usize = 2048;
/// The most that single precision loses of the sum of two scores, in units of a score.
const ROUNDING: f64 = 1.0 / 128.0;

/// The places at which the summed correlations of a row may exceed `limit`, by all its scores from each
/// pass.
///
/// # Panics
/// If the passes have different numbers of scores.
pub fn may_exceed(level: Level, passes: &[(&Scores, Cow<[i16]>)], limit: f64) -> Vec<u32> {
    let most = passes
        .iter()
        .map(|(scores, _)| scores.unit * (scores.offset + scores.up + ROUNDING));
    let least = (limit - most.sum::<f64>()) as f32;
    let length = passes.first().map_or(0, |(_, values)| values.len());
    assert!(passes.iter().all(|(_, values)| values.len() == length));
    let (mut places, mut sums) = (Vec::new(), [0f32; BLOCK]);
    for start in (0..length).step_by(BLOCK) {
        let sums = &mut sums[..BLOCK.min(length - start)];
        sums.fill(0.0);
        for (scores, values) in passes {
            add(
                level,
                &values[start..][..sums.len()],
                scores.unit as f32,
                sums,
            );
        }
        collect_above(level, sums, least, start as u32, &mut places);
    }
    places
}

multiversion! {
    fn add(scores: &[i16], unit: f32, sums: &mut [f32]) {
        for (sum, score) in sums.iter_mut().zip(scores) {
            *sum += unit * f32::from(*score);
        }
    }
}

multiversion! {
    fn collect_above(sums: &[f32], least: f32, first: u32, places: &mut Vec<u32>) {
        for (block, sums) in sums.chunks(64).enumerate() {
            // Without branches, so that the compiler vectorises the comparison.
            if sums.iter().fold(false, |any, sum| any | (*sum > least)) {
                let above = (first + 64 * block as u32..).zip(sums).filter(|(_, sum)| **sum > least);
                places.extend(above.map(|(place, _)| place));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_of_large_sums_are_found() {
        let level = Level::detect();
        for length in [1, 63, 64, 130, BLOCK + 70] {
            let pass = |unit, up| Scores {
                unit,
                up,
                ..Scores::default()
            };
            let (one, other) = (pass(0.5, 1.0), pass(2.0, 0.0));
            let first: Vec<i16> = (0..length).map(|i| (i * 7919 % 1000) as i16).collect();
            let second: Vec<i16> = first.iter().map(|v| 500 - v).collect();
            let passes = [(&one, Cow::from(&first)), (&other, Cow::from(&second))];
            let found = may_exceed(level, &passes, 900.0);
            let sum = |i: usize| 0.5 * f64::from(first[i]) + 2.0 * f64::from(second[i]);
            let expected = (0..length).filter(|&i| sum(i) > 900.0 - 0.5 - 2.5 * ROUNDING);
            assert_eq!(found, expected.map(|i| i as u32).collect::<Vec<_>>());
        }
    }
}
