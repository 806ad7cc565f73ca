//! Likely pixels of every row, and rows solved on given pixels.

use crate::solver::{checked_start, fidelity, run_interruptibly, Floats, PreparedPatterns, Solved};
use lightmatrix_core::active_set::{Rows, Settings, Start, Values};
use lightmatrix_core::coherent::{
    self, Candidates, Expectation, Expected, Further, Knowledge, Neighbours, Sparse, Weighted,
    Windows,
};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

type Csr<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray1<f32>>,
);

/// The parts of a sparse matrix of `rows` rows whose indices are below `size`, after checking them.
fn checked(
    indptr: &[i64],
    indices: &[i32],
    values: &[f32],
    rows: usize,
    size: usize,
) -> PyResult<()> {
    let sound = indptr.len() == rows + 1
        && indptr.first() == Some(&0)
        && indptr.last() == Some(&(indices.len() as i64))
        && indptr.windows(2).all(|w| w[0] <= w[1])
        && indices.len() == values.len()
        && indices.iter().all(|&i| i >= 0 && (i as usize) < size);
    if sound {
        Ok(())
    } else {
        Err(PyValueError::new_err("a sparse matrix that does not fit"))
    }
}

#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn likely_pixels<'py>(
    py: Python<'py>,
    indptr: PyReadonlyArray1<'py, i64>,
    indices: PyReadonlyArray1<'py, i32>,
    values: PyReadonlyArray1<'py, f32>,
    camera: [usize; 3],
    projector: [usize; 2],
    reach: [usize; 2],
    most: usize,
    range: [usize; 2],
) -> PyResult<Csr<'py>> {
    let matrix = Sparse {
        indptr: indptr.as_slice()?,
        indices: indices.as_slice()?,
        values: values.as_slice()?,
    };
    let windows = Windows {
        camera,
        projector,
        camera_reach: reach[0],
        projector_reach: reach[1],
        most,
    };
    let (rows, pixels) = (camera.iter().product(), projector.iter().product());
    checked(matrix.indptr, matrix.indices, matrix.values, rows, pixels)?;
    if range[0] > range[1] || range[1] > rows {
        return Err(PyValueError::new_err(format!("rows {range:?} of {rows}")));
    }
    let found = py.detach(|| coherent::likely(matrix, windows, range[0]..range[1]));
    let mut indptr = vec![0i64];
    let (mut indices, mut values) = (Vec::new(), Vec::new());
    for (pixels, shares) in found {
        indices.extend(pixels);
        values.extend(shares);
        indptr.push(indices.len() as i64);
    }
    Ok((
        indptr.into_pyarray(py),
        indices.into_pyarray(py),
        values.into_pyarray(py),
    ))
}

/// Expected samples and their variances; see `lightmatrix.estimators.expectations`.
#[pyfunction]
#[allow(clippy::too_many_arguments, clippy::type_complexity)]
fn expected_samples<'py>(
    py: Python<'py>,
    shown: &PreparedPatterns,
    unseen: &PreparedPatterns,
    samples: &Bound<'py, PyAny>,
    clipped: PyReadonlyArray2<'py, bool>,
    weights: Option<PyReadonlyArray2<'py, f64>>,
    matrix: (
        PyReadonlyArray1<'py, i64>,
        PyReadonlyArray1<'py, i32>,
        PyReadonlyArray1<'py, f32>,
    ),
    camera: [usize; 3],
    projector: [usize; 2],
    reach: usize,
    movement: PyReadonlyArray2<'py, f32>,
    background: PyReadonlyArray2<'py, f32>,
    first: usize,
    start: usize,
    level: f64,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let (shown, unseen) = (&shown.dictionary, &unseen.dictionary);
    let floats = Floats::of(samples)?;
    let (shape, values) = floats.view()?;
    let (count, patterns) = (shape[0], shape[1]);
    let all = patterns + unseen.patterns;
    let (rows, pixels) = (camera.iter().product(), projector.iter().product());
    let matrix = Sparse {
        indptr: matrix.0.as_slice()?,
        indices: matrix.1.as_slice()?,
        values: matrix.2.as_slice()?,
    };
    checked(matrix.indptr, matrix.indices, matrix.values, rows, pixels)?;
    // The rows that the first and the last row asked for have around them.
    let halo = (reach * camera[1] + reach) * camera[2];
    let around = start.saturating_sub(halo)..(start + count + halo).min(rows);
    let sound = patterns == shown.patterns
        && shown.pixels == pixels
        && unseen.pixels == pixels
        && start + count <= rows
        && clipped.shape() == [count, patterns]
        && movement.shape() == [count, 4]
        && background.shape()[1] == all
        && first <= around.start
        && first + background.shape()[0] >= around.end
        && level > 0.0
        && weights
            .as_ref()
            .is_none_or(|w| w.shape()[1] == patterns && [1, count].contains(&w.shape()[0]));
    if !sound {
        return Err(PyValueError::new_err(
            "the neighbours do not fit the samples",
        ));
    }
    let neighbours = Neighbours {
        matrix,
        camera,
        projector,
        reach,
        movement: movement.as_slice()?,
        background: background.as_slice()?,
        first,
    };
    let rows = Rows {
        count,
        samples: values,
        clipped: clipped.as_slice()?,
        weights: match &weights {
            None => None,
            Some(weights) => Some(Values::F64(weights.as_slice()?)),
        },
        start: None,
    };
    let Expected { values, variances } = py.detach(|| {
        coherent::expected(shown, unseen, neighbours, rows, level, start..start + count)
    });
    let shaped = |values: Vec<f32>| {
        values
            .into_pyarray(py)
            .call_method1("reshape", (count, all))
    };
    Ok((shaped(values)?, shaped(variances)?))
}

/// Solves rows on their candidates; see `lightmatrix.solvers.weighted`.
#[pyfunction]
#[pyo3(signature = (
    prepared, samples, clipped, weights, candidates, further, expected, row_background, start, regularization, fidelity_name,
    nonnegative, background, tolerance, max_passes, threads=None, progress=None
))]
#[allow(clippy::too_many_arguments, clippy::type_complexity)]
fn solve_weighted<'py>(
    py: Python<'py>,
    prepared: &PreparedPatterns,
    samples: &Bound<'py, PyAny>,
    clipped: PyReadonlyArray2<'py, bool>,
    weights: Option<PyReadonlyArray2<'py, f64>>,
    candidates: (
        PyReadonlyArray1<'py, i64>,
        PyReadonlyArray1<'py, i32>,
        PyReadonlyArray1<'py, f32>,
    ),
    further: (
        PyReadonlyArray2<'py, f32>,
        PyReadonlyArray1<'py, f32>,
        Option<PyReadonlyArray2<'py, f32>>,
    ),
    expected: Option<(
        PyRef<'py, PreparedPatterns>,
        PyReadonlyArray2<'py, f32>,
        PyReadonlyArray2<'py, f32>,
    )>,
    row_background: Option<PyReadonlyArray2<'py, f32>>,
    start: Option<(
        PyReadonlyArray1<'py, i64>,
        PyReadonlyArray1<'py, i32>,
        PyReadonlyArray1<'py, f64>,
        PyReadonlyArray1<'py, f64>,
    )>,
    regularization: f64,
    fidelity_name: &str,
    nonnegative: bool,
    background: bool,
    tolerance: f64,
    max_passes: u32,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(Solved, Bound<'py, PyAny>)> {
    let dictionary = &prepared.dictionary;
    let floats = Floats::of(samples)?;
    let (shape, values) = floats.view()?;
    let (count, patterns) = (shape[0], shape[1]);
    let candidates = Candidates {
        indptr: candidates.0.as_slice()?,
        pixels: candidates.1.as_slice()?,
        penalties: candidates.2.as_slice()?,
    };
    let pixels = dictionary.pixels;
    checked(
        candidates.indptr,
        candidates.pixels,
        candidates.penalties,
        count,
        pixels,
    )?;
    let shared = further.1.len();
    let unseen = expected.as_ref().map(|(unseen, ..)| &unseen.dictionary);
    let all = patterns + unseen.map_or(0, |unseen| unseen.patterns);
    let fits = patterns == dictionary.patterns
        && clipped.shape() == [count, patterns]
        && further.0.shape() == [shared, all]
        && further
            .2
            .as_ref()
            .is_none_or(|start| start.shape() == [count, shared])
        && weights
            .as_ref()
            .is_none_or(|w| w.shape()[1] == patterns && [1, count].contains(&w.shape()[0]));
    let fits = fits
        && row_background
            .as_ref()
            .is_none_or(|background| background.shape() == [count, all]);
    let columns = further.0.as_slice()?;
    let positive = |values: &[f32]| values.iter().all(|&v| v > 0.0 && v.is_finite());
    let sound = fits
        && columns.iter().all(|v| (0.0..=1.0).contains(v))
        && positive(candidates.penalties)
        && positive(further.1.as_slice()?)
        && regularization > 0.0
        && regularization.is_finite()
        && tolerance > 0.0;
    if !sound {
        return Err(PyValueError::new_err(
            "the weighted problem's parts do not fit",
        ));
    }
    let further = Further {
        columns,
        penalties: further.1.as_slice()?,
        start: match &further.2 {
            None => None,
            Some(start) => Some(start.as_slice()?),
        },
    };
    let start = match &start {
        None => None,
        Some((indptr, indices, values, background)) => Some(checked_start(
            Start {
                indptr: indptr.as_slice()?,
                indices: indices.as_slice()?,
                values: values.as_slice()?,
                background: background.as_slice()?,
            },
            count,
            pixels,
        )?),
    };
    let expected = match (&expected, unseen) {
        (Some((_, values, weights)), Some(unseen)) => {
            let values_and_weights = (values.as_slice()?, weights.as_slice()?);
            let sound = unseen.pixels == pixels
                && values.shape() == [count, all]
                && weights.shape() == [count, all]
                && values_and_weights.0.iter().all(|v| v.is_finite())
                && (values_and_weights.1.iter()).all(|v| v.is_finite() && *v >= 0.0);
            if !sound {
                return Err(PyValueError::new_err(
                    "the expected samples do not fit the problem",
                ));
            }
            Some(Expectation {
                unseen,
                values: values_and_weights.0,
                weights: values_and_weights.1,
            })
        }
        _ => None,
    };
    let knowledge = Knowledge {
        candidates,
        further,
        expected,
        background: match &row_background {
            None => None,
            Some(background) => Some(background.as_slice()?),
        },
    };
    let rows = Rows {
        count,
        samples: values,
        clipped: clipped.as_slice()?,
        weights: match &weights {
            None => None,
            Some(weights) => Some(Values::F64(weights.as_slice()?)),
        },
        start,
    };
    let settings = Settings {
        regularization,
        fidelity: fidelity(fidelity_name)?,
        nonnegative,
        background,
        tolerance,
        max_passes,
    };
    let solutions = run_interruptibly(py, count, threads, progress, |cancelled, finished| {
        coherent::solve(dictionary, rows, knowledge, settings, cancelled, finished)
    })?;
    let mut shares = Vec::with_capacity(count * shared);
    let mut found = Vec::with_capacity(count);
    for Weighted { row, further } in solutions {
        shares.extend(further);
        found.push(row);
    }
    let shares = shares
        .into_pyarray(py)
        .call_method1("reshape", (count, shared))?;
    Ok((Solved::new(py, found), shares))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(likely_pixels, module)?)?;
    module.add_function(wrap_pyfunction!(expected_samples, module)?)?;
    module.add_function(wrap_pyfunction!(solve_weighted, module)?)
}
