//! The scores of a row, and the filter that chooses which of them to keep.

use super::outside::collect_outside;
#[cfg(target_arch = "x86_64")]
use super::outside::{collect_marked, WIDTH};
use crate::simd::Level;

/// Rows that a kernel works on at a time: their sums fit into registers.
pub const BATCH: usize = 3;
/// Rows that share one reading of patterns that exceed the caches.
pub const MANY: usize = 8 * BATCH;

/// The number of scores is padded to a multiple of this: two AVX-512 registers.
pub(super) const GROUP: usize = 64;

/// Which scores of a row a pass keeps.
#[derive(Clone, Copy, Default)]
pub enum ScoreFilter {
    /// All scores, by place.
    #[default]
    All,
    /// The scores of correlations that may exceed `value`, in absolute value if `both`.
    Beyond { value: f64, both: bool },
}

/// Scores of one row: a_j . e lies in `unit * (score + offset - down ..= score + offset + up)`.
#[derive(Clone, Default)]
pub struct Scores {
    /// Set before the pass.
    pub filter: ScoreFilter,
    /// All scores by place, with `ScoreFilter::All`.
    pub values: Vec<i16>,
    /// With `ScoreFilter::Beyond`, the places, ascending, and scores that were kept.
    pub(super) places: Vec<u32>,
    pub(super) collected: Vec<i16>,
    /// With `ScoreFilter::Beyond`, scores below the first or above the second number are kept.
    pub(super) outside: (i16, i16),
    pub unit: f64,
    pub offset: f64,
    pub up: f64,
    pub down: f64,
}

impl Scores {
    /// Begins a new row, once its unit and offset are known.
    pub(super) fn begin(&mut self) {
        self.places.clear();
        self.collected.clear();
        if let ScoreFilter::Beyond { value, both } = self.filter {
            self.outside = self.thresholds(value, both);
        }
    }

    /// Thresholds (below, above). The correlations of scores from `below` to `above` do not exceed
    /// `value`, in absolute value if `both`.
    pub(super) fn thresholds(&self, value: f64, both: bool) -> (i16, i16) {
        let above = (value / self.unit - self.offset - self.up).floor() as i16;
        let below = if both {
            (-value / self.unit - self.offset + self.down).ceil() as i16
        } else {
            i16::MIN
        };
        (below, above)
    }

    /// Filters the scores of the places from `first` on, a multiple of `GROUP` of them.
    pub(super) fn keep(&mut self, level: Level, first: usize, scores: &[i16]) {
        match self.filter {
            ScoreFilter::All => self.values[first..][..scores.len()].copy_from_slice(scores),
            ScoreFilter::Beyond { .. } => {
                let Scores {
                    places, collected, ..
                } = self;
                collect_outside(level, first, scores, self.outside, places, collected);
            }
        }
    }

    /// Scores below the first or above the second number pass the filter.
    #[cfg(target_arch = "x86_64")]
    pub(super) fn outside(&self) -> (i16, i16) {
        match self.filter {
            ScoreFilter::All => (i16::MAX, i16::MAX),
            ScoreFilter::Beyond { .. } => self.outside,
        }
    }

    /// Keeps the scores of the places from `first` on whose bits are set: those that pass the filter.
    #[cfg(target_arch = "x86_64")]
    pub(super) fn keep_marked(
        &mut self,
        level: Level,
        first: usize,
        scores: &[i16; WIDTH],
        mask: u32,
    ) {
        match self.filter {
            ScoreFilter::All => self.values[first..][..WIDTH].copy_from_slice(scores),
            ScoreFilter::Beyond { .. } => {
                let Scores {
                    places, collected, ..
                } = self;
                collect_marked(level, first, scores, mask, places, collected);
            }
        }
    }

    /// Filters `values`, where a kernel has written all scores.
    pub(super) fn filter_values(&mut self, level: Level) {
        if let ScoreFilter::Beyond { .. } = self.filter {
            let values = std::mem::take(&mut self.values);
            self.keep(level, 0, &values);
            self.values = values;
        }
    }
}
