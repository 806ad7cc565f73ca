//! The Python module `lightmatrix._core`: it checks and converts arguments, releases the GIL and calls the
//! core. No arithmetic.
//!
//! Functions are in `products` (pattern products), `planes` (blurred images), `places` (rows at fixed places), `solver` (prepared patterns,
//! the active-set solver), `coherent` and `frames` (of a video). `arrays` and `input` check arguments, `threads` runs the core.
//! `_core.pyi` documents the module for Python.

mod arrays;
mod coherent;
mod frames;
mod input;
mod places;
mod planes;
mod products;
mod sets;
mod solved;
mod solver;
mod threads;

use lightmatrix_core::aligned::Aligned;
use pyo3::prelude::*;

#[global_allocator]
static ALLOCATOR: Aligned = Aligned;

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    products::register(module)?;
    places::register(module)?;
    planes::register(module)?;
    solved::register(module)?;
    solver::register(module)?;
    coherent::register(module)?;
    frames::register(module)
}
