//! What neighbouring camera pixels know of each other: the projector pixels that a row probably
//! holds, what its samples probably are, and rows solved on these pixels alone, each pixel with a
//! penalty of its own.

mod around;
mod expected;
mod likely;
mod weighted;

pub use expected::{expected, Expected, Neighbours};
pub use likely::{likely, penalties, Penalties, Windows};
pub use weighted::{solve, Expectation, Further, Knowledge, Weighted};

#[cfg(test)]
mod tests;
