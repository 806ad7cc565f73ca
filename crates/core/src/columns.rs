//! Columns of P. Column j says how much projector pixel j contributes to each sample of a row.

use crate::bits::{column_codes, Bits};
use crate::dots::{filled, mixed_dots, single_dots};
use crate::simd::{multiversion, Kind, Level};
use crate::vector::{add_terms, fold, padded, LANES, SUMS};
use crate::words::WordColumns;
use rayon::prelude::*;

/// Columns of 0/1 patterns as words of 64 samples, least significant bit first.
pub struct BitColumns {
    words: Vec<u64>,
    stride: usize,
}

impl BitColumns {
    pub fn new(bits: Bits) -> Self {
        let (pixels, stride) = (bits.pixels(), padded(bits.patterns()) / 64);
        let codes = column_codes(bits);
        let mut words = vec![0u64; pixels * stride];
        words
            .par_chunks_mut(stride.max(1) * 256)
            .enumerate()
            .for_each(|(block, words)| {
                for (group, codes) in codes.chunks_exact(pixels).enumerate() {
                    let codes = &codes[block * 256..];
                    for (words, code) in words.chunks_exact_mut(stride).zip(codes) {
                        words[group / 8] |= u64::from(*code) << (8 * (group % 8));
                    }
                }
            });
        BitColumns { words, stride }
    }

    /// Number of words of a column.
    pub fn stride(&self) -> usize {
        self.stride
    }

    pub fn column(&self, pixel: u32) -> &[u64] {
        &self.words[pixel as usize * self.stride..][..self.stride]
    }
}

/// Columns of any patterns, float32, padded.
pub struct DenseColumns {
    values: Vec<f32>,
    stride: usize,
    largest: f64,
    /// Whether inner products of two columns may be summed in float32.
    quick_products: bool,
}

impl DenseColumns {
    /// From P, (patterns, pixels) in C order.
    ///
    /// # Panics
    /// If `p` does not hold `patterns * pixels` values.
    pub fn new(p: &[f32], patterns: usize, pixels: usize) -> Self {
        assert_eq!(p.len(), patterns * pixels);
        let stride = padded(patterns);
        let mut values = vec![0f32; pixels * stride];
        values
            .par_chunks_mut(stride.max(1) * 64)
            .enumerate()
            .for_each(|(block, values)| {
                for (k, row) in p.chunks_exact(pixels).enumerate() {
                    for (column, value) in values.chunks_exact_mut(stride).zip(&row[block * 64..]) {
                        column[k] = *value;
                    }
                }
            });
        let largest = p.iter().fold(0f32, |m, v| m.max(v.abs())).into();
        DenseColumns {
            values,
            stride,
            largest,
            quick_products: false,
        }
    }

    /// From columns side by side, each padded to `stride` values, none of whose absolute values
    /// exceeds `largest`.
    ///
    /// # Panics
    /// If `values` does not hold whole columns.
    pub fn from_padded(values: Vec<f32>, stride: usize, largest: f64) -> Self {
        assert!(values.len().is_multiple_of(stride.max(1)));
        DenseColumns {
            values,
            stride,
            largest,
            quick_products: false,
        }
    }

    /// The same columns, of which inner products are summed in float32: three times as fast, and to
    /// within about a millionth. Enough where the columns themselves are not known any better.
    pub fn with_quick_products(self) -> Self {
        DenseColumns {
            quick_products: true,
            ..self
        }
    }

    /// The memory of the columns, for reuse.
    pub fn into_values(self) -> Vec<f32> {
        self.values
    }

    pub fn column(&self, pixel: u32) -> &[f32] {
        &self.values[pixel as usize * self.stride..][..self.stride]
    }

    /// The columns of a range of pixels, side by side.
    pub fn block(&self, pixels: std::ops::Range<usize>) -> &[f32] {
        &self.values[pixels.start * self.stride..pixels.end * self.stride]
    }

    /// The largest absolute value of any pattern.
    pub fn largest(&self) -> f64 {
        self.largest
    }
}

/// Columns of P in one of three storage formats.
pub enum Columns {
    Bits(BitColumns),
    Dense(DenseColumns),
    Words(WordColumns),
}

impl Columns {
    /// The largest difference between a stored value and the pattern's own.
    pub fn lost(&self) -> f64 {
        match self {
            Columns::Bits(_) | Columns::Dense(_) => 0.0,
            Columns::Words(_) => WordColumns::LOST,
        }
    }

    /// Whether `quick_products` applies.
    pub fn has_quick_products(&self) -> bool {
        matches!(self, Columns::Dense(dense) if dense.quick_products)
    }

    /// a_j . e for each of `pixels`, summed in float32, for columns that allow it; `e` is padded.
    ///
    /// # Panics
    /// For columns that do not.
    pub fn quick_products(&self, level: Level, pixels: &[u32], e: &[f32], out: &mut [f64]) {
        let Columns::Dense(dense) = self else {
            panic!("only dense columns have quick products");
        };
        assert!(pixels.len() == out.len() && dense.stride == e.len());
        single_dots(level, &dense.values, pixels, e, out);
    }

    /// a_j . e for each of `pixels`, in float64; `e` is padded.
    pub fn correlate(&self, level: Level, pixels: &[u32], e: &[f64], out: &mut [f64]) {
        assert_eq!(pixels.len(), out.len());
        match self {
            Columns::Bits(bits) => {
                assert_eq!(64 * bits.stride(), e.len());
                for pixel in pixels {
                    prefetch(bits.column(*pixel));
                }
                for (out, pixels) in out.chunks_mut(4).zip(pixels.chunks(4)) {
                    let columns = filled(pixels).map(|pixel| bits.column(pixel));
                    out.copy_from_slice(&masked_sums(level, columns, e)[..out.len()]);
                }
            }
            Columns::Dense(dense) => {
                assert_eq!(dense.stride, e.len());
                mixed_dots(level, &dense.values, pixels, e, out);
            }
            Columns::Words(words) => {
                for (out, pixel) in out.iter_mut().zip(pixels) {
                    *out = words.correlate(level, *pixel, e);
                }
            }
        }
    }

    /// out = factor a_j, padded, in float32.
    pub fn copy_scaled(&self, level: Level, pixel: u32, factor: f32, out: &mut [f32]) {
        match self {
            Columns::Bits(bits) => expand(level, bits.column(pixel), factor, out),
            Columns::Dense(dense) => times(level, dense.column(pixel), factor, out),
            Columns::Words(words) => words.copy_scaled(level, pixel, factor, out),
        }
    }

    /// u += factor a_j
    pub fn add(&self, level: Level, pixel: u32, factor: f64, u: &mut [f64]) {
        match self {
            Columns::Bits(bits) => masked_add(level, bits.column(pixel), factor, u),
            Columns::Dense(dense) => mixed_add(level, dense.column(pixel), factor, u),
            Columns::Words(words) => words.add(level, pixel, factor, u),
        }
    }

    /// u += factor a_j for all `terms` (j, factor), in their order.
    pub fn add_all(&self, level: Level, terms: &[(u32, f64)], u: &mut [f64]) {
        #[cfg(target_arch = "x86_64")]
        if let (Columns::Bits(bits), Kind::Avx512) = (self, level.kind()) {
            assert_eq!(64 * bits.stride(), u.len());
            for (pixel, _) in terms {
                prefetch(bits.column(*pixel));
            }
            // SAFETY: the level proves the instructions; the lengths were just compared.
            unsafe { avx512::add_all(bits, terms, u) };
            return;
        }
        for &(pixel, factor) in terms {
            self.add(level, pixel, factor, u);
        }
    }

    /// u += factor a_j for all `terms` (j, factor), in float32.
    pub fn add_all_f32(&self, level: Level, terms: &[(u32, f32)], u: &mut [f32]) {
        match self {
            Columns::Bits(bits) => {
                for (pixel, factor) in terms {
                    masked_add_f32(level, bits.column(*pixel), *factor, u);
                }
            }
            Columns::Dense(dense) => add_columns(level, &dense.values, dense.stride, terms, u),
            Columns::Words(words) => words.add_all_f32(level, terms, u),
        }
    }

    /// out = d a_j, element by element.
    pub fn scaled(&self, level: Level, pixel: u32, d: &[f64], out: &mut [f64]) {
        match self {
            Columns::Bits(bits) => masked(level, bits.column(pixel), d, out),
            Columns::Dense(dense) => mixed_product(level, dense.column(pixel), d, out),
            Columns::Words(words) => words.scaled(level, pixel, d, out),
        }
    }
}

/// Prefetches a column that is needed soon. A pass over all pixels leaves few columns in the nearer caches,
/// and the processor cannot predict which columns come next.
fn prefetch(words: &[u64]) {
    #[cfg(target_arch = "x86_64")]
    for line in words.chunks(8) {
        use std::arch::x86_64::{_mm_prefetch, _MM_HINT_T0};
        // SAFETY: every x86-64 processor has the instruction, and it never faults.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast()) };
    }
}

/// For four columns, the sums of the values whose bits are set.
fn masked_sums(level: Level, columns: [&[u64]; 4], e: &[f64]) -> [f64; 4] {
    match level.kind() {
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512 => {
            assert!(columns.iter().all(|words| 64 * words.len() == e.len()));
            // SAFETY: the level proves the instructions; the lengths were just compared.
            unsafe { avx512::masked_sums(columns, e) }
        }
        _ => columns.map(|words| masked_sum_plain(level, words, e)),
    }
}

multiversion! {
    fn masked_sum_plain(words: &[u64], e: &[f64]) -> f64 {
        let mut sums = [0.0; SUMS];
        for (word, e) in words.iter().zip(e.chunks_exact(64)) {
            for (part, e) in e.chunks_exact(SUMS).enumerate() {
                let bits = word >> (part * SUMS);
                for i in 0..SUMS {
                    let keep = 0u64.wrapping_sub(bits >> i & 1);
                    sums[i] += f64::from_bits(e[i].to_bits() & keep);
                }
            }
        }
        fold(sums)
    }
}

/// u += factor where the bit is set.
fn masked_add(level: Level, words: &[u64], factor: f64, u: &mut [f64]) {
    assert_eq!(64 * words.len(), u.len());
    match level.kind() {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the level proves the instructions; the lengths were just compared.
        Kind::Avx512 => unsafe { avx512::masked_add(words, factor, u) },
        _ => masked_add_plain(level, words, factor, u),
    }
}

multiversion! {
    fn masked_add_plain(words: &[u64], factor: f64, u: &mut [f64]) {
        for (word, u) in words.iter().zip(u.chunks_exact_mut(64)) {
            for (i, u) in u.iter_mut().enumerate() {
                let keep = 0u64.wrapping_sub(word >> i & 1);
                *u += f64::from_bits(factor.to_bits() & keep);
            }
        }
    }
}

multiversion! {
    fn masked_add_f32(words: &[u64], factor: f32, u: &mut [f32]) {
        for (word, u) in words.iter().zip(u.chunks_exact_mut(64)) {
            for (i, u) in u.iter_mut().enumerate() {
                let keep = 0u32.wrapping_sub((word >> i & 1) as u32);
                *u += f32::from_bits(factor.to_bits() & keep);
            }
        }
    }
}

multiversion! {
    fn masked(words: &[u64], d: &[f64], out: &mut [f64]) {
        for ((word, d), out) in words.iter().zip(d.chunks_exact(64)).zip(out.chunks_exact_mut(64)) {
            for (i, (d, out)) in d.iter().zip(out).enumerate() {
                let keep = 0u64.wrapping_sub(word >> i & 1);
                *out = f64::from_bits(d.to_bits() & keep);
            }
        }
    }
}

multiversion! {
    /// out = factor values
    pub(crate) fn times(values: &[f32], factor: f32, out: &mut [f32]) {
        for (out, value) in out.iter_mut().zip(values) {
            *out = factor * value;
        }
    }
}

multiversion! {
    /// out = factor where the bit is set, else 0.
    fn expand(words: &[u64], factor: f32, out: &mut [f32]) {
        for (word, out) in words.iter().zip(out.chunks_exact_mut(64)) {
            for (i, out) in out.iter_mut().enumerate() {
                let keep = 0u32.wrapping_sub((word >> i & 1) as u32);
                *out = f32::from_bits(factor.to_bits() & keep);
            }
        }
    }
}

multiversion! {
    /// u += factor a_j for all terms.
    fn add_columns(columns: &[f32], stride: usize, terms: &[(u32, f32)], u: &mut [f32]) {
        for (block, u) in u.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            *u = add_terms(columns, stride, block, terms, *u);
        }
    }
}

multiversion! {
    fn mixed_add(column: &[f32], factor: f64, u: &mut [f64]) {
        for (a, u) in column.iter().zip(u) {
            *u += f64::from(*a) * factor;
        }
    }
}

multiversion! {
    fn mixed_product(column: &[f32], d: &[f64], out: &mut [f64]) {
        for ((a, d), out) in column.iter().zip(d).zip(out) {
            *out = f64::from(*a) * d;
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::{fold, BitColumns};
    use std::arch::x86_64::*;

    /// # Safety
    /// `e` holds 64 values for each word of every column.
    #[target_feature(enable = "avx512f")]
    pub unsafe fn masked_sums(columns: [&[u64]; 4], e: &[f64]) -> [f64; 4] {
        let mut sums = [[_mm512_setzero_pd(); 2]; 4];
        for w in 0..e.len() / 64 {
            // SAFETY: w is below the number of words of every column.
            let words = columns.map(|column| unsafe { *column.get_unchecked(w) });
            for part in 0..8 {
                // SAFETY: 64 w + 8 part + 8 <= 64 (w + 1), which `e` holds.
                let values = unsafe { _mm512_loadu_pd(e.as_ptr().add(64 * w + 8 * part)) };
                for (sums, word) in sums.iter_mut().zip(words) {
                    let sum = &mut sums[part % 2];
                    *sum = _mm512_mask_add_pd(*sum, (word >> (8 * part)) as u8, *sum, values);
                }
            }
        }
        sums.map(|sums| {
            let mut lanes = [0.0; 16];
            // SAFETY: 16 lanes are two registers of eight.
            unsafe {
                _mm512_storeu_pd(lanes.as_mut_ptr(), sums[0]);
                _mm512_storeu_pd(lanes.as_mut_ptr().add(8), sums[1]);
            }
            fold(lanes)
        })
    }

    /// # Safety
    /// `u` holds 64 values for each word of a column.
    #[target_feature(enable = "avx512f")]
    pub unsafe fn add_all(bits: &BitColumns, terms: &[(u32, f64)], u: &mut [f64]) {
        for (w, u) in u.as_chunks_mut::<64>().0.iter_mut().enumerate() {
            // SAFETY, for both: eight registers of eight values.
            let at = |part: usize| unsafe { _mm512_loadu_pd(u.as_ptr().add(8 * part)) };
            let mut sums: [__m512d; 8] = std::array::from_fn(at);
            for &(pixel, factor) in terms {
                let (word, factor) = (bits.column(pixel)[w], _mm512_set1_pd(factor));
                for (part, sum) in sums.iter_mut().enumerate() {
                    *sum = _mm512_mask_add_pd(*sum, (word >> (8 * part)) as u8, *sum, factor);
                }
            }
            for (part, sum) in sums.into_iter().enumerate() {
                unsafe { _mm512_storeu_pd(u.as_mut_ptr().add(8 * part), sum) };
            }
        }
    }

    /// # Safety
    /// `u` holds 64 values for each word.
    #[target_feature(enable = "avx512f")]
    pub unsafe fn masked_add(words: &[u64], factor: f64, u: &mut [f64]) {
        let factor = _mm512_set1_pd(factor);
        for (w, &word) in words.iter().enumerate() {
            for part in 0..8 {
                // SAFETY: 64 w + 8 part + 8 <= 64 (w + 1), which `u` holds.
                unsafe {
                    let at = u.as_mut_ptr().add(64 * w + 8 * part);
                    let values = _mm512_loadu_pd(at);
                    let mask = (word >> (8 * part)) as u8;
                    _mm512_storeu_pd(at, _mm512_mask_add_pd(values, mask, values, factor));
                }
            }
        }
    }
}
