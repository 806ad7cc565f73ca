//! Products with patterns and matrices, and the Walsh-Hadamard transform.

use crate::arrays::{array, check_memory, check_shape, long_or_short, whole, Floats};
use crate::threads::on_all_cores;
use lightmatrix_core::bits::{self, Bits};
use lightmatrix_core::float::Float;
use lightmatrix_core::hadamard;
use lightmatrix_core::product::rows_times;
use numpy::{Element, IntoPyArray, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Largest number of projector pixels: their indices are int32.
pub const MOST_PIXELS: usize = i32::MAX as usize;

/// Patterns as packed bits, (K, ceil(N / 8)).
pub struct Packed<'py> {
    bytes: PyReadonlyArrayDyn<'py, u8>,
    pixels: usize,
}

impl<'py> Packed<'py> {
    pub fn read(packed: &Bound<'py, PyAny>, pixels: &Bound<'py, PyAny>) -> PyResult<Self> {
        let pixels = whole(pixels, "pixels", 0..=MOST_PIXELS)?;
        let bytes = array::<u8>(packed, "packed")?;
        let stride = pixels.div_ceil(8);
        let why = format!("{stride} bytes a pattern hold {pixels} pixels");
        check_shape("packed", bytes.shape(), &[None, Some(stride)], &why)?;
        Ok(Packed { bytes, pixels })
    }

    pub fn view(&self) -> PyResult<Bits<'_>> {
        let patterns = self.bytes.shape()[0];
        Ok(Bits::new(self.bytes.as_slice()?, patterns, self.pixels))
    }
}

/// Calls `compute(rows, input, output)`, with rows of `widths` (input, output) values.
fn product<'py, T: Float + Element>(
    py: Python<'py>,
    rows: &PyReadonlyArrayDyn<'py, T>,
    widths: (usize, usize),
    compute: impl Fn(usize, &[T], &mut [T]) + Send + Sync,
) -> PyResult<Bound<'py, PyAny>> {
    let why = format!("each row has {} values", widths.0);
    check_shape("rows", rows.shape(), &[None, Some(widths.0)], &why)?;
    let count = rows.shape()[0];
    let input = rows.as_slice()?;
    let length = check_memory::<T>(&[count, widths.1], "the product")?;
    let output = on_all_cores(py, || {
        let mut output = vec![T::default(); length];
        compute(count, input, &mut output);
        output
    })?;
    output
        .into_pyarray(py)
        .call_method1("reshape", (count, widths.1))
}

/// Calls `product` on rows of float32 or float64.
macro_rules! product_of_either {
    ($py:expr, $rows:expr, $widths:expr, $compute:expr) => {
        match &Floats::unchecked($rows, "rows")? {
            Floats::Single(rows) => product($py, rows, $widths, $compute),
            Floats::Double(rows) => product($py, rows, $widths, $compute),
        }
    };
}

/// Rows of x, (M, N), times the transposed patterns: (M, K).
#[pyfunction]
fn bits_forward<'py>(
    py: Python<'py>,
    packed: &Bound<'py, PyAny>,
    pixels: &Bound<'py, PyAny>,
    x: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let packed = Packed::read(packed, pixels)?;
    let bits = packed.view()?;
    let widths = (bits.pixels(), bits.patterns());
    product_of_either!(py, x, widths, |n, x, out| bits::forward(bits, n, x, out))
}

/// Rows of e, (M, K), times the patterns: (M, N).
#[pyfunction]
fn bits_adjoint<'py>(
    py: Python<'py>,
    packed: &Bound<'py, PyAny>,
    pixels: &Bound<'py, PyAny>,
    e: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let packed = Packed::read(packed, pixels)?;
    let bits = packed.view()?;
    let widths = (bits.patterns(), bits.pixels());
    check_memory::<u8>(&[bits.patterns().div_ceil(8), bits.pixels()], "the columns")?;
    product_of_either!(py, e, widths, |n, e, out| bits::adjoint(bits, n, e, out))
}

/// Columns of the patterns, (K, index.size) float32.
#[pyfunction]
fn bits_columns<'py>(
    py: Python<'py>,
    packed: &Bound<'py, PyAny>,
    pixels: &Bound<'py, PyAny>,
    index: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let packed = Packed::read(packed, pixels)?;
    let bits = packed.view()?;
    let index = long_or_short(index, "index")?;
    check_shape("index", index.shape(), &[None], "pixels")?;
    let index = below(index.as_slice()?, bits.pixels(), "index")?;
    let length = check_memory::<f32>(&[bits.patterns(), index.len()], "the columns")?;
    let mut out = vec![0f32; length];
    bits::columns(bits, &index, &mut out);
    let shape = (bits.patterns(), index.len());
    out.into_pyarray(py).call_method1("reshape", shape)
}

/// Converts indices to the core's type; rejects those that are not below `size`.
pub fn below<T: TryFrom<i64>>(values: &[i64], size: usize, what: &str) -> PyResult<Vec<T>> {
    let outside =
        |value| PyValueError::new_err(format!("{what} holds {value}, expected 0 to below {size}"));
    check_memory::<T>(&[values.len()], what)?;
    values
        .iter()
        .map(|&value| {
            let within = usize::try_from(value).is_ok_and(|value| value < size);
            let value_or_none = within.then(|| T::try_from(value).ok()).flatten();
            value_or_none.ok_or_else(|| outside(value))
        })
        .collect()
}

/// The fast Walsh-Hadamard transform of each row, (M, a power of two).
#[pyfunction(name = "hadamard")]
fn hadamard_rows<'py>(py: Python<'py>, x: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let floats = Floats::unchecked(x, "rows")?;
    check_shape("rows", floats.shape(), &[None, None], "rows to transform")?;
    let length = floats.shape()[1];
    if !length.is_power_of_two() {
        return Err(PyValueError::new_err(format!(
            "rows have {length} values, the transform needs a power of two"
        )));
    }
    product_of_either!(py, x, (length, length), |_, x, out| {
        out.copy_from_slice(x);
        hadamard::transform(out, length);
    })
}

/// Rows (M, B) times a matrix (B, K), float32. The result for a row does not depend on the other rows.
#[pyfunction(name = "rows_times")]
fn rows_times_matrix<'py>(
    py: Python<'py>,
    rows: &Bound<'py, PyAny>,
    matrix: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let (rows, matrix) = (array::<f32>(rows, "rows")?, array::<f32>(matrix, "matrix")?);
    check_shape("matrix", matrix.shape(), &[None, None], "a matrix")?;
    let (widths, matrix) = ((matrix.shape()[0], matrix.shape()[1]), matrix.as_slice()?);
    product(py, &rows, widths, |_, rows, out| {
        rows_times(rows, matrix, widths.1, out);
    })
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(bits_forward, module)?)?;
    module.add_function(wrap_pyfunction!(bits_adjoint, module)?)?;
    module.add_function(wrap_pyfunction!(bits_columns, module)?)?;
    module.add_function(wrap_pyfunction!(hadamard_rows, module)?)?;
    module.add_function(wrap_pyfunction!(rows_times_matrix, module)?)
}
