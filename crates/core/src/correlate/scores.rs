//! What a correlation pass gives.

/// Rows that share one pass over the patterns.
pub const BATCH: usize = 3;

/// A row has a multiple of so many scores; some stand for no pixel.
pub(super) const GROUP: usize = 64;

/// Scores of one row: a_j . e lies in `unit * (score + offset - down ..= score + offset + up)`.
#[derive(Clone, Default)]
pub struct Scores {
    pub values: Vec<i16>,
    pub unit: f64,
    pub offset: f64,
    pub up: f64,
    pub down: f64,
}
