//! Inner products of columns of float32 with a vector, four columns at a time.

use crate::simd::multiversion;
use crate::vector::{fold, SUMS};
use std::ops::AddAssign;

multiversion! {
    /// Inner products of some columns, all as long as `e`.
    pub fn mixed_dots(columns: &[f32], pixels: &[u32], e: &[f64], out: &mut [f64]) {
        by_fours(columns, pixels, e, out, |sum, a, e| *sum += f64::from(a) * e);
    }
}

multiversion! {
    /// The same, summed in float32.
    pub fn single_dots(columns: &[f32], pixels: &[u32], e: &[f32], out: &mut [f64]) {
        by_fours(columns, pixels, e, out, |sum, a, e| *sum += a * e);
    }
}

/// Inner products of some columns, four at a time: they share each reading of `e`.
#[inline(always)]
fn by_fours<T: Copy + Default + AddAssign + Into<f64>>(
    columns: &[f32],
    pixels: &[u32],
    e: &[T],
    out: &mut [f64],
    add_product: impl Fn(&mut T, f32, T) + Copy,
) {
    for (out, pixels) in out.chunks_mut(4).zip(pixels.chunks(4)) {
        let dots = dots(columns, filled(pixels), e, add_product);
        for (out, dot) in out.iter_mut().zip(dots) {
            *out = dot.into();
        }
    }
}

/// One to four pixels, the last one repeated to make four: four columns take hardly longer than one.
#[inline(always)]
pub fn filled(pixels: &[u32]) -> [u32; 4] {
    std::array::from_fn(|i| pixels[i.min(pixels.len() - 1)])
}

/// Inner products of four columns.
#[inline(always)]
fn dots<T: Copy + Default + AddAssign>(
    columns: &[f32],
    pixels: [u32; 4],
    e: &[T],
    add_product: impl Fn(&mut T, f32, T),
) -> [T; 4] {
    let columns = pixels.map(|pixel| {
        let column = &columns[pixel as usize * e.len()..][..e.len()];
        column.as_chunks::<SUMS>().0
    });
    let mut sums = [[T::default(); SUMS]; 4];
    for (place, e) in e.as_chunks::<SUMS>().0.iter().enumerate() {
        for (sums, column) in sums.iter_mut().zip(&columns) {
            let a = &column[place];
            for i in 0..SUMS {
                add_product(&mut sums[i], a[i], e[i]);
            }
        }
    }
    sums.map(fold)
}
