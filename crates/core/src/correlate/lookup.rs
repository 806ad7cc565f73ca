//! The pass over 0/1 patterns, by tables of partial sums ('four Russians').
//!
//! A table holds the sums over all subsets of a few values; the bits of a pixel's column pick one.
//! AVX-512 keeps tables of six values in registers (a permute of 64 bytes) and AVX2 tables of four (byte
//! shuffles). The portable version has tables of eight in memory. AMX multiplies instead.

use super::scores::{Scores, BATCH, GROUP, MANY};
#[cfg(target_arch = "x86_64")]
use super::{amx, avx2, avx512};
use crate::bits::{column_codes, Bits};
use crate::simd::{Kind, Level};
use crate::subsets::subset_sums;

/// Patterns of more bytes than this are read from memory in every pass, as today's caches do not hold
/// them.
const CACHED: usize = 16 << 20;

pub struct Lookup {
    length: usize,
    codes: Codes,
}

enum Codes {
    /// Planes of `length` bytes, one for each eight patterns.
    Bytes(Vec<u8>),
    /// One byte for each pixel and table of six patterns: the index into the table.
    #[cfg(target_arch = "x86_64")]
    Sixes(Vec<u8>),
    /// One bit for each pixel and pattern.
    #[cfg(target_arch = "x86_64")]
    Tiles(Vec<u8>),
}

/// The buffers of one thread.
#[derive(Default)]
pub struct Buffers {
    #[cfg(target_arch = "x86_64")]
    tables: avx512::Buffers,
    #[cfg(target_arch = "x86_64")]
    tiles: amx::Buffers,
}

impl Lookup {
    pub fn new(level: Level, bits: Bits) -> Self {
        let length = bits.pixels().next_multiple_of(GROUP);
        let codes = match level.kind() {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 if level.tiles() => Codes::Tiles(amx::codes(bits, length)),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => Codes::Sixes(avx512::codes(bits, length)),
            _ => Codes::Bytes(padded_planes(&column_codes(bits), bits.pixels(), length)),
        };
        Lookup { length, codes }
    }

    pub fn length(&self) -> usize {
        self.length
    }

    /// The best number of rows for a run: they share one reading of the patterns.
    pub fn batch(&self) -> usize {
        match &self.codes {
            #[cfg(target_arch = "x86_64")]
            Codes::Tiles(_) => amx::LANES,
            _ if self.reads_memory() => MANY,
            _ => BATCH,
        }
    }

    /// Whether the patterns exceed the caches, so that each pass reads them from memory.
    pub fn reads_memory(&self) -> bool {
        self.bytes() > CACHED
    }

    /// Number of bytes that a pass reads.
    fn bytes(&self) -> usize {
        match &self.codes {
            Codes::Bytes(codes) => codes.len(),
            #[cfg(target_arch = "x86_64")]
            Codes::Sixes(codes) | Codes::Tiles(codes) => codes.len(),
        }
    }

    /// Whether the kernel filters scores while it computes them, instead of writing all of them first.
    pub fn streams(&self) -> bool {
        !matches!(self.codes, Codes::Bytes(_))
    }

    /// Computes the scores. Padding gets the score 0.
    pub fn run(
        &self,
        level: Level,
        rows: &[Vec<i16>],
        buffers: &mut Buffers,
        out: &mut [&mut Scores],
    ) {
        let codes = match &self.codes {
            #[cfg(target_arch = "x86_64")]
            Codes::Sixes(codes) => {
                return avx512::run(level, codes, self.length, rows, &mut buffers.tables, out);
            }
            #[cfg(target_arch = "x86_64")]
            Codes::Tiles(codes) => {
                return amx::run(level, codes, self.length, rows, &mut buffers.tiles, out);
            }
            Codes::Bytes(codes) => codes,
        };
        match level.kind() {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => avx2::run(level, codes, self.length, rows, out),
            _ => {
                for (row, out) in rows.iter().zip(out.iter_mut()) {
                    portable(codes, self.length, row, &mut out.values);
                }
            }
        }
    }
}

/// The portable version: one table look-up for each pixel and group of eight patterns.
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

const _: () = assert!(
    BATCH == 3,
    "the kernels are written out for one to three rows"
);
