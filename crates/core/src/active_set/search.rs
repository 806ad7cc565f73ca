//! Exact minimisation along a line and over the background.

use crate::simd::Level;
use crate::vector::{along, DataTerm};

/// Limit of Newton steps on the piecewise linear slope. Each step finds the linear piece of the minimum
/// or halves the bracket, so 40 steps reach it to one part in 10^12.
const STEPS: usize = 40;
/// A line search stops when the slope has fallen to this share of its first value. The next Newton step
/// starts from an exact residual, so more accuracy gains nothing. Chosen by hand.
const SLOPE_SHARE: f64 = 0.01;

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
        if slope.abs() <= SLOPE_SHARE * -start || (t == limit && slope < 0.0) {
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

/// The step t >= `floor` that minimises the data term of u + t m, up to a slope of `negligible`.
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
            // The minimum lies at the bound, or the next step moves away from it again.
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
