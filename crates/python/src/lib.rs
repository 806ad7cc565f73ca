//! `lightmatrix._core`: casts, checks and releases the GIL; no arithmetic.

mod products;

use pyo3::prelude::*;

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    products::register(module)
}
