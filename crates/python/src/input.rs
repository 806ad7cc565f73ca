//! The solvers' input, checked once: settings, rows of samples, sparse rows and starting points.
//!
//! Python passes objects, whose attributes are read here. Every check has its own message, which names the
//! attribute and the expected value.

use crate::arrays::{
    attribute, boolean, booleans, check_shape, indices, long_or_short, positive, whole, Floats,
    Real, Values,
};
use lightmatrix_core::problem::{self, Fidelity, Rows, Sparse};
use numpy::{PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// Largest number of threads. More would only be slower.
pub const MOST_THREADS: usize = 1024;

const FIDELITIES: [(&str, Fidelity); 3] = [
    ("linear", Fidelity::Linear),
    ("one-sided", Fidelity::OneSided),
    ("rejection", Fidelity::Rejection),
];

/// Settings of the solver.
///
/// Parameters
/// ----------
/// regularization : float
///     lambda, in units of camera sample; > 0.
/// fidelity : {"linear", "one-sided", "rejection"}
///     How clipped samples are treated.
/// nonnegative : bool
///     Whether coefficients and the background must be >= 0.
/// background : bool
///     Whether there is a background: a coefficient of the patterns' means.
/// tolerance : float
///     Relative duality gap at which a row is solved, in (0, 1).
/// max_passes : int
///     Limit of passes over all pixels, at least 1. A row that reaches it is returned with the gap that it has.
/// threads : int or None
///     1 to 1024; None means one per core.
///
/// Raises
/// ------
/// ValueError, TypeError
///     If a value has a wrong type or is out of range; the message names the parameter.
#[pyclass(frozen, get_all, module = "lightmatrix._core")]
pub struct Settings {
    regularization: f64,
    fidelity: &'static str,
    nonnegative: bool,
    background: bool,
    tolerance: f64,
    max_passes: u32,
    pub threads: Option<usize>,
}

#[pymethods]
impl Settings {
    #[new]
    #[pyo3(signature = (
        *, regularization, fidelity, nonnegative, background, tolerance, max_passes, threads=None
    ))]
    fn new(
        regularization: &Bound<'_, PyAny>,
        fidelity: &str,
        nonnegative: &Bound<'_, PyAny>,
        background: &Bound<'_, PyAny>,
        tolerance: &Bound<'_, PyAny>,
        max_passes: &Bound<'_, PyAny>,
        threads: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let Some((fidelity, _)) = FIDELITIES.iter().find(|(name, _)| *name == fidelity) else {
            return Err(PyValueError::new_err(format!(
                "fidelity is {fidelity:?}, expected {}",
                FIDELITIES.map(|(name, _)| name).join(", ")
            )));
        };
        let gap = positive(tolerance, "tolerance")?;
        if gap >= 1.0 {
            return Err(PyValueError::new_err(format!(
                "tolerance is {gap}, expected a relative gap below 1"
            )));
        }
        let threads = threads.map(|threads| whole(threads, "threads", 1..=MOST_THREADS));
        Ok(Settings {
            regularization: positive(regularization, "regularization")?,
            fidelity,
            nonnegative: boolean(nonnegative, "nonnegative")?,
            background: boolean(background, "background")?,
            tolerance: gap,
            max_passes: whole(max_passes, "max_passes", 1..=i32::MAX as usize)? as u32,
            threads: threads.transpose()?,
        })
    }
}

impl Settings {
    pub fn view(&self) -> problem::Settings {
        let known = FIDELITIES.iter().find(|(name, _)| *name == self.fidelity);
        problem::Settings {
            regularization: self.regularization,
            fidelity: known.expect("checked when it was made").1,
            nonnegative: self.nonnegative,
            background: self.background,
            tolerance: self.tolerance,
            max_passes: self.max_passes,
        }
    }
}

/// Rows of samples, from an object with `values` (M, K), `clipped` (M, K) and `weights` (None, (K,) or
/// (M, K)).
pub struct Samples<'py> {
    values: Floats<'py>,
    clipped: PyReadonlyArrayDyn<'py, bool>,
    weights: Option<Floats<'py>>,
    pub count: usize,
}

impl<'py> Samples<'py> {
    pub fn read(object: &Bound<'py, PyAny>, patterns: usize) -> PyResult<Self> {
        let part = |name| attribute(object, name, "samples");
        let why = format!("one sample of each row under each of {patterns} patterns");
        let values = Floats::of(&part("values")?, "samples.values")?;
        check_shape(
            "samples.values",
            values.shape(),
            &[None, Some(patterns)],
            &why,
        )?;
        let count = values.shape()[0];
        let clipped = booleans(&part("clipped")?, "samples.clipped")?;
        let shape = [Some(count), Some(patterns)];
        check_shape("samples.clipped", clipped.shape(), &shape, "one a sample")?;
        let weights = part("weights")?;
        let weights = match weights.is_none() {
            true => None,
            false => Some(Self::weights(&weights, count, patterns)?),
        };
        Ok(Samples {
            values,
            clipped,
            weights,
            count,
        })
    }

    fn weights(value: &Bound<'py, PyAny>, count: usize, patterns: usize) -> PyResult<Floats<'py>> {
        let what = "samples.weights";
        let weights = Floats::of(value, what)?;
        if weights.shape() != [patterns] {
            let why = format!("one a sample, or one for each of {patterns} patterns");
            let shape = [Some(count), Some(patterns)];
            check_shape(what, weights.shape(), &shape, &why)?;
        }
        let sound = match &weights {
            Floats::Single(values) => values.as_slice()?.iter().fold(true, |a, w| a & (*w >= 0.0)),
            Floats::Double(values) => values.as_slice()?.iter().fold(true, |a, w| a & (*w >= 0.0)),
        };
        if !sound {
            return Err(PyValueError::new_err(format!(
                "{what} holds negative weights, expected 0 (which masks a sample) or more"
            )));
        }
        Ok(weights)
    }

    pub fn rows<'a>(&'a self, start: Option<problem::Start<'a>>) -> PyResult<Rows<'a>> {
        Ok(Rows {
            count: self.count,
            samples: view(&self.values)?,
            clipped: self.clipped.as_slice()?,
            weights: self.weights.as_ref().map(view).transpose()?,
            start,
        })
    }
}

fn view<'a>(floats: &'a Floats<'_>) -> PyResult<problem::Values<'a>> {
    Ok(match floats {
        Floats::Single(values) => problem::Values::F32(values.as_slice()?),
        Floats::Double(values) => problem::Values::F64(values.as_slice()?),
    })
}

/// Sparse rows over pixels, from an object with `indptr`, `indices` and `data`, such as a csr_array.
pub struct SparseRows<'py, T: Real> {
    indptr: Values<'py, i64>,
    indices: Values<'py, i32>,
    values: Values<'py, T>,
    what: &'static str,
}

impl<'py, T: Real + Into<f64>> SparseRows<'py, T> {
    /// Checks that the parts fit together and to `shape` (rows, pixels).
    pub fn read(
        object: &Bound<'py, PyAny>,
        what: &'static str,
        shape: (usize, usize),
    ) -> PyResult<Self> {
        let (count, pixels) = shape;
        // The attributes of other sparse formats have the same names but another meaning.
        if let Some(format) = object.getattr_opt("format")? {
            if !format.eq("csr")? {
                return Err(PyTypeError::new_err(format!(
                    "{what} has the sparse format {format}, expected csr"
                )));
            }
        }
        if let Some(own) = object.getattr_opt("shape")? {
            if !own.eq(shape)? {
                return Err(PyValueError::new_err(format!(
                    "{what} has shape {own}, expected ({count}, {pixels}): rows and pixels"
                )));
            }
        }
        let indptr = long_or_short(
            &attribute(object, "indptr", what)?,
            &format!("{what}.indptr"),
        )?;
        let indices = indices(
            &attribute(object, "indices", what)?,
            pixels,
            &format!("{what}.indices"),
        )?;
        let values = Values::reals(&attribute(object, "data", what)?, &format!("{what}.data"))?;
        let why = format!("where each of {count} rows begins, and where the last one ends");
        let length = count.checked_add(1);
        check_shape(
            &format!("{what}.indptr"),
            indptr.shape(),
            &[length.or(Some(count))],
            &why,
        )?;
        check_shape(
            &format!("{what}.indices"),
            indices.shape(),
            &[None],
            "pixels",
        )?;
        let entries = indices.as_slice()?.len();
        let why = "one value for each of the indices";
        check_shape(
            &format!("{what}.data"),
            values.shape(),
            &[Some(entries)],
            why,
        )?;
        check_indptr(indptr.as_slice()?, entries, what)?;
        Ok(SparseRows {
            indptr,
            indices,
            values,
            what,
        })
    }

    pub fn view(&self) -> PyResult<Sparse<'_, T>> {
        Ok(Sparse {
            indptr: self.indptr.as_slice()?,
            indices: self.indices.as_slice()?,
            values: self.values.as_slice()?,
        })
    }

    /// Rejects rows whose pixels are not in ascending order.
    pub fn check_ascending(&self) -> PyResult<()> {
        let rows = self.view()?;
        for row in 0..rows.indptr.len() - 1 {
            let (pixels, _) = rows.row(row);
            if let Some(pair) = pixels.windows(2).find(|pair| pair[0] >= pair[1]) {
                return Err(PyValueError::new_err(format!(
                    "{} has pixel {} after pixel {} in row {row}, expected ascending pixels",
                    self.what, pair[1], pair[0]
                )));
            }
        }
        Ok(())
    }

    /// Rejects rows that hold a pixel twice.
    fn check_distinct(&self) -> PyResult<()> {
        let rows = self.view()?;
        let mut sorted = Vec::new();
        for row in 0..rows.indptr.len() - 1 {
            let (pixels, _) = rows.row(row);
            if pixels.is_sorted_by(|a, b| a < b) {
                continue;
            }
            sorted.clear();
            sorted.extend_from_slice(pixels);
            sorted.sort_unstable();
            if let Some(pair) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
                return Err(PyValueError::new_err(format!(
                    "{} holds pixel {} twice in row {row}",
                    self.what, pair[0]
                )));
            }
        }
        Ok(())
    }
}

fn check_indptr(indptr: &[i64], entries: usize, what: &str) -> PyResult<()> {
    let first = indptr.first().copied().unwrap_or(0);
    if first != 0 {
        return Err(PyValueError::new_err(format!(
            "{what}.indptr begins at {first}, expected 0"
        )));
    }
    if let Some(row) = indptr.windows(2).position(|pair| pair[0] > pair[1]) {
        return Err(PyValueError::new_err(format!(
            "{what}.indptr falls from {} to {} at row {row}",
            indptr[row],
            indptr[row + 1]
        )));
    }
    let last = indptr.last().copied().unwrap_or(0);
    if last != entries as i64 {
        return Err(PyValueError::new_err(format!(
            "{what}.indptr ends at {last}, but there are {entries} indices"
        )));
    }
    Ok(())
}

/// A starting point, from an object with `coefficients` (sparse rows) and `background` (M, 1 + C): the
/// background's coefficient and those of the C cells of a weighted problem.
pub struct Start<'py> {
    rows: SparseRows<'py, f64>,
    background: Vec<f64>,
    /// (M, C)
    cells: Vec<f32>,
    pub cell_count: usize,
}

impl<'py> Start<'py> {
    /// Checks a starting point of `shape` (rows, pixels); None stays None.
    pub fn read(
        object: Option<&Bound<'py, PyAny>>,
        shape: (usize, usize),
    ) -> PyResult<Option<Self>> {
        let Some(object) = object else {
            return Ok(None);
        };
        let rows = attribute(object, "coefficients", "start")?;
        let rows = SparseRows::read(&rows, "start.coefficients", shape)?;
        rows.check_distinct()?;
        let what = "start.background";
        let background = Values::reals(&attribute(object, "background", "start")?, what)?;
        let why = "rows, and the background's column with those of the cells";
        check_shape(what, background.shape(), &[Some(shape.0), None], why)?;
        let width = background.shape()[1];
        if width == 0 {
            return Err(PyValueError::new_err(format!(
                "{what} has no column, expected that of the background at least"
            )));
        }
        let values: &[f64] = background.as_slice()?;
        Ok(Some(Start {
            rows,
            background: values.iter().step_by(width).copied().collect(),
            cells: values
                .chunks_exact(width)
                .flat_map(|row| row[1..].iter().map(|&v| v as f32))
                .collect(),
            cell_count: width - 1,
        }))
    }

    pub fn view(&self) -> PyResult<problem::Start<'_>> {
        Ok(problem::Start {
            rows: self.rows.view()?,
            background: &self.background,
        })
    }

    /// The coefficients of the cells; None if their number differs from `count`.
    pub fn cells(&self, count: usize) -> Option<&[f32]> {
        (count > 0 && self.cell_count == count).then_some(&self.cells)
    }
}
