//! What neighbouring camera pixels know of each other: the projector pixels that a row probably
//! holds, and rows solved on these alone, each pixel with a penalty of its own.

mod likely;
mod weighted;

pub use likely::{likely, Sparse, Windows};
pub use weighted::{solve, Candidates, Further, Knowledge, Weighted, White};

#[cfg(test)]
mod tests;
