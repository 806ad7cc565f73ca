//! The patterns of the frames of a video.

use crate::arrays::{array, check_shape, indices, positive, whole, writable, wrong_type};
use crate::input::SparseRows;
use crate::threads::on_all_cores;
use lightmatrix_core::frames::{Scene, PIXEL, SAMPLE};
use lightmatrix_core::images::{Light, LANES};
use numpy::{IntoPyArray, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Writes the patterns, `out` (K, N), of K wanted pictures, (M) each. Returns for each the sum of its squared
/// errors and the number of samples that are reached, (K,) each. `room` holds 32 (M + N) + 16 numbers.
#[pyfunction]
#[pyo3(signature = (
    rows, columns, background, cells, samples, pixels, wanted, last_pattern, last_wanted, out, room, *,
    ridge, tolerance, steps
))]
// The arguments are independent of each other; a struct would only name them again.
#[allow(clippy::too_many_arguments)]
fn frame_patterns<'py>(
    py: Python<'py>,
    rows: &Bound<'py, PyAny>,
    columns: &Bound<'py, PyAny>,
    background: &Bound<'py, PyAny>,
    cells: &Bound<'py, PyAny>,
    samples: &Bound<'py, PyAny>,
    pixels: &Bound<'py, PyAny>,
    wanted: &Bound<'py, PyAny>,
    last_pattern: &Bound<'py, PyAny>,
    last_wanted: &Bound<'py, PyAny>,
    out: &Bound<'py, PyAny>,
    room: &Bound<'py, PyAny>,
    ridge: &Bound<'py, PyAny>,
    tolerance: &Bound<'py, PyAny>,
    steps: &Bound<'py, PyAny>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let Ok(wanted) = wanted.extract::<Vec<Bound<'_, PyAny>>>() else {
        return Err(wrong_type("wanted", wanted, "a list of pictures"));
    };
    let samples = array::<f32>(samples, "samples")?;
    let why = format!("{SAMPLE} numbers of each camera sample");
    check_shape("samples", samples.shape(), &[None, Some(SAMPLE)], &why)?;
    let (frames, height) = (wanted.len(), samples.shape()[0]);
    let pixels = array::<f32>(pixels, "pixels")?;
    let why = format!("{PIXEL} numbers of each projector pixel");
    check_shape("pixels", pixels.shape(), &[None, Some(PIXEL)], &why)?;
    let width = pixels.shape()[0];
    if !(1..=LANES).contains(&frames) || height == 0 || width == 0 {
        return Err(PyValueError::new_err(format!(
            "{frames} pictures of {height} samples for {width} pixels, expected 1 to {LANES} pictures"
        )));
    }
    let why = "one value of each camera sample";
    let mut pictures = Vec::with_capacity(frames);
    for picture in &wanted {
        let picture = array::<f32>(picture, "wanted")?;
        check_shape("wanted", picture.shape(), &[Some(height)], why)?;
        pictures.push(picture);
    }
    let last_wanted = array::<f32>(last_wanted, "last_wanted")?;
    check_shape("last_wanted", last_wanted.shape(), &[Some(height)], why)?;
    let background = array::<f32>(background, "background")?;
    let shape = [Some(height), None];
    check_shape(
        "background",
        background.shape(),
        &shape,
        "each cell's light",
    )?;
    let count = background.shape()[1];
    let cells = indices(cells, count, "cells")?;
    check_shape("cells", cells.shape(), &[Some(width)], "one of each pixel")?;
    let rows = SparseRows::<f32>::read(rows, "rows", (height, width))?;
    let columns = SparseRows::<f32>::read(columns, "columns", (width, height))?;
    let last_pattern = array::<f32>(last_pattern, "last_pattern")?;
    let why = "one value of each projector pixel";
    check_shape("last_pattern", last_pattern.shape(), &[Some(width)], why)?;
    let (ridge, tolerance) = (positive(ridge, "ridge")?, positive(tolerance, "tolerance")?);
    let steps = whole(steps, "steps", 1..=i32::MAX as usize)?;
    let mut out = writable(out, "out")?;
    check_shape(
        "out",
        out.shape(),
        &[Some(frames), Some(width)],
        "a pattern of each picture",
    )?;

    let scene = Scene {
        light: Light::new(
            rows.view()?,
            columns.view()?,
            background.as_slice()?,
            cells.as_slice()?,
            count,
        ),
        samples: samples.as_slice()?.as_chunks().0,
        pixels: pixels.as_slice()?.as_chunks().0,
        ridge: ridge as f32,
        tolerance: tolerance as f32,
    };
    let mut room = writable(room, "room")?;
    if room.len() < scene.room() {
        return Err(PyValueError::new_err(format!(
            "room for {} numbers, expected {} or more",
            room.len(),
            scene.room()
        )));
    }
    let wanted = pictures.iter().map(|picture| picture.as_slice());
    let wanted = wanted.collect::<Result<Vec<_>, _>>()?;
    let before = (last_pattern.as_slice()?, last_wanted.as_slice()?);
    let (out, room) = (out.as_slice_mut()?, room.as_slice_mut()?);
    let found = on_all_cores(py, || scene.frames(&wanted, before, steps, out, room))?;
    let [squares, reached] = [found.squares, found.reached].map(|sums| sums.into_pyarray(py));
    Ok((squares.into_any(), reached.into_any()))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(frame_patterns, module)?)
}
