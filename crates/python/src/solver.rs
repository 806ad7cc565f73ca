//! Prepared patterns, with the active-set solver and its correlation pass as methods.

use crate::arrays::{array, check_memory, check_shape, grid, long_or_short, Values};
use crate::input::{Samples, Settings, Start};
use crate::planes::plane;
use crate::products::{below, Packed};
use crate::sets::{check_any, level, padded_means, Transform};
use crate::solved::{Solved, ROW_BYTES};
use crate::threads::{on_all_cores, run_interruptibly, thread_count};
use lightmatrix_core::active_set;
use lightmatrix_core::atoms::Atoms;
use lightmatrix_core::columns::{BitColumns, Columns, DenseColumns};
use lightmatrix_core::correlate::{Correlator, Scores, Scratch};
use lightmatrix_core::problem::Dictionary;
use lightmatrix_core::vector::padded;
use numpy::{IntoPyArray, PyArray1, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::Arc;

/// Bytes of a thread's buffers whose size does not depend on patterns and pixels: the factor and the Gram
/// matrix of a few hundred pixels.
const THREAD_BYTES: usize = 4 << 20;
/// Number of float64 vectors over the patterns that a thread holds, rounded up.
const THREAD_VECTORS: usize = 64;

/// Patterns prepared for the solver: columns, and the tables of the correlation pass.
#[pyclass(frozen, module = "lightmatrix._core")]
pub struct PreparedPatterns {
    pub dictionary: Arc<Dictionary>,
}

#[pymethods]
impl PreparedPatterns {
    /// 0/1 patterns as packed bits; with `transform` (length, selected, position) also Hadamard.
    #[staticmethod]
    #[pyo3(signature = (packed, pixels, means, transform=None, instructions=None))]
    fn from_bits<'py>(
        py: Python<'py>,
        packed: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        means: &Bound<'py, PyAny>,
        transform: Option<(Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>)>,
        instructions: Option<&str>,
    ) -> PyResult<Self> {
        let packed = Packed::read(packed, pixels)?;
        let bits = packed.view()?;
        let (patterns, pixels) = (bits.patterns(), bits.pixels());
        check_any(patterns, pixels)?;
        let level = level(instructions)?;
        let means = padded_means(means, patterns)?;
        let transform = transform.map(|parts| Transform::read(parts, patterns, pixels));
        let transform = transform.transpose()?;
        // Bytes of columns, their transpose and the planes of the pass.
        check_memory::<u8>(&[pixels, padded(patterns) / 2], "the prepared patterns")?;
        let dictionary = on_all_cores(py, || Dictionary {
            level,
            columns: Columns::Bits(BitColumns::new(bits)),
            correlator: match transform {
                None => Correlator::lookup(level, bits),
                Some(Transform {
                    length,
                    selected,
                    position,
                }) => Correlator::transform(level, length, &selected, &position),
            },
            means,
            patterns,
            pixels,
        })?;
        let dictionary = Arc::new(dictionary);
        Ok(PreparedPatterns { dictionary })
    }

    /// Patterns of any values in [0, 1], (K, N) float32.
    #[staticmethod]
    #[pyo3(signature = (matrix, means, instructions=None))]
    fn from_dense<'py>(
        py: Python<'py>,
        matrix: &Bound<'py, PyAny>,
        means: &Bound<'py, PyAny>,
        instructions: Option<&str>,
    ) -> PyResult<Self> {
        let matrix = array::<f32>(matrix, "matrix")?;
        check_shape(
            "matrix",
            matrix.shape(),
            &[None, None],
            "patterns and pixels",
        )?;
        let (patterns, pixels) = (matrix.shape()[0], matrix.shape()[1]);
        check_any(patterns, pixels)?;
        let level = level(instructions)?;
        let means = padded_means(means, patterns)?;
        let values = matrix.as_slice()?;
        if !values.iter().all(|v| (0.0..=1.0).contains(v)) {
            return Err(PyValueError::new_err("a pattern value is outside [0, 1]"));
        }
        check_memory::<f32>(&[pixels, padded(patterns)], "the prepared patterns")?;
        let dictionary = on_all_cores(py, || Dictionary {
            level,
            columns: Columns::Dense(DenseColumns::new(values, patterns, pixels)),
            correlator: Correlator::dense(level, patterns, pixels),
            means,
            patterns,
            pixels,
        })?;
        let dictionary = Arc::new(dictionary);
        Ok(PreparedPatterns { dictionary })
    }

    /// Atoms under the patterns, with (kernel, gain) for each plane; see `lightmatrix_core::atoms`.
    /// `narrow` stores columns in half the memory, with an error of at most 1e-5. The columns of atoms
    /// that are not `wanted` are zero. None: all are wanted.
    #[pyo3(signature = (shape, planes, narrow=false, wanted=None))]
    fn atoms<'py>(
        &self,
        py: Python<'py>,
        shape: &Bound<'py, PyAny>,
        planes: Vec<(Bound<'py, PyAny>, Bound<'py, PyAny>)>,
        narrow: bool,
        wanted: Option<Vec<u32>>,
    ) -> PyResult<Self> {
        let (grid, pixels) = grid(shape, "shape")?;
        let single = Arc::clone(&self.dictionary);
        if pixels != single.pixels || planes.is_empty() {
            return Err(PyValueError::new_err(format!(
                "{} planes of {pixels} atoms, expected at least 1 of {}",
                planes.len(),
                single.pixels
            )));
        }
        let planes = planes.iter().map(plane).collect::<PyResult<Vec<_>>>()?;
        let atoms = Atoms { grid, planes };
        let (level, patterns) = (single.level, single.patterns);
        if let Some(outside) = (wanted.iter().flatten()).find(|&&j| j as usize >= atoms.count()) {
            return Err(PyValueError::new_err(format!(
                "atom {outside} of {}",
                atoms.count()
            )));
        }
        // The columns, and those of single pixels between margins, which may be as wide as they are.
        let size = atoms.planes.len() * if narrow { 2 } else { 4 } + 2 * size_of::<f32>();
        check_memory::<u8>(&[size, pixels, padded(patterns)], "the prepared atoms")?;
        let dictionary = on_all_cores(py, || Dictionary {
            level,
            columns: if narrow {
                Columns::Words(atoms.words(level, &single.columns, patterns, wanted.as_deref()))
            } else {
                Columns::Dense(atoms.columns(level, &single.columns, patterns, wanted.as_deref()))
            },
            means: single.means.clone(),
            patterns,
            pixels: atoms.count(),
            correlator: {
                let inner = Arc::clone(&single);
                let pass = move |e: &[&[f64]], out: &mut [&mut Scores], scratch: &mut Scratch| {
                    let columns = &inner.columns;
                    inner.correlator.run(columns, e, out, scratch);
                };
                Correlator::blurred(level, patterns, atoms, &single.correlator, Box::new(pass))
            },
        })?;
        Ok(PreparedPatterns {
            dictionary: Arc::new(dictionary),
        })
    }

    /// The columns of the pixels or atoms `index`, (m, K) float32.
    fn columns<'py>(
        &self,
        py: Python<'py>,
        index: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let dictionary = &self.dictionary;
        let index = long_or_short(index, "index")?;
        check_shape("index", index.shape(), &[None], "one a column")?;
        let index: Vec<u32> = below(index.as_slice()?, dictionary.pixels, "index")?;
        let (count, stride) = (dictionary.patterns, padded(dictionary.patterns));
        check_memory::<f32>(&[index.len(), count], "the columns")?;
        let mut values = vec![0f32; index.len() * count];
        let mut column = vec![0f32; stride];
        for (out, &pixel) in values.chunks_exact_mut(count).zip(&index) {
            let columns = &dictionary.columns;
            columns.copy_scaled(dictionary.level, pixel, 1.0, &mut column);
            out.copy_from_slice(&column[..count]);
        }
        values
            .into_pyarray(py)
            .call_method1("reshape", (index.len(), count))
    }

    #[getter]
    fn instructions(&self) -> &'static str {
        self.dictionary.level.name()
    }

    /// One correlation pass: scores, and for each row of `e` the numbers unit, offset, up, down that turn
    /// them into bounds of a_j . e.
    fn scores<'py>(
        &self,
        py: Python<'py>,
        e: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyArray1<f64>>)> {
        let dictionary = &self.dictionary;
        let rows = self.checked_rows(e)?;
        check_memory::<i16>(&[rows.len(), dictionary.pixels], "the scores")?;
        let (values, bounds) = py.detach(|| {
            let mut values = Vec::with_capacity(rows.len() * dictionary.pixels);
            let mut bounds = Vec::with_capacity(4 * rows.len());
            self.each_batch(&rows, |scores| {
                for scores in scores {
                    values.extend_from_slice(&dictionary.correlator.by_pixel(scores));
                    bounds.extend([scores.unit, scores.offset, scores.up, scores.down]);
                }
            });
            (values, bounds)
        });
        let shape = (rows.len(), dictionary.pixels);
        let values = values.into_pyarray(py).call_method1("reshape", shape)?;
        Ok((values, bounds.into_pyarray(py)))
    }

    /// Runs the pass over all rows of `e` on one thread and discards the scores, for timing.
    fn pass_only(&self, py: Python<'_>, e: &Bound<'_, PyAny>) -> PyResult<()> {
        let rows = self.checked_rows(e)?;
        py.detach(|| self.each_batch(&rows, |_| {}));
        Ok(())
    }

    /// Solves rows of samples; see `lightmatrix.solvers.active_set`.
    #[pyo3(signature = (samples, settings, *, start=None, progress=None))]
    fn solve<'py>(
        &self,
        py: Python<'py>,
        samples: &Bound<'py, PyAny>,
        settings: &Settings,
        start: Option<&Bound<'py, PyAny>>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Solved> {
        let dictionary = &self.dictionary;
        let samples = Samples::read(samples, dictionary.patterns)?;
        let count = samples.count;
        let start = Start::read(start, (count, dictionary.pixels))?;
        let start = start.as_ref().map(Start::view).transpose()?;
        let rows = samples.rows(start)?;
        self.check_solver_memory(count, settings.threads)?;
        let threads = settings.threads;
        let settings = settings.view();
        let solutions = run_interruptibly(py, count, threads, progress, |cancelled, finished| {
            active_set::solve(dictionary, rows, settings, cancelled, finished)
        })?;
        Solved::new(py, solutions)
    }
}

impl PreparedPatterns {
    /// Rejects a solve of `count` rows for which there is no memory.
    pub fn check_solver_memory(&self, count: usize, threads: Option<usize>) -> PyResult<()> {
        let (pixels, vector) = (self.dictionary.pixels, 8 * padded(self.dictionary.patterns));
        let scores = size_of::<i16>() * self.dictionary.correlator.batch() * pixels;
        let thread = THREAD_BYTES + THREAD_VECTORS * vector + scores;
        check_memory::<u8>(&[thread_count(threads), thread], "the threads")?;
        check_memory::<u8>(&[count, ROW_BYTES], "the solved rows")?;
        Ok(())
    }

    fn checked_rows(&self, e: &Bound<'_, PyAny>) -> PyResult<Vec<Vec<f64>>> {
        let patterns = self.dictionary.patterns;
        let e = Values::<f64>::reals(e, "e")?;
        let why = format!("there are {patterns} patterns");
        check_shape("e", e.shape(), &[None, Some(patterns)], &why)?;
        check_memory::<f64>(&[e.shape()[0], padded(patterns)], "the rows")?;
        Ok(e.as_slice()?
            .chunks_exact(patterns)
            .map(|row| {
                let mut row = row.to_vec();
                row.resize(padded(patterns), 0.0);
                row
            })
            .collect())
    }

    fn each_batch(&self, rows: &[Vec<f64>], mut use_scores: impl FnMut(&[Scores])) {
        let batch = self.dictionary.correlator.batch();
        let mut scores = vec![Scores::default(); batch];
        let mut scratch = Scratch::default();
        for rows in rows.chunks(batch) {
            let scores = &mut scores[..rows.len()];
            self.pass(rows, scores, &mut scratch);
            use_scores(scores);
        }
    }

    /// The scores of at most a batch of rows.
    fn pass(&self, rows: &[Vec<f64>], scores: &mut [Scores], scratch: &mut Scratch) {
        let e: Vec<&[f64]> = rows.iter().map(Vec::as_slice).collect();
        let mut out: Vec<&mut Scores> = scores.iter_mut().collect();
        let Dictionary {
            columns,
            correlator,
            ..
        } = &*self.dictionary;
        correlator.run(columns, &e, &mut out, scratch);
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Settings>()?;
    module.add_class::<PreparedPatterns>()
}
