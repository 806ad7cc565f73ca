//! The functions of the coherent estimate: likely atoms, expected samples, rows solved on candidates.

mod checks;
mod expected;
mod likely;
mod weighted;

use pyo3::prelude::*;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(likely::likely_pixels, module)?)?;
    module.add_function(wrap_pyfunction!(expected::expected_samples, module)?)?;
    module.add_function(wrap_pyfunction!(weighted::solve_weighted, module)?)
}
