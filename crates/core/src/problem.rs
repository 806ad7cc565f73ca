//! The solvers' input and output: patterns, rows of samples, settings, solutions. No arithmetic.

use crate::columns::Columns;
use crate::correlate::Correlator;
use crate::simd::Level;

/// The patterns, prepared for solving.
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
    /// They count like any other sample.
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
    /// Whether x and b must be >= 0.
    pub nonnegative: bool,
    /// Whether there is a background coefficient b.
    pub background: bool,
    /// The relative duality gap at which a row is solved.
    pub tolerance: f64,
    /// Limit of passes over all pixels. A row that reaches it is returned with the gap that it has.
    pub max_passes: u32,
}

/// Numbers in the precision in which the caller holds them.
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

    pub(crate) fn copy_f32(&self, start: usize, out: &mut [f32]) {
        match self {
            Values::F32(values) => out.copy_from_slice(&values[start..start + out.len()]),
            Values::F64(values) => {
                for (out, v) in out.iter_mut().zip(&values[start..]) {
                    *out = *v as f32;
                }
            }
        }
    }

    pub fn len(&self) -> usize {
        match self {
            Values::F32(values) => values.len(),
            Values::F64(values) => values.len(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Sparse rows over projector pixels: the parts of a CSR matrix.
#[derive(Clone, Copy)]
pub struct Sparse<'a, T> {
    pub indptr: &'a [i64],
    pub indices: &'a [i32],
    pub values: &'a [T],
}

impl<'a, T> Sparse<'a, T> {
    /// Pixels and values of one row.
    pub fn row(&self, row: usize) -> (&'a [i32], &'a [T]) {
        let range = self.indptr[row] as usize..self.indptr[row + 1] as usize;
        (&self.indices[range.clone()], &self.values[range])
    }
}

/// The point where the solver starts.
#[derive(Clone, Copy)]
pub struct Start<'a> {
    /// A row holds no pixel twice.
    pub rows: Sparse<'a, f64>,
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
    /// (count, patterns), or (patterns) shared by all rows; None means 1.
    pub weights: Option<Values<'a>>,
    pub start: Option<Start<'a>>,
}

/// One row's solution.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solution {
    /// Pixels that differ from zero, ascending.
    pub pixels: Vec<u32>,
    pub x: Vec<f64>,
    pub background: f64,
    pub objective: f64,
    /// The relative duality gap, (P - D) / max(P, 1e-6 ||y||^2 / 2), with the primal objective P and the
    /// dual objective D.
    pub gap: f64,
    pub passes: u32,
    /// Whether the gap reached the tolerance.
    pub converged: bool,
}
