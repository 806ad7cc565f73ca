//! Rounds values to integers whose sums fit 16 bits, with a guaranteed bound on the error of any sum.

use super::tables::least_unit;
use crate::simd::{multiversion, Level};
use crate::vector::signed_sums;

/// Which sums of the integers must fit 16 bits.
#[derive(Clone, Copy, PartialEq)]
pub enum Sums {
    /// Sums over subsets (0/1 patterns). The sums of a table must also fit a byte.
    OfSubsets,
    /// Sums with any signs (+1/-1 patterns).
    Signed,
}

/// Up to this many values are rounded to nearest, which may add half a unit each to a sum: a quarter of
/// the range at most. More values are rounded towards zero.
const NEAREST: usize = 16_384;
/// Largest sum, in units. It leaves room for float64 rounding within 16 bits (32,767).
const LARGEST: f64 = 32_700.0;
/// Margin of the bounds for their own float64 rounding, in units.
const SLACK: f64 = 1e-3;

pub struct Rounded {
    pub unit: f64,
    /// How far the exact sum over any subset may lie above the rounded one, in units.
    pub up: f64,
    /// How far it may lie below, in units.
    pub down: f64,
}

/// 1.5 * 2^52: adding it rounds a float64 to the nearest integer, held in the low bits of the sum.
pub const MAGIC: f64 = 6_755_399_441_055_744.0;
/// Number of independent partial sums.
const LANES: usize = 16;

/// Rounds the first `count` values of `e` (padded with zeros) to integers times a unit.
pub fn quantise(level: Level, e: &[f64], count: usize, sums: Sums, out: &mut Vec<i16>) -> Rounded {
    let (negative, positive) = signed_sums(level, e);
    let range = match sums {
        Sums::OfSubsets => positive.max(-negative),
        Sums::Signed => positive - negative,
    };
    out.clear();
    out.resize(e.len(), 0);
    // Denormal residuals would make the unit zero. Rounding them to zero changes no decision.
    let (unit, lost) = if range < f64::MIN_POSITIVE * 1e6 {
        (1.0, (0.0, 0.0))
    } else {
        // The most that rounding adds to a value, in units.
        let rounding = if count <= NEAREST { 0.5 } else { 0.0 };
        let least = match sums {
            Sums::OfSubsets => least_unit(level, &e[..count], rounding),
            Sums::Signed => 0.0,
        };
        let unit = (range / (LARGEST - rounding * count as f64)).max(least);
        let lost = if rounding > 0.0 {
            to_nearest(level, e, 1.0 / unit, out)
        } else {
            towards_zero(e, 1.0 / unit, out)
        };
        (unit, lost)
    };
    out.truncate(count);
    Rounded {
        unit,
        up: SLACK + lost.0,
        down: SLACK + lost.1,
    }
}

multiversion! {
    /// Returns how much rounding took away and how much it added in all, in units.
    fn to_nearest(e: &[f64], scale: f64, out: &mut [i16]) -> (f64, f64) {
        let (mut up, mut down) = ([0.0; LANES], [0.0; LANES]);
        for (e, out) in e.chunks_exact(LANES).zip(out.chunks_exact_mut(LANES)) {
            for i in 0..LANES {
                let exact = e[i] * scale;
                let shifted = exact + MAGIC;
                // The range guarantees that the integer fits 16 bits.
                out[i] = shifted.to_bits() as i16;
                let lost = exact - (shifted - MAGIC);
                up[i] += lost.max(0.0);
                down[i] -= lost.min(0.0);
            }
        }
        (up.iter().sum(), down.iter().sum())
    }
}

/// The same for so many values that rounding away from zero could exceed the range.
fn towards_zero(e: &[f64], scale: f64, out: &mut [i16]) -> (f64, f64) {
    let (mut up, mut down) = (0.0, 0.0);
    for (e, out) in e.iter().zip(out) {
        let exact = e * scale;
        *out = exact as i16;
        let lost = exact - f64::from(*out);
        up += lost.max(0.0);
        down -= lost.min(0.0);
    }
    (up, down)
}

multiversion! {
    /// The largest absolute value.
    pub fn largest(values: &[f32]) -> f32 {
        let mut most = [0f32; 16];
        let (parts, rest) = values.as_chunks::<16>();
        for part in parts {
            for i in 0..16 {
                let value = part[i].abs();
                // One instruction, unlike `max`.
                most[i] = if value > most[i] { value } else { most[i] };
            }
        }
        most.iter().chain(rest).fold(0f32, |most, value| most.max(value.abs()))
    }
}
