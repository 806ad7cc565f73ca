//! Packing and sweeping with AVX-512: eight pixels a register.

use crate::octet::WIDTH;
use std::arch::x86_64::*;

/// The values of a row whose bits are set, times `inverse`, then zeros up to `size`.
///
/// # Safety
/// `row` and `inverse` have eight values a group, `out` eight more than `size`, and at most
/// `size` bits are set.
#[target_feature(enable = "avx512f")]
pub unsafe fn compress(row: &[f64], inverse: &[f64], groups: &[u8], size: usize, out: &mut [f64]) {
    // SAFETY: as this function's; what lies behind the compressed values is zero, and the next
    // octet, or the next row, overwrites it.
    unsafe {
        let mut at = out.as_mut_ptr();
        _mm512_storeu_pd(at.add(size - 8), _mm512_setzero_pd());
        for (i, &bits) in groups.iter().enumerate() {
            let values = _mm512_loadu_pd(row.as_ptr().add(8 * i));
            let scaled = _mm512_mul_pd(values, _mm512_loadu_pd(inverse.as_ptr().add(8 * i)));
            _mm512_storeu_pd(at, _mm512_maskz_compress_pd(bits, scaled));
            at = at.add(bits.count_ones() as usize);
        }
    }
}

/// The values whose bits are set, then zeros up to `size`.
///
/// # Safety
/// `values` has eight values a group, `out` eight more than `size`, and at most `size` bits are set.
#[target_feature(enable = "avx512f")]
pub unsafe fn pick(values: &[f64], groups: &[u8], size: usize, out: &mut [f64]) {
    if size == 0 {
        return;
    }
    // SAFETY: as for `compress`.
    unsafe {
        let mut at = out.as_mut_ptr();
        _mm512_storeu_pd(at.add(size - 8), _mm512_setzero_pd());
        for (i, &bits) in groups.iter().enumerate() {
            let values = _mm512_loadu_pd(values.as_ptr().add(8 * i));
            _mm512_storeu_pd(at, _mm512_maskz_compress_pd(bits, values));
            at = at.add(bits.count_ones() as usize);
        }
    }
}

/// # Safety
/// `x`, `pull`, `band` and `diagonal` have one length, a multiple of `WIDTH`, and `matrix` at
/// least its square.
#[target_feature(enable = "avx512f,avx512dq")]
pub unsafe fn sweep(
    matrix: &[f64],
    diagonal: &[f64],
    band: &[f64],
    signed: bool,
    x: &mut [f64],
    pull: &mut [f64],
) -> f64 {
    let size = x.len();
    let zero = _mm512_setzero_pd();
    let mut change = zero;
    for block in (0..size).step_by(WIDTH) {
        // SAFETY: block + 8 <= size bounds all reads and writes of vectors; rows block to
        // block + 8 of the matrix begin at most at (size - 1) size and hold size values.
        unsafe {
            let rows = matrix.as_ptr().add(block * size);
            let pulls = pull.as_mut_ptr();
            let at = x.as_mut_ptr().add(block);
            let x = _mm512_loadu_pd(at);
            let back = _mm512_sub_pd(zero, x);
            let band = _mm512_loadu_pd(band.as_ptr().add(block));
            let mut pull = _mm512_loadu_pd(pulls.add(block));
            let mut moved = zero;
            // Where none would move at first none will: most blocks of pixels that stay at zero.
            let first = if signed {
                _mm512_min_pd(back, _mm512_add_pd(pull, band))
            } else {
                back
            };
            if _mm512_cmp_pd_mask::<_CMP_NEQ_UQ>(_mm512_max_pd(pull, first), zero) == 0 {
                continue;
            }
            // One number after the other: a maximum and a fused product are all that the next
            // move waits for, where a register of eight would wait for a permutation too.
            let lanes = |values: __m512d| {
                let mut lanes = [0.0; WIDTH];
                _mm512_storeu_pd(lanes.as_mut_ptr(), values);
                lanes.map(|value| _mm_set_sd(value))
            };
            let (mut pulled, back, band) = (lanes(pull), lanes(back), lanes(band));
            let mut moves = [zero; WIDTH];
            for i in 0..WIDTH {
                let mut least = back[i];
                if signed {
                    least = _mm_min_sd(least, _mm_add_sd(pulled[i], band[i]));
                }
                let by = _mm_max_sd(pulled[i], least);
                // Compilers unroll this loop with an index, and not with an iterator.
                #[allow(clippy::needless_range_loop)]
                for k in i + 1..WIDTH {
                    let factor = _mm_load_sd(rows.add(i * size + block + k));
                    pulled[k] = _mm_fnmadd_sd(by, factor, pulled[k]);
                }
                moves[i] = _mm512_broadcastsd_pd(by);
                moved = _mm512_mask_mov_pd(moved, 1 << i, moves[i]);
            }
            for (i, by) in moves.iter().enumerate() {
                pull = _mm512_fnmadd_pd(*by, _mm512_loadu_pd(rows.add(i * size + block)), pull);
            }
            // A pixel that goes back to zero lands on it exactly.
            _mm512_storeu_pd(at, _mm512_add_pd(x, moved));
            let diagonal = _mm512_loadu_pd(diagonal.as_ptr().add(block));
            change = _mm512_max_pd(change, _mm512_mul_pd(_mm512_abs_pd(moved), diagonal));
            _mm512_storeu_pd(pulls.add(block), pull);
            // The next block first: it waits for nothing else.
            let others = (block + WIDTH..size).chain(0..block);
            for other in others.step_by(WIDTH) {
                let row = |i: usize| _mm512_loadu_pd(rows.add(i * size + other));
                let mut a = _mm512_loadu_pd(pulls.add(other));
                let mut b = _mm512_mul_pd(moves[1], row(1));
                a = _mm512_fnmadd_pd(moves[0], row(0), a);
                for i in [2, 4, 6] {
                    a = _mm512_fnmadd_pd(moves[i], row(i), a);
                    b = _mm512_fmadd_pd(moves[i + 1], row(i + 1), b);
                }
                _mm512_storeu_pd(pulls.add(other), _mm512_sub_pd(a, b));
            }
        }
    }
    _mm512_reduce_max_pd(change)
}
