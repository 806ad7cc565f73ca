//! `lightmatrix._core`: casts, checks and releases the GIL; no arithmetic.

mod arrays;
mod coherent;
mod input;
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
    planes::register(module)?;
    solved::register(module)?;
    solver::register(module)?;
    coherent::register(module)
}
