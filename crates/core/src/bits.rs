//! Products with 0/1 patterns stored as bits, least significant bit first along the pixels.
//!
//! Both products use tables of partial sums ('four Russians'): a byte of a pattern picks one of 256
//! sums. A table costs 256 additions and saves seven at each use.

use crate::float::Float;
use crate::subsets::subset_sums;
use rayon::prelude::*;

/// Correlations of a row that are summed together: they stay in the nearest cache.
const BLOCK: usize = 2048;
/// Blocks that one thread handles at a time, enough to hide the cost of starting a task.
const TASK: usize = 8;

/// K patterns over N pixels, each pattern in `stride = ceil(N / 8)` bytes.
#[derive(Clone, Copy)]
pub struct Bits<'a> {
    bytes: &'a [u8],
    patterns: usize,
    pixels: usize,
}

impl<'a> Bits<'a> {
    /// # Panics
    /// If `bytes` does not hold `patterns * ceil(pixels / 8)` bytes.
    pub fn new(bytes: &'a [u8], patterns: usize, pixels: usize) -> Self {
        assert_eq!(bytes.len(), patterns * pixels.div_ceil(8));
        Bits {
            bytes,
            patterns,
            pixels,
        }
    }

    pub fn patterns(&self) -> usize {
        self.patterns
    }

    pub fn pixels(&self) -> usize {
        self.pixels
    }

    pub fn stride(&self) -> usize {
        self.pixels.div_ceil(8)
    }

    /// The bytes of one pattern.
    pub fn pattern(&self, k: usize) -> &'a [u8] {
        &self.bytes[k * self.stride()..(k + 1) * self.stride()]
    }

    /// Whether a pattern lights a pixel.
    pub fn lit(&self, k: usize, pixel: usize) -> bool {
        self.pattern(k)[pixel / 8] >> (pixel % 8) & 1 == 1
    }
}

/// `out = x P'`: rows of `x` hold N coefficients, rows of `out` K samples.
///
/// # Panics
/// If the lengths do not match `rows`.
pub fn forward<T: Float>(bits: Bits, rows: usize, x: &[T], out: &mut [T]) {
    assert_eq!(x.len(), rows * bits.pixels());
    assert_eq!(out.len(), rows * bits.patterns());
    if x.is_empty() || out.is_empty() {
        return;
    }
    x.par_chunks(bits.pixels())
        .zip(out.par_chunks_mut(bits.patterns()))
        .for_each(|(x, out)| forward_row(bits, x, out));
}

fn forward_row<T: Float>(bits: Bits, x: &[T], out: &mut [T]) {
    // Eight tables at a time, so that a pass over the patterns reads 64 bits of each.
    const GROUP: usize = 8;
    let mut tables = [[T::default(); 256]; GROUP];
    out.fill(T::default());
    for (word, values) in x.chunks(8 * GROUP).enumerate() {
        // Rows of T are mostly zero, so skip words without light.
        if values.iter().all(|v| is_zero(*v)) {
            continue;
        }
        let used = values.len().div_ceil(8);
        for (values, table) in values.chunks(8).zip(tables.iter_mut()) {
            subset_sums(values, table);
        }
        for (k, sum) in out.iter_mut().enumerate() {
            let start = word * GROUP;
            let bytes = &bits.pattern(k)[start..start + used];
            for (byte, table) in bytes.iter().zip(&tables) {
                *sum += table[*byte as usize & mask(values.len(), byte, bytes)];
            }
        }
    }
}

/// A mask for the last byte of a pattern: bits beyond the last pixel are padding.
fn mask(values: usize, byte: &u8, bytes: &[u8]) -> usize {
    let last = std::ptr::eq(byte, &bytes[bytes.len() - 1]);
    match values % 8 {
        rest if last && rest != 0 => (1 << rest) - 1,
        _ => 0xff,
    }
}

fn is_zero<T: Float>(value: T) -> bool {
    value == T::default()
}

/// `out = e P`: rows of `e` hold K values, rows of `out` N correlations.
///
/// # Panics
/// If the lengths do not match `rows`.
pub fn adjoint<T: Float>(bits: Bits, rows: usize, e: &[T], out: &mut [T]) {
    assert_eq!(e.len(), rows * bits.patterns());
    assert_eq!(out.len(), rows * bits.pixels());
    if out.is_empty() {
        return;
    }
    if bits.patterns() == 0 {
        out.fill(T::default());
        return;
    }
    let codes = column_codes(bits);
    e.par_chunks(bits.patterns())
        .zip(out.par_chunks_mut(bits.pixels()))
        .for_each(|(e, out)| adjoint_row(&codes, e, out));
}

fn adjoint_row<T: Float>(codes: &[u8], e: &[T], out: &mut [T]) {
    let mut tables = vec![[T::default(); 256]; e.len().div_ceil(8)];
    for (values, table) in e.chunks(8).zip(&mut tables) {
        subset_sums(values, table);
    }
    let pixels = out.len();
    let blocks = out.par_chunks_mut(BLOCK).enumerate();
    blocks.with_min_len(TASK).for_each(|(block, out)| {
        out.fill(T::default());
        for (table, codes) in tables.iter().zip(codes.chunks(pixels)) {
            for (sum, code) in out.iter_mut().zip(&codes[block * BLOCK..]) {
                *sum += table[*code as usize];
            }
        }
    });
}

/// The transposed patterns, laid out (group, pixel): group g has one byte for each pixel, whose bit i is
/// pattern 8 g + i.
pub fn column_codes(bits: Bits) -> Vec<u8> {
    let pixels = bits.pixels();
    let mut codes = vec![0u8; bits.patterns().div_ceil(8) * pixels];
    codes
        .par_chunks_mut(pixels.max(1))
        .enumerate()
        .for_each(|(group, codes)| {
            let patterns: Vec<&[u8]> = (8 * group..(8 * group + 8).min(bits.patterns()))
                .map(|k| bits.pattern(k))
                .collect();
            for (place, codes) in codes.chunks_mut(8).enumerate() {
                let mut square = [0u8; 8];
                for (byte, pattern) in square.iter_mut().zip(&patterns) {
                    *byte = pattern[place];
                }
                let transposed = transpose(u64::from_le_bytes(square)).to_le_bytes();
                codes.copy_from_slice(&transposed[..codes.len()]);
            }
        });
    codes
}

/// Swaps the rows and columns of an 8 x 8 square of bits, of which a byte is a row (Warren, Hacker's Delight,
/// 2012, section 7-3).
fn transpose(square: u64) -> u64 {
    let swap = |square: u64, distance: u32, mask: u64| {
        let changed = (square ^ (square >> distance)) & mask;
        square ^ changed ^ (changed << distance)
    };
    let square = swap(square, 7, 0x00aa_00aa_00aa_00aa);
    let square = swap(square, 14, 0x0000_cccc_0000_cccc);
    swap(square, 28, 0x0000_0000_f0f0_f0f0)
}

/// The columns `index` of P, as (K, index.len()).
///
/// # Panics
/// If an index is beyond the pixels, or `out` has the wrong length.
pub fn columns(bits: Bits, index: &[usize], out: &mut [f32]) {
    assert_eq!(out.len(), bits.patterns() * index.len());
    if index.is_empty() {
        return;
    }
    let rows = out.par_chunks_mut(index.len()).enumerate();
    rows.for_each(|(k, row)| {
        let pattern = bits.pattern(k);
        for (value, &pixel) in row.iter_mut().zip(index) {
            *value = f32::from(pattern[pixel / 8] >> (pixel % 8) & 1);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example(patterns: usize, pixels: usize) -> (Vec<u8>, Vec<f64>, Vec<f64>) {
        let mut state = 7u64;
        let mut next = move || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 33) as u32
        };
        let bytes = (0..patterns * pixels.div_ceil(8))
            .map(|_| next() as u8)
            .collect();
        let mut values = |n: usize| (0..n).map(|_| f64::from(next()) / 1e9 - 1.0).collect();
        (bytes, values(3 * pixels), values(3 * patterns))
    }

    #[test]
    fn a_transposed_square_has_its_rows_as_columns() {
        let mut square = 0x0123_4567_89ab_cdef_u64;
        for _ in 0..20 {
            square = square.wrapping_mul(6364136223846793005).wrapping_add(99);
            let transposed = transpose(square);
            for row in 0..8 {
                for col in 0..8 {
                    assert_eq!(
                        transposed >> (8 * col + row) & 1,
                        square >> (8 * row + col) & 1
                    );
                }
            }
        }
    }

    #[test]
    fn products_match_their_definition() {
        for (patterns, pixels) in [
            (1, 1),
            (3, 7),
            (8, 8),
            (9, 65),
            (17, 130),
            (40, 200),
            (9, 2 * BLOCK + 5),
        ] {
            let (bytes, x, e) = example(patterns, pixels);
            let bits = Bits::new(&bytes, patterns, pixels);
            let mut samples = vec![0.0; 3 * patterns];
            let mut correlations = vec![0.0; 3 * pixels];
            forward(bits, 3, &x, &mut samples);
            adjoint(bits, 3, &e, &mut correlations);
            for row in 0..3 {
                for k in 0..patterns {
                    let direct: f64 = (0..pixels)
                        .filter(|&n| bits.lit(k, n))
                        .map(|n| x[row * pixels + n])
                        .sum();
                    assert!((samples[row * patterns + k] - direct).abs() < 1e-9);
                }
                for n in 0..pixels {
                    let direct: f64 = (0..patterns)
                        .filter(|&k| bits.lit(k, n))
                        .map(|k| e[row * patterns + k])
                        .sum();
                    assert!((correlations[row * pixels + n] - direct).abs() < 1e-9);
                }
            }
        }
    }
}
