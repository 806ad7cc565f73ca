//! The active-set solver and its correlation pass.

use crate::products::checked_bits;
use lightmatrix_core::active_set::{self, Dictionary, Fidelity, Rows, Settings, Start, Values};
use lightmatrix_core::columns::{BitColumns, Columns, DenseColumns};
use lightmatrix_core::correlate::{Correlator, Scores, Scratch, BATCH};
use lightmatrix_core::simd::Level;
use lightmatrix_core::vector::padded;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc;
use std::time::Duration;

/// How long a signal such as Ctrl-C may wait, and how often progress is reported.
const PATIENCE: Duration = Duration::from_millis(50);

/// Patterns prepared for the solver: packed columns and the tables of the correlation pass.
#[pyclass(frozen, module = "lightmatrix._core")]
pub struct PreparedPatterns {
    pub dictionary: Dictionary,
}

fn level(name: Option<&str>) -> PyResult<Level> {
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

pub fn fidelity(name: &str) -> PyResult<Fidelity> {
    match name {
        "linear" => Ok(Fidelity::Linear),
        "one-sided" => Ok(Fidelity::OneSided),
        "rejection" => Ok(Fidelity::Rejection),
        other => Err(PyValueError::new_err(format!("no fidelity {other:?}"))),
    }
}

/// A two-dimensional array of float32 or float64.
pub enum Floats<'py> {
    Single(PyReadonlyArray2<'py, f32>),
    Double(PyReadonlyArray2<'py, f64>),
}

impl<'py> Floats<'py> {
    pub fn of(array: &Bound<'py, PyAny>) -> PyResult<Self> {
        match array.extract() {
            Ok(single) => Ok(Floats::Single(single)),
            Err(_) => Ok(Floats::Double(array.extract()?)),
        }
    }

    pub fn view(&self) -> PyResult<(&[usize], Values<'_>)> {
        Ok(match self {
            Floats::Single(values) => (values.shape(), Values::F32(values.as_slice()?)),
            Floats::Double(values) => (values.shape(), Values::F64(values.as_slice()?)),
        })
    }
}

fn padded_means(means: &PyReadonlyArray1<'_, f64>, patterns: usize) -> PyResult<Vec<f64>> {
    let mut values = means.as_slice()?.to_vec();
    if values.len() != patterns {
        return Err(PyValueError::new_err(format!(
            "{} means for {patterns} patterns",
            values.len()
        )));
    }
    values.resize(padded(patterns), 0.0);
    Ok(values)
}

fn index(values: &PyReadonlyArray1<'_, i64>, size: usize, what: &str) -> PyResult<Vec<u32>> {
    values
        .as_slice()?
        .iter()
        .map(|&v| {
            u32::try_from(v)
                .ok()
                .filter(|&v| (v as usize) < size)
                .ok_or_else(|| PyValueError::new_err(format!("{what} {v} of {size}")))
        })
        .collect()
}

#[pymethods]
impl PreparedPatterns {
    /// 0/1 patterns as packed bits; with `transform` (length, selected, position) also Hadamard.
    #[staticmethod]
    #[pyo3(signature = (packed, pixels, means, transform=None, instructions=None))]
    fn from_bits(
        py: Python<'_>,
        packed: PyReadonlyArray2<'_, u8>,
        pixels: usize,
        means: PyReadonlyArray1<'_, f64>,
        transform: Option<(usize, PyReadonlyArray1<'_, i64>, PyReadonlyArray1<'_, i64>)>,
        instructions: Option<&str>,
    ) -> PyResult<Self> {
        let bits = checked_bits(&packed, pixels)?;
        let level = level(instructions)?;
        let means = padded_means(&means, bits.patterns())?;
        let transform = match transform {
            None => None,
            Some((length, selected, position)) => {
                let selected = index(&selected, length, "Hadamard pattern")?;
                let position = index(&position, length, "place of a pixel")?;
                if !length.is_power_of_two()
                    || selected.len() != bits.patterns()
                    || position.len() != pixels
                {
                    return Err(PyValueError::new_err(format!(
                        "a transform of length {length} with {} patterns and {} pixels for {} \
                         patterns of {pixels} pixels",
                        selected.len(),
                        position.len(),
                        bits.patterns()
                    )));
                }
                Some((length, selected, position))
            }
        };
        let dictionary = py.detach(|| Dictionary {
            level,
            columns: Columns::Bits(BitColumns::new(bits)),
            correlator: match transform {
                None => Correlator::lookup(level, bits),
                Some((length, selected, position)) => {
                    Correlator::transform(level, length, &selected, &position)
                }
            },
            means,
            patterns: bits.patterns(),
            pixels,
        });
        Ok(PreparedPatterns { dictionary })
    }

    /// Patterns of any values in [0, 1], (K, N) float32.
    #[staticmethod]
    #[pyo3(signature = (matrix, means, instructions=None))]
    fn from_dense(
        py: Python<'_>,
        matrix: PyReadonlyArray2<'_, f32>,
        means: PyReadonlyArray1<'_, f64>,
        instructions: Option<&str>,
    ) -> PyResult<Self> {
        let (patterns, pixels) = (matrix.shape()[0], matrix.shape()[1]);
        let level = level(instructions)?;
        let means = padded_means(&means, patterns)?;
        let values = matrix.as_slice()?;
        if !values.iter().all(|v| (0.0..=1.0).contains(v)) {
            return Err(PyValueError::new_err("a pattern value is outside [0, 1]"));
        }
        let dictionary = py.detach(|| Dictionary {
            level,
            columns: Columns::Dense(DenseColumns::new(values, patterns, pixels)),
            correlator: Correlator::dense(level, patterns, pixels),
            means,
            patterns,
            pixels,
        });
        Ok(PreparedPatterns { dictionary })
    }

    #[getter]
    fn instructions(&self) -> &'static str {
        self.dictionary.level.name()
    }

    /// One correlation pass: for each row of `e` a lower and an upper bound of a_j . e, as
    /// (scores, unit, offset, up, down).
    fn scores<'py>(
        &self,
        py: Python<'py>,
        e: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyArray1<f64>>)> {
        let dictionary = &self.dictionary;
        let rows = self.checked_rows(&e)?;
        let (values, bounds) = py.detach(|| {
            let n = dictionary.pixels;
            let mut values = vec![0i16; rows.len() * n];
            let mut bounds = Vec::with_capacity(4 * rows.len());
            self.each_batch(&rows, |first, scores| {
                for (i, scores) in scores.iter().enumerate() {
                    let row = &mut values[(first + i) * n..][..n];
                    for (place, score) in scores.values.iter().enumerate() {
                        if let Some(pixel) = dictionary.correlator.pixel(place) {
                            row[pixel as usize] = *score;
                        }
                    }
                    bounds.extend([scores.unit, scores.offset, scores.up, scores.down]);
                }
            });
            (values, bounds)
        });
        let shape = (rows.len(), dictionary.pixels);
        let values = values.into_pyarray(py).call_method1("reshape", shape)?;
        Ok((values, bounds.into_pyarray(py)))
    }

    /// Runs the pass over all rows of `e` on one thread and throws the scores away: for timing.
    fn pass_only(&self, py: Python<'_>, e: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let rows = self.checked_rows(&e)?;
        py.detach(|| self.each_batch(&rows, |_, _| {}));
        Ok(())
    }

    /// Solves rows; see `lightmatrix.solvers.active_set`.
    #[pyo3(signature = (
        samples, clipped, weights, start, regularization, fidelity, nonnegative, background,
        tolerance, max_passes, threads=None, progress=None
    ))]
    #[allow(clippy::too_many_arguments, clippy::type_complexity)]
    fn solve<'py>(
        &self,
        py: Python<'py>,
        samples: &Bound<'py, PyAny>,
        clipped: PyReadonlyArray2<'py, bool>,
        weights: Option<PyReadonlyArray2<'py, f64>>,
        start: Option<(
            PyReadonlyArray1<'py, i64>,
            PyReadonlyArray1<'py, i32>,
            PyReadonlyArray1<'py, f64>,
            PyReadonlyArray1<'py, f64>,
        )>,
        regularization: f64,
        fidelity: &str,
        nonnegative: bool,
        background: bool,
        tolerance: f64,
        max_passes: u32,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Solved> {
        let settings = Settings {
            regularization,
            fidelity: self::fidelity(fidelity)?,
            nonnegative,
            background,
            tolerance,
            max_passes,
        };
        if !(regularization > 0.0 && regularization.is_finite() && tolerance > 0.0) {
            return Err(PyValueError::new_err(
                "regularization and tolerance must be positive",
            ));
        }
        let floats = Floats::of(samples)?;
        let (shape, values) = floats.view()?;
        let (count, patterns) = (shape[0], shape[1]);
        if patterns != self.dictionary.patterns || clipped.shape() != shape {
            return Err(PyValueError::new_err(format!(
                "samples {shape:?} and clipped {:?} for {} patterns",
                clipped.shape(),
                self.dictionary.patterns
            )));
        }
        if let Some(weights) = &weights {
            if weights.shape()[1] != patterns || ![1, count].contains(&weights.shape()[0]) {
                return Err(PyValueError::new_err("weights do not fit the samples"));
            }
        }
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
                self.dictionary.pixels,
            )?),
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
        let dictionary = &self.dictionary;
        let solutions = run_interruptibly(py, count, threads, progress, |cancelled, finished| {
            active_set::solve(dictionary, rows, settings, cancelled, finished)
        })?;
        Ok(Solved::new(py, solutions))
    }
}

impl PreparedPatterns {
    fn checked_rows(&self, e: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Vec<f64>>> {
        let patterns = self.dictionary.patterns;
        if e.shape()[1] != patterns {
            return Err(PyValueError::new_err(format!(
                "rows have {} values, there are {patterns} patterns",
                e.shape()[1]
            )));
        }
        Ok(e.as_slice()?
            .chunks_exact(patterns)
            .map(|row| {
                let mut row = row.to_vec();
                row.resize(padded(patterns), 0.0);
                row
            })
            .collect())
    }

    fn each_batch(&self, rows: &[Vec<f64>], mut take: impl FnMut(usize, &[Scores])) {
        let mut scores = vec![Scores::default(); BATCH];
        let mut scratch = Scratch::default();
        for (batch, rows) in rows.chunks(BATCH).enumerate() {
            let e: Vec<&[f64]> = rows.iter().map(Vec::as_slice).collect();
            let mut out: Vec<&mut Scores> = scores.iter_mut().take(e.len()).collect();
            let dictionary = &self.dictionary;
            dictionary
                .correlator
                .run(&dictionary.columns, &e, &mut out, &mut scratch);
            take(batch * BATCH, &scores[..e.len()]);
        }
    }
}

pub fn checked_start(start: Start<'_>, count: usize, pixels: usize) -> PyResult<Start<'_>> {
    let entries = start.indices.len();
    let sound = start.indptr.len() == count + 1
        && start.background.len() == count
        && start.values.len() == entries
        && start.indptr.first() == Some(&0)
        && start.indptr.last() == Some(&(entries as i64))
        && start.indptr.windows(2).all(|w| w[0] <= w[1])
        && start
            .indices
            .iter()
            .all(|&i| i >= 0 && (i as usize) < pixels)
        && start.values.iter().all(|v| v.is_finite())
        && start.background.iter().all(|v| v.is_finite());
    if sound {
        Ok(start)
    } else {
        Err(PyValueError::new_err("the start does not fit the problem"))
    }
}

/// Solves on other threads while this one listens for signals and reports progress.
pub fn run_interruptibly<T: Send>(
    py: Python<'_>,
    count: usize,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
    solve: impl FnOnce(&AtomicBool, &AtomicUsize) -> Option<T> + Send,
) -> PyResult<T> {
    let pool = match threads {
        None => None,
        Some(n) => Some(
            rayon::ThreadPoolBuilder::new()
                .num_threads(n)
                .build()
                .map_err(|error| PyValueError::new_err(error.to_string()))?,
        ),
    };
    let (cancelled, finished) = (AtomicBool::new(false), AtomicUsize::new(0));
    let (sender, receiver) = mpsc::channel::<()>();
    std::thread::scope(|scope| {
        let (cancelled, finished, pool) = (&cancelled, &finished, &pool);
        let worker = scope.spawn(move || {
            let _ends_with_the_thread = sender;
            let solve = || solve(cancelled, finished);
            match pool {
                Some(pool) => pool.install(solve),
                None => solve(),
            }
        });
        let mut outcome = Ok(());
        let receiver = std::sync::Mutex::new(receiver);
        loop {
            let ended = py.detach(|| {
                let receiver = receiver.lock().expect("only this thread locks it");
                receiver.recv_timeout(PATIENCE) == Err(mpsc::RecvTimeoutError::Disconnected)
            });
            if outcome.is_ok() {
                outcome = py.check_signals();
                if let (Ok(()), Some(progress)) = (&outcome, &progress) {
                    let done = finished.load(Ordering::Relaxed);
                    outcome = progress.call1((done, count)).map(|_| ());
                }
                if outcome.is_err() {
                    cancelled.store(true, Ordering::Relaxed);
                }
            }
            if ended {
                break;
            }
        }
        let solutions = py.detach(|| worker.join());
        outcome?;
        match solutions {
            Ok(Some(solutions)) => Ok(solutions),
            Ok(None) => unreachable!("cancelled only with an error"),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

/// Rows as the parts of a CSR matrix, and what is known of each.
#[pyclass(frozen, get_all, module = "lightmatrix._core")]
pub struct Solved {
    indptr: Py<PyArray1<i64>>,
    indices: Py<PyArray1<i32>>,
    values: Py<PyArray1<f64>>,
    background: Py<PyArray1<f64>>,
    objective: Py<PyArray1<f64>>,
    gap: Py<PyArray1<f64>>,
    passes: Py<PyArray1<i32>>,
    converged: Py<PyArray1<bool>>,
}

impl Solved {
    pub fn new(py: Python<'_>, solutions: Vec<active_set::Solution>) -> Self {
        let mut indptr = vec![0i64];
        let (mut indices, mut values) = (Vec::new(), Vec::new());
        for solution in &solutions {
            indices.extend(solution.pixels.iter().map(|&pixel| pixel as i32));
            values.extend_from_slice(&solution.x);
            indptr.push(indices.len() as i64);
        }
        let each = |take: fn(&active_set::Solution) -> f64| -> Py<PyArray1<f64>> {
            let values: Vec<f64> = solutions.iter().map(take).collect();
            values.into_pyarray(py).unbind()
        };
        let passes: Vec<i32> = solutions.iter().map(|s| s.passes as i32).collect();
        let converged: Vec<bool> = solutions.iter().map(|s| s.converged).collect();
        Solved {
            indptr: indptr.into_pyarray(py).unbind(),
            indices: indices.into_pyarray(py).unbind(),
            values: values.into_pyarray(py).unbind(),
            background: each(|s| s.background),
            objective: each(|s| s.objective),
            gap: each(|s| s.gap),
            passes: passes.into_pyarray(py).unbind(),
            converged: converged.into_pyarray(py).unbind(),
        }
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PreparedPatterns>()?;
    module.add_class::<Solved>()
}
