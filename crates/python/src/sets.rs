//! Checks of a pattern set: its size, means, Hadamard structure and instruction set.

use crate::arrays::{check_memory, check_shape, long_or_short, whole, Values};
use crate::products::{below, MOST_PIXELS};
use lightmatrix_core::simd::Level;
use lightmatrix_core::vector::padded;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The processor's best instruction set, or the one called `name`.
pub fn level(name: Option<&str>) -> PyResult<Level> {
    match name {
        None => Ok(Level::detect()),
        Some(name) => Level::named(name).ok_or_else(|| {
            let known: Vec<_> = Level::available().iter().map(|l| l.name()).collect();
            PyValueError::new_err(format!(
                "this CPU has no instruction set called {name:?}, it has {}",
                known.join(", ")
            ))
        }),
    }
}

/// Rejects a set without patterns or pixels, from which no row can be estimated.
pub fn check_any(patterns: usize, pixels: usize) -> PyResult<()> {
    if patterns == 0 || pixels == 0 {
        return Err(PyValueError::new_err(format!(
            "{patterns} patterns of {pixels} pixels, expected at least 1 of each"
        )));
    }
    Ok(())
}

/// The mean of each pattern, padded with zeros to the length of a column.
pub fn padded_means(means: &Bound<'_, PyAny>, patterns: usize) -> PyResult<Vec<f64>> {
    let means = Values::<f64>::reals(means, "means")?;
    check_shape("means", means.shape(), &[Some(patterns)], "one a pattern")?;
    let mut values = means.as_slice()?.to_vec();
    values.resize(padded(patterns), 0.0);
    Ok(values)
}

/// Hadamard structure: the rows (patterns) and columns (pixels) of the Sylvester matrix of order `length`.
pub struct Transform {
    pub length: usize,
    pub selected: Vec<u32>,
    pub position: Vec<u32>,
}

impl Transform {
    pub fn read(
        (length, selected, position): (Bound<'_, PyAny>, Bound<'_, PyAny>, Bound<'_, PyAny>),
        patterns: usize,
        pixels: usize,
    ) -> PyResult<Self> {
        let length = whole(&length, "the length of the transform", 1..=MOST_PIXELS)?;
        if !length.is_power_of_two() {
            return Err(PyValueError::new_err(format!(
                "the transform of length {length} needs a power of two"
            )));
        }
        check_memory::<u32>(&[length, 2], "the transform")?;
        let places = |value: &Bound<'_, PyAny>, what: &str, count| -> PyResult<Vec<u32>> {
            let value = long_or_short(value, what)?;
            check_shape(what, value.shape(), &[Some(count)], "one place each")?;
            let places: Vec<u32> = below(value.as_slice()?, length, what)?;
            let mut used = vec![false; length];
            for &place in &places {
                if std::mem::replace(&mut used[place as usize], true) {
                    return Err(PyValueError::new_err(format!("{what} holds {place} twice")));
                }
            }
            Ok(places)
        };
        Ok(Transform {
            length,
            selected: places(&selected, "selected", patterns)?,
            position: places(&position, "position", pixels)?,
        })
    }
}
