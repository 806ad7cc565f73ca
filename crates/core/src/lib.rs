//! Bit-packed pattern products and solvers for light transport estimation; knows no Python.

pub mod bits;
pub mod float;
pub mod hadamard;
