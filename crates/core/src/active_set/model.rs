//! The restricted problem while no sample changes between clipped-above and not: a quadratic.
//!
//! Its Hessian is the Gram matrix of the working set's columns over the samples that count, with
//! the background eliminated ('centred'). Rows are made when they are first asked for: most never
//! are.

use super::gram::GramSource;
use crate::octet::{octets, WIDTH};
use crate::problem::Dictionary;
use crate::simd::{multiversion, Level};
use crate::vector::{dot, DataTerm};

/// Columns with less curvature than this share of the samples are combinations of the background.
const FLAT: f64 = 1e-9;
const UNSET: u32 = u32::MAX;

pub struct Model {
    pub level: Level,
    gram: GramSource,
    /// Whether weights are 0 or 1 only.
    unit_weights: bool,
    /// d, the samples' curvature, and its bits where it is 0 or 1.
    curvature: Vec<f64>,
    active: Vec<u64>,
    /// d m
    weighted_means: Vec<f64>,
    /// a_j . d m, padded
    pub coupling: Vec<f64>,
    coupled: bool,
    /// 1 / m' D m where the background is eliminated, 0 where it is held.
    per_mean: f64,
    /// Rows of the centred Gram matrix made so far, `stride` apart, and where each pixel's is.
    pub rows: Vec<f64>,
    pub slot: Vec<u32>,
    pub stride: usize,
    /// Pixels of the working set that no row made so far holds products with: buffers.
    missing: Vec<usize>,
    missing_pixels: Vec<u32>,
    /// One over the diagonal, padded; 0 where there is no curvature.
    pub inverse: Vec<f64>,
    pub diagonal: Vec<f64>,
    /// Bits of the pixels whose rows have been made and that have curvature.
    pub ready: Vec<u8>,
}

impl Model {
    pub fn new(level: Level) -> Self {
        Model {
            level,
            gram: GramSource::default(),
            unit_weights: false,
            curvature: Vec::new(),
            active: Vec::new(),
            weighted_means: Vec::new(),
            coupling: Vec::new(),
            coupled: false,
            per_mean: 0.0,
            rows: Vec::new(),
            slot: Vec::new(),
            stride: 0,
            missing: Vec::new(),
            missing_pixels: Vec::new(),
            inverse: Vec::new(),
            diagonal: Vec::new(),
            ready: Vec::new(),
        }
    }

    /// Takes note of a new row's data.
    pub fn load_row(&mut self, data: &DataTerm) {
        self.unit_weights = all_zero_or_one(self.level, &data.weights);
        self.curvature.clear();
        // Nothing known of the last row holds for this one.
        self.curvature.resize(data.y.len(), f64::NAN);
        self.weighted_means.resize(data.y.len(), 0.0);
    }

    /// Takes in the pixels of a new working set.
    pub fn load_pixels(&mut self, dictionary: &Dictionary, pixels: &[u32]) {
        self.gram.load(&dictionary.columns, pixels);
        self.stride = pixels.len().next_multiple_of(WIDTH);
        self.coupling.clear();
        self.coupling.resize(self.stride, 0.0);
        self.coupled = false;
        self.slot.clear();
        self.slot.resize(pixels.len(), UNSET);
        self.inverse.clear();
        self.inverse.resize(self.stride, 0.0);
        self.diagonal.resize(self.stride, 0.0);
        self.ready.clear();
        self.ready.resize(self.stride / WIDTH, 0);
        self.rows.clear();
    }

    /// a_j . e for the pixels of the working set.
    pub fn correlate(
        &mut self,
        dictionary: &Dictionary,
        pixels: &[u32],
        e: &[f64],
        out: &mut [f64],
    ) {
        self.gram
            .correlate(self.level, &dictionary.columns, pixels, e, out);
    }

    /// Makes the samples' curvature that of the model; exchanges it with what was there before.
    pub fn set_curvature(&mut self, means: &[f64], curvature: &mut Vec<f64>) {
        if self.has_curvature(curvature) {
            return;
        }
        std::mem::swap(curvature, &mut self.curvature);
        self.active.clear();
        if self.unit_weights {
            self.active.resize(self.curvature.len() / 64, 0);
            positive(self.level, &self.curvature, &mut self.active);
        }
        product(self.level, &self.curvature, means, &mut self.weighted_means);
        self.coupled = false;
        self.forget_rows();
    }

    pub fn has_curvature(&self, curvature: &[f64]) -> bool {
        self.curvature.len() == curvature.len() && same(self.level, &self.curvature, curvature)
    }

    /// m' D m
    pub fn along_means(&self, means: &[f64]) -> f64 {
        dot(self.level, &self.weighted_means, means)
    }

    /// Whether pixels act on the background's slope from now on.
    pub fn couple(&mut self, dictionary: &Dictionary, pixels: &[u32], centred: bool) {
        if !centred {
            self.coupling.fill(0.0);
            self.coupled = false;
        } else if !self.coupled {
            let coupling = &mut self.coupling[..pixels.len()];
            let columns = &dictionary.columns;
            self.gram
                .correlate(self.level, columns, pixels, &self.weighted_means, coupling);
            self.coupled = true;
        }
    }

    /// Eliminates the background (`per_mean` = 1 / m' D m) or holds it (0).
    pub fn centre(&mut self, per_mean: f64) {
        if per_mean != self.per_mean {
            self.forget_rows();
            self.per_mean = per_mean;
        }
    }

    fn forget_rows(&mut self) {
        self.slot.fill(UNSET);
        self.inverse.fill(0.0);
        self.ready.fill(0);
        self.rows.clear();
    }

    /// Where row j, which has been made, begins.
    pub fn place(&self, j: u32) -> usize {
        self.slot[j as usize] as usize * self.stride
    }

    pub fn has_row(&self, j: usize) -> bool {
        self.slot[j] != UNSET
    }

    /// Row j, which has been made.
    pub fn row(&self, j: usize) -> &[f64] {
        &self.rows[self.place(j as u32)..][..self.stride]
    }

    /// Makes row j unless it is there.
    pub fn make_row(&mut self, dictionary: &Dictionary, pixels: &[u32], j: usize) {
        if self.has_row(j) {
            return;
        }
        let (level, start) = (self.level, self.rows.len());
        self.slot[j] = (start / self.stride) as u32;
        self.rows.resize(start + self.stride, 0.0);
        let (made, row) = self.rows.split_at_mut(start);
        let (columns, factor) = (&dictionary.columns, -self.coupling[j] * self.per_mean);
        let (active, coupling) = (&self.active, &self.coupling);
        let gram = &mut self.gram;
        if !gram.count_row(level, columns, pixels[j], active, factor, coupling, row) {
            // The matrix is symmetric: only what no other row holds is left to work out.
            self.missing.clear();
            self.missing_pixels.clear();
            for (i, &slot) in self.slot.iter().enumerate() {
                if slot == UNSET || i == j {
                    self.missing.push(i);
                    self.missing_pixels.push(pixels[i]);
                } else {
                    row[i] = made[slot as usize * self.stride + j];
                }
            }
            let (d, others) = (&self.curvature, &self.missing_pixels);
            let products = gram.products(level, columns, pixels[j], d, others);
            for (&i, product) in self.missing.iter().zip(products) {
                row[i] = product + factor * coupling[i];
            }
        }
        if row[j] > FLAT * self.curvature.len() as f64 {
            self.inverse[j] = 1.0 / row[j];
            self.diagonal[j] = row[j];
            self.ready[j / WIDTH] |= 1 << (j % WIDTH);
        }
    }
}

octets! {
    /// Bits of the values above zero, 64 a word.
    fn positive<O>(values: &[f64], words: &mut [u64]) {
        for (word, values) in words.iter_mut().zip(values.as_chunks::<64>().0) {
            let octets = values.as_chunks().0.iter().enumerate();
            *word = octets.fold(0, |word, (i, v)| word | u64::from(O::load(v).positive()) << (8 * i));
        }
    }
}

multiversion! {
    // Without branches, so that vectors are compared at once.
    fn all_zero_or_one(values: &[f64]) -> bool {
        values.iter().fold(true, |all, &v| all & ((v == 0.0) | (v == 1.0)))
    }
}

multiversion! {
    fn same(a: &[f64], b: &[f64]) -> bool {
        a.iter().zip(b).fold(true, |all, (a, b)| all & (a == b))
    }
}

multiversion! {
    fn product(a: &[f64], b: &[f64], out: &mut [f64]) {
        for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
            *out = a * b;
        }
    }
}
