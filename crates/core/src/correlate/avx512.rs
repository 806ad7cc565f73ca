//! The look-up pass with AVX-512: tables of six patterns, 64 sums in two registers, one permute.

use super::scores::Scores;
use crate::simd::{Kind, Level};
use std::arch::x86_64::*;

/// Pixels whose sums stay in the first-level cache while all patterns pass.
const TILE: usize = 2048;
/// Values of the four tables of one step (two planes are two steps' worth each of two tables).
const TABLE: usize = 64;
/// Planes of twelve patterns taken at a time.
const PLANES: usize = 2;

/// # Panics
/// If the level is not AVX-512 or the lengths do not fit.
pub fn run(
    level: Level,
    codes: &[u16],
    length: usize,
    rows: &[Vec<i16>],
    tables: &mut Vec<i16>,
    out: &mut [&mut Scores],
) {
    assert_eq!(level.kind(), Kind::Avx512);
    let planes = codes.len() / length.max(1);
    assert!(planes.is_multiple_of(PLANES) && length.is_multiple_of(32));
    assert!(rows.iter().all(|row| row.len() <= 12 * planes));
    assert!(out.iter().all(|out| out.values.len() == length));
    tables.clear();
    tables.resize(rows.len() * 2 * planes * TABLE, 0);
    for (row, tables) in rows.iter().zip(tables.chunks_exact_mut(2 * planes * TABLE)) {
        for (values, table) in row.chunks(6).zip(tables.chunks_exact_mut(TABLE)) {
            let mut six = [0; 6];
            six[..values.len()].copy_from_slice(values);
            // SAFETY: the level proves the instructions.
            unsafe { subset_sums(six, table) };
        }
    }
    // SAFETY, for all: the level proves the instructions; the asserts above are the contract.
    match out {
        [a] => unsafe { pass(codes, length, tables, [&mut a.values]) },
        [a, b] => unsafe { pass(codes, length, tables, [&mut a.values, &mut b.values]) },
        [a, b, c] => unsafe {
            pass(
                codes,
                length,
                tables,
                [&mut a.values, &mut b.values, &mut c.values],
            );
        },
        _ => assert!(out.is_empty()),
    }
}

/// `subsets::subset_sums` of six values, whose table is two registers: with the common one a pass
/// over 512 patterns takes 8 % longer at 128 x 128 pixels and 19 % longer at 32 x 32.
#[target_feature(enable = "avx512f,avx512bw")]
fn subset_sums(values: [i16; 6], table: &mut [i16]) {
    let lanes = [
        0xaaaa_aaaa,
        0xcccc_cccc,
        0xf0f0_f0f0,
        0xff00_ff00,
        0xffff_0000,
    ];
    let mut low = _mm512_setzero_si512();
    for (mask, value) in lanes.into_iter().zip(values) {
        low = _mm512_add_epi16(low, _mm512_maskz_set1_epi16(mask, value));
    }
    let high = _mm512_add_epi16(low, _mm512_set1_epi16(values[5]));
    let (first, second) = table.split_at_mut(32);
    assert!(first.len() == 32 && second.len() == 32);
    // SAFETY: each half holds one register.
    unsafe {
        _mm512_storeu_si512(first.as_mut_ptr().cast(), low);
        _mm512_storeu_si512(second.as_mut_ptr().cast(), high);
    }
}

/// # Safety
/// `codes` holds an even number of planes of `length` words, `length` a multiple of 32; `tables`
/// two tables a plane for each row; each `out` has `length` values.
#[target_feature(enable = "avx512f,avx512bw")]
unsafe fn pass<const R: usize>(codes: &[u16], length: usize, tables: &[i16], out: [&mut [i16]; R]) {
    let planes = codes.len() / length;
    let out = out.map(|out| out.as_mut_ptr());
    for tile in (0..length).step_by(TILE) {
        let end = (tile + TILE).min(length);
        for plane in (0..planes).step_by(PLANES) {
            let mut sums = [[[_mm512_setzero_si512(); 4]; PLANES]; R];
            for (r, sums) in sums.iter_mut().enumerate() {
                for (p, sums) in sums.iter_mut().enumerate() {
                    for (half, sums) in sums.iter_mut().enumerate() {
                        let at = (2 * (r * planes + plane + p)) * TABLE + 32 * half;
                        // SAFETY: r < R and plane + p < planes, so 128 values follow 128 times
                        // (r planes + plane + p).
                        *sums = unsafe { _mm512_loadu_si512(tables.as_ptr().add(at).cast()) };
                    }
                }
            }
            for pixel in (tile..end).step_by(32) {
                // SAFETY: pixel + 32 <= length, and so are the reads and writes of 32 values.
                unsafe {
                    let mut total = [_mm512_setzero_si512(); R];
                    if plane > 0 {
                        for r in 0..R {
                            total[r] = _mm512_loadu_si512(out[r].add(pixel).cast());
                        }
                    }
                    // An index, not an iterator: it walks the second axis of `sums`.
                    #[allow(clippy::needless_range_loop)]
                    for p in 0..PLANES {
                        let at = (plane + p) * length + pixel;
                        let low = _mm512_loadu_si512(codes.as_ptr().add(at).cast());
                        // The permute reads the six low bits of each index only.
                        let high = _mm512_srli_epi16::<6>(low);
                        for r in 0..R {
                            let [a, b, c, d] = sums[r][p];
                            let first = _mm512_permutex2var_epi16(a, low, b);
                            let second = _mm512_permutex2var_epi16(c, high, d);
                            total[r] = _mm512_add_epi16(total[r], first);
                            total[r] = _mm512_add_epi16(total[r], second);
                        }
                    }
                    for r in 0..R {
                        _mm512_storeu_si512(out[r].add(pixel).cast(), total[r]);
                    }
                }
            }
        }
    }
}
