//! The solver's result as NumPy arrays.

use crate::arrays::check_memory;
use lightmatrix_core::problem::Solution;
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;

/// Estimated bytes of a row's solution, with 64 entries of 12 bytes. Used to check for memory.
pub const ROW_BYTES: usize = size_of::<Solution>() + 64 * 12;

/// Solved rows: the parts of a CSR matrix, and the diagnostics of each row.
#[pyclass(frozen, get_all, module = "lightmatrix._core")]
pub struct Solved {
    indptr: Py<PyArray1<i64>>,
    indices: Py<PyArray1<i32>>,
    values: Py<PyArray1<f64>>,
    background: Py<PyArray1<f64>>,
    objective: Py<PyArray1<f64>>,
    gap: Py<PyArray1<f64>>,
    passes: Py<PyArray1<i32>>,
    converged: Py<PyArray1<bool>>,
}

impl Solved {
    pub fn new(py: Python<'_>, solutions: Vec<Solution>) -> PyResult<Self> {
        let entries = solutions.iter().map(|solution| solution.x.len()).sum();
        check_memory::<(i32, f64)>(&[entries], "the solved rows")?;
        let mut indptr = vec![0i64];
        let (mut indices, mut values) = (Vec::new(), Vec::new());
        for solution in &solutions {
            indices.extend(solution.pixels.iter().map(|&pixel| pixel as i32));
            values.extend_from_slice(&solution.x);
            indptr.push(indices.len() as i64);
        }
        let each = |value: fn(&Solution) -> f64| -> Py<PyArray1<f64>> {
            let values: Vec<f64> = solutions.iter().map(value).collect();
            values.into_pyarray(py).unbind()
        };
        let passes: Vec<i32> = solutions.iter().map(|s| s.passes as i32).collect();
        let converged: Vec<bool> = solutions.iter().map(|s| s.converged).collect();
        Ok(Solved {
            indptr: indptr.into_pyarray(py).unbind(),
            indices: indices.into_pyarray(py).unbind(),
            values: values.into_pyarray(py).unbind(),
            background: each(|s| s.background),
            objective: each(|s| s.objective),
            gap: each(|s| s.gap),
            passes: passes.into_pyarray(py).unbind(),
            converged: converged.into_pyarray(py).unbind(),
        })
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Solved>()
}
