//! Rows whose light lies at fixed places, times patterns.

use crate::arrays::{array, check_memory, check_shape, long_or_short};
use crate::products::below;
use crate::threads::on_all_cores;
use lightmatrix_core::places::Places;
use numpy::{IntoPyArray, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Checked places of m rows.
struct Checked<'py> {
    starts: Vec<i64>,
    pixels: Vec<u32>,
    columns: numpy::PyReadonlyArrayDyn<'py, f32>,
    count: usize,
}

impl<'py> Checked<'py> {
    fn read(
        starts: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        columns: &Bound<'py, PyAny>,
    ) -> PyResult<Self> {
        let columns = array::<f32>(columns, "columns")?;
        check_shape(
            "columns",
            columns.shape(),
            &[None, None],
            "K values of each pixel",
        )?;
        let [height, count] = [columns.shape()[0], columns.shape()[1]];
        let pixels = long_or_short(pixels, "pixels")?;
        check_shape("pixels", pixels.shape(), &[None], "one of each place")?;
        let pixels = below::<u32>(pixels.as_slice()?, height, "pixels")?;
        let starts = long_or_short(starts, "starts")?;
        check_shape(
            "starts",
            starts.shape(),
            &[None],
            "one of each row, and the end",
        )?;
        let starts = starts.as_slice()?.to_vec();
        let ascending = starts.windows(2).all(|pair| pair[0] <= pair[1]);
        if starts.first() != Some(&0) || starts.last() != Some(&(pixels.len() as i64)) || !ascending
        {
            let why = format!("starts do not ascend from 0 to {}", pixels.len());
            return Err(PyValueError::new_err(why));
        }
        if count == 0 {
            return Err(PyValueError::new_err("columns of no pattern"));
        }
        Ok(Checked {
            starts,
            pixels,
            columns,
            count,
        })
    }

    fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    fn view(&self) -> PyResult<Places<'_>> {
        let columns = self.columns.as_slice()?;
        Ok(Places::new(&self.starts, &self.pixels, columns, self.count))
    }
}

/// The light of m rows under K patterns, (m, K): of `light` at their places.
#[pyfunction]
fn light_at_places<'py>(
    py: Python<'py>,
    starts: &Bound<'py, PyAny>,
    pixels: &Bound<'py, PyAny>,
    columns: &Bound<'py, PyAny>,
    light: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let checked = Checked::read(starts, pixels, columns)?;
    let light = array::<f32>(light, "light")?;
    check_shape(
        "light",
        light.shape(),
        &[Some(checked.pixels.len())],
        "one of each place",
    )?;
    let (places, light) = (checked.view()?, light.as_slice()?);
    let length = check_memory::<f32>(&[checked.rows(), checked.count], "the light of rows")?;
    let shown = on_all_cores(py, || {
        let mut shown = vec![0f32; length];
        places.shown(light, &mut shown);
        shown
    })?;
    let shape = (checked.rows(), checked.count);
    shown.into_pyarray(py).call_method1("reshape", shape)
}

/// The adjoint: what each place has of samples (m, K) of its row.
#[pyfunction]
fn gathered_at_places<'py>(
    py: Python<'py>,
    starts: &Bound<'py, PyAny>,
    pixels: &Bound<'py, PyAny>,
    columns: &Bound<'py, PyAny>,
    samples: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let checked = Checked::read(starts, pixels, columns)?;
    let samples = array::<f32>(samples, "samples")?;
    let shape = [Some(checked.rows()), Some(checked.count)];
    check_shape("samples", samples.shape(), &shape, "K values of each row")?;
    let (places, samples) = (checked.view()?, samples.as_slice()?);
    let length = check_memory::<f32>(&[checked.pixels.len()], "what places have")?;
    let gathered = on_all_cores(py, || {
        let mut gathered = vec![0f32; length];
        places.gathered(samples, &mut gathered);
        gathered
    })?;
    Ok(gathered.into_pyarray(py).into_any())
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(light_at_places, module)?)?;
    module.add_function(wrap_pyfunction!(gathered_at_places, module)?)
}
