//! The coherent estimate: neighbouring camera pixels see neighbouring projector pixels, so that rows can
//! help each other.
//!
//! Locally the map from camera to projector pixels is linear. Its 2 x 2 Jacobian says how far the
//! footprint of a row moves from one camera pixel to the next, so a neighbour's row, moved back, is a
//! guess at the row itself (`camera_window`). Each round of the estimate calls
//!
//! 1. `likely`: which atoms a row probably holds, from the sum of its neighbours' moved rows, and their
//!    penalties;
//! 2. `expected`: what its samples probably are, as the mean and the variance of the neighbours' guesses;
//! 3. `solve`: the rows on these atoms alone, min sum_j w_j lambda x_j + data term, with the expected
//!    samples as additional samples (pseudo-samples).

mod camera_window;
mod expected;
mod likely;
mod weighted;

pub use expected::{expected, Expected, Neighbours};
pub use likely::{likely, penalties, Penalties, Windows};
pub use weighted::{solve, Knowledge, PseudoSamples, SharedColumns, Weighted};

#[cfg(test)]
mod tests;
