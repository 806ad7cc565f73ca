//! The pass with AMX: products of matrices of bytes, sixteen rows' integers with 0/1 patterns.
//!
//! A tile of the processor holds 16 lines of 64 bytes. The integers of 16 rows under 64 patterns
//! are one such; a tile of patterns holds 16 pixels under 64 patterns, four to a line, and is
//! expanded from bits just before it is read. Sums are of 32 bits, so that all patterns pass before
//! they are written.

use super::scores::Scores;
use crate::bits::{column_codes, Bits};
use crate::simd::Level;
use rayon::prelude::*;
use std::arch::asm;
use std::arch::x86_64::*;

/// Rows that one product takes.
pub const LANES: usize = 16;
/// Bytes of a line of a tile, and patterns that one product takes.
const LINE: usize = 64;
/// Bytes of a tile.
const TILE: usize = 16 * LINE;
/// Pixels of a tile.
const COLUMNS: usize = 16;
/// Tiles of sums that are worked on at a time, and their pixels.
const TILES: usize = 4;
const BLOCK: usize = TILES * COLUMNS;
/// Blocks between which sums are handed on: so many sums, and codes for all rows, stay in the
/// second-level cache.
const BLOCKS: usize = 16;

/// Patterns a bit each, in the order in which `products` reads them.
pub fn codes(bits: Bits, length: usize) -> Vec<u8> {
    let bytes = column_codes(bits);
    let chunks = chunks_of(bits.patterns());
    let mut codes = vec![0; length * chunks * LINE / 8];
    let blocks = codes.par_chunks_mut(BLOCK * chunks * LINE / 8);
    blocks.enumerate().for_each(|(block, codes)| {
        for (line, codes) in codes.as_chunks_mut::<LINE>().0.iter_mut().enumerate() {
            let (chunk, tile, half) = (line / 8, line / 2 % TILES, line % 2);
            for (column, codes) in codes.as_chunks_mut::<4>().0.iter_mut().enumerate() {
                let pixel = block * BLOCK + pixel_of(tile, column);
                if pixel < bits.pixels() {
                    let plane = |i| bytes.get((8 * chunk + 4 * half + i) * bits.pixels() + pixel);
                    let word = [0, 1, 2, 3].map(|i| plane(i).copied().unwrap_or(0));
                    let word = u32::from_le_bytes(word);
                    *codes = [0, 1, 2, 3].map(|i| every_fourth(word >> i));
                }
            }
        }
    });
    codes
}

/// Products that so many patterns take, one at least.
fn chunks_of(patterns: usize) -> usize {
    patterns.div_ceil(LINE).max(1)
}

/// The pixel of a block whose sum is in a column of a tile: packing two registers into one takes
/// four from each in turn.
fn pixel_of(tile: usize, column: usize) -> usize {
    tile / 2 * 2 * COLUMNS + column / 4 * 8 + tile % 2 * 4 + column % 4
}

/// Bits 0, 4, ... 28 side by side.
fn every_fourth(word: u32) -> u8 {
    let pairs = word & 0x1111_1111;
    let pairs = (pairs | pairs >> 3) & 0x0303_0303;
    let fours = (pairs | pairs >> 6) & 0x000f_000f;
    (fours | fours >> 12) as u8
}

/// Buffers of one thread.
#[derive(Default)]
pub struct Buffers {
    integers: Vec<[u8; LINE]>,
    work: Option<Box<Work>>,
}

#[repr(C, align(8192))]
struct Work {
    /// Of 64 patterns and a block of pixels, a byte each: of a step and of that before it.
    planes: [[[u8; TILE]; TILES]; 2],
    sums: [[[i32; BLOCK]; LANES]; BLOCKS],
    /// Of one row.
    scores: [[i16; BLOCK]; BLOCKS],
}

impl Default for Work {
    fn default() -> Self {
        Work {
            planes: [[[0; TILE]; TILES]; 2],
            sums: [[[0; BLOCK]; LANES]; BLOCKS],
            scores: [[0; BLOCK]; BLOCKS],
        }
    }
}

/// # Panics
/// If the level has no tiles or the lengths do not fit.
pub fn run(
    level: Level,
    codes: &[u8],
    length: usize,
    rows: &[Vec<i16>],
    buffers: &mut Buffers,
    out: &mut [&mut Scores],
) {
    assert!(level.tiles());
    let patterns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let chunks = chunks_of(patterns);
    assert_eq!(codes.len(), length * chunks * LINE / 8);
    assert!(length.is_multiple_of(BLOCK) && rows.len() == out.len());
    let Buffers { integers, work } = buffers;
    let work = work.get_or_insert_default();
    integers.clear();
    integers.resize(rows.len().div_ceil(LANES) * chunks * LANES, [0; LINE]);
    for (i, row) in rows.iter().enumerate() {
        for (chunk, values) in row.chunks(LINE).enumerate() {
            let line = &mut integers[(i / LANES * chunks + chunk) * LANES + i % LANES];
            for (to, value) in line.iter_mut().zip(values) {
                debug_assert!((-127..=127).contains(value));
                *to = *value as u8;
            }
        }
    }
    for pixel in (0..length).step_by(BLOCKS * BLOCK) {
        let blocks = (length - pixel).min(BLOCKS * BLOCK) / BLOCK;
        let codes = &codes[pixel * chunks * LINE / 8..];
        let groups = integers.chunks(chunks * LANES);
        for (integers, out) in groups.zip(out.chunks_mut(LANES)) {
            // SAFETY: the level proves the instructions; the asserts above are the contract.
            unsafe {
                products(codes, integers, chunks, blocks, work);
                for (lane, out) in out.iter_mut().enumerate() {
                    let scores = packed(&work.sums[..blocks], lane, &mut work.scores);
                    out.take(level, pixel, scores);
                }
            }
        }
    }
}

/// What the tiles are: 16 lines of 64 bytes, all eight.
#[repr(C, align(64))]
struct Configuration {
    palette: [u8; 16],
    line_bytes: [u16; 16],
    lines: [u8; 16],
}

const CONFIGURATION: Configuration = {
    let mut all = Configuration {
        palette: [0; 16],
        line_bytes: [0; 16],
        lines: [0; 16],
    };
    all.palette[0] = 1;
    let mut tile = 0;
    while tile < 8 {
        all.line_bytes[tile] = LINE as u16;
        all.lines[tile] = 16;
        tile += 1;
    }
    all
};

/// Instructions that expand codes of half a tile each (`$half`): bit `$bit` of each byte to a line.
macro_rules! expand {
    ($($half:literal)*) => {
        concat!($(
            "vmovdqu64 zmm0, [{codes} + 64 * ", $half, "]\n",
            expand!($half, 0), expand!($half, 1), expand!($half, 2), expand!($half, 3),
            expand!($half, 4), expand!($half, 5), expand!($half, 6), expand!($half, 7),
        )*)
    };
    ($half:literal, $bit:literal) => {
        concat!(
            "vpsrlw zmm1, zmm0, ", $bit, "\n",
            "vpandd zmm1, zmm1, zmm2\n",
            "vmovdqa64 [{planes} + 512 * ", $half, " + 64 * ", $bit, "], zmm1\n",
        )
    };
}

/// Sums of `LANES` rows over some blocks of pixels, into `work.sums`.
///
/// # Safety
/// `codes` holds `chunks` times 64 patterns of `blocks` blocks, `integers` `chunks` tiles;
/// `blocks` is at most `BLOCKS` and not 0.
#[target_feature(enable = "avx512f,avx512bw")]
unsafe fn products(
    codes: &[u8],
    integers: &[[u8; LINE]],
    chunks: usize,
    blocks: usize,
    work: &mut Work,
) {
    debug_assert!(codes.len() >= blocks * chunks * BLOCK * LINE / 8);
    debug_assert!(integers.len() >= chunks * LANES && (1..=BLOCKS).contains(&blocks));
    // SAFETY: reads and writes stay within what the contract says there is. Tiles and their
    // configuration are as if never used in the end.
    unsafe {
        asm!(
            "ldtilecfg [{tiles}]",
            "vpbroadcastd zmm2, {line:e}",
            "tilezero tmm0",
            "tilezero tmm1",
            "tilezero tmm2",
            "tilezero tmm3",
            "2:", // expands the patterns of a step, if there are more,
            "test {left}, {left}",
            "jz 4f",
            expand!(0 1 2 3 4 5 6 7),
            "add {codes}, 512",
            "4:", // and multiplies those of the step before, if there was one
            "xor {planes}, 4096",
            "cmp {left}, {steps}",
            "je 5f",
            "mov {line}, 64",
            "tileloadd tmm4, [{integers} + {line} * 1]",
            "tileloadd tmm5, [{planes} + {line} * 1]",
            "tdpbsud tmm0, tmm4, tmm5",
            "tileloadd tmm6, [{planes} + {line} * 1 + 1024]",
            "tdpbsud tmm1, tmm4, tmm6",
            "tileloadd tmm7, [{planes} + {line} * 1 + 2048]",
            "tdpbsud tmm2, tmm4, tmm7",
            "tileloadd tmm5, [{planes} + {line} * 1 + 3072]",
            "tdpbsud tmm3, tmm4, tmm5",
            "add {integers}, 1024",
            "dec {chunk}",
            "jnz 5f",
            // A block of pixels has seen all patterns.
            "mov {line}, 256",
            "tilestored [{sums} + {line} * 1], tmm0",
            "tilestored [{sums} + {line} * 1 + 64], tmm1",
            "tilestored [{sums} + {line} * 1 + 128], tmm2",
            "tilestored [{sums} + {line} * 1 + 192], tmm3",
            "tilezero tmm0",
            "tilezero tmm1",
            "tilezero tmm2",
            "tilezero tmm3",
            "add {sums}, 4096",
            "mov {integers}, {first}",
            "mov {chunk}, {chunks}",
            "5:",
            "dec {left}",
            "jns 2b",
            "tilerelease",
            first = in(reg) integers.as_ptr(),
            chunks = in(reg) chunks,
            steps = in(reg) blocks * chunks,
            left = inout(reg) blocks * chunks => _,
            integers = inout(reg) integers.as_ptr() => _,
            chunk = inout(reg) chunks => _,
            codes = inout(reg) codes.as_ptr() => _,
            planes = inout(reg) work.planes.as_mut_ptr() => _,
            sums = inout(reg) work.sums.as_mut_ptr() => _,
            tiles = in(reg) &CONFIGURATION,
            line = inout(reg) 0x0101_0101u64 => _,
            out("zmm0") _, out("zmm1") _, out("zmm2") _,
            out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
            out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
            options(nostack),
        );
    }
}

/// A row's sums as scores.
#[target_feature(enable = "avx512f,avx512bw")]
fn packed<'a>(
    sums: &[[[i32; BLOCK]; LANES]],
    lane: usize,
    scores: &'a mut [[i16; BLOCK]; BLOCKS],
) -> &'a [i16] {
    for (sums, scores) in sums.iter().zip(scores.iter_mut()) {
        let tiles = sums[lane].as_ptr();
        for half in 0..TILES / 2 {
            // SAFETY: tiles of 16 sums, a register each; two give one of scores.
            unsafe {
                let at = |tile: usize| _mm512_loadu_si512(tiles.add(tile * COLUMNS).cast());
                let both = _mm512_packs_epi32(at(2 * half), at(2 * half + 1));
                _mm512_storeu_si512(scores.as_mut_ptr().add(2 * half * COLUMNS).cast(), both);
            }
        }
    }
    scores[..sums.len()].as_flattened()
}
