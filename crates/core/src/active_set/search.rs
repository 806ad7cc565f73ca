//! Exact minimisation along a line and over the background.

use crate::simd::Level;
use crate::vector::{along, DataTerm};

/// Newton steps on a piecewise linear slope; each pins down the piece or halves the bracket.
const STEPS: usize = 40;

/// The step t in [0, limit], limit <= 1, that minimises `linear t + data term(u + t v)`, a convex
/// function that falls at 0 and is expected to have its minimum near 1.
pub fn line(level: Level, data: &DataTerm, u: &[f64], v: &[f64], linear: f64, limit: f64) -> f64 {
    let slope_at = |t: f64| {
        let (slope, curve) = along(level, &data.y, &data.weights, &data.lower, u, v, t);
        (slope + linear, curve)
    };
    let (start, _) = slope_at(0.0);
    if start >= 0.0 {
        return 0.0;
    }
    let mut t = limit;
    let (mut low, mut high) = (0.0, limit);
    for _ in 0..STEPS {
        let (slope, curve) = slope_at(t);
        // A hundredth of the first slope: the next round starts from an exact residual anyway.
        if slope.abs() <= 0.01 * -start || (t == limit && slope < 0.0) {
            break;
        }
        if slope < 0.0 {
            low = t;
        } else {
            high = t;
        }
        let newton = t - slope / curve;
        t = if newton > low && newton < high {
            newton
        } else {
            (low + high) / 2.0
        };
    }
    t
}

/// The step t that minimises the data term of u + t m, with b + t >= `lowest`, up to a slope of
/// `negligible`.
pub fn background(
    level: Level,
    data: &DataTerm,
    u: &[f64],
    means: &[f64],
    floor: f64,
    negligible: f64,
) -> f64 {
    let mut t = floor.max(0.0);
    let (mut low, mut high) = (floor, f64::INFINITY);
    for _ in 0..STEPS {
        let (slope, curve) = along(level, &data.y, &data.weights, &data.lower, u, means, t);
        if slope.abs() <= negligible || (t == floor && slope >= 0.0) {
            break;
        }
        if slope < 0.0 {
            low = t;
        } else {
            high = t;
        }
        let newton = t - slope / curve;
        t = if newton > low && newton < high {
            newton
        } else if slope > 0.0 && low == floor && floor.is_finite() {
            // Beyond the bound: it is the minimum, or the next step leaves it again.
            low = f64::NEG_INFINITY;
            floor
        } else if low.is_finite() && high.is_finite() {
            (low + high) / 2.0
        } else {
            newton.max(floor)
        };
    }
    t
}
