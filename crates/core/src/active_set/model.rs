//! The quadratic model of the restricted problem, exact while no sample's clip state changes.
//!
//! Its Hessian is the Gram matrix A' D A of the working set's columns, with D the samples' curvature.
//! Where the background is free it is eliminated ('centred'): A' D A - A' D m m' D A / (m' D m). Rows of
//! the matrix are computed on first use, as most are never used.

use super::factor::{DEPENDENT, QUICK_DEPENDENT};
use super::gram::GramSource;
use crate::octet::{octets, WIDTH};
use crate::problem::Dictionary;
use crate::simd::{multiversion, Level};
use crate::vector::{dot, DataTerm};

/// A column whose curvature is below this, per sample, counts as a multiple of the background: it is
/// rounding. Curvature per sample is at most the largest weight.
const FLAT: f64 = 1e-9;
/// Where inner products are summed in float32, less than this share of a column's curvature is rounding.
const QUICK_FLAT: f64 = 3e-6;
/// Marks rows that have not been computed.
const UNSET: u32 = u32::MAX;

pub struct Model {
    pub level: Level,
    /// Whether inner products are exact, also of columns that allow quick ones.
    pub exact: bool,
    gram: GramSource,
    /// Whether all weights are 0 or 1.
    unit_weights: bool,
    /// The curvature d of the samples, and its bits if the weights are 0 or 1.
    curvature: Vec<f64>,
    active: Vec<u64>,
    /// d m
    weighted_means: Vec<f64>,
    /// a_j . d m, padded
    pub coupling: Vec<f64>,
    coupled: bool,
    /// 1 / m' D m where the background is eliminated, 0 where it is fixed.
    per_mean: f64,
    /// The rows of the centred Gram matrix computed so far, `stride` apart, and the row of each pixel.
    pub rows: Vec<f64>,
    pub slot: Vec<u32>,
    pub stride: usize,
    /// If a pivot is below this share of its diagonal element, the column depends on those before it.
    pub dependent: f64,
    /// Buffers: the pixels with which no computed row holds products.
    missing: Vec<usize>,
    missing_pixels: Vec<u32>,
    /// The inverse diagonal, padded; 0 where there is no curvature.
    pub inverse: Vec<f64>,
    pub diagonal: Vec<f64>,
    /// Bits of the pixels whose rows are computed and that have curvature.
    pub ready: Vec<u8>,
}

impl Model {
    pub fn new(level: Level) -> Self {
        Model {
            level,
            exact: false,
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
            dependent: DEPENDENT,
            missing: Vec::new(),
            missing_pixels: Vec::new(),
            inverse: Vec::new(),
            diagonal: Vec::new(),
            ready: Vec::new(),
        }
    }

    /// Loads a new row's data.
    pub fn load_row(&mut self, data: &DataTerm) {
        self.unit_weights = all_zero_or_one(self.level, &data.weights);
        self.curvature.clear();
        // NaN equals nothing, so the curvature of the last row is not reused.
        self.curvature.resize(data.y.len(), f64::NAN);
        self.weighted_means.resize(data.y.len(), 0.0);
    }

    /// Loads the columns of a new working set.
    pub fn load_pixels(&mut self, dictionary: &Dictionary, pixels: &[u32]) {
        self.gram.load(&dictionary.columns, pixels);
        self.gram.quick = !self.exact && dictionary.columns.has_quick_products();
        self.dependent = if self.gram.quick {
            QUICK_DEPENDENT
        } else {
            DEPENDENT
        };
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

    /// Sets the samples' curvature; `curvature` receives the old one.
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

    /// Couples the pixels with the background, or not.
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

    /// Eliminates the background (`per_mean` = 1 / m' D m) or fixes it (0).
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

    /// Where row j, which must be computed, begins.
    pub fn place(&self, j: u32) -> usize {
        self.slot[j as usize] as usize * self.stride
    }

    pub fn has_row(&self, j: usize) -> bool {
        self.slot[j] != UNSET
    }

    /// Row j, which must be computed.
    pub fn row(&self, j: usize) -> &[f64] {
        &self.rows[self.place(j as u32)..][..self.stride]
    }

    /// Computes row j unless that is done.
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
            // The matrix is symmetric: copy the products that other rows hold, compute the rest.
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
        let rounding = if gram.quick {
            QUICK_FLAT * (row[j] - factor * coupling[j])
        } else {
            FLAT * self.curvature.len() as f64
        };
        if row[j] > rounding {
            self.inverse[j] = 1.0 / row[j];
            self.diagonal[j] = row[j];
            self.ready[j / WIDTH] |= 1 << (j % WIDTH);
        }
    }
}

octets! {
    /// Sets the bits of the values above zero, 64 in a word.
    fn positive<O>(values: &[f64], words: &mut [u64]) {
        for (word, values) in words.iter_mut().zip(values.as_chunks::<64>().0) {
            let octets = values.as_chunks().0.iter().enumerate();
            *word = octets.fold(0, |word, (i, v)| word | u64::from(O::load(v).positive()) << (8 * i));
        }
    }
}

multiversion! {
    // Without branches, so that the compiler vectorises the comparison.
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
