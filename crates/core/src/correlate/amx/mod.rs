//! The pass with AMX: products of matrices of bytes, the rows' integers times 0/1 patterns.
//!
//! A tile of the processor holds 16 lines of 64 bytes. A tile of integers holds 16 rows under 64 patterns.
//! A tile of patterns holds 16 pixels under 64 patterns, and is expanded from bits shortly before it is
//! used. Two tiles of integers and two of patterns have four products. Their sums have 32 bits, so they
//! stay in tiles until all patterns are done. Stores that miss the first-level cache, and loads of data
//! that is still being stored, would cost as much as the products: so everything that is stored stays in
//! that cache, and is loaded only some steps later.

mod tiles;

use super::scores::Scores;
use crate::bits::{column_codes, Bits};
use crate::simd::Level;
use rayon::prelude::*;
use std::arch::x86_64::*;
pub use tiles::LANES;
use tiles::{expand, Ring, Sums, Tiles, AHEAD, BLOCK, COLUMNS, LINE, ROWS, STEP, TILE, TILES};

/// Number of blocks whose scores are collected before they go to their rows: they stay in the
/// second-level cache.
const BLOCKS: usize = 128;

/// The patterns, one bit each, in the order in which steps read them, then `AHEAD` steps of padding.
pub fn codes(bits: Bits, length: usize) -> Vec<u8> {
    let bytes = column_codes(bits);
    let chunks = chunks_of(bits.patterns());
    let used = length / BLOCK * chunks * STEP;
    let mut codes = vec![0; used + AHEAD * STEP];
    let blocks = codes[..used].par_chunks_mut(chunks * STEP);
    blocks.enumerate().for_each(|(block, codes)| {
        for (line, codes) in codes.as_chunks_mut::<LINE>().0.iter_mut().enumerate() {
            let (half, tile, chunk) = (line % 2, line / 2 % TILES, line / 2 / TILES);
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

/// Number of products that `patterns` take, at least one.
fn chunks_of(patterns: usize) -> usize {
    patterns.div_ceil(LINE).max(1)
}

/// The pixel of a block whose sum is in this column of this tile: packing two registers into one takes
/// four values of each in turn.
fn pixel_of(tile: usize, column: usize) -> usize {
    column / 4 * 8 + tile * 4 + column % 4
}

/// Bits 0, 4, ..., 28 of a word, side by side.
fn every_fourth(word: u32) -> u8 {
    let pairs = word & 0x1111_1111;
    let pairs = (pairs | pairs >> 3) & 0x0303_0303;
    let fours = (pairs | pairs >> 6) & 0x000f_000f;
    (fours | fours >> 12) as u8
}

/// The buffers of one thread.
#[derive(Default)]
pub struct Buffers {
    integers: Vec<[u8; LINE]>,
    work: Option<Box<Work>>,
}

/// The data that one step or block leaves to the next, and the scores that are kept.
#[repr(C, align(4096))]
struct Work {
    ring: Ring,
    sums: Sums,
    outside: [(i16, i16); LANES],
    kept: Kept,
}

/// The scores of blocks in which some pass the filter. The scores of all rows are in one list: with a list
/// for each row, stores would go to more pages than the processor's address cache holds.
struct Kept {
    scores: [[i16; BLOCK]; LANES * BLOCKS],
    marks: [Mark; LANES * BLOCKS],
}

#[derive(Clone, Copy)]
#[repr(C, align(8))]
struct Mark {
    row: u16,
    block: u16,
    /// Bits of the scores that pass the filter.
    mask: u32,
}

const _: () = assert!(BLOCKS <= 1 << 16, "blocks are kept in 16 bits");

impl Default for Work {
    fn default() -> Self {
        let none = Mark {
            row: 0,
            block: 0,
            mask: 0,
        };
        Work {
            ring: [[[0; TILE]; TILES]; AHEAD + 1],
            sums: [[0; BLOCK]; LANES],
            outside: [(0, 0); LANES],
            kept: Kept {
                scores: [[0; BLOCK]; LANES * BLOCKS],
                marks: [none; LANES * BLOCKS],
            },
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
    assert_eq!(codes.len(), (length / BLOCK * chunks + AHEAD) * STEP);
    assert!(length.is_multiple_of(BLOCK) && rows.len() == out.len() && rows.len() <= LANES);
    let Buffers { integers, work } = buffers;
    let work = work.get_or_insert_default();
    integers.clear();
    integers.resize(chunks * LANES, [0; LINE]);
    for (i, row) in rows.iter().enumerate() {
        for (chunk, values) in row.chunks(LINE).enumerate() {
            for (to, value) in integers[chunk * LANES + i].iter_mut().zip(values) {
                debug_assert!((-127..=127).contains(value));
                *to = *value as u8;
            }
        }
    }
    for (outside, out) in work.outside.iter_mut().zip(out.iter()) {
        *outside = out.outside();
    }
    let all = rows.len() > ROWS;
    let blocks_of = if all {
        blocks_of::<true>
    } else {
        blocks_of::<false>
    };
    let blocks = length / BLOCK;
    for first in (0..blocks).step_by(BLOCKS) {
        let last = blocks.min(first + BLOCKS);
        let codes = &codes[first * chunks * STEP..][..((last - first) * chunks + AHEAD) * STEP];
        // SAFETY: the level proves the instructions; the asserts above are the contract.
        let count = unsafe { blocks_of(codes, integers, chunks, rows.len(), work) };
        let Kept { scores, marks } = &work.kept;
        for (scores, mark) in scores.iter().zip(&marks[..count]) {
            let place = (first + usize::from(mark.block)) * BLOCK;
            out[usize::from(mark.row)].keep_marked(level, place, scores, mark.mask);
        }
    }
}

/// Computes the scores of the first `lanes` rows over blocks of pixels, with `ALL` in up to `LANES` rows,
/// else in up to `ROWS`. Keeps each row's blocks in which some scores pass the filter; returns their
/// number.
///
/// # Safety
/// `integers` holds `chunks` times `LANES` lines; `codes` steps of at most `BLOCKS` blocks, `chunks`
/// each, and of `AHEAD` steps more.
#[target_feature(enable = "avx512f,avx512bw")]
unsafe fn blocks_of<const ALL: bool>(
    codes: &[u8],
    integers: &[[u8; LINE]],
    chunks: usize,
    lanes: usize,
    work: &mut Work,
) -> usize {
    let blocks = (codes.len() / STEP - AHEAD) / chunks;
    debug_assert!(integers.len() == chunks * LANES && (1..=BLOCKS).contains(&blocks));
    debug_assert!(codes.len() == (blocks * chunks + AHEAD) * STEP);
    debug_assert!(lanes <= if ALL { LANES } else { ROWS });
    let Work {
        ring,
        sums,
        outside,
        kept,
    } = work;
    let outside = &outside[..lanes];
    let both = outside.iter().any(|(below, _)| *below > i16::MIN);
    let keep = if both { keep::<true> } else { keep::<false> };
    let mut count = 0;
    // SAFETY: there are codes for all steps, those ahead included, and each block is kept once.
    unsafe {
        let mut tiles = Tiles::configured();
        for (step, planes) in ring.iter_mut().enumerate().take(AHEAD) {
            expand(codes.as_ptr().add(step * STEP), planes);
        }
        let mut at = 0;
        for block in 0..blocks {
            let codes = codes.as_ptr().add((block * chunks + AHEAD) * STEP);
            at = tiles.multiply::<ALL>(codes, integers.as_ptr(), chunks, ring, at);
            // Read the sums of the previous block, which are stored by now, while tiles multiply.
            if block > 0 {
                count = keep(block - 1, sums, outside, kept, count);
            }
            tiles.store(sums);
        }
        keep(blocks - 1, sums, outside, kept, count)
    }
}

/// Appends a block's scores of each row in which some pass the filter to the `count` that are kept;
/// returns the new count. It always writes and has no branch: a mispredicted branch would stall the tiles
/// for longer than everything else here takes.
///
/// # Safety
/// The scores kept so far are of earlier blocks, and there are at most `BLOCKS` blocks.
#[target_feature(enable = "avx512f,avx512bw")]
unsafe fn keep<const BOTH: bool>(
    block: usize,
    sums: &Sums,
    outside: &[(i16, i16)],
    kept: &mut Kept,
    mut count: usize,
) -> usize {
    for (row, (sums, (below, above))) in sums.iter().zip(outside).enumerate() {
        // SAFETY: a row has the sums of two tiles, 16 each; there is room for all rows and blocks.
        unsafe {
            let [a, b] = [0, COLUMNS].map(|at| _mm512_loadu_si512(sums.as_ptr().add(at).cast()));
            let scores = _mm512_packs_epi32(a, b);
            let mut mask = _mm512_cmpgt_epi16_mask(scores, _mm512_set1_epi16(*above));
            if BOTH {
                mask |= _mm512_cmplt_epi16_mask(scores, _mm512_set1_epi16(*below));
            }
            let to = kept.scores.get_unchecked_mut(count);
            _mm512_storeu_si512(to.as_mut_ptr().cast(), scores);
            let (row, block) = (row as u16, block as u16);
            *kept.marks.get_unchecked_mut(count) = Mark { row, block, mask };
            count += usize::from(mask != 0);
        }
    }
    count
}
