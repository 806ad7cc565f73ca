//! Sums over 0/1 patterns by tables of partial sums ('four Russians').
//!
//! A table holds the sums over all subsets of a few values; the bits of a pixel's column pick one.
//! AVX-512 keeps tables of six values in registers (a permute of 64 16-bit entries), AVX2 tables of
//! four (byte shuffles), and the portable twin tables of eight in memory.

use super::scores::{Scores, BATCH, GROUP};
#[cfg(target_arch = "x86_64")]
use super::{avx2, avx512};
use crate::bits::{column_codes, Bits};
use crate::simd::{Kind, Level};
use crate::subsets::subset_sums;

pub struct Lookup {
    pixels: usize,
    length: usize,
    codes: Codes,
}

enum Codes {
    /// Planes of (length) bytes, eight patterns a plane.
    Bytes(Vec<u8>),
    /// Planes of (length) words, twelve patterns a plane in the low bits: two indices of six.
    #[cfg(target_arch = "x86_64")]
    Words(Vec<u16>),
}

impl Lookup {
    pub fn new(level: Level, bits: Bits) -> Self {
        let (pixels, length) = (bits.pixels(), bits.pixels().next_multiple_of(GROUP));
        let bytes = column_codes(bits);
        let codes = match level.kind() {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => Codes::Words(word_planes(&bytes, bits, length)),
            _ => Codes::Bytes(padded_planes(&bytes, pixels, length)),
        };
        Lookup {
            pixels,
            length,
            codes,
        }
    }

    pub fn length(&self) -> usize {
        self.length
    }

    pub fn run(
        &self,
        level: Level,
        rows: &[Vec<i16>],
        tables: &mut Vec<i16>,
        out: &mut [&mut Scores],
    ) {
        match &self.codes {
            #[cfg(target_arch = "x86_64")]
            Codes::Words(codes) => avx512::run(level, codes, self.length, rows, tables, out),
            #[cfg(target_arch = "x86_64")]
            Codes::Bytes(codes) if level.kind() == Kind::Avx2 => {
                avx2::run(level, codes, self.length, rows, out);
            }
            Codes::Bytes(codes) => {
                for (row, out) in rows.iter().zip(out.iter_mut()) {
                    portable(codes, self.length, row, &mut out.values);
                }
            }
        }
        for out in out {
            // Padding pixels belong to no pattern; their scores must not look like any pixel's.
            out.values[self.pixels..].fill(0);
        }
    }
}

/// The plain twin: for each group of eight patterns, one table look-up a pixel.
fn portable(codes: &[u8], length: usize, row: &[i16], out: &mut [i16]) {
    let mut table = [0i16; 256];
    out.fill(0);
    for (values, codes) in row.chunks(8).zip(codes.chunks_exact(length)) {
        subset_sums(values, &mut table);
        for (out, code) in out.iter_mut().zip(codes) {
            *out = out.wrapping_add(table[usize::from(*code)]);
        }
    }
}

fn padded_planes(bytes: &[u8], pixels: usize, length: usize) -> Vec<u8> {
    let mut planes = Vec::with_capacity(bytes.len() / pixels.max(1) * length);
    for plane in bytes.chunks_exact(pixels) {
        planes.extend_from_slice(plane);
        planes.resize(planes.len().next_multiple_of(length), 0);
    }
    planes
}

/// Twelve bits a pixel and plane, from eight bits a pixel and byte plane.
#[cfg(target_arch = "x86_64")]
fn word_planes(bytes: &[u8], bits: Bits, length: usize) -> Vec<u16> {
    use rayon::prelude::*;
    // An even number of planes: the kernel takes two at a time.
    let planes = bits.patterns().div_ceil(24) * 2;
    let mut words = vec![0u16; planes * length];
    words
        .par_chunks_mut(length.max(1))
        .enumerate()
        .for_each(|(plane, words)| {
            let first = 12 * plane;
            for group in first / 8..=(first + 11) / 8 {
                let Some(codes) = bytes.chunks_exact(bits.pixels()).nth(group) else {
                    continue;
                };
                let shift = 8 * group as i32 - first as i32;
                for (word, &code) in words.iter_mut().zip(codes) {
                    let code = u32::from(code);
                    let moved = if shift >= 0 {
                        code << shift
                    } else {
                        code >> -shift
                    };
                    *word |= (moved & 0xfff) as u16;
                }
            }
        });
    words
}

const _: () = assert!(
    BATCH == 3,
    "the kernels are written out for one to three rows"
);
