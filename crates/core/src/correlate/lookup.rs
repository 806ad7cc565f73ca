//! Sums over 0/1 patterns by tables of partial sums ('four Russians').
//!
//! A table holds the sums over all subsets of a few values; the bits of a pixel's column pick one.
//! AVX-512 keeps tables of six values in registers (a permute of 64 bytes), AVX2 tables of four (byte
//! shuffles), and the portable twin tables of eight in memory.

use super::scores::{Scores, BATCH, GROUP, MANY};
#[cfg(target_arch = "x86_64")]
use super::{amx, avx2, avx512};
use crate::bits::{column_codes, Bits};
use crate::simd::{Kind, Level};
use crate::subsets::subset_sums;

/// More bytes of patterns are read from memory by every pass: no cache of today keeps them.
const CACHED: usize = 16 << 20;

pub struct Lookup {
    length: usize,
    codes: Codes,
}

enum Codes {
    /// Planes of (length) bytes, eight patterns a plane.
    Bytes(Vec<u8>),
    /// An index a byte into each table of six patterns.
    #[cfg(target_arch = "x86_64")]
    Sixes(Vec<u8>),
    /// A bit a pattern and pixel.
    #[cfg(target_arch = "x86_64")]
    Tiles(Vec<u8>),
}

/// Buffers of one thread.
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

    /// How many rows a run should have: so many share a reading of the patterns best.
    pub fn batch(&self) -> usize {
        match &self.codes {
            #[cfg(target_arch = "x86_64")]
            Codes::Tiles(_) => amx::LANES,
            _ if self.reads_memory() => MANY,
            _ => BATCH,
        }
    }

    /// Whether a pass reads more than the caches keep from one to the next.
    pub fn reads_memory(&self) -> bool {
        self.bytes() > CACHED
    }

    /// What a pass reads.
    fn bytes(&self) -> usize {
        match &self.codes {
            Codes::Bytes(codes) => codes.len(),
            #[cfg(target_arch = "x86_64")]
            Codes::Sixes(codes) | Codes::Tiles(codes) => codes.len(),
        }
    }

    /// Whether scores go to their rows as they come, and are written only where all are wanted.
    pub fn hands_on(&self) -> bool {
        !matches!(self.codes, Codes::Bytes(_))
    }

    /// Scores. Places that stand for no pixel are lit by no pattern: their scores are 0.
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

const _: () = assert!(
    BATCH == 3,
    "the kernels are written out for one to three rows"
);
