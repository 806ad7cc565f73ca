//! Pattern products and solvers for light transport estimation. This crate knows no Python.
//!
//! A camera row of the light transport matrix T is estimated from samples y = min(1, P x + b m):
//! P holds the patterns, x >= 0 the row of T, m the means of the patterns and b the background.
//!
//! - `active_set` solves rows by themselves, each to a certified duality gap: start at
//!   `active_set::solve`. It correlates residuals with all columns of P by `correlate` and handles
//!   single columns by `columns`.
//! - `coherent` predicts from neighbouring rows which pixels a row holds and what its clipped samples
//!   are, and solves rows on these pixels with the same solver.
//! - `places` multiplies rows whose light lies at fixed places with patterns.
//! - `frames` finds the patterns of frames of a video, with `images`, which multiplies T with sixteen images
//!   at once.
//! - `problem` defines what solvers take and return. `bits`, `words`, `atoms`, `hadamard` and
//!   `product` store patterns and multiply with them.
//! - `vector` and `octet` hold the inner loops, which `simd` compiles for each instruction set.

// Processors other than x86-64 compile the portable kernels only, which leaves helpers of the other
// kernels unused.
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
mod dots;
pub mod float;
pub mod frames;
pub mod hadamard;
pub mod images;
mod octet;
pub mod places;
pub mod problem;
pub mod product;
pub mod simd;
mod subsets;
pub mod vector;
pub mod words;
