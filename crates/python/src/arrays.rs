//! Arrays and numbers from Python, checked for dtype, shape, order and alignment.
//!
//! Aligned arrays in C order are read in place. Others (Fortran order, strides, a slice of bytes) are copied
//! first.

use numpy::{
    Element, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyReadwriteArrayDyn, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyMemoryError, PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyBool};
use std::ops::RangeInclusive;

pub fn wrong_type(what: &str, value: &Bound<'_, PyAny>, expected: &str) -> PyErr {
    let name = value.get_type().name();
    let name = name.map_or("thing".into(), |name| name.to_string());
    PyTypeError::new_err(format!("{what} is a {name}, expected {expected}"))
}

/// An attribute of an object. Messages call the object `what`.
pub fn attribute<'py>(
    object: &Bound<'py, PyAny>,
    name: &str,
    what: &str,
) -> PyResult<Bound<'py, PyAny>> {
    match object.getattr_opt(name)? {
        Some(value) => Ok(value),
        None => Err(wrong_type(what, object, &format!("an object with {name}"))),
    }
}

fn untyped<'a, 'py>(
    value: &'a Bound<'py, PyAny>,
    what: &str,
) -> PyResult<&'a Bound<'py, PyUntypedArray>> {
    value
        .cast::<PyUntypedArray>()
        .map_err(|_| wrong_type(what, value, "a NumPy array"))
}

/// A NumPy array of this dtype.
pub fn array<'py, T: Element>(
    value: &Bound<'py, PyAny>,
    what: &str,
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let dtype = untyped(value, what)?.dtype();
    let Ok(array) = value.cast::<PyArrayDyn<T>>() else {
        let expected = T::get_dtype(value.py());
        return Err(PyTypeError::new_err(format!(
            "{what} is an array of {dtype}, expected {expected}"
        )));
    };
    let aligned = (array.data() as usize).is_multiple_of(align_of::<T>());
    if array.is_c_contiguous() && aligned {
        return Ok(array.try_readonly()?);
    }
    let order = [("order", "C")].into_py_dict(value.py())?;
    let numpy = value.py().import("numpy")?;
    let copied = numpy.call_method("array", (array,), Some(&order))?;
    Ok(copied.cast::<PyArrayDyn<T>>()?.try_readonly()?)
}

/// A NumPy array of this dtype that results are written to: in C order and aligned, since a copy of it would
/// not reach the caller, and not borrowed by anyone else, as an array that is given twice is.
pub fn writable<'py, T: Element>(
    value: &Bound<'py, PyAny>,
    what: &str,
) -> PyResult<PyReadwriteArrayDyn<'py, T>> {
    let dtype = untyped(value, what)?.dtype();
    let expected = T::get_dtype(value.py());
    let refused = |why: String| PyTypeError::new_err(format!("{what} {why}"));
    let Ok(array) = value.cast::<PyArrayDyn<T>>() else {
        return Err(refused(format!(
            "is an array of {dtype}, expected {expected}"
        )));
    };
    let aligned = (array.data() as usize).is_multiple_of(align_of::<T>());
    if !array.is_c_contiguous() || !aligned {
        return Err(refused("is not in C order, or not aligned".into()));
    }
    let borrowed = array.try_readwrite();
    borrowed.map_err(|error| refused(format!("cannot be written to: {error}")))
}

/// A NumPy array of booleans. Rejects bytes other than 0 and 1, which a view of an array can contain: they
/// are undefined behaviour in Rust.
pub fn booleans<'py>(
    value: &Bound<'py, PyAny>,
    what: &str,
) -> PyResult<PyReadonlyArrayDyn<'py, bool>> {
    let booleans = array::<bool>(value, what)?;
    let bytes = booleans.call_method1("view", ("uint8",))?;
    let bytes = array::<u8>(&bytes, what)?;
    if bytes.as_slice()?.iter().fold(0, |all, byte| all | byte) > 1 {
        return Err(PyValueError::new_err(format!(
            "{what} holds bytes that are neither 0 nor 1"
        )));
    }
    Ok(booleans)
}

/// Rejects any other shape than the expected one. None means a side of any length.
pub fn check_shape(
    what: &str,
    shape: &[usize],
    expected: &[Option<usize>],
    why: &str,
) -> PyResult<()> {
    let fits = |(side, expected): (&usize, &Option<usize>)| expected.is_none_or(|e| e == *side);
    if shape.len() == expected.len() && shape.iter().zip(expected).all(fits) {
        return Ok(());
    }
    let side = |side: &Option<usize>| side.map_or("any".into(), |side| side.to_string());
    let (shape, expected) = (
        tuple(shape.iter().map(usize::to_string)),
        tuple(expected.iter().map(side)),
    );
    Err(PyValueError::new_err(format!(
        "{what} has shape {shape}, expected {expected}: {why}"
    )))
}

fn tuple(sides: impl Iterator<Item = String>) -> String {
    let sides: Vec<_> = sides.collect();
    match &sides[..] {
        [side] => format!("({side},)"),
        sides => format!("({})", sides.join(", ")),
    }
}

/// float32 or float64.
pub trait Real: Element + Copy {
    fn from_single(value: f32) -> Self;
    fn from_double(value: f64) -> Self;
    /// Whether it is a finite number in the range of float32, whose square does not overflow float64.
    fn is_moderate(self) -> bool;
}

impl Real for f32 {
    fn from_single(value: f32) -> Self {
        value
    }
    fn from_double(value: f64) -> Self {
        value as f32
    }
    fn is_moderate(self) -> bool {
        self.abs() <= f32::MAX
    }
}

impl Real for f64 {
    fn from_single(value: f32) -> Self {
        value.into()
    }
    fn from_double(value: f64) -> Self {
        value
    }
    fn is_moderate(self) -> bool {
        self.abs() <= f32::MAX.into()
    }
}

/// An array of float32 or float64.
pub enum Floats<'py> {
    Single(PyReadonlyArrayDyn<'py, f32>),
    Double(PyReadonlyArrayDyn<'py, f64>),
}

impl<'py> Floats<'py> {
    /// Accepts any values, NaN and infinity included.
    pub fn unchecked(value: &Bound<'py, PyAny>, what: &str) -> PyResult<Self> {
        let dtype = untyped(value, what)?.dtype();
        if dtype.is_equiv_to(&f32::get_dtype(value.py())) {
            Ok(Floats::Single(array(value, what)?))
        } else if dtype.is_equiv_to(&f64::get_dtype(value.py())) {
            Ok(Floats::Double(array(value, what)?))
        } else {
            Err(PyTypeError::new_err(format!(
                "{what} is an array of {dtype}, expected float32 or float64"
            )))
        }
    }

    pub fn of(value: &Bound<'py, PyAny>, what: &str) -> PyResult<Self> {
        let floats = Floats::unchecked(value, what)?;
        match &floats {
            Floats::Single(values) => check_moderate(values.as_slice()?, what)?,
            Floats::Double(values) => check_moderate(values.as_slice()?, what)?,
        }
        Ok(floats)
    }

    pub fn shape(&self) -> &[usize] {
        match self {
            Floats::Single(values) => values.shape(),
            Floats::Double(values) => values.shape(),
        }
    }
}

fn check_moderate<T: Real + Into<f64>>(values: &[T], what: &str) -> PyResult<()> {
    // Without an early exit, so that the compiler vectorises the loop.
    if values.iter().fold(true, |all, v| all & v.is_moderate()) {
        return Ok(());
    }
    let odd = values.iter().find(|v| !v.is_moderate());
    Err(PyValueError::new_err(format!(
        "{what} holds {}, expected finite numbers within the range of float32",
        odd.map_or(f64::NAN, |&v| v.into())
    )))
}

/// Values of the type that the core needs: an array in place, or converted values.
pub enum Values<'py, T: Element> {
    Array(PyReadonlyArrayDyn<'py, T>),
    Converted(Vec<T>, Vec<usize>),
}

impl<'py, T: Element + Copy> Values<'py, T> {
    pub fn as_slice(&self) -> PyResult<&[T]> {
        match self {
            Values::Array(array) => Ok(array.as_slice()?),
            Values::Converted(values, _) => Ok(values),
        }
    }

    pub fn shape(&self) -> &[usize] {
        match self {
            Values::Array(array) => array.shape(),
            Values::Converted(_, shape) => shape,
        }
    }

    fn converted<S: Element + Copy>(
        array: &PyReadonlyArrayDyn<'py, S>,
        convert: impl Fn(S) -> T,
        what: &str,
    ) -> PyResult<Self> {
        check_memory::<T>(&[array.len()], what)?;
        let values = array.as_slice()?.iter().map(|&v| convert(v)).collect();
        Ok(Values::Converted(values, array.shape().to_vec()))
    }
}

impl<'py, T: Real + Into<f64>> Values<'py, T> {
    /// From float32 or float64.
    pub fn reals(value: &Bound<'py, PyAny>, what: &str) -> PyResult<Self> {
        let values = match Floats::unchecked(value, what)? {
            Floats::Single(values) => match value.cast::<PyArrayDyn<T>>() {
                Ok(_) => Values::Array(array(value, what)?),
                Err(_) => Values::converted(&values, T::from_single, what)?,
            },
            Floats::Double(values) => match value.cast::<PyArrayDyn<T>>() {
                Ok(_) => Values::Array(array(value, what)?),
                Err(_) => Values::converted(&values, T::from_double, what)?,
            },
        };
        check_moderate(values.as_slice()?, what)?;
        Ok(values)
    }
}

/// Indices from 0 to below `size`, of int32 or int64.
pub fn indices<'py>(
    value: &Bound<'py, PyAny>,
    size: usize,
    what: &str,
) -> PyResult<Values<'py, i32>> {
    let outside = |index: i64| {
        PyValueError::new_err(format!("{what} holds {index}, expected 0 to below {size}"))
    };
    if untyped(value, what)?
        .dtype()
        .is_equiv_to(&i32::get_dtype(value.py()))
    {
        let array = array::<i32>(value, what)?;
        // Without its sign, a negative index is a large one.
        let within = |&&i: &&i32| (i as u32 as usize) < size;
        let values = array.as_slice()?;
        if !values.iter().fold(true, |all, i| all & within(&i)) {
            let odd = values.iter().find(|i| !within(i));
            return Err(outside(odd.map_or(-1, |&i| i.into())));
        }
        return Ok(Values::Array(array));
    }
    let array = long_or_short(value, what)?;
    let values = array.as_slice()?;
    let largest = size.min(i32::MAX as usize) as i64;
    if let Some(&odd) = values.iter().find(|i| !(0..largest).contains(*i)) {
        return Err(outside(odd));
    }
    match array {
        Values::Array(array) => Values::converted(&array, |i| i as i32, what),
        Values::Converted(..) => unreachable!("int32 is returned above"),
    }
}

/// Whole numbers of int32 or int64, as int64.
pub fn long_or_short<'py>(value: &Bound<'py, PyAny>, what: &str) -> PyResult<Values<'py, i64>> {
    let dtype = untyped(value, what)?.dtype();
    if dtype.is_equiv_to(&i64::get_dtype(value.py())) {
        Ok(Values::Array(array(value, what)?))
    } else if dtype.is_equiv_to(&i32::get_dtype(value.py())) {
        Values::converted(&array::<i32>(value, what)?, i64::from, what)
    } else {
        Err(PyTypeError::new_err(format!(
            "{what} is an array of {dtype}, expected int32 or int64"
        )))
    }
}

/// A whole number within a range.
pub fn whole(
    value: &Bound<'_, PyAny>,
    what: &str,
    range: RangeInclusive<usize>,
) -> PyResult<usize> {
    let outside = || {
        let text = value.repr().map_or("too large".into(), |r| r.to_string());
        PyValueError::new_err(format!(
            "{what} is {text}, expected {} to {}",
            range.start(),
            range.end()
        ))
    };
    match value.extract::<i64>() {
        Ok(number) => usize::try_from(number)
            .ok()
            .filter(|number| range.contains(number))
            .ok_or_else(outside),
        Err(error) if error.is_instance_of::<PyOverflowError>(value.py()) => Err(outside()),
        Err(_) => Err(wrong_type(what, value, "a whole number")),
    }
}

/// A finite number above 0.
pub fn positive(value: &Bound<'_, PyAny>, what: &str) -> PyResult<f64> {
    match value.extract::<f64>() {
        Ok(number) if number > 0.0 && number.is_finite() => Ok(number),
        Ok(number) => Err(PyValueError::new_err(format!(
            "{what} is {number}, expected a positive number"
        ))),
        Err(error) if error.is_instance_of::<PyOverflowError>(value.py()) => Err(
            PyValueError::new_err(format!("{what} is too large, expected a positive number")),
        ),
        Err(_) => Err(wrong_type(what, value, "a number")),
    }
}

pub fn boolean(value: &Bound<'_, PyAny>, what: &str) -> PyResult<bool> {
    match value.cast::<PyBool>() {
        Ok(value) => Ok(value.is_true()),
        Err(_) => value
            .extract()
            .map_err(|_| wrong_type(what, value, "True or False")),
    }
}

/// The sides of a grid, each at least 1, and its number of places.
pub fn grid<const N: usize>(value: &Bound<'_, PyAny>, what: &str) -> PyResult<([usize; N], usize)> {
    let Ok(sides) = value.extract::<Vec<Bound<'_, PyAny>>>() else {
        return Err(wrong_type(what, value, &format!("{N} whole numbers")));
    };
    if sides.len() != N {
        return Err(PyValueError::new_err(format!(
            "{what} has {} numbers, expected {N}",
            sides.len()
        )));
    }
    let mut grid = [0; N];
    let mut places = 1usize;
    for (side, value) in grid.iter_mut().zip(&sides) {
        *side = whole(value, what, 1..=i32::MAX as usize)?;
        places = places.checked_mul(*side).ok_or_else(|| {
            PyValueError::new_err(format!("{what} has more places than can be counted"))
        })?;
    }
    Ok((grid, places))
}

/// Rejects arrays for which there is no memory, as the core would abort; returns the product of `sides`.
pub fn check_memory<T>(sides: &[usize], what: &str) -> PyResult<usize> {
    let count = sides
        .iter()
        .try_fold(1usize, |n, side| n.checked_mul(*side));
    let mut tried = Vec::<T>::new();
    let fits = count.is_some_and(|count| tried.try_reserve_exact(count).is_ok());
    // The compiler might remove an unused allocation.
    std::hint::black_box(&mut tried);
    count.filter(|_| fits).ok_or_else(|| {
        let sides = sides.iter().map(usize::to_string).collect::<Vec<_>>();
        PyMemoryError::new_err(format!(
            "not enough memory for {what}: {} numbers of {} bytes",
            sides.join(" x "),
            size_of::<T>()
        ))
    })
}
