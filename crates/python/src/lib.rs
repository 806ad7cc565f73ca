//! `lightmatrix._core`: casts, checks and releases the GIL; no arithmetic.

mod arrays;
mod coherent;
mod input;
mod products;
mod solver;
mod threads;

use pyo3::prelude::*;

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    products::register(module)?;
    solver::register(module)?;
    coherent::register(module)
}
