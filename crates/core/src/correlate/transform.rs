//! The pass over Hadamard patterns: a fast Walsh-Hadamard transform in 16 bits.

use super::scores::GROUP;
use crate::simd::{multiversion, Kind, Level};

pub struct Transform {
    length: usize,
    selected: Vec<u32>,
    /// The pixel of each place of the transform, or NONE.
    pixel: Vec<u32>,
    /// Whether there are places without a pixel.
    partial: bool,
}

const NONE: u32 = u32::MAX;
/// Number of 16-bit values in an AVX-512 register.
const WIDTH: usize = 32;

impl Transform {
    pub fn new(length: usize, selected: &[u32], position: &[u32]) -> Self {
        assert!(length.is_power_of_two());
        assert!(selected.iter().all(|&s| (s as usize) < length));
        let mut pixel = vec![NONE; length.next_multiple_of(GROUP)];
        for (j, &p) in position.iter().enumerate() {
            pixel[p as usize] = j as u32;
        }
        Transform {
            length,
            selected: selected.to_vec(),
            partial: pixel.contains(&NONE),
            pixel,
        }
    }

    pub fn length(&self) -> usize {
        self.pixel.len()
    }

    pub fn pixel(&self, place: usize) -> Option<u32> {
        Some(self.pixel[place]).filter(|&p| p != NONE)
    }

    /// Computes H q at every place. Places without a pixel get the score of correlation 0.
    pub fn run(&self, level: Level, row: &[i16], offset: f64, out: &mut [i16]) {
        assert_eq!(out.len(), self.pixel.len());
        out.fill(0);
        for (&place, &value) in self.selected.iter().zip(row) {
            out[place as usize] = value;
        }
        let transformed = &mut out[..self.length];
        match level.kind() {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 if self.length >= WIDTH => {
                // SAFETY: the level proves the instructions; the length is a power of two and at
                // least WIDTH, hence a multiple of it.
                unsafe { avx512::within(transformed) };
                across(level, transformed, WIDTH);
            }
            _ => across(level, transformed, 1),
        }
        if self.partial {
            for (out, &pixel) in out.iter_mut().zip(&self.pixel) {
                if pixel == NONE {
                    *out = -offset as i16;
                }
            }
        }
    }
}

multiversion! {
    /// All butterflies of distance `first` and more.
    fn across(out: &mut [i16], first: usize) {
        let mut half = first;
        // Two stages at a time halve the memory traffic.
        while 4 * half <= out.len() {
            for group in out.chunks_exact_mut(4 * half) {
                let (ab, cd) = group.split_at_mut(2 * half);
                let (a, b) = ab.split_at_mut(half);
                let (c, d) = cd.split_at_mut(half);
                for (((a, b), c), d) in a.iter_mut().zip(b).zip(c).zip(d) {
                    let (sum, difference) = (a.wrapping_add(*b), a.wrapping_sub(*b));
                    let (other_sum, other) = (c.wrapping_add(*d), c.wrapping_sub(*d));
                    *a = sum.wrapping_add(other_sum);
                    *b = difference.wrapping_add(other);
                    *c = sum.wrapping_sub(other_sum);
                    *d = difference.wrapping_sub(other);
                }
            }
            half *= 4;
        }
        if 2 * half <= out.len() {
            let (a, b) = out.split_at_mut(half);
            for (a, b) in a.iter_mut().zip(b) {
                let (sum, difference) = (a.wrapping_add(*b), a.wrapping_sub(*b));
                *a = sum;
                *b = difference;
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::WIDTH;
    use std::arch::x86_64::*;

    /// The five stages of distances below `WIDTH`, each within a register.
    ///
    /// # Safety
    /// The length is a multiple of `WIDTH`.
    #[target_feature(enable = "avx512f,avx512bw")]
    pub unsafe fn within(out: &mut [i16]) {
        for group in out.chunks_exact_mut(WIDTH) {
            // SAFETY: a group holds one register.
            let mut v = unsafe { _mm512_loadu_si512(group.as_ptr().cast()) };
            // In each pair, the first becomes the sum and the second the difference.
            let stage = |v: __m512i, swapped: __m512i, second: u32| {
                _mm512_mask_sub_epi16(_mm512_add_epi16(v, swapped), second, swapped, v)
            };
            v = stage(v, _mm512_rol_epi32::<16>(v), 0xaaaa_aaaa);
            v = stage(v, _mm512_shuffle_epi32::<0xb1>(v), 0xcccc_cccc);
            v = stage(v, _mm512_shuffle_epi32::<0x4e>(v), 0xf0f0_f0f0);
            v = stage(v, _mm512_shuffle_i64x2::<0xb1>(v, v), 0xff00_ff00);
            v = stage(v, _mm512_shuffle_i64x2::<0x4e>(v, v), 0xffff_0000);
            // SAFETY: as above.
            unsafe { _mm512_storeu_si512(group.as_mut_ptr().cast(), v) };
        }
    }
}
