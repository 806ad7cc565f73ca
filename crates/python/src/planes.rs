//! Separable kernels, which define atoms, and images blurred by them.

use crate::arrays::{array, check_shape, grid, positive, Values};
use crate::threads::on_all_cores;
use lightmatrix_core::atoms::{self, Plane};
use lightmatrix_core::simd::Level;
use numpy::PyUntypedArrayMethods;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A plane of atoms from a kernel, from its middle outwards, and a gain.
pub fn plane((kernel, gain): &(Bound<'_, PyAny>, Bound<'_, PyAny>)) -> PyResult<Plane> {
    let gain = positive(gain, "a gain")?;
    if gain > 1.0 {
        let why = format!("a gain of {gain}, expected none above 1");
        return Err(PyValueError::new_err(why));
    }
    Ok(Plane {
        kernel: kernel_of(kernel)?,
        gain: gain as f32,
    })
}

/// One side of a separable kernel, from its middle outwards.
fn kernel_of(kernel: &Bound<'_, PyAny>) -> PyResult<Vec<f32>> {
    let values = Values::<f32>::reals(kernel, "a kernel")?;
    check_shape("a kernel", values.shape(), &[None], "one side of it")?;
    let kernel = values.as_slice()?.to_vec();
    let sum: f32 = kernel.iter().sum::<f32>() * 2.0 - kernel.first().unwrap_or(&0.0);
    if !(kernel.iter().all(|&v| v >= 0.0) && sum > 0.0 && sum < 1.001) {
        let why = format!("a kernel of sum {sum}, expected none above 1");
        return Err(PyValueError::new_err(why));
    }
    Ok(kernel)
}

/// The sum and the sum of squares of all values of images (m, N) float32 after blurring with a kernel.
#[pyfunction]
fn blurred_moments(
    py: Python<'_>,
    images: &Bound<'_, PyAny>,
    shape: &Bound<'_, PyAny>,
    kernel: &Bound<'_, PyAny>,
) -> PyResult<(f64, f64)> {
    let (grid, pixels) = grid(shape, "shape")?;
    let kernel = kernel_of(kernel)?;
    let plane = Plane { kernel, gain: 1.0 };
    let images = array::<f32>(images, "images")?;
    check_shape(
        "images",
        images.shape(),
        &[None, Some(pixels)],
        "pixels of each",
    )?;
    let images = images.as_slice()?;
    let [sum, squares] =
        on_all_cores(py, || atoms::moments(Level::detect(), grid, &plane, images))?;
    Ok((sum, squares))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(blurred_moments, module)?)
}
