//! Bit-packed pattern products and solvers for light transport estimation; knows no Python.

pub mod active_set;
pub mod atoms;
pub mod bits;
pub mod coherent;
pub mod columns;
pub mod correlate;
pub mod float;
pub mod hadamard;
mod octet;
pub mod problem;
pub mod simd;
mod subsets;
pub mod vector;
pub mod words;
