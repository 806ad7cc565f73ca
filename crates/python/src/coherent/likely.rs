//! Predicts which atoms rows hold.

use super::checks::{self, LARGEST};
use crate::arrays::{check_memory, check_shape, grid, positive, whole, Values};
use crate::input::SparseRows;
use crate::threads::{on_all_cores, thread_count};
use lightmatrix_core::coherent::{self, Windows};
use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

type Csr<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray1<f32>>,
);

/// Predicts the atoms of each row of a range (start, stop), or of the rows `index` of it, and their
/// penalties: the parts of a CSR matrix.
#[pyfunction]
#[pyo3(signature = (
    rows, camera, projector, jacobian, spots, within, wider, singles, reach, most, doubts, range,
    index=None
))]
#[allow(clippy::too_many_arguments)]
pub(super) fn likely_pixels<'py>(
    py: Python<'py>,
    rows: &Bound<'py, PyAny>,
    camera: &Bound<'py, PyAny>,
    projector: &Bound<'py, PyAny>,
    jacobian: &Bound<'py, PyAny>,
    spots: Vec<Bound<'py, PyAny>>,
    within: &Bound<'py, PyAny>,
    wider: &Bound<'py, PyAny>,
    singles: &Bound<'py, PyAny>,
    reach: (Bound<'py, PyAny>, Bound<'py, PyAny>),
    most: &Bound<'py, PyAny>,
    doubts: &Bound<'py, PyAny>,
    range: (Bound<'py, PyAny>, Bound<'py, PyAny>),
    index: Option<&Bound<'py, PyAny>>,
) -> PyResult<Csr<'py>> {
    let (camera, count) = grid(camera, "camera")?;
    let (projector, pixels) = grid(projector, "projector")?;
    let jacobian = checks::jacobian(jacobian, "jacobian", count)?;
    let spots = spots
        .iter()
        .map(|spot| Values::<f32>::reals(spot, "a spot"))
        .collect::<PyResult<Vec<_>>>()?;
    let spots = spots
        .iter()
        .map(Values::as_slice)
        .collect::<PyResult<Vec<_>>>()?;
    let valid = |spot: &&[f32]| !spot.is_empty() && spot.iter().all(|v| (0.0..=1.0).contains(v));
    if spots.len() != projector[0] || !spots.iter().all(valid) {
        return Err(PyValueError::new_err(format!(
            "{} spots for {} planes, expected one side of each in [0, 1]",
            spots.len(),
            projector[0]
        )));
    }
    let wider = Values::<f32>::reals(wider, "wider")?;
    let singles = Values::<f32>::reals(singles, "singles")?;
    let (wider, singles) = (wider.as_slice()?, singles.as_slice()?);
    let in_range = singles.iter().all(|share| (0.0..=1.0).contains(share));
    if wider.len() != projector[0] || wider.iter().any(|&share| share < 0.0) {
        return Err(PyValueError::new_err(format!(
            "{} shares of the next wider spots for {} planes, expected one of each, from 0 on",
            wider.len(),
            projector[0]
        )));
    }
    if singles.len() != count || !in_range {
        return Err(PyValueError::new_err(format!(
            "{} shares of single pixels for {count} rows, expected one of each in [0, 1]",
            singles.len()
        )));
    }
    let windows = Windows {
        wider,
        singles,
        spots: &spots,
        within: positive(within, "within")? as f32,
        camera,
        projector,
        jacobian: jacobian.as_slice()?,
        camera_reach: whole(&reach.0, "the reach in the camera", 0..=LARGEST)?,
        projector_reach: whole(&reach.1, "the reach in the projector", 0..=LARGEST)?,
        most: whole(most, "most", 1..=LARGEST)?,
    };
    let rows_selected = checks::selected(index, checks::range(range, count)?)?;
    let doubts = Values::<f64>::reals(doubts, "doubts")?;
    let why = "one for each row of the range or the index";
    check_shape("doubts", doubts.shape(), &[Some(rows_selected.len())], why)?;
    let doubts = doubts.as_slice()?;
    if let Some(odd) = doubts.iter().find(|&&doubt| doubt <= 0.0) {
        return Err(PyValueError::new_err(format!(
            "doubts holds {odd}, expected numbers above 0"
        )));
    }
    let rows = SparseRows::<f32>::read(rows, "rows", (count, pixels))?;
    let matrix = rows.view()?;
    check_memory::<f32>(&[thread_count(None), pixels], "sums over the pixels")?;
    let most = windows.most.min(pixels);
    check_memory::<(i32, f32)>(&[rows_selected.len(), most], "the likely pixels")?;
    let parts = on_all_cores(py, || {
        coherent::penalties(&coherent::likely(matrix, windows, &rows_selected), doubts)
    })?;
    Ok((
        parts.indptr.into_pyarray(py),
        parts.atoms.into_pyarray(py),
        parts.values.into_pyarray(py),
    ))
}
