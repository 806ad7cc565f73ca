//! Rounding to integers whose sums fit 16 bits, with a sure bound on what it does to any sum.

use super::tables::least_unit;
use crate::simd::{multiversion, Level};
use crate::vector::signed_sums;

/// Which sums of the integers have to fit.
#[derive(Clone, Copy, PartialEq)]
pub enum Sums {
    /// Sums over subsets (0/1 patterns), and those of a table in a byte.
    OfSubsets,
    /// Sums with any signs (+1/-1 patterns).
    Signed,
}

/// Up to so many values rounding to nearest is worth its share of the range.
const NEAREST: usize = 16_384;
const LARGEST: f64 = 32_700.0;
/// Covers the float64 rounding of the bounds themselves, in units.
const SLACK: f64 = 1e-3;

pub struct Rounded {
    pub unit: f64,
    /// Most that the exact sum over any subset may lie above the rounded one, in units.
    pub up: f64,
    /// Most that it may lie below, in units.
    pub down: f64,
}

/// Adding this number rounds to the nearest integer, which its low bits then hold.
pub const MAGIC: f64 = 6_755_399_441_055_744.0;
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
    // Denormal residuals would make the unit zero; as zeros they change no decision.
    let (unit, lost) = if range < f64::MIN_POSITIVE * 1e6 {
        (1.0, (0.0, 0.0))
    } else {
        // Most that rounding adds to a value, in units.
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
    /// Returns what rounding took away and what it added, in units.
    fn to_nearest(e: &[f64], scale: f64, out: &mut [i16]) -> (f64, f64) {
        let (mut up, mut down) = ([0.0; LANES], [0.0; LANES]);
        for (e, out) in e.chunks_exact(LANES).zip(out.chunks_exact_mut(LANES)) {
            for i in 0..LANES {
                let exact = e[i] * scale;
                let shifted = exact + MAGIC;
                // The range keeps integers within 16 bits.
                out[i] = shifted.to_bits() as i16;
                let lost = exact - (shifted - MAGIC);
                up[i] += lost.max(0.0);
                down[i] -= lost.min(0.0);
            }
        }
        (up.iter().sum(), down.iter().sum())
    }
}

/// As above, for so many values that rounding up could leave the range.
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
                // Unlike `max`, one instruction.
                most[i] = if value > most[i] { value } else { most[i] };
            }
        }
        most.iter().chain(rest).fold(0f32, |most, value| most.max(value.abs()))
    }
}
