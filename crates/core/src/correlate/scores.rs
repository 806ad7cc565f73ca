//! What a correlation pass gives.

use crate::simd::{multiversion, Level};
use std::ops::Range;

/// Rows that a kernel works on at a time.
pub const BATCH: usize = 3;
/// Rows that share a reading of patterns too large for the caches.
pub const MANY: usize = 8 * BATCH;

/// A row has a multiple of so many scores; some stand for no pixel.
pub(super) const GROUP: usize = 64;

/// Groups of places of which the extreme is known: places that are equal modulo their number.
pub(super) const PEAKS: usize = 1024;

/// Scores of one row: a_j . e lies in `unit * (score + offset - down ..= score + offset + up)`.
#[derive(Clone)]
pub struct Scores {
    pub values: Vec<i16>,
    /// The largest of each group.
    pub(super) tops: [i16; PEAKS],
    pub unit: f64,
    pub offset: f64,
    pub up: f64,
    pub down: f64,
}

impl Default for Scores {
    fn default() -> Self {
        Scores {
            values: Vec::new(),
            tops: [i16::MIN; PEAKS],
            unit: 0.0,
            offset: 0.0,
            up: 0.0,
            down: 0.0,
        }
    }
}

impl Scores {
    /// Takes note of the largest scores among some places, which begin with a multiple of `PEAKS`.
    pub(super) fn note_tops(&mut self, level: Level, places: Range<usize>) {
        debug_assert!(places.start.is_multiple_of(PEAKS));
        peaks(level, &self.values[places], &mut self.tops);
    }
}

multiversion! {
    fn peaks(scores: &[i16], most: &mut [i16; PEAKS]) {
        for scores in scores.chunks(PEAKS) {
            for (most, score) in most.iter_mut().zip(scores) {
                *most = (*most).max(*score);
            }
        }
    }
}
