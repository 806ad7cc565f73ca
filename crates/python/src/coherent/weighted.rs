//! Solves rows on their candidates.

use super::checks::check_pixels;
use crate::arrays::{attribute, check_memory, check_shape, Values};
use crate::input::{Samples, Settings, SparseRows, Start};
use crate::solved::Solved;
use crate::solver::PreparedPatterns;
use crate::threads::{run_interruptibly, thread_count};
use lightmatrix_core::coherent::{self, Knowledge, PseudoSamples, SharedColumns, Weighted};
use lightmatrix_core::vector::padded;
use numpy::IntoPyArray;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The cells of the background, whose columns all rows share, from an object with `means` (C, K + E) in [0, 1] and `penalties` (C,).
struct Cells<'py> {
    means: Values<'py, f32>,
    penalties: Values<'py, f32>,
    count: usize,
}

impl<'py> Cells<'py> {
    fn read(object: &Bound<'py, PyAny>, all: usize) -> PyResult<Self> {
        let part = |name| attribute(object, name, "cells");
        let means = Values::reals(&part("means")?, "cells.means")?;
        let why = format!("cells, and {all} patterns shown and unseen");
        check_shape("cells.means", means.shape(), &[None, Some(all)], &why)?;
        let count = means.shape()[0];
        if !means.as_slice()?.iter().all(|v| (0.0..=1.0).contains(v)) {
            return Err(PyValueError::new_err(
                "cells.means holds a value outside [0, 1]",
            ));
        }
        let penalties = Values::reals(&part("penalties")?, "cells.penalties")?;
        let shape = [Some(count)];
        check_shape("cells.penalties", penalties.shape(), &shape, "one a cell")?;
        check_penalties(penalties.as_slice()?, "cells.penalties")?;
        Ok(Cells {
            means,
            penalties,
            count,
        })
    }
}

fn check_penalties(penalties: &[f32], what: &str) -> PyResult<()> {
    match penalties.iter().find(|&&p| p <= 0.0) {
        None => Ok(()),
        Some(odd) => Err(PyValueError::new_err(format!(
            "{what} holds {odd}, expected penalties above 0"
        ))),
    }
}

/// Pseudo-samples: the prepared unseen patterns, and an object with `values` and `weights`, each
/// (M, K + E).
struct CheckedPseudoSamples<'py> {
    unseen: PyRef<'py, PreparedPatterns>,
    values: Values<'py, f32>,
    weights: Values<'py, f32>,
}

impl<'py> CheckedPseudoSamples<'py> {
    fn read(
        (unseen, object): (PyRef<'py, PreparedPatterns>, Bound<'py, PyAny>),
        count: usize,
        shown: &PreparedPatterns,
    ) -> PyResult<Self> {
        check_pixels(&unseen, shown.dictionary.pixels, "expected")?;
        let all = shown.dictionary.patterns + unseen.dictionary.patterns;
        let part = |name, what| {
            let values = Values::<f32>::reals(&attribute(&object, name, "expected")?, what)?;
            let why = "rows, and patterns shown and unseen";
            check_shape(what, values.shape(), &[Some(count), Some(all)], why)?;
            PyResult::Ok(values)
        };
        let values = part("values", "expected.values")?;
        let weights = part("weights", "expected.weights")?;
        if let Some(odd) = weights.as_slice()?.iter().find(|&&w| w < 0.0) {
            return Err(PyValueError::new_err(format!(
                "expected.weights holds {odd}, expected 0 or more"
            )));
        }
        Ok(CheckedPseudoSamples {
            unseen,
            values,
            weights,
        })
    }

    fn view(&self) -> PyResult<PseudoSamples<'_>> {
        Ok(PseudoSamples {
            unseen: &self.unseen.dictionary,
            values: self.values.as_slice()?,
            weights: self.weights.as_slice()?,
        })
    }
}

/// Solves rows on their candidates; see `lightmatrix.solvers.weighted`. Returns the rows and the cells'
/// coefficients.
#[pyfunction]
#[pyo3(signature = (
    prepared, samples, settings, candidates, *,
    cells=None, expected=None, background=None, start=None, progress=None
))]
// Four arguments are required; the others are optional and have names.
#[allow(clippy::too_many_arguments)]
pub(super) fn solve_weighted<'py>(
    py: Python<'py>,
    prepared: &PreparedPatterns,
    samples: &Bound<'py, PyAny>,
    settings: &Settings,
    candidates: &Bound<'py, PyAny>,
    cells: Option<&Bound<'py, PyAny>>,
    expected: Option<(PyRef<'py, PreparedPatterns>, Bound<'py, PyAny>)>,
    background: Option<&Bound<'py, PyAny>>,
    start: Option<&Bound<'py, PyAny>>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Solved, Bound<'py, PyAny>)> {
    let dictionary = &*prepared.dictionary;
    let samples = Samples::read(samples, dictionary.patterns)?;
    let count = samples.count;
    let shape = (count, dictionary.pixels);
    let candidates = SparseRows::<f32>::read(candidates, "candidates", shape)?;
    candidates.check_ascending()?;
    let candidates = candidates.view()?;
    check_penalties(candidates.values, "candidates.data")?;
    let expected = expected.map(|parts| CheckedPseudoSamples::read(parts, count, prepared));
    let expected = expected.transpose()?;
    let unseen = expected.as_ref().map(|e| e.unseen.dictionary.patterns);
    let all = dictionary.patterns + unseen.unwrap_or(0);
    let cells = cells.map(|cells| Cells::read(cells, all)).transpose()?;
    let shared = cells.as_ref().map_or(0, |cells| cells.count);
    let start = Start::read(start, shape)?;
    let starting_cells = start.as_ref().and_then(|start| start.cells(shared));
    let start = start.as_ref().map(Start::view).transpose()?;
    let background = match background {
        None => None,
        Some(background) => {
            let background = Values::<f32>::reals(background, "background")?;
            let why = "rows, and patterns shown and unseen";
            let shape = [Some(count), Some(all)];
            check_shape("background", background.shape(), &shape, why)?;
            Some(background)
        }
    };
    let knowledge = Knowledge {
        candidates,
        shared_columns: SharedColumns {
            columns: cells
                .as_ref()
                .map_or(Ok(&[][..]), |cells| cells.means.as_slice())?,
            penalties: cells
                .as_ref()
                .map_or(Ok(&[][..]), |cells| cells.penalties.as_slice())?,
            start: starting_cells,
        },
        pseudo_samples: expected
            .as_ref()
            .map(CheckedPseudoSamples::view)
            .transpose()?,
        background: background.as_ref().map(Values::as_slice).transpose()?,
    };
    let rows = samples.rows(start)?;
    let threads = settings.threads;
    prepared.check_solver_memory(count, threads)?;
    let most = candidates.indptr.windows(2).map(|w| w[1] - w[0]).max();
    let columns = most.unwrap_or(0) as usize + shared;
    let sides = [thread_count(threads), columns, padded(all)];
    check_memory::<f32>(&sides, "the columns of the candidates")?;
    check_memory::<f64>(&[count, shared], "the cells' coefficients")?;
    let settings = settings.view();
    let solutions = run_interruptibly(py, count, threads, progress, |cancelled, finished| {
        coherent::solve(dictionary, rows, knowledge, settings, cancelled, finished)
    })?;
    let mut cell_values = Vec::with_capacity(count * shared);
    let mut solved = Vec::with_capacity(count);
    for Weighted { row, shared } in solutions {
        cell_values.extend(shared);
        solved.push(row);
    }
    let cell_values = cell_values
        .into_pyarray(py)
        .call_method1("reshape", (count, shared))?;
    Ok((Solved::new(py, solved)?, cell_values))
}
