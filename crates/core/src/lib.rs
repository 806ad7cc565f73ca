//! Bit-packed pattern products and solvers for light transport estimation; knows no Python.

// Other processors than x86-64 have the portable kernels only, and leave unused what the rest takes.
#![cfg_attr(
    not(target_arch = "x86_64"),
    allow(
        dead_code,
        unused_imports,
        unused_variables,
        unused_mut,
        clippy::ptr_arg
    )
)]

pub mod active_set;
pub mod aligned;
pub mod atoms;
pub mod bits;
pub mod coherent;
pub mod columns;
pub mod correlate;
pub mod float;
pub mod hadamard;
mod octet;
pub mod problem;
pub mod product;
pub mod simd;
mod subsets;
pub mod vector;
pub mod words;
