//! `lightmatrix._core`: casts, checks and releases the GIL; no arithmetic.

mod coherent;
mod products;
mod solver;

use pyo3::prelude::*;

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    products::register(module)?;
    solver::register(module)?;
    coherent::register(module)
}
