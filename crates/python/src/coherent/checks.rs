//! Checks of arguments that the functions of the coherent estimate share.

use crate::arrays::{check_shape, long_or_short, whole, Values};
use crate::products::below;
use crate::solver::PreparedPatterns;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::ops::Range;

/// Largest window and largest number of atoms: indices are int32.
pub(super) const LARGEST: usize = i32::MAX as usize;

/// A range (start, stop) of rows.
pub(super) fn range(
    value: (Bound<'_, PyAny>, Bound<'_, PyAny>),
    rows: usize,
) -> PyResult<Range<usize>> {
    let stop = whole(&value.1, "the end of the range", 0..=rows)?;
    let start = whole(&value.0, "the start of the range", 0..=stop)?;
    Ok(start..stop)
}

/// The rows of a range, or a selection of them: `index` counts from its start and ascends.
pub(super) fn selected(
    index: Option<&Bound<'_, PyAny>>,
    range: Range<usize>,
) -> PyResult<Vec<usize>> {
    let Some(index) = index else {
        return Ok(range.collect());
    };
    let index = long_or_short(index, "index")?;
    check_shape("index", index.shape(), &[None], "rows of the range")?;
    let index: Vec<usize> = below(index.as_slice()?, range.len(), "index")?;
    if !index.is_sorted_by(|a, b| a < b) {
        return Err(PyValueError::new_err("index does not ascend"));
    }
    Ok(index.into_iter().map(|row| range.start + row).collect())
}

/// The Jacobian of the correspondence: four numbers for each row.
pub(super) fn jacobian<'py>(
    value: &Bound<'py, PyAny>,
    what: &str,
    rows: usize,
) -> PyResult<Values<'py, f32>> {
    let jacobian = Values::<f32>::reals(value, what)?;
    let why = "projector row and column by camera row and column, for each row";
    check_shape(what, jacobian.shape(), &[Some(rows), Some(4)], why)?;
    Ok(jacobian)
}

/// Rejects patterns over another number of pixels.
pub(super) fn check_pixels(prepared: &PreparedPatterns, pixels: usize, what: &str) -> PyResult<()> {
    match prepared.dictionary.pixels {
        own if own == pixels => Ok(()),
        own => Err(PyValueError::new_err(format!(
            "{what} has patterns of {own} pixels, expected {pixels}"
        ))),
    }
}
