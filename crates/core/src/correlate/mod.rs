//! The correlation pass: a_j . e for every projector pixel j, as 16-bit scores with guaranteed bounds.
//!
//! e is rounded to integers times a unit (`quantise`), chosen so that the sum over every subset fits 16
//! bits. The rounding error of any such sum is bounded, so a score bounds the exact correlation from both
//! sides. Integer sums do not depend on their order, so all kernels give the same scores.
//!
//! `Correlator::run` chooses the kernel: `lookup` for 0/1 patterns (tables of partial sums in portable
//! code, `avx2` or `avx512`, or byte tiles in `amx`), `transform` for Hadamard patterns, `dense` for any
//! other values, and `blurred` for atoms, which blurs the scores of single pixels. `Scores` keeps the
//! scores beyond a threshold (`outside`), and `select` finds the largest among them.

#[cfg(target_arch = "x86_64")]
mod amx;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod blurred;
mod dense;
mod lookup;
mod outside;
mod quantise;
mod scores;
mod select;
mod tables;
mod transform;

use crate::atoms::Atoms;
use crate::bits::Bits;
use crate::columns::Columns;
use crate::simd::Level;
use crate::vector::signed_sums;
use blurred::{Blurred, Buffers};
use dense::Dense;
use lookup::Lookup;
use quantise::{quantise, Sums};
pub use scores::{ScoreFilter, Scores};
use scores::{BATCH, GROUP};
use std::borrow::Cow;
use transform::Transform;

/// Computes scores in the way that suits the patterns.
pub struct Correlator {
    level: Level,
    patterns: usize,
    pixels: usize,
    kind: Kind,
}

/// A function that computes the scores of some rows, like `Correlator::run`.
pub type Pass = Box<dyn Fn(&[&[f64]], &mut [&mut Scores], &mut Scratch) + Send + Sync>;

enum Kind {
    Lookup(Lookup),
    Transform(Transform),
    Dense(Dense),
    Blurred(Pass, Blurred),
}

/// The buffers of one thread.
#[derive(Default)]
pub struct Scratch {
    quantised: Vec<Vec<i16>>,
    lookup: lookup::Buffers,
    dense: dense::Buffers,
    /// For atoms: the scores and the buffers of the pass over single pixels.
    single: Vec<Scores>,
    inner: Option<Box<Scratch>>,
    blurred: Buffers,
}

impl Correlator {
    /// For 0/1 patterns: tables of partial sums, or byte tiles.
    pub fn lookup(level: Level, bits: Bits) -> Self {
        Correlator {
            level,
            patterns: bits.patterns(),
            pixels: bits.pixels(),
            kind: Kind::Lookup(Lookup::new(level, bits)),
        }
    }

    /// For Hadamard patterns: the rows `selected` of (H + 1) / 2 with H the Sylvester matrix of order
    /// `length`. Pixel j is column `position[j]`.
    ///
    /// # Panics
    /// If `length` is no power of two or an index is not below it.
    pub fn transform(level: Level, length: usize, selected: &[u32], position: &[u32]) -> Self {
        Correlator {
            level,
            patterns: selected.len(),
            pixels: position.len(),
            kind: Kind::Transform(Transform::new(length, selected, position)),
        }
    }

    /// For patterns of any values. Their columns are passed to `run`.
    pub fn dense(level: Level, patterns: usize, pixels: usize) -> Self {
        Correlator {
            level,
            patterns,
            pixels,
            kind: Kind::Dense(Dense),
        }
    }

    /// For atoms of several sizes. `single` and `pass` are the correlator and the pass of single pixels.
    ///
    /// # Panics
    /// If the atoms lie on another number of pixels.
    pub fn blurred(
        level: Level,
        patterns: usize,
        atoms: Atoms,
        single: &Correlator,
        pass: Pass,
    ) -> Self {
        assert_eq!(atoms.pixels(), single.pixels);
        let pixel = (0..single.length()).map(|s| single.pixel(s)).collect();
        Correlator {
            level,
            patterns,
            pixels: atoms.count(),
            kind: Kind::Blurred(pass, Blurred::new(atoms, pixel)),
        }
    }

    /// Number of scores of a row: one for each pixel, and padding.
    pub fn length(&self) -> usize {
        match &self.kind {
            Kind::Lookup(lookup) => lookup.length(),
            Kind::Transform(transform) => transform.length(),
            Kind::Dense(_) => self.pixels.next_multiple_of(GROUP),
            Kind::Blurred(_, blurred) => blurred.length(),
        }
    }

    /// The pixel of a score; None for padding.
    pub fn pixel(&self, score: usize) -> Option<u32> {
        match &self.kind {
            Kind::Transform(transform) => transform.pixel(score),
            _ => (score < self.pixels).then_some(score as u32),
        }
    }

    /// All scores of a pass, by pixel.
    pub fn by_pixel<'a>(&self, scores: &'a Scores) -> Cow<'a, [i16]> {
        let Kind::Transform(transform) = &self.kind else {
            return Cow::Borrowed(&scores.values[..self.pixels]);
        };
        let mut values = vec![0; self.pixels];
        for (place, score) in scores.values.iter().enumerate() {
            if let Some(pixel) = transform.pixel(place) {
                values[pixel as usize] = *score;
            }
        }
        Cow::Owned(values)
    }

    /// Whether patterns are of 0/1 values without structure, so that a row's first passes should return
    /// only the largest of many scores.
    pub fn is_lookup(&self) -> bool {
        matches!(self.kind, Kind::Lookup(_))
    }

    /// Whether the patterns exceed the caches, so that each pass reads them from memory.
    pub fn reads_memory(&self) -> bool {
        matches!(&self.kind, Kind::Lookup(lookup) if lookup.reads_memory())
    }

    /// The best number of rows for a run: they share one reading of the patterns.
    pub fn batch(&self) -> usize {
        match &self.kind {
            Kind::Lookup(lookup) => lookup.batch(),
            _ => BATCH,
        }
    }

    /// Computes the scores of up to `batch` rows `e` (padded); each `out` keeps those that pass its filter.
    ///
    /// # Panics
    /// If there are more rows, or not as many `out` as rows.
    pub fn run(
        &self,
        columns: &Columns,
        e: &[&[f64]],
        out: &mut [&mut Scores],
        scratch: &mut Scratch,
    ) {
        assert!(e.len() <= self.batch() && e.len() == out.len());
        let streams = match &self.kind {
            Kind::Lookup(lookup) => lookup.streams(),
            Kind::Blurred(..) => true,
            _ => false,
        };
        for out in out.iter_mut() {
            if !streams || matches!(out.filter, ScoreFilter::All) {
                out.values.resize(self.length(), 0);
            }
        }
        self.score(columns, e, out, scratch);
        if !streams {
            for out in out {
                out.begin();
                out.filter_values(self.level);
            }
        }
    }

    /// Computes all scores; a streaming kernel keeps only those that pass the filter.
    fn score(
        &self,
        columns: &Columns,
        e: &[&[f64]],
        out: &mut [&mut Scores],
        scratch: &mut Scratch,
    ) {
        let sums = match &self.kind {
            Kind::Dense(dense) => {
                let (patterns, pixels) = (self.patterns, self.pixels);
                let buffers = &mut scratch.dense;
                return dense.run(self.level, columns, patterns, pixels, e, out, buffers);
            }
            Kind::Blurred(pass, blurred) => {
                scratch.single.resize_with(e.len(), Scores::default);
                let mut single: Vec<&mut Scores> = scratch.single.iter_mut().collect();
                pass(e, &mut single, scratch.inner.get_or_insert_default());
                for ((single, out), e) in single.iter_mut().zip(out).zip(e) {
                    // Stored columns may be rounded; widen the bounds by what that can change.
                    let (negative, positive) = signed_sums(self.level, e);
                    let lost = columns.lost() * (positive - negative) / single.unit;
                    single.up += lost;
                    single.down += lost;
                    blurred.run(self.level, single, out, &mut scratch.blurred);
                }
                return;
            }
            Kind::Lookup(_) => Sums::OfSubsets,
            Kind::Transform(_) => Sums::Signed,
        };
        scratch.quantised.resize_with(e.len(), Vec::new);
        for ((e, out), quantised) in e.iter().zip(out.iter_mut()).zip(&mut scratch.quantised) {
            let rounded = quantise(self.level, e, self.patterns, sums, quantised);
            (out.unit, out.up, out.down) = (rounded.unit, rounded.up, rounded.down);
            out.offset = 0.0;
            if let Kind::Transform(_) = self.kind {
                // a_j . q is half of (H q)_j plus the sum of q.
                out.unit /= 2.0;
                out.up *= 2.0;
                out.down *= 2.0;
                out.offset = quantised.iter().map(|&q| f64::from(q)).sum();
            }
            out.begin();
        }
        match &self.kind {
            Kind::Lookup(lookup) => {
                lookup.run(self.level, &scratch.quantised, &mut scratch.lookup, out)
            }
            Kind::Transform(transform) => {
                for (quantised, out) in scratch.quantised.iter().zip(out) {
                    transform.run(self.level, quantised, out.offset, &mut out.values);
                }
            }
            Kind::Dense(_) | Kind::Blurred(..) => unreachable!("returned above"),
        }
    }
}

#[cfg(test)]
mod tests;
