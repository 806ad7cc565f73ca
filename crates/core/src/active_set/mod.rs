//! The active-set solver: solves every row of the light transport matrix to a certified duality gap.
//!
//! For each row, with a_j the columns of P and m the means of the patterns,
//!
//! ```text
//! min over x >= 0, b >= 0 of  lambda sum x + sum_k w_k max(y_k - u_k, l_k)^2 / 2,  u = A x + b m
//! ```
//!
//! where l_k is 0 on one-sided (clipped) samples and minus infinity elsewhere. A row alternates
//! between a restricted solve on few pixels (the working set) and a pass over all pixels. The pass
//! finds the pixels that violate their optimality condition most, and bounds the duality gap.
//!
//! `solve` calls `lanes::solve_rows` on every thread. That advances several `row::RowSolver`s, whose
//! passes share one reading of the patterns (`correlate`). After each pass a row
//!
//! 1. finds violators (`pricing`) and computes its gap (`certificate`),
//! 2. adds them to the working set and solves there (`restricted`): Newton steps on a quadratic
//!    `model`, each minimised by coordinate `descent` (in float32, `packed`) or, where that is slow,
//!    by an `exact` active-set method with a Cholesky `factor`; `search` does line searches.
//!
//! Rows do not depend on each other, so results depend neither on the number of threads nor on how
//! rows are grouped.

mod certificate;
mod descent;
mod exact;
mod factor;
mod gram;
mod lanes;
mod model;
mod packed;
mod point;
mod pricing;
mod progress;
mod restricted;
mod row;
mod search;

use crate::problem::{Dictionary, Rows, Settings, Solution};
use crate::vector::padded;
use lanes::solve_rows;
pub use lanes::SingleRowSolver;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Solves all rows. Returns None if `cancelled` is set meanwhile; `finished` counts solved rows.
///
/// # Panics
/// If the lengths of the arrays do not match.
pub fn solve(
    dictionary: &Dictionary,
    rows: Rows,
    settings: Settings,
    cancelled: &AtomicBool,
    finished: &AtomicUsize,
) -> Option<Vec<Solution>> {
    let (patterns, count) = (dictionary.patterns, rows.count);
    assert_eq!(dictionary.means.len(), padded(patterns));
    assert_eq!(rows.samples.len(), count * patterns);
    assert_eq!(rows.clipped.len(), count * patterns);
    if let Some(weights) = rows.weights {
        assert!(weights.len() == count * patterns || weights.len() == patterns);
    }
    let waiting = AtomicUsize::new(0);
    let solved =
        rayon::broadcast(|_| solve_rows(dictionary, rows, settings, &waiting, cancelled, finished));
    if cancelled.load(Ordering::Relaxed) {
        return None;
    }
    let mut solutions = vec![Solution::default(); count];
    for (row, solution) in solved.into_iter().flatten() {
        solutions[row] = solution;
    }
    Some(solutions)
}

#[cfg(test)]
mod tests;
