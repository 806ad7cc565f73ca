//! What a correlation pass gives.

use super::outside::collect_outside;
#[cfg(target_arch = "x86_64")]
use super::outside::{collect_marked, WIDTH};
use crate::simd::Level;

/// Rows that a kernel works on at a time.
pub const BATCH: usize = 3;
/// Rows that share a reading of patterns too large for the caches.
pub const MANY: usize = 8 * BATCH;

/// A row has a multiple of so many scores; some stand for no pixel.
pub(super) const GROUP: usize = 64;

/// Which scores of a row a pass is to give.
#[derive(Clone, Copy, Default)]
pub enum Wanted {
    /// All, by place.
    #[default]
    All,
    /// Those of correlations that may exceed `value` (with `both`, in absolute value).
    Beyond { value: f64, both: bool },
}

/// Scores of one row: a_j . e lies in `unit * (score + offset - down ..= score + offset + up)`.
#[derive(Clone, Default)]
pub struct Scores {
    /// To be said before the pass.
    pub wanted: Wanted,
    /// All scores by place, where all are wanted.
    pub values: Vec<i16>,
    /// Places, ascending, and scores of those that are wanted where not all are.
    pub(super) places: Vec<u32>,
    pub(super) found: Vec<i16>,
    /// Scores below the first or above the second number are wanted, where not all are.
    pub(super) outside: (i16, i16),
    pub unit: f64,
    pub offset: f64,
    pub up: f64,
    pub down: f64,
}

impl Scores {
    /// Begins a row anew, once its unit and offset are known.
    pub(super) fn begin(&mut self) {
        self.places.clear();
        self.found.clear();
        if let Wanted::Beyond { value, both } = self.wanted {
            self.outside = self.thresholds(value, both);
        }
    }

    /// Thresholds (below, above) between which, both included, no correlation exceeds `value`
    /// (with `both`, in absolute value).
    pub(super) fn thresholds(&self, value: f64, both: bool) -> (i16, i16) {
        let above = (value / self.unit - self.offset - self.up).floor() as i16;
        let below = if both {
            (-value / self.unit - self.offset + self.down).ceil() as i16
        } else {
            i16::MIN
        };
        (below, above)
    }

    /// Takes in the scores of the places from `first` on: as many as a multiple of `GROUP`.
    pub(super) fn take(&mut self, level: Level, first: usize, scores: &[i16]) {
        match self.wanted {
            Wanted::All => self.values[first..][..scores.len()].copy_from_slice(scores),
            Wanted::Beyond { .. } => {
                let Scores { places, found, .. } = self;
                collect_outside(level, first, scores, self.outside, places, found);
            }
        }
    }

    /// Scores below the first or above the second number are wanted.
    #[cfg(target_arch = "x86_64")]
    pub(super) fn outside(&self) -> (i16, i16) {
        match self.wanted {
            Wanted::All => (i16::MAX, i16::MAX),
            Wanted::Beyond { .. } => self.outside,
        }
    }

    /// Takes in the scores of the places from `first` on whose bits are set: those that are wanted.
    #[cfg(target_arch = "x86_64")]
    pub(super) fn take_marked(
        &mut self,
        level: Level,
        first: usize,
        scores: &[i16; WIDTH],
        mask: u32,
    ) {
        match self.wanted {
            Wanted::All => self.values[first..][..WIDTH].copy_from_slice(scores),
            Wanted::Beyond { .. } => {
                let Scores { places, found, .. } = self;
                collect_marked(level, first, scores, mask, places, found);
            }
        }
    }

    /// Takes in `values`, which a kernel has written at once.
    pub(super) fn take_values(&mut self, level: Level) {
        if let Wanted::Beyond { .. } = self.wanted {
            let values = std::mem::take(&mut self.values);
            self.take(level, 0, &values);
            self.values = values;
        }
    }
}
