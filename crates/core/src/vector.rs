//! The inner loops over the samples of a row, in float64.
//!
//! Vectors are padded with zeros: to a multiple of `LANES` samples where columns of bits are used, else to
//! a multiple of `SUMS`. Sums run in `SUMS` lanes, so that they are the same on every CPU.

use crate::simd::multiversion;
use std::ops::AddAssign;

/// Vectors are padded to a multiple of this: the bits of a word of a bit column.
pub const LANES: usize = 64;
/// Number of independent partial sums of a reduction: two AVX-512 registers.
pub(crate) const SUMS: usize = 16;

/// The padded length of `samples` values.
pub fn padded(samples: usize) -> usize {
    samples.div_ceil(LANES) * LANES
}

/// `samples` rounded up to a multiple of `SUMS`, the length that sums need.
pub fn summed(samples: usize) -> usize {
    samples.next_multiple_of(SUMS)
}

/// Adds partial sums in a fixed order.
#[inline(always)]
pub(crate) fn fold<T: Copy + AddAssign>(mut sums: [T; SUMS]) -> T {
    let mut half = SUMS / 2;
    while half > 0 {
        for i in 0..half {
            sums[i] += sums[i + half];
        }
        half /= 2;
    }
    sums[0]
}

/// Sums of one block of samples, plus that of factor a_j for all `terms` (j, factor). They stay in
/// registers. `columns` has the a_j side by side, `stride` values each.
#[inline(always)]
pub(crate) fn add_terms<T: Copy + Into<f32>>(
    columns: &[T],
    stride: usize,
    block: usize,
    terms: &[(u32, f32)],
    mut sums: [f32; LANES],
) -> [f32; LANES] {
    for (pixel, factor) in terms {
        let column = &columns[*pixel as usize * stride + block * LANES..][..LANES];
        for i in 0..LANES {
            sums[i] += factor * column[i].into();
        }
    }
    sums
}

multiversion! {
    /// sum a b
    pub fn dot(a: &[f64], b: &[f64]) -> f64 {
        let mut sums = [0.0; SUMS];
        for (a, b) in a.chunks_exact(SUMS).zip(b.chunks_exact(SUMS)) {
            for i in 0..SUMS {
                sums[i] += a[i] * b[i];
            }
        }
        fold(sums)
    }
}

multiversion! {
    /// y += factor x
    pub fn add_scaled(y: &mut [f64], factor: f64, x: &[f64]) {
        for (y, x) in y.iter_mut().zip(x) {
            *y += factor * x;
        }
    }
}

multiversion! {
    /// The smallest and the largest sum over any subset: the sum of the negative values and the sum of
    /// the positive values.
    pub fn signed_sums(values: &[f64]) -> (f64, f64) {
        let (mut low, mut high) = ([0.0; SUMS], [0.0; SUMS]);
        for values in values.chunks_exact(SUMS) {
            for i in 0..SUMS {
                low[i] += values[i].min(0.0);
                high[i] += values[i].max(0.0);
            }
        }
        (fold(low), fold(high))
    }
}

/// The data term of one row, sum_k w_k max(y_k - u_k, lower_k)^2 / 2, in padded vectors.
///
/// `lower` is 0 on one-sided samples and minus infinity elsewhere; weights are 0 on samples that do
/// not count.
#[derive(Default)]
pub struct DataTerm {
    pub y: Vec<f64>,
    pub weights: Vec<f64>,
    /// 1 / weights, or 0 where a weight is 0. A division takes ten times as long as a product.
    pub inverse: Vec<f64>,
    pub lower: Vec<f64>,
}

multiversion! {
    /// out = 1 / w, or 0 where w is 0.
    pub fn invert(weights: &[f64], out: &mut [f64]) {
        for (out, w) in out.iter_mut().zip(weights) {
            *out = if *w > 0.0 { 1.0 / w } else { 0.0 };
        }
    }
}

multiversion! {
    /// out = 0 where a sample is clipped, minus infinity elsewhere.
    pub fn one_sided(clipped: &[bool], out: &mut [f64]) {
        for (out, clipped) in out.iter_mut().zip(clipped) {
            *out = if *clipped { 0.0 } else { f64::NEG_INFINITY };
        }
    }
}

multiversion! {
    /// The sum of the squared means over the two-sided samples that count.
    pub fn free_energy(means: &[f64], weights: &[f64], lower: &[f64]) -> f64 {
        let mut sums = [0.0; SUMS];
        let n = means.len();
        let (weights, lower) = (&weights[..n], &lower[..n]);
        for start in (0..n / SUMS).map(|i| i * SUMS) {
            let means = &means[start..start + SUMS];
            let (weights, lower) = (&weights[start..start + SUMS], &lower[start..start + SUMS]);
            for i in 0..SUMS {
                // A mask, as the compiler turns `if` into a branch here.
                let free = (weights[i] > 0.0) & (lower[i] == f64::NEG_INFINITY);
                let mask = u64::from(free).wrapping_neg();
                sums[i] += f64::from_bits((means[i] * means[i]).to_bits() & mask);
            }
        }
        fold(sums)
    }
}

multiversion! {
    /// theta -= factor m on two-sided samples that count.
    pub fn subtract_free(
        theta: &mut [f64], factor: f64, means: &[f64], weights: &[f64], lower: &[f64]
    ) {
        for (((theta, m), w), l) in theta.iter_mut().zip(means).zip(weights).zip(lower) {
            let free = (*w > 0.0) & (*l == f64::NEG_INFINITY);
            *theta -= if free { factor * m } else { 0.0 };
        }
    }
}

multiversion! {
    /// theta = w max(y - u, lower) and the data term's value, sum w max(y - u, lower)^2 / 2.
    pub fn residual(
        y: &[f64], weights: &[f64], lower: &[f64], u: &[f64], theta: &mut [f64]
    ) -> f64 {
        let mut sums = [0.0; SUMS];
        let n = theta.len();
        let (y, weights, lower, u) = (&y[..n], &weights[..n], &lower[..n], &u[..n]);
        for start in (0..n / SUMS).map(|i| i * SUMS) {
            let theta = &mut theta[start..start + SUMS];
            let (y, weights) = (&y[start..start + SUMS], &weights[start..start + SUMS]);
            let (lower, u) = (&lower[start..start + SUMS], &u[start..start + SUMS]);
            for i in 0..SUMS {
                let r = y[i] - u[i];
                let r = if r > lower[i] { r } else { lower[i] };
                let t = weights[i] * r;
                theta[i] = t;
                sums[i] += t * r;
            }
        }
        fold(sums) / 2.0
    }
}

multiversion! {
    /// Curvature of the data term, d_k = w_k where y - u > lower, else 0.
    pub fn curvature(
        y: &[f64], weights: &[f64], lower: &[f64], u: &[f64], d: &mut [f64]
    ) {
        for ((((d, y), w), l), u) in d.iter_mut().zip(y).zip(weights).zip(lower).zip(u) {
            *d = if y - u > *l { *w } else { 0.0 };
        }
    }
}

multiversion! {
    /// Slope and curvature of the data term along u + t v: (sum -theta v, sum d v^2).
    pub fn along(
        y: &[f64], weights: &[f64], lower: &[f64], u: &[f64], v: &[f64], t: f64
    ) -> (f64, f64) {
        let (mut slope, mut curve) = ([0.0; SUMS], [0.0; SUMS]);
        let n = v.len();
        let (y, weights, lower, u) = (&y[..n], &weights[..n], &lower[..n], &u[..n]);
        for start in (0..n / SUMS).map(|i| i * SUMS) {
            let v = &v[start..start + SUMS];
            let (y, weights) = (&y[start..start + SUMS], &weights[start..start + SUMS]);
            let (lower, u) = (&lower[start..start + SUMS], &u[start..start + SUMS]);
            for i in 0..SUMS {
                let r = y[i] - (u[i] + t * v[i]);
                let wv = weights[i] * v[i];
                slope[i] -= wv * if r > lower[i] { r } else { lower[i] };
                curve[i] += if r > lower[i] { wv * v[i] } else { 0.0 };
            }
        }
        (fold(slope), fold(curve))
    }
}

multiversion! {
    /// sum y theta and sum theta^2 / w over the samples that count.
    pub fn dual_sums(y: &[f64], inverse: &[f64], theta: &[f64]) -> (f64, f64) {
        let (mut linear, mut square) = ([0.0; SUMS], [0.0; SUMS]);
        let n = theta.len();
        let (y, inverse) = (&y[..n], &inverse[..n]);
        for start in (0..n / SUMS).map(|i| i * SUMS) {
            let (y, inverse) = (&y[start..start + SUMS], &inverse[start..start + SUMS]);
            let theta = &theta[start..start + SUMS];
            for i in 0..SUMS {
                linear[i] += y[i] * theta[i];
                square[i] += theta[i] * theta[i] * inverse[i];
            }
        }
        (fold(linear), fold(square))
    }
}
