//! Pattern products and transforms.

use lightmatrix_core::bits::{self, Bits};
use lightmatrix_core::float::Float;
use lightmatrix_core::hadamard;
use numpy::{
    Element, IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// Views the packed bits after checking their shape.
pub fn checked_bits<'a>(packed: &'a PyReadonlyArray2<'_, u8>, pixels: usize) -> PyResult<Bits<'a>> {
    let (patterns, stride) = (packed.shape()[0], packed.shape()[1]);
    if stride != pixels.div_ceil(8) {
        return Err(PyValueError::new_err(format!(
            "bits have {stride} bytes a pattern, {pixels} pixels need {}",
            pixels.div_ceil(8)
        )));
    }
    Ok(Bits::new(packed.as_slice()?, patterns, pixels))
}

fn product<'py, T: Float + Element>(
    py: Python<'py>,
    rows: &PyReadonlyArray2<'py, T>,
    widths: (usize, usize),
    compute: impl Fn(usize, &[T], &mut [T]) + Send + Sync,
) -> PyResult<Bound<'py, PyAny>> {
    let count = rows.shape()[0];
    if rows.shape()[1] != widths.0 {
        return Err(PyValueError::new_err(format!(
            "rows have {} values, the patterns need {}",
            rows.shape()[1],
            widths.0
        )));
    }
    let input = rows.as_slice()?;
    let output = py.detach(|| {
        let mut output = vec![T::default(); count * widths.1];
        compute(count, input, &mut output);
        output
    });
    output
        .into_pyarray(py)
        .call_method1("reshape", (count, widths.1))
}

/// Calls `$body` with `$rows` as float32 or float64, whichever it is.
macro_rules! for_either_float {
    ($value:expr, $rows:ident => $body:expr) => {
        if let Ok($rows) = $value.extract::<PyReadonlyArray2<f32>>() {
            $body
        } else if let Ok($rows) = $value.extract::<PyReadonlyArray2<f64>>() {
            $body
        } else {
            Err(PyTypeError::new_err(
                "expected a two-dimensional float32 or float64 array",
            ))
        }
    };
}

#[pyfunction]
fn bits_forward<'py>(
    py: Python<'py>,
    packed: PyReadonlyArray2<'py, u8>,
    pixels: usize,
    x: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let bits = checked_bits(&packed, pixels)?;
    let widths = (pixels, bits.patterns());
    for_either_float!(x, rows => product(py, &rows, widths, |n, x, out| bits::forward(bits, n, x, out)))
}

#[pyfunction]
fn bits_adjoint<'py>(
    py: Python<'py>,
    packed: PyReadonlyArray2<'py, u8>,
    pixels: usize,
    e: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let bits = checked_bits(&packed, pixels)?;
    let widths = (bits.patterns(), pixels);
    for_either_float!(e, rows => product(py, &rows, widths, |n, e, out| bits::adjoint(bits, n, e, out)))
}

#[pyfunction]
fn bits_columns<'py>(
    py: Python<'py>,
    packed: PyReadonlyArray2<'py, u8>,
    pixels: usize,
    index: PyReadonlyArray1<'py, i64>,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let bits = checked_bits(&packed, pixels)?;
    let index = index
        .as_slice()?
        .iter()
        .map(|&i| {
            usize::try_from(i)
                .ok()
                .filter(|&i| i < pixels)
                .ok_or_else(|| {
                    PyValueError::new_err(format!("pixel {i} of a projector of {pixels}"))
                })
        })
        .collect::<PyResult<Vec<_>>>()?;
    let mut out = vec![0f32; bits.patterns() * index.len()];
    bits::columns(bits, &index, &mut out);
    let shape = (bits.patterns(), index.len());
    Ok(out
        .into_pyarray(py)
        .call_method1("reshape", shape)?
        .extract()?)
}

#[pyfunction(name = "hadamard")]
fn hadamard_rows<'py>(py: Python<'py>, x: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    for_either_float!(x, rows => {
        let length = rows.shape()[1];
        if !length.is_power_of_two() {
            return Err(PyValueError::new_err(format!(
                "rows have {length} values, the transform needs a power of two"
            )));
        }
        product(py, &rows, (length, length), |_, x, out| {
            out.copy_from_slice(x);
            hadamard::transform(out, length);
        })
    })
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(bits_forward, module)?)?;
    module.add_function(wrap_pyfunction!(bits_adjoint, module)?)?;
    module.add_function(wrap_pyfunction!(bits_columns, module)?)?;
    module.add_function(wrap_pyfunction!(hadamard_rows, module)?)
}
