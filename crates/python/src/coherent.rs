//! Likely pixels of every row, and rows solved on given pixels.

use crate::arrays::{attribute, check_shape, grid, long_or_short, positive, room, whole, Values};
use crate::input::{Samples, Settings, SparseRows, Start};
use crate::products::below;
use crate::solved::Solved;
use crate::solver::PreparedPatterns;
use crate::threads::{count_of, on_all_cores, run_interruptibly};
use lightmatrix_core::coherent::{
    self, Expectation, Expected, Further, Knowledge, Neighbours, Weighted, Windows,
};
use lightmatrix_core::vector::padded;
use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::ops::Range;

type Csr<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray1<f32>>,
);

const NUMBERS: usize = i32::MAX as usize;

/// A range (start, stop) of rows.
fn range(value: (Bound<'_, PyAny>, Bound<'_, PyAny>), rows: usize) -> PyResult<Range<usize>> {
    let stop = whole(&value.1, "the end of the range", 0..=rows)?;
    let start = whole(&value.0, "the start of the range", 0..=stop)?;
    Ok(start..stop)
}

/// The rows of a range, or those of them that an ascending index from its start on says.
fn asked(index: Option<&Bound<'_, PyAny>>, range: Range<usize>) -> PyResult<Vec<usize>> {
    let Some(index) = index else {
        return Ok(range.collect());
    };
    let index = long_or_short(index, "index")?;
    check_shape("index", index.shape(), &[None], "rows of the range")?;
    let index: Vec<usize> = below(index.as_slice()?, range.len(), "index")?;
    if !index.is_sorted_by(|a, b| a < b) {
        return Err(PyValueError::new_err("index does not ascend"));
    }
    Ok(index.into_iter().map(|row| range.start + row).collect())
}

/// How footprints move: four numbers for each row.
fn movement<'py>(value: &Bound<'py, PyAny>, what: &str, rows: usize) -> PyResult<Values<'py, f32>> {
    let movement = Values::<f32>::reals(value, what)?;
    let why = "rows and columns, by rows and columns, for each row";
    check_shape(what, movement.shape(), &[Some(rows), Some(4)], why)?;
    Ok(movement)
}

/// The atoms that each row of a range (start, stop) probably holds, and their penalties, as the parts
/// of a CSR matrix.
#[pyfunction]
#[pyo3(signature = (
    rows, camera, projector, movement, spots, within, wider, singles, reach, most, doubts, range,
    index=None
))]
#[allow(clippy::too_many_arguments)]
fn likely_pixels<'py>(
    py: Python<'py>,
    rows: &Bound<'py, PyAny>,
    camera: &Bound<'py, PyAny>,
    projector: &Bound<'py, PyAny>,
    movement: &Bound<'py, PyAny>,
    spots: Vec<Bound<'py, PyAny>>,
    within: &Bound<'py, PyAny>,
    wider: &Bound<'py, PyAny>,
    singles: &Bound<'py, PyAny>,
    reach: (Bound<'py, PyAny>, Bound<'py, PyAny>),
    most: &Bound<'py, PyAny>,
    doubts: &Bound<'py, PyAny>,
    range: (Bound<'py, PyAny>, Bound<'py, PyAny>),
    index: Option<&Bound<'py, PyAny>>,
) -> PyResult<Csr<'py>> {
    let (camera, count) = grid(camera, "camera")?;
    let (projector, pixels) = grid(projector, "projector")?;
    let movement = self::movement(movement, "movement", count)?;
    let spots = spots
        .iter()
        .map(|spot| Values::<f32>::reals(spot, "a spot"))
        .collect::<PyResult<Vec<_>>>()?;
    let spots = spots
        .iter()
        .map(Values::as_slice)
        .collect::<PyResult<Vec<_>>>()?;
    let fit = |spot: &&[f32]| !spot.is_empty() && spot.iter().all(|v| (0.0..=1.0).contains(v));
    if spots.len() != projector[0] || !spots.iter().all(fit) {
        return Err(PyValueError::new_err(format!(
            "{} spots for {} planes, expected one side of each in [0, 1]",
            spots.len(),
            projector[0]
        )));
    }
    let wider = Values::<f32>::reals(wider, "wider")?;
    let singles = Values::<f32>::reals(singles, "singles")?;
    let (wider, singles) = (wider.as_slice()?, singles.as_slice()?);
    let believed = singles.iter().all(|share| (0.0..=1.0).contains(share));
    if wider.len() != projector[0] || wider.iter().any(|&share| share < 0.0) {
        return Err(PyValueError::new_err(format!(
            "{} shares of the next wider spots for {} planes, expected one of each, from 0 on",
            wider.len(),
            projector[0]
        )));
    }
    if singles.len() != count || !believed {
        return Err(PyValueError::new_err(format!(
            "{} shares of single pixels for {count} rows, expected one of each in [0, 1]",
            singles.len()
        )));
    }
    let windows = Windows {
        wider,
        singles,
        spots: &spots,
        within: positive(within, "within")? as f32,
        camera,
        projector,
        movement: movement.as_slice()?,
        camera_reach: whole(&reach.0, "the reach in the camera", 0..=NUMBERS)?,
        projector_reach: whole(&reach.1, "the reach in the projector", 0..=NUMBERS)?,
        most: whole(most, "most", 1..=NUMBERS)?,
    };
    let asked = self::asked(index, self::range(range, count)?)?;
    let doubts = Values::<f64>::reals(doubts, "doubts")?;
    let why = "one for each row asked for";
    check_shape("doubts", doubts.shape(), &[Some(asked.len())], why)?;
    let doubts = doubts.as_slice()?;
    if let Some(odd) = doubts.iter().find(|&&doubt| doubt <= 0.0) {
        return Err(PyValueError::new_err(format!(
            "doubts holds {odd}, expected numbers above 0"
        )));
    }
    let rows = SparseRows::<f32>::read(rows, "rows", (count, pixels))?;
    let matrix = rows.view()?;
    room::<f32>(&[count_of(None), pixels], "sums over the pixels")?;
    let most = windows.most.min(pixels);
    room::<(i32, f32)>(&[asked.len(), most], "the likely pixels")?;
    let found = on_all_cores(py, || {
        coherent::penalties(&coherent::likely(matrix, windows, &asked), doubts)
    })?;
    Ok((
        found.indptr.into_pyarray(py),
        found.atoms.into_pyarray(py),
        found.values.into_pyarray(py),
    ))
}

/// Refuses patterns of other pixels than there are.
fn check_pixels(prepared: &PreparedPatterns, pixels: usize, what: &str) -> PyResult<()> {
    match prepared.dictionary.pixels {
        own if own == pixels => Ok(()),
        own => Err(PyValueError::new_err(format!(
            "{what} has patterns of {own} pixels, expected {pixels}"
        ))),
    }
}

/// Expected samples and their variances, each (m, K + E); see
/// `lightmatrix.estimators.coherent.expectations`.
#[pyfunction]
#[pyo3(signature = (
    shown, unseen, samples, neighbourhood, background, *, reach, start, level, index=None
))]
// The last three are numbers with names; a group of them would have none.
#[allow(clippy::too_many_arguments)]
fn expected_samples<'py>(
    py: Python<'py>,
    shown: &PreparedPatterns,
    unseen: &PreparedPatterns,
    samples: &Bound<'py, PyAny>,
    neighbourhood: &Bound<'py, PyAny>,
    background: &Bound<'py, PyAny>,
    reach: &Bound<'py, PyAny>,
    start: &Bound<'py, PyAny>,
    level: &Bound<'py, PyAny>,
    index: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let part = |name| attribute(neighbourhood, name, "neighbourhood");
    let (camera, total) = grid(&part("camera")?, "neighbourhood.camera")?;
    let (projector, pixels) = grid(&part("projector")?, "neighbourhood.projector")?;
    check_pixels(shown, pixels, "shown")?;
    check_pixels(unseen, pixels, "unseen")?;
    let rows = attribute(&part("rows")?, "coefficients", "neighbourhood.rows")?;
    let rows = SparseRows::read(&rows, "neighbourhood.rows", (total, pixels))?;
    let samples = Samples::read(samples, shown.dictionary.patterns)?;
    let count = samples.count;
    if count > total {
        return Err(PyValueError::new_err(format!(
            "samples of {count} rows for a camera of {total}"
        )));
    }
    let start = whole(start, "start", 0..=total - count)?;
    let asked = match index {
        None => (start..start + count).collect(),
        Some(_) => self::asked(index, start..total)?,
    };
    if asked.len() != count {
        return Err(PyValueError::new_err(format!(
            "an index of {} rows for samples of {count}",
            asked.len()
        )));
    }
    let stop = asked.last().map_or(start, |last| last + 1);
    let level = positive(level, "level")?;
    let farthest = camera[0].max(camera[1]);
    let reach = whole(reach, "reach", 0..=NUMBERS)?.min(farthest);

    let movement = self::movement(&part("movement")?, "neighbourhood.movement", total)?;
    let movement = movement.as_slice()?;

    // The rows that the first and the last row asked for have around them.
    let halo = reach
        .saturating_mul(camera[1] + 1)
        .saturating_mul(camera[2]);
    let first = start.saturating_sub(halo);
    let around = stop.saturating_add(halo).min(total) - first;
    let all = shown.dictionary.patterns + unseen.dictionary.patterns;
    let background = Values::<f32>::reals(background, "background")?;
    let why = "of the rows around, under the patterns shown and the unseen ones";
    let shape = [Some(around), Some(all)];
    check_shape("background", background.shape(), &shape, why)?;

    let neighbours = Neighbours {
        matrix: rows.view()?,
        camera,
        projector,
        reach,
        movement,
        background: background.as_slice()?,
        first,
    };
    let rows = samples.rows(None)?;
    room::<[f32; 2]>(&[count, all], "the expected samples")?;
    let (shown, unseen) = (&shown.dictionary, &unseen.dictionary);
    let Expected { values, variances } = on_all_cores(py, || {
        coherent::expected(shown, unseen, neighbours, rows, level, &asked)
    })?;
    let shaped = |values: Vec<f32>| {
        values
            .into_pyarray(py)
            .call_method1("reshape", (count, all))
    };
    Ok((shaped(values)?, shaped(variances)?))
}

/// Columns that all rows share: an object with `means` (C, K + E) in [0, 1] and `penalties` (C,).
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

/// Further samples of little weight: the patterns that were not shown, prepared, and an object with
/// `values` and `weights`, each (M, K + E).
struct FurtherSamples<'py> {
    unseen: PyRef<'py, PreparedPatterns>,
    values: Values<'py, f32>,
    weights: Values<'py, f32>,
}

impl<'py> FurtherSamples<'py> {
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
        Ok(FurtherSamples {
            unseen,
            values,
            weights,
        })
    }

    fn view(&self) -> PyResult<Expectation<'_>> {
        Ok(Expectation {
            unseen: &self.unseen.dictionary,
            values: self.values.as_slice()?,
            weights: self.weights.as_slice()?,
        })
    }
}

/// Solves rows on their candidates; see `lightmatrix.solvers.weighted`.
#[pyfunction]
#[pyo3(signature = (
    prepared, samples, settings, candidates, *,
    cells=None, expected=None, background=None, start=None, progress=None
))]
// Four that are needed; what may be left out has names.
#[allow(clippy::too_many_arguments)]
fn solve_weighted<'py>(
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
    let expected = expected.map(|parts| FurtherSamples::read(parts, count, prepared));
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
        further: Further {
            columns: cells.as_ref().map_or(Ok(&[][..]), |b| b.means.as_slice())?,
            penalties: cells
                .as_ref()
                .map_or(Ok(&[][..]), |b| b.penalties.as_slice())?,
            start: starting_cells,
        },
        expected: expected.as_ref().map(FurtherSamples::view).transpose()?,
        background: background.as_ref().map(Values::as_slice).transpose()?,
    };
    let rows = samples.rows(start)?;
    let threads = settings.threads;
    prepared.check_room(count, threads)?;
    let most = candidates.indptr.windows(2).map(|w| w[1] - w[0]).max();
    let columns = most.unwrap_or(0) as usize + shared;
    let sides = [count_of(threads), columns, padded(all)];
    room::<f32>(&sides, "the columns of the candidates")?;
    room::<f64>(&[count, shared], "the cells' coefficients")?;
    let settings = settings.view();
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
    Ok((Solved::new(py, found)?, shares))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(likely_pixels, module)?)?;
    module.add_function(wrap_pyfunction!(expected_samples, module)?)?;
    module.add_function(wrap_pyfunction!(solve_weighted, module)?)
}
