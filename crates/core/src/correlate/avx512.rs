//! The look-up pass with AVX-512: a register holds the table of six patterns, 64 sums of one byte each.
//!
//! A step handles two tables, whose added sums fit a byte: two permutes look up 64 pixels in each, and one
//! addition joins them. To widen the bytes to 16 bits, one sum adds up words of two pixels and another one
//! only their upper bytes. At the end the upper bytes are subtracted from the words, which leaves the lower
//! ones.

use super::scores::{Scores, BATCH, MANY};
use super::tables::{count, PATTERNS};
use crate::bits::{column_codes, Bits};
use crate::simd::{Kind, Level};
use rayon::prelude::*;
use std::arch::x86_64::*;

/// Number of sums of a table, one byte each: one register.
const TABLE: usize = 64;
/// Number of pixels whose sums stay in registers while all patterns of a part are read.
const BLOCK: usize = 64;
/// The first half of a block is in the lower bytes of words, the second half in the upper bytes.
const HALF: usize = BLOCK / 2;
/// Number of steps of a part: its tables (4 KB for each row) stay in the first-level cache.
const STEPS: usize = 32;
/// Distance of prefetching, in bytes of codes. They come from the second- or third-level cache, whose
/// own prefetching stops at each page.
const AHEAD: usize = 2048;
/// Number of pixels of a tile: its codes of one part, and its sums, stay in the nearer caches while the
/// rows are processed.
const TILE: usize = 1024;
/// For each bit i, the indices below 64 that have it.
const LANES: [u64; PATTERNS] = [
    0xaaaa_aaaa_aaaa_aaaa,
    0xcccc_cccc_cccc_cccc,
    0xf0f0_f0f0_f0f0_f0f0,
    0xff00_ff00_ff00_ff00,
    0xffff_0000_ffff_0000,
    0xffff_ffff_0000_0000,
];

/// The indices of all pixels in the order in which `run` reads them: by tile, then by part of `STEPS`
/// steps, then by block of pixels, then by step.
pub fn codes(bits: Bits, length: usize) -> Vec<u8> {
    let (bytes, tables) = (column_codes(bits), count(bits.patterns()));
    let mut codes = vec![0; tables * length];
    let tiles = codes.par_chunks_mut((tables * TILE).max(1)).enumerate();
    tiles.for_each(|(tile, mut codes)| {
        let pixels = codes.len() / tables;
        for first in (0..tables).step_by(2 * STEPS) {
            let steps = (tables - first).min(2 * STEPS);
            let part;
            (part, codes) = codes.split_at_mut(steps * pixels);
            for (i, codes) in part.as_chunks_mut::<BLOCK>().0.iter_mut().enumerate() {
                let (table, pixel) = (first + i % steps, tile * TILE + i / steps * BLOCK);
                let [lower, upper] =
                    [0, HALF].map(|half| indices(&bytes, bits, table, pixel + half));
                let pairs = codes.as_chunks_mut::<2>().0.iter_mut();
                for ((pair, lower), upper) in pairs.zip(lower).zip(upper) {
                    *pair = [lower, upper];
                }
            }
        }
    });
    codes
}

/// The indices of `HALF` pixels from `first` on into one table.
fn indices(bytes: &[u8], bits: Bits, table: usize, first: usize) -> [u8; HALF] {
    let mut indices = [0; HALF];
    let end = bits.pixels().min(first + HALF);
    for i in 0..PATTERNS {
        let pattern = table + i * count(bits.patterns());
        if pattern < bits.patterns() && first < end {
            let plane = &bytes[pattern / 8 * bits.pixels()..][first..end];
            for (index, byte) in indices.iter_mut().zip(plane) {
                *index |= (byte >> (pattern % 8) & 1) << i;
            }
        }
    }
    indices
}

/// The buffers of one thread.
#[derive(Default)]
pub struct Buffers {
    tables: Vec<u8>,
    /// Sums of the pixels of a tile.
    sums: [Vec<i16>; BATCH],
}

/// # Panics
/// If the level is not AVX-512 or the lengths do not fit.
pub fn run(
    level: Level,
    codes: &[u8],
    length: usize,
    rows: &[Vec<i16>],
    buffers: &mut Buffers,
    out: &mut [&mut Scores],
) {
    assert_eq!(level.kind(), Kind::Avx512);
    let each = codes.len() / length.max(1);
    assert!(each.is_multiple_of(2) && length.is_multiple_of(BLOCK));
    assert!(rows.iter().all(|row| count(row.len()) == each));
    assert!(rows.len() == out.len() && rows.len() <= MANY);
    let Buffers { tables, sums } = buffers;
    tables.clear();
    tables.resize(rows.len() * each * TABLE, 0);
    let mut shifts = [0; MANY];
    let size = (each * TABLE).max(1);
    for ((row, tables), shift) in rows
        .iter()
        .zip(tables.chunks_exact_mut(size))
        .zip(&mut shifts)
    {
        // SAFETY: the level proves the instructions.
        *shift = unsafe { make_tables(row, tables) };
    }
    for pixel in (0..length).step_by(TILE) {
        let pixels = TILE.min(length - pixel);
        sums.iter_mut().for_each(|sums| sums.resize(pixels, 0));
        let groups = tables.chunks(BATCH * size).zip(shifts.chunks(BATCH));
        for ((tables, shifts), out) in groups.zip(out.chunks_mut(BATCH)) {
            let mut codes = &codes[pixel * each..][..pixels * each];
            for first in (0..each / 2).step_by(STEPS) {
                let steps = STEPS.min(each / 2 - first);
                let part;
                (part, codes) = codes.split_at(2 * steps * pixels);
                let [a, b, c] = &mut *sums;
                // SAFETY, for all: the level proves the instructions; the asserts above are the
                // contract.
                unsafe {
                    match out.len() {
                        1 => pass(part, first, steps, tables, shifts, [a]),
                        2 => pass(part, first, steps, tables, shifts, [a, b]),
                        _ => pass(part, first, steps, tables, shifts, [a, b, c]),
                    }
                }
            }
            for (out, sums) in out.iter_mut().zip(&*sums) {
                out.keep(level, pixel, sums);
            }
        }
    }
}

/// Fills the tables of a row, each shifted so that its least sum is 0; returns the sum of all shifts, which
/// a score contains.
#[target_feature(enable = "avx512f,avx512bw")]
fn make_tables(row: &[i16], tables: &mut [u8]) -> i16 {
    let each = tables.len() / TABLE;
    let mut all = 0i16;
    for (t, table) in tables.as_chunks_mut::<TABLE>().0.iter_mut().enumerate() {
        let values = || row[t..].iter().step_by(each);
        let shift: i16 = values().map(|value| -value.min(&0)).sum();
        all = all.wrapping_add(shift);
        // The shifted sums lie in 0 to 255, so bytes hold them even if additions wrap on the way.
        let mut sums = _mm512_set1_epi8(shift as i8);
        for (value, lanes) in values().zip(LANES) {
            let value = _mm512_maskz_set1_epi8(lanes, *value as i8);
            sums = _mm512_add_epi8(sums, value);
        }
        // SAFETY: a table holds one register.
        unsafe { _mm512_storeu_si512(table.as_mut_ptr().cast(), sums) };
    }
    all
}

/// Adds the sums of the steps `first` to `first + steps` to the scores of a tile.
///
/// # Safety
/// Each `out` has one length, a multiple of `BLOCK`; `codes` holds 2 `steps` bytes a pixel, `tables`
/// the same number of tables, of at least 2 (`first` + `steps`), for each row.
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi")]
unsafe fn pass<const R: usize>(
    codes: &[u8],
    first: usize,
    steps: usize,
    tables: &[u8],
    shifts: &[i16],
    out: [&mut Vec<i16>; R],
) {
    let (length, each) = (out[0].len(), tables.len() / R);
    let out = out.map(|out| out.as_mut_ptr());
    let shifts: [__m512i; R] = std::array::from_fn(|r| _mm512_set1_epi16(shifts[r].wrapping_neg()));
    let mut code = codes.as_ptr();
    for pixel in (0..length).step_by(BLOCK) {
        // SAFETY: codes of `steps` steps are read for each block, once each; a row has pairs of
        // tables for all steps; pixel + BLOCK <= length bounds the sums.
        unsafe {
            // Sums of words, and of their upper bytes.
            let mut sums = [[_mm512_setzero_si512(); 2]; R];
            for step in first..first + steps {
                let [a, b] = [0, 1].map(|i| _mm512_loadu_si512(code.add(i * BLOCK).cast()));
                code = code.add(2 * BLOCK);
                for line in [0, BLOCK] {
                    _mm_prefetch::<_MM_HINT_T0>(code.wrapping_add(AHEAD + line).cast());
                }
                for (r, [words, upper]) in sums.iter_mut().enumerate() {
                    let table = tables.as_ptr().add(r * each + step * 2 * TABLE);
                    let a = _mm512_permutexvar_epi8(a, _mm512_loadu_si512(table.cast()));
                    let b = _mm512_permutexvar_epi8(b, _mm512_loadu_si512(table.add(TABLE).cast()));
                    let both = _mm512_add_epi8(a, b);
                    *words = _mm512_add_epi16(*words, both);
                    *upper = _mm512_add_epi16(*upper, _mm512_srli_epi16::<8>(both));
                }
            }
            for (([words, upper], out), shift) in sums.into_iter().zip(out).zip(shifts) {
                let lower = _mm512_sub_epi16(words, _mm512_slli_epi16::<8>(upper));
                for (half, sum) in [lower, upper].into_iter().enumerate() {
                    let at = out.add(pixel + half * HALF);
                    let before = if first > 0 {
                        _mm512_loadu_si512(at.cast_const().cast())
                    } else {
                        shift
                    };
                    _mm512_storeu_si512(at.cast(), _mm512_add_epi16(before, sum));
                }
            }
        }
    }
}
