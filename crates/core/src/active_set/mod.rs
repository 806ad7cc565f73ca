//! The active-set solver: every row of the light transport matrix to a certified duality gap.
//!
//! For each row, with a_j the columns of P and m the means of the patterns,
//!
//! ```text
//! min over x >= 0, b >= 0 of  lambda sum x + sum_k w_k max(y_k - u_k, l_k)^2 / 2,  u = A x + b m
//! ```
//!
//! where l_k is 0 on one-sided (clipped) samples and minus infinity elsewhere. A row alternates
//! between a restricted solve on few pixels and a pass over all pixels, which finds the strongest
//! violators and, with the dual value, how far from optimal the row is at most.
//!
//! A row depends on no other, so results depend neither on threads nor on how rows are grouped.

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
mod restricted;
mod row;
mod search;

use crate::columns::Columns;
use crate::correlate::Correlator;
use crate::simd::Level;
use crate::vector::padded;
pub use lanes::solve_row;
use lanes::solve_rows;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// The patterns, ready for solving.
pub struct Dictionary {
    pub level: Level,
    pub columns: Columns,
    pub correlator: Correlator,
    /// Means of the patterns, padded with zeros.
    pub means: Vec<f64>,
    pub patterns: usize,
    pub pixels: usize,
}

/// How clipped samples are treated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fidelity {
    /// Like any other.
    Linear,
    /// Their value is a lower bound.
    OneSided,
    /// They do not count.
    Rejection,
}

#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// lambda, > 0.
    pub regularization: f64,
    pub fidelity: Fidelity,
    /// Whether x and b are >= 0.
    pub nonnegative: bool,
    /// Whether there is a coefficient b.
    pub background: bool,
    /// Relative duality gap at which a row is done.
    pub tolerance: f64,
    /// Passes over all pixels after which a row is given up as it is.
    pub max_passes: u32,
}

/// Numbers as they came.
#[derive(Clone, Copy)]
pub enum Values<'a> {
    F32(&'a [f32]),
    F64(&'a [f64]),
}

impl Values<'_> {
    pub(crate) fn copy(&self, start: usize, out: &mut [f64]) {
        match self {
            Values::F32(values) => {
                for (out, v) in out.iter_mut().zip(&values[start..]) {
                    *out = f64::from(*v);
                }
            }
            Values::F64(values) => out.copy_from_slice(&values[start..start + out.len()]),
        }
    }

    pub(crate) fn len(&self) -> usize {
        match self {
            Values::F32(values) => values.len(),
            Values::F64(values) => values.len(),
        }
    }
}

/// Sparse rows to start from.
#[derive(Clone, Copy)]
pub struct Start<'a> {
    pub indptr: &'a [i64],
    pub indices: &'a [i32],
    pub values: &'a [f64],
    pub background: &'a [f64],
}

/// The rows to solve.
#[derive(Clone, Copy)]
pub struct Rows<'a> {
    pub count: usize,
    /// (count, patterns)
    pub samples: Values<'a>,
    /// (count, patterns)
    pub clipped: &'a [bool],
    /// (count, patterns), or (patterns) shared by all rows, or none for 1.
    pub weights: Option<Values<'a>>,
    pub start: Option<Start<'a>>,
}

/// One row's solution.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solution {
    /// Ascending.
    pub pixels: Vec<u32>,
    pub x: Vec<f64>,
    pub background: f64,
    pub objective: f64,
    /// (P - D) / max(P, 1e-6 ||y||^2 / 2)
    pub gap: f64,
    pub passes: u32,
    pub converged: bool,
}

/// Solves all rows. Returns None if `cancelled` was set meanwhile; `finished` counts rows.
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
