//! Predicts the samples of rows.

use super::checks::{self, check_pixels, LARGEST};
use crate::arrays::{attribute, check_memory, check_shape, grid, positive, whole, Values};
use crate::input::{Samples, SparseRows};
use crate::solver::PreparedPatterns;
use crate::threads::on_all_cores;
use lightmatrix_core::coherent::{self, Expected, Neighbours};
use numpy::IntoPyArray;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Predicts the samples of the rows from `start` on, or of the rows `index` after it, and their variances,
/// each (m, K + E): under the K patterns shown, then under the E unseen ones.
#[pyfunction]
#[pyo3(signature = (
    shown, unseen, samples, neighbourhood, background, *, reach, start, level, index=None
))]
// The arguments are independent of each other; a struct would only name them again.
#[allow(clippy::too_many_arguments)]
pub(super) fn expected_samples<'py>(
    py: Python<'py>,
    shown: &PreparedPatterns,
    unseen: &PreparedPatterns,
    samples: &Bound<'py, PyAny>,
    neighbourhood: &Bound<'py, PyAny>,
    background: &Bound<'py, PyAny>,
    reach: &Bound<'py, PyAny>,
    start: &Bound<'py, PyAny>,
    level: &Bound<'py, PyAny>,
    index: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let part = |name| attribute(neighbourhood, name, "neighbourhood");
    let (camera, total) = grid(&part("camera")?, "neighbourhood.camera")?;
    let (projector, pixels) = grid(&part("projector")?, "neighbourhood.projector")?;
    check_pixels(shown, pixels, "shown")?;
    check_pixels(unseen, pixels, "unseen")?;
    let rows = attribute(&part("rows")?, "coefficients", "neighbourhood.rows")?;
    let rows = SparseRows::read(&rows, "neighbourhood.rows", (total, pixels))?;
    let samples = Samples::read(samples, shown.dictionary.patterns)?;
    let count = samples.count;
    if count > total {
        return Err(PyValueError::new_err(format!(
            "samples of {count} rows for a camera of {total}"
        )));
    }
    let start = whole(start, "start", 0..=total - count)?;
    let selected: Vec<usize> = match index {
        None => (start..start + count).collect(),
        Some(_) => checks::selected(index, start..total)?,
    };
    if selected.len() != count {
        return Err(PyValueError::new_err(format!(
            "an index of {} rows for samples of {count}",
            selected.len()
        )));
    }
    let stop = selected.last().map_or(start, |last| last + 1);
    let level = positive(level, "level")?;
    let largest = camera[0].max(camera[1]);
    let reach = whole(reach, "reach", 0..=LARGEST)?.min(largest);

    let jacobian = checks::jacobian(&part("jacobian")?, "neighbourhood.jacobian", total)?;

    // The rows of the windows around the first and the last selected row.
    let halo = reach
        .saturating_mul(camera[1] + 1)
        .saturating_mul(camera[2]);
    let first = start.saturating_sub(halo);
    let window_rows = stop.saturating_add(halo).min(total) - first;
    let all = shown.dictionary.patterns + unseen.dictionary.patterns;
    let background = Values::<f32>::reals(background, "background")?;
    let why = "rows of the windows, and patterns shown and unseen";
    let shape = [Some(window_rows), Some(all)];
    check_shape("background", background.shape(), &shape, why)?;

    let neighbours = Neighbours {
        matrix: rows.view()?,
        camera,
        projector,
        reach,
        jacobian: jacobian.as_slice()?,
        background: background.as_slice()?,
        first,
    };
    let rows = samples.rows(None)?;
    check_memory::<[f32; 2]>(&[count, all], "the expected samples")?;
    let (shown, unseen) = (&shown.dictionary, &unseen.dictionary);
    let Expected { values, variances } = on_all_cores(py, || {
        coherent::expected(shown, unseen, neighbours, rows, level, &selected)
    })?;
    let shaped = |values: Vec<f32>| {
        values
            .into_pyarray(py)
            .call_method1("reshape", (count, all))
    };
    Ok((shaped(values)?, shaped(variances)?))
}
