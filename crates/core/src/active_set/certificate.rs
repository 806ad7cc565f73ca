//! The certificate of a row: a dual value, which bounds how far from optimal the row is. In float64.
//!
//! The dual problem is: maximise sum y theta - theta^2 / (2 w) subject to A' theta <= lambda (in
//! absolute value if x may be negative), theta >= 0 on one-sided samples and m' theta <= 0 (= 0 if b
//! may be negative). The residual theta, moved onto the last constraint along m and scaled onto the
//! first ones, is a feasible point.

use crate::problem::Settings;
use crate::simd::Level;
use crate::vector::{dot, dual_sums, subtract_free, DataTerm};

/// Limit of the factor that scales the dual point. Near the optimum the best factor is 1; a much larger
/// one would only magnify rounding errors in m' theta = 0.
const LARGEST_SCALING: f64 = 2.0;

/// Moves `theta` along the means, on two-sided samples, until m' theta <= 0 (= 0 if b is free);
/// `energy` is the sum of the squared means over these samples.
///
/// Returns by how much m' theta was off. Where b is optimal that is no more than rounding.
pub fn orthogonal_to_means(
    level: Level,
    settings: &Settings,
    data: &DataTerm,
    means: &[f64],
    energy: f64,
    theta: &mut [f64],
) -> f64 {
    if !settings.background {
        return 0.0;
    }
    let excess = dot(level, theta, means);
    if excess == 0.0 || (settings.nonnegative && excess < 0.0) {
        return 0.0;
    }
    if energy > 0.0 {
        let (weights, lower) = (&data.weights, &data.lower);
        subtract_free(level, theta, excess / energy, means, weights, lower);
    } else {
        // Only one-sided samples have a slope along the means: drop them from the dual point.
        for k in (0..theta.len()).filter(|&k| means[k] > 0.0) {
            theta[k] = 0.0;
        }
    }
    excess.abs()
}

/// The dual value of the best scaling of `theta` whose correlations stay within lambda, given the
/// largest correlation of `theta` itself.
pub fn dual_value(
    level: Level,
    regularization: f64,
    data: &DataTerm,
    theta: &[f64],
    largest: f64,
) -> f64 {
    let (linear, square) = dual_sums(level, &data.y, &data.inverse, theta);
    if square <= 0.0 {
        return 0.0;
    }
    // The dual value is a parabola in the scaling. Take its top, or the last feasible scaling below it.
    let limit = if largest > 0.0 {
        regularization / largest
    } else {
        f64::INFINITY
    };
    let scaling = (linear / square).clamp(0.0, limit.min(LARGEST_SCALING));
    scaling * linear - scaling * scaling * square / 2.0
}
