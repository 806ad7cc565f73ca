//! Solves rows on candidate atoms only, each with a penalty of its own.
//!
//! A penalty w lambda x is a penalty lambda (w x), and the column of w x is a / w. So the active-set solver
//! gets a dictionary of the row's own scaled columns, and its certificate holds for the weighted problem
//! on these columns.

use crate::active_set::SingleRowSolver;
use crate::columns::{times, Columns, DenseColumns};
use crate::correlate::Correlator;
use crate::problem::{Dictionary, Rows, Settings, Solution, Sparse, Start, Values};
use crate::simd::Level;
use crate::vector::{padded, summed};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Rows that one thread solves at a time, enough to hide the cost of starting a task.
const TASK: usize = 16;

/// Columns that all rows may use besides their candidates, such as the means over coarse cells.
#[derive(Clone, Copy)]
pub struct SharedColumns<'a> {
    /// One column after the other, with a value in [0, 1] for each pattern: those shown, then the unseen
    /// ones of the pseudo-samples.
    pub columns: &'a [f32],
    /// Penalties relative to lambda, > 0.
    pub penalties: &'a [f32],
    /// The starting point, (rows, columns).
    pub start: Option<&'a [f32]>,
}

/// Expected samples as additional samples with weights: first under patterns that were shown (where the
/// true samples clip, for example), then under unseen patterns.
#[derive(Clone, Copy)]
pub struct PseudoSamples<'a> {
    pub unseen: &'a Dictionary,
    /// (rows, patterns shown and unseen).
    pub values: &'a [f32],
    /// The same shape; 0 omits a pseudo-sample.
    pub weights: &'a [f32],
}

/// Prior knowledge of the rows.
#[derive(Clone, Copy)]
pub struct Knowledge<'a> {
    /// The atoms that each row may use, ascending, and their penalties relative to lambda, > 0.
    pub candidates: Sparse<'a, f32>,
    pub shared_columns: SharedColumns<'a>,
    pub pseudo_samples: Option<PseudoSamples<'a>>,
    /// The samples of each row's background, (rows, patterns shown and unseen), in place of the patterns'
    /// means.
    pub background: Option<&'a [f32]>,
}

/// One row's solution.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Weighted {
    pub row: Solution,
    /// Coefficients of the shared columns.
    pub shared: Vec<f64>,
}

/// Solves every row on its candidates. Returns None if `cancelled` is set meanwhile; `finished` counts
/// solved rows.
///
/// # Panics
/// If the lengths of the arrays do not match.
pub fn solve(
    dictionary: &Dictionary,
    rows: Rows,
    knowledge: Knowledge,
    settings: Settings,
    cancelled: &AtomicBool,
    finished: &AtomicUsize,
) -> Option<Vec<Weighted>> {
    let Knowledge {
        candidates,
        shared_columns,
        pseudo_samples,
        background,
    } = knowledge;
    let shared = shared_columns.penalties.len();
    let patterns = dictionary.patterns + pseudo_samples.map_or(0, |e| e.unseen.patterns);
    assert_eq!(candidates.indptr.len(), rows.count + 1);
    assert_eq!(candidates.indices.len(), candidates.values.len());
    assert_eq!(shared_columns.columns.len(), shared * patterns);
    if let Some(start) = shared_columns.start {
        assert_eq!(start.len(), rows.count * shared);
    }
    if let Some(pseudo_samples) = pseudo_samples {
        assert_eq!(pseudo_samples.unseen.pixels, dictionary.pixels);
        assert_eq!(pseudo_samples.values.len(), rows.count * patterns);
        assert_eq!(pseudo_samples.weights.len(), rows.count * patterns);
    }
    if let Some(background) = background {
        assert_eq!(background.len(), rows.count * patterns);
    }
    let mut solutions = vec![Weighted::default(); rows.count];
    solutions.par_chunks_mut(TASK).enumerate().for_each_init(
        || Work::new(dictionary.level),
        |work, (task, solutions)| {
            for (i, solution) in solutions.iter_mut().enumerate() {
                if cancelled.load(Ordering::Relaxed) {
                    return;
                }
                let row = task * TASK + i;
                *solution = work.solve(dictionary, rows, row, knowledge, settings);
                finished.fetch_add(1, Ordering::Relaxed);
            }
        },
    );
    (!cancelled.load(Ordering::Relaxed)).then_some(solutions)
}

/// The buffers of one thread.
struct Work {
    solver: SingleRowSolver,
    values: Vec<f32>,
    penalties: Vec<f32>,
    places: Vec<i32>,
    start: Vec<f64>,
    samples: Vec<f64>,
    weights: Vec<f64>,
    clipped: Vec<bool>,
    means: Vec<f64>,
    /// The patterns of the row's pseudo-samples: those shown, then the unseen ones.
    added: Vec<usize>,
    /// A column's values under the unseen patterns.
    unseen: Vec<f32>,
}

impl Work {
    fn new(level: Level) -> Self {
        Work {
            solver: SingleRowSolver::new(level),
            values: Vec::new(),
            penalties: Vec::new(),
            places: Vec::new(),
            start: Vec::new(),
            samples: Vec::new(),
            weights: Vec::new(),
            clipped: Vec::new(),
            means: Vec::new(),
            added: Vec::new(),
            unseen: Vec::new(),
        }
    }

    fn solve(
        &mut self,
        dictionary: &Dictionary,
        rows: Rows,
        row: usize,
        knowledge: Knowledge,
        settings: Settings,
    ) -> Weighted {
        let Knowledge {
            candidates,
            shared_columns,
            pseudo_samples,
            background,
        } = knowledge;
        let (pixels, penalties) = candidates.row(row);
        self.penalties.clear();
        self.penalties.extend(penalties);
        self.penalties.extend(shared_columns.penalties);
        // Scale penalties so that the smallest is 1, so that no column exceeds 1.
        let least = self.penalties.iter().copied().fold(f32::INFINITY, f32::min);
        let least = if least.is_finite() { least } else { 1.0 };
        self.load(dictionary, rows, row, pseudo_samples);
        if let Some(background) = background {
            let all = dictionary.patterns + pseudo_samples.map_or(0, |e| e.unseen.patterns);
            let own = &background[row * all..][..all];
            let used = (0..dictionary.patterns).chain(self.added.iter().copied());
            for (mean, k) in self.means.iter_mut().zip(used) {
                *mean = f64::from(own[k]);
            }
        }
        let patterns = self.samples.len();
        self.gather(dictionary, pseudo_samples, pixels, shared_columns, least);
        let shared = shared_columns.penalties.len();
        let background = [rows.start.map_or(0.0, |start| start.background[row])];
        self.starting(rows.start, row, pixels, shared_columns, least);
        let indptr = [0, self.places.len() as i64];
        let start = rows.start.is_some() || shared_columns.start.is_some();
        let local = Dictionary {
            level: dictionary.level,
            columns: Columns::Dense(
                DenseColumns::from_padded(std::mem::take(&mut self.values), self.means.len(), 1.0)
                    .with_quick_products(),
            ),
            correlator: Correlator::dense(dictionary.level, patterns, pixels.len() + shared),
            means: std::mem::take(&mut self.means),
            patterns,
            pixels: pixels.len() + shared,
        };
        let start = start.then_some(Start {
            rows: Sparse {
                indptr: &indptr,
                indices: &self.places,
                values: &self.start,
            },
            background: &background,
        });
        let settings = Settings {
            regularization: settings.regularization * f64::from(least),
            ..settings
        };
        let rows = Rows {
            count: 1,
            samples: Values::F64(&self.samples),
            clipped: &self.clipped,
            weights: Some(Values::F64(&self.weights)),
            start,
        };
        let solution = self.solver.solve(&local, rows, settings);
        if let Columns::Dense(columns) = local.columns {
            self.values = columns.into_values();
        }
        self.means = local.means;
        self.unscaled(solution, pixels, shared, least)
    }

    /// Loads the row's samples, with the pseudo-samples last, and the means of their patterns.
    fn load(
        &mut self,
        dictionary: &Dictionary,
        rows: Rows,
        row: usize,
        pseudo_samples: Option<PseudoSamples>,
    ) {
        let patterns = dictionary.patterns;
        let first = row * patterns;
        for buffer in [&mut self.samples, &mut self.weights] {
            buffer.clear();
            buffer.resize(patterns, 1.0);
        }
        rows.samples.copy(first, &mut self.samples);
        if let Some(weights) = rows.weights {
            let start = if weights.len() == patterns { 0 } else { first };
            weights.copy(start, &mut self.weights);
        }
        self.clipped.clear();
        self.clipped.extend(&rows.clipped[first..first + patterns]);
        self.means.clear();
        self.means.extend(&dictionary.means[..patterns]);
        self.added.clear();
        if let Some(pseudo_samples) = pseudo_samples {
            let all = patterns + pseudo_samples.unseen.patterns;
            let weights = &pseudo_samples.weights[row * all..][..all];
            self.added.extend((0..all).filter(|&k| weights[k] > 0.0));
            for &k in &self.added {
                self.samples
                    .push(f64::from(pseudo_samples.values[row * all + k]));
                self.weights.push(f64::from(weights[k]));
                self.clipped.push(false);
                self.means.push(match k.checked_sub(patterns) {
                    None => dictionary.means[k],
                    Some(unseen) => pseudo_samples.unseen.means[unseen],
                });
            }
        }
        // `copy_scaled` writes columns of the padded length.
        let stride = summed(self.samples.len()).max(padded(patterns));
        self.means.resize(stride, 0.0);
    }

    /// Gathers the row's columns, each divided by its penalty, with the pseudo-samples last.
    fn gather(
        &mut self,
        dictionary: &Dictionary,
        pseudo_samples: Option<PseudoSamples>,
        pixels: &[i32],
        shared_columns: SharedColumns,
        least: f32,
    ) {
        let patterns = dictionary.patterns;
        let unseen = pseudo_samples.map_or(0, |pseudo_samples| pseudo_samples.unseen.patterns);
        let own = padded(patterns);
        let stride = self.means.len();
        self.values.resize(self.penalties.len() * stride, 0.0);
        self.unseen.resize(padded(unseen), 0.0);
        let first = self.added.partition_point(|&k| k < patterns);
        let places = self.added.split_at(first);
        let mut outs = self.values.chunks_exact_mut(stride).zip(&self.penalties);
        for (&pixel, (out, penalty)) in pixels.iter().zip(&mut outs) {
            let (pixel, factor) = (pixel as u32, least / penalty);
            let columns = &dictionary.columns;
            columns.copy_scaled(dictionary.level, pixel, factor, &mut out[..own]);
            if let Some(pseudo_samples) = pseudo_samples {
                let (level, columns) =
                    (pseudo_samples.unseen.level, &pseudo_samples.unseen.columns);
                columns.copy_scaled(level, pixel, factor, &mut self.unseen);
            }
            append(places, &self.unseen[..unseen], patterns, out);
        }
        let columns = shared_columns.columns;
        for (column, (out, penalty)) in columns.chunks_exact((patterns + unseen).max(1)).zip(outs) {
            let (factor, level) = (least / penalty, dictionary.level);
            let (shown, beyond) = column.split_at(patterns);
            times(level, shown, factor, out);
            times(level, beyond, factor, &mut self.unseen);
            append(places, &self.unseen[..unseen], patterns, out);
        }
    }

    /// Converts the starting point to the places and scales of the row's own columns.
    fn starting(
        &mut self,
        start: Option<Start>,
        row: usize,
        pixels: &[i32],
        shared_columns: SharedColumns,
        least: f32,
    ) {
        self.places.clear();
        self.start.clear();
        if let Some(start) = start {
            let (pixels_then, values) = start.rows.row(row);
            for (pixel, value) in pixels_then.iter().zip(values) {
                if let Ok(place) = pixels.binary_search(pixel) {
                    self.places.push(place as i32);
                    self.start
                        .push(value * f64::from(self.penalties[place] / least));
                }
            }
        }
        if let Some(values) = shared_columns.start {
            let shared = shared_columns.penalties.len();
            for (i, &value) in values[row * shared..][..shared].iter().enumerate() {
                if value != 0.0 {
                    let place = pixels.len() + i;
                    self.places.push(place as i32);
                    self.start
                        .push(f64::from(value) * f64::from(self.penalties[place] / least));
                }
            }
        }
    }

    /// Converts the solution back to atoms and their own scale.
    fn unscaled(&self, solution: Solution, pixels: &[i32], shared: usize, least: f32) -> Weighted {
        let mut result = Weighted {
            shared: vec![0.0; shared],
            row: Solution {
                pixels: Vec::new(),
                x: Vec::new(),
                ..solution
            },
        };
        for (&place, &x) in solution.pixels.iter().zip(&solution.x) {
            let place = place as usize;
            let x = x * f64::from(least / self.penalties[place]);
            match place.checked_sub(pixels.len()) {
                None => {
                    result.row.pixels.push(pixels[place] as u32);
                    result.row.x.push(x);
                }
                Some(i) => result.shared[i] = x,
            }
        }
        result
    }
}

/// Writes the values of a column under the patterns of the pseudo-samples behind those under the
/// `patterns` shown, and zeros up to the end. `places` are of shown and of unseen patterns.
fn append(places: (&[usize], &[usize]), unseen: &[f32], patterns: usize, column: &mut [f32]) {
    let (shown, rest) = column.split_at_mut(patterns);
    let (repeated, rest) = rest.split_at_mut(places.0.len());
    for (out, &k) in repeated.iter_mut().zip(places.0) {
        *out = shown[k];
    }
    let (added, end) = rest.split_at_mut(places.1.len());
    if added.len() == unseen.len() {
        added.copy_from_slice(unseen);
    } else {
        for (out, &k) in added.iter_mut().zip(places.1) {
            *out = unseen[k - patterns];
        }
    }
    end.fill(0.0);
}
