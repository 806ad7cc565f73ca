//! The look-up pass with AVX2: byte shuffles look up 16-bit sums of four patterns, low and high bytes
//! apart.

use super::scores::Scores;
use crate::simd::{Kind, Level};
use crate::subsets::subset_sums;
use std::arch::x86_64::*;
use std::ops::Range;

/// Pixels whose sums stay in the first-level cache while all patterns pass.
const TILE: usize = 4096;
/// Bytes of the tables of one plane of eight patterns: low and high bytes of two tables of 16 sums.
const TABLE: usize = 64;

/// # Panics
/// If the level has no AVX2 or the lengths do not fit.
pub fn run(level: Level, codes: &[u8], length: usize, rows: &[Vec<i16>], out: &mut [&mut Scores]) {
    assert_eq!(level.kind(), Kind::Avx2);
    assert!(length.is_multiple_of(32));
    let planes = codes.len() / length.max(1);
    let mut split = Vec::with_capacity(rows.len() * planes * TABLE);
    for (row, out) in rows.iter().zip(out.iter()) {
        assert!(row.len() <= 8 * planes && out.values.len() == length);
        for step in 0..2 * planes {
            let values = row.get(4 * step..).unwrap_or(&[]);
            let mut sums = [0i16; 16];
            subset_sums(&values[..values.len().min(4)], &mut sums);
            split.extend(sums.map(|sum| sum.to_le_bytes()[0]));
            split.extend(sums.map(|sum| sum.to_le_bytes()[1]));
        }
    }
    for tile in (0..length).step_by(TILE) {
        let end = length.min(tile + TILE);
        let parts = split.chunks_exact((planes * TABLE).max(1));
        for (tables, out) in parts.zip(out.iter_mut()) {
            // SAFETY: the level proves the instructions; the asserts above are the contract.
            unsafe { pass(codes, length, tile..end, tables, &mut out.values) };
        }
    }
}

/// Computes the scores of some pixels.
///
/// # Safety
/// `codes` holds planes of `length` bytes; `pixels` lie within them, from and to a multiple of 32;
/// `tables` 64 bytes a plane; `out` `length` values.
#[target_feature(enable = "avx2")]
unsafe fn pass(codes: &[u8], length: usize, pixels: Range<usize>, tables: &[u8], out: &mut [i16]) {
    let nibble = _mm256_set1_epi8(0x0f);
    out[pixels.clone()].fill(0);
    for (plane, tables) in tables.chunks_exact(TABLE).enumerate() {
        let table = |i: usize| {
            // SAFETY: i < 4, and a plane's tables are 4 times 16 bytes.
            let half = unsafe { _mm_loadu_si128(tables.as_ptr().add(16 * i).cast()) };
            _mm256_broadcastsi128_si256(half)
        };
        let (low0, high0, low1, high1) = (table(0), table(1), table(2), table(3));
        for pixel in pixels.clone().step_by(32) {
            // SAFETY: pixel + 32 <= length bounds the 32 codes read and the 32 sums written.
            unsafe {
                let at = codes.as_ptr().add(plane * length + pixel);
                let code = _mm256_loadu_si256(at.cast());
                let first = _mm256_and_si256(code, nibble);
                let second = _mm256_and_si256(_mm256_srli_epi16::<4>(code), nibble);
                let (l0, h0) = (
                    _mm256_shuffle_epi8(low0, first),
                    _mm256_shuffle_epi8(high0, first),
                );
                let (l1, h1) = (
                    _mm256_shuffle_epi8(low1, second),
                    _mm256_shuffle_epi8(high1, second),
                );
                // Unpacking works within each half of a register, so the second and the third group of
                // eight pixels swap places. The last loop swaps them back.
                let near =
                    _mm256_add_epi16(_mm256_unpacklo_epi8(l0, h0), _mm256_unpacklo_epi8(l1, h1));
                let far =
                    _mm256_add_epi16(_mm256_unpackhi_epi8(l0, h0), _mm256_unpackhi_epi8(l1, h1));
                let sums = out.as_mut_ptr().add(pixel).cast::<__m256i>();
                let near = _mm256_add_epi16(near, _mm256_loadu_si256(sums));
                let far = _mm256_add_epi16(far, _mm256_loadu_si256(sums.add(1)));
                _mm256_storeu_si256(sums, near);
                _mm256_storeu_si256(sums.add(1), far);
            }
        }
    }
    for pixel in pixels.clone().step_by(32) {
        // SAFETY: as above.
        unsafe {
            let sums = out.as_mut_ptr().add(pixel).cast::<__m256i>();
            let (near, far) = (_mm256_loadu_si256(sums), _mm256_loadu_si256(sums.add(1)));
            _mm256_storeu_si256(sums, _mm256_permute2x128_si256::<0x20>(near, far));
            _mm256_storeu_si256(sums.add(1), _mm256_permute2x128_si256::<0x31>(near, far));
        }
    }
}
