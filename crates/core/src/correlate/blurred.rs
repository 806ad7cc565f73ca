//! The pass over atoms of several sizes: it blurs the scores of single pixels.
//!
//! The correlation with a blurred column is the blurred correlation. So one pass over the patterns serves
//! all sizes, and the blurring costs the same for any number of patterns.

use super::quantise::largest;
use super::scores::{Scores, GROUP};
use crate::atoms::{Atoms, Blurring};
use crate::simd::{multiversion, Level};

pub struct Blurred {
    atoms: Atoms,
    /// The pixel of each score of the pass over single pixels, None for padding; empty if the scores
    /// are in the order of the pixels.
    pixel: Vec<Option<u32>>,
}

/// Largest score. It leaves room for rounding within 16 bits (32,767).
const LARGEST: f32 = 32_000.0;
/// Largest rounding error of a score, in steps: a half, and 2 % for the rounding of the quotient.
const HALF: f64 = 0.51;

/// The buffers of one thread.
#[derive(Default)]
pub struct Buffers {
    image: Vec<f32>,
    blurring: Blurring,
    /// Scores that wait until there are whole groups of them.
    waiting: Vec<i16>,
}

impl Blurred {
    pub fn new(atoms: Atoms, mut pixel: Vec<Option<u32>>) -> Self {
        let mut first = pixel.iter().take(atoms.pixels()).zip(0..);
        if first.all(|(&pixel, place)| pixel == Some(place)) {
            pixel.clear();
        }
        Blurred { atoms, pixel }
    }

    pub fn length(&self) -> usize {
        self.atoms.count().next_multiple_of(GROUP)
    }

    /// Computes the scores of all atoms from those of single pixels; `out` keeps those that pass its
    /// filter. The blurred images of all sizes exceed the caches, so each part is filtered at once.
    pub fn run(&self, level: Level, single: &Scores, out: &mut Scores, buffers: &mut Buffers) {
        let Buffers {
            image,
            blurring,
            waiting,
        } = buffers;
        image.resize(self.atoms.pixels(), 0.0);
        let shift = (single.offset + (single.up - single.down) / 2.0) as f32;
        if self.pixel.is_empty() {
            shifted(level, &single.values, shift, image);
        }
        for (pixel, score) in self.pixel.iter().zip(&single.values) {
            if let Some(pixel) = pixel {
                image[*pixel as usize] = f32::from(*score) + shift;
            }
        }
        let step = self.set_bounds(level, single, image, out);
        let mut first = 0;
        waiting.clear();
        for plane in &self.atoms.planes {
            blurring.run(level, self.atoms.grid, plane, image, |values| {
                let before = waiting.len();
                waiting.resize(before + values.len(), 0);
                rounded(level, values, 1.0 / step, &mut waiting[before..]);
                let whole = waiting.len() - waiting.len() % GROUP;
                out.keep(level, first, &waiting[..whole]);
                waiting.drain(..whole);
                first += whole;
            });
        }
        waiting.resize(waiting.len().next_multiple_of(GROUP), 0);
        out.keep(level, first, waiting);
    }

    /// Sets the bounds on the errors of blurring and rounding; returns the step that scores are rounded to.
    fn set_bounds(&self, level: Level, single: &Scores, image: &[f32], out: &mut Scores) -> f32 {
        let taps = self.atoms.planes.iter().map(|plane| 2 * plane.kernel.len());
        // Two sums of `taps` products each, with kernels that sum to 1 and gains of at most 1.
        let roundings = 2 * taps.max().unwrap_or(0) + 8;
        let top = largest(level, image);
        let error = f64::from(top) * roundings as f64 * f64::from(f32::EPSILON);
        let margin = (single.up + single.down) / 2.0 + error;
        // No blurred score exceeds the largest single one. A finer step than the margin would only
        // resolve errors.
        let step = (top.max(margin as f32) / LARGEST).max(f32::MIN_POSITIVE);
        out.unit = single.unit * f64::from(step);
        out.offset = 0.0;
        out.up = HALF + margin / f64::from(step);
        out.down = out.up;
        out.begin();
        step
    }
}

/// 1.5 * 2^23: adding it rounds a float32 to the nearest integer, held in the low bits of the sum.
const MAGIC: f32 = 12_582_912.0;

multiversion! {
    fn shifted(scores: &[i16], shift: f32, out: &mut [f32]) {
        for (out, score) in out.iter_mut().zip(scores) {
            *out = f32::from(*score) + shift;
        }
    }
}

multiversion! {
    fn rounded(values: &[f32], scale: f32, out: &mut [i16]) {
        for (out, value) in out.iter_mut().zip(values) {
            *out = (value * scale + MAGIC).to_bits() as i16;
        }
    }
}
