//! The correlation pass: a_j . e for every projector pixel j, as 16-bit scores with a sure margin.
//!
//! Values e are rounded to integers times a unit, so that every sum of a subset of them fits 16 bits.
//! What rounding may have done to a sum of any subset is known, so a score bounds the exact
//! correlation from both sides. Integer sums do not depend on their order: every kernel gives the
//! same scores.

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
pub use scores::{Scores, Wanted};
use scores::{BATCH, GROUP};
use transform::Transform;

/// One way of computing scores, chosen by what the patterns are.
pub struct Correlator {
    level: Level,
    patterns: usize,
    pixels: usize,
    kind: Kind,
}

/// Scores of some rows, as `Correlator::run` gives them.
pub type Pass = Box<dyn Fn(&[&[f64]], &mut [&mut Scores], &mut Scratch) + Send + Sync>;

enum Kind {
    Lookup(Lookup),
    Transform(Transform),
    Dense(Dense),
    Blurred(Pass, Blurred),
}

/// Buffers of one thread.
#[derive(Default)]
pub struct Scratch {
    quantised: Vec<Vec<i16>>,
    lookup: lookup::Buffers,
    dense: dense::Buffers,
    /// For atoms: what the pass over single pixels gives, and works in.
    single: Vec<Scores>,
    inner: Option<Box<Scratch>>,
    blurred: Buffers,
}

impl Correlator {
    /// Any 0/1 patterns, by tables of partial sums.
    pub fn lookup(level: Level, bits: Bits) -> Self {
        Correlator {
            level,
            patterns: bits.patterns(),
            pixels: bits.pixels(),
            kind: Kind::Lookup(Lookup::new(level, bits)),
        }
    }

    /// Rows `selected` of (H + 1) / 2 with H the Sylvester matrix of order `length`; pixel j is
    /// column `position[j]`.
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

    /// Patterns of any values, whose columns are kept elsewhere.
    pub fn dense(level: Level, patterns: usize, pixels: usize) -> Self {
        Correlator {
            level,
            patterns,
            pixels,
            kind: Kind::Dense(Dense),
        }
    }

    /// Atoms of several sizes, over the `single` pixels whose `pass` this is.
    ///
    /// # Panics
    /// If there are not as many pixels as the atoms lie on.
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

    /// Scores of a row: one for each pixel, and some that stand for none.
    pub fn length(&self) -> usize {
        match &self.kind {
            Kind::Lookup(lookup) => lookup.length(),
            Kind::Transform(transform) => transform.length(),
            Kind::Dense(_) => self.pixels.next_multiple_of(GROUP),
            Kind::Blurred(_, blurred) => blurred.length(),
        }
    }

    /// The pixel that a score belongs to.
    pub fn pixel(&self, score: usize) -> Option<u32> {
        match &self.kind {
            Kind::Transform(transform) => transform.pixel(score),
            _ => (score < self.pixels).then_some(score as u32),
        }
    }

    /// Whether there are so many correlations, of random patterns, that few should be looked at.
    pub fn is_lookup(&self) -> bool {
        matches!(self.kind, Kind::Lookup(_))
    }

    /// Whether a pass reads more than the caches keep from one to the next.
    pub fn reads_memory(&self) -> bool {
        matches!(&self.kind, Kind::Lookup(lookup) if lookup.reads_memory())
    }

    /// How many rows a run should have: so many share a reading of the patterns best.
    pub fn batch(&self) -> usize {
        match &self.kind {
            Kind::Lookup(lookup) => lookup.batch(),
            _ => BATCH,
        }
    }

    /// Scores of up to `batch` rows `e` (padded): those that each `out` wants.
    ///
    /// # Panics
    /// If there are more rows or not one `out` a row.
    pub fn run(
        &self,
        columns: &Columns,
        e: &[&[f64]],
        out: &mut [&mut Scores],
        scratch: &mut Scratch,
    ) {
        assert!(e.len() <= self.batch() && e.len() == out.len());
        let hands_on = matches!(&self.kind, Kind::Lookup(lookup) if lookup.hands_on());
        for out in out.iter_mut() {
            if !hands_on || matches!(out.wanted, Wanted::All) {
                out.values.resize(self.length(), 0);
            }
        }
        self.score(columns, e, out, scratch);
        if !hands_on {
            for out in out {
                out.begin();
                out.take_values(self.level);
            }
        }
    }

    /// All scores, or, of a kernel that hands them on as they come, those that are wanted.
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
                    // Columns that were rounded differ from the blurred patterns by so much.
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
