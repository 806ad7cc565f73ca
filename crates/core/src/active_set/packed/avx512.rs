//! Packing and sweeping with AVX-512: eight pixels move, then the slopes of sixteen at a time are updated.

use crate::octet::{PAIR, WIDTH};
use std::arch::x86_64::*;

/// Writes the values of a row whose bits are set, times `inverse`, in float32, then zeros up to `size`.
///
/// # Safety
/// `row` and `inverse` have eight values a group, `out` eight more than `size`, a multiple of `PAIR`,
/// and at most `size` bits are set.
#[target_feature(enable = "avx512f,avx512vl")]
pub unsafe fn compress(row: &[f64], inverse: &[f64], groups: &[u8], size: usize, out: &mut [f32]) {
    // SAFETY: as this function's. The zeros behind the compressed values are overwritten by the next
    // octet or the next row.
    unsafe {
        let mut at = out.as_mut_ptr();
        _mm512_storeu_ps(at.add(size - PAIR), _mm512_setzero_ps());
        for (i, &bits) in groups.iter().enumerate() {
            let values = _mm512_loadu_pd(row.as_ptr().add(8 * i));
            let scaled = _mm512_mul_pd(values, _mm512_loadu_pd(inverse.as_ptr().add(8 * i)));
            let single = _mm512_cvtpd_ps(scaled);
            _mm256_storeu_ps(at, _mm256_maskz_compress_ps(bits, single));
            at = at.add(bits.count_ones() as usize);
        }
    }
}

/// Writes the values whose bits are set, then zeros up to `size`.
///
/// # Safety
/// `values` has eight values a group, `out` eight more than `size`, a multiple of `PAIR`, and at most
/// `size` bits are set.
#[target_feature(enable = "avx512f")]
pub unsafe fn pick(values: &[f64], groups: &[u8], size: usize, out: &mut [f64]) {
    if size == 0 {
        return;
    }
    // SAFETY: as for `compress`.
    unsafe {
        let mut at = out.as_mut_ptr();
        for end in [PAIR, WIDTH] {
            _mm512_storeu_pd(at.add(size - end), _mm512_setzero_pd());
        }
        for (i, &bits) in groups.iter().enumerate() {
            let values = _mm512_loadu_pd(values.as_ptr().add(8 * i));
            _mm512_storeu_pd(at, _mm512_maskz_compress_pd(bits, values));
            at = at.add(bits.count_ones() as usize);
        }
    }
}

/// # Safety
/// `room`, `delta`, `pull`, `band` and `diagonal` have one length, a multiple of `PAIR`, and `matrix` at
/// least its square.
#[target_feature(enable = "avx512f,avx512dq,avx512vl,fma")]
pub unsafe fn sweep(
    matrix: &[f32],
    diagonal: &[f32],
    band: &[f32],
    signed: bool,
    room: &mut [f32],
    delta: &mut [f32],
    pull: &mut [f32],
) -> f32 {
    let size = room.len();
    let zero = _mm256_setzero_ps();
    let mut change = zero;
    for block in (0..size).step_by(WIDTH) {
        // SAFETY: block + 8 <= size, and other + 16 <= size, bound all reads and writes of vectors;
        // rows block to block + 8 of the matrix begin at most at (size - 1) size and hold size
        // values.
        unsafe {
            let rows = matrix.as_ptr().add(block * size);
            let pulls = pull.as_mut_ptr();
            let back = _mm256_loadu_ps(room.as_ptr().add(block));
            let band = _mm256_loadu_ps(band.as_ptr().add(block));
            let pull = _mm256_loadu_ps(pulls.add(block));
            // If no pixel of the block would move first, none moves. Most blocks at zero end here.
            let first = if signed {
                _mm256_min_ps(back, _mm256_add_ps(pull, band))
            } else {
                back
            };
            if _mm256_cmp_ps_mask::<_CMP_NEQ_UQ>(_mm256_max_ps(pull, first), zero) == 0 {
                continue;
            }
            // Moves are scalars: the next one then waits for a maximum and a fused product only. With
            // the eight in one register it would wait for a permutation too.
            let lanes = |values: __m256| {
                let mut lanes = [0.0; WIDTH];
                _mm256_storeu_ps(lanes.as_mut_ptr(), values);
                lanes.map(|value| _mm_set_ss(value))
            };
            let (mut pulled, backs, bands) = (lanes(pull), lanes(back), lanes(band));
            let mut moves = [_mm512_setzero_ps(); WIDTH];
            let mut moved = zero;
            for i in 0..WIDTH {
                let mut least = backs[i];
                if signed {
                    least = _mm_min_ss(least, _mm_add_ss(pulled[i], bands[i]));
                }
                let by = _mm_max_ss(pulled[i], least);
                // The compiler unrolls this loop with an index, but not with an iterator.
                #[allow(clippy::needless_range_loop)]
                for k in i + 1..WIDTH {
                    let factor = _mm_load_ss(rows.add(i * size + block + k));
                    pulled[k] = _mm_fnmadd_ss(by, factor, pulled[k]);
                }
                moves[i] = _mm512_broadcastss_ps(by);
                moved = _mm256_mask_mov_ps(moved, 1 << i, _mm512_castps512_ps256(moves[i]));
            }
            // A pixel that returns to zero has no room left.
            _mm256_storeu_ps(room.as_mut_ptr().add(block), _mm256_sub_ps(back, moved));
            let deltas = delta.as_mut_ptr().add(block);
            _mm256_storeu_ps(deltas, _mm256_add_ps(_mm256_loadu_ps(deltas), moved));
            let diagonal = _mm256_loadu_ps(diagonal.as_ptr().add(block));
            let size_of = _mm256_andnot_ps(_mm256_set1_ps(-0.0), moved);
            change = _mm256_max_ps(change, _mm256_mul_ps(size_of, diagonal));
            // Update the next block first, as its moves wait for nothing else.
            let next = (block + WIDTH) / PAIR * PAIR;
            for other in (next..size).chain(0..next).step_by(PAIR) {
                let row = |i: usize| _mm512_loadu_ps(rows.add(i * size + other));
                let mut a = _mm512_loadu_ps(pulls.add(other));
                let mut b = _mm512_mul_ps(moves[1], row(1));
                a = _mm512_fnmadd_ps(moves[0], row(0), a);
                for i in [2, 4, 6] {
                    a = _mm512_fnmadd_ps(moves[i], row(i), a);
                    b = _mm512_fmadd_ps(moves[i + 1], row(i + 1), b);
                }
                _mm512_storeu_ps(pulls.add(other), _mm512_sub_ps(a, b));
            }
        }
    }
    let mut lanes = [0.0; WIDTH];
    // SAFETY: eight numbers.
    unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), change) };
    lanes.into_iter().fold(0.0, f32::max)
}
