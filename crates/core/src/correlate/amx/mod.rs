//! The pass with AMX: products of matrices of bytes, sixteen rows' integers with 0/1 patterns.
//!
//! A tile of the processor holds 16 lines of 64 bytes. The integers of 16 rows under 64 patterns
//! are one such; a tile of patterns holds 16 pixels under 64 patterns, four to a line, and is
//! expanded from bits just before it is read. Sums are of 32 bits, so that all patterns pass before
//! they are written. All that is written stays in the first-level cache and is read a while later:
//! stores that miss it, and reads of what is still being stored, cost as much as the products.

mod tiles;

use super::scores::Scores;
use crate::bits::{column_codes, Bits};
use crate::simd::Level;
use rayon::prelude::*;
use std::arch::x86_64::*;
use std::mem::swap;
pub use tiles::LANES;
use tiles::{expand, Planes, Sums, Tiles, BLOCK, COLUMNS, LINE, STEP, TILE, TILES};

/// Blocks whose codes stay in the second-level cache while rows take them, `LANES` at a time.
const BLOCKS: usize = 64;
const PIXELS: usize = BLOCKS * BLOCK;
/// Scores of a register.
const WIDTH: usize = 32;

const _: () = assert!(PIXELS <= 1 << 16, "places are kept in 16 bits");

/// Patterns a bit each, in the order in which steps read them; then a step that means nothing.
pub fn codes(bits: Bits, length: usize) -> Vec<u8> {
    let bytes = column_codes(bits);
    let chunks = chunks_of(bits.patterns());
    let used = length / BLOCK * chunks * STEP;
    let mut codes = vec![0; used + STEP];
    let blocks = codes[..used].par_chunks_mut(chunks * STEP);
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

/// What one step or block leaves to the next, and what that leaves in turn; and what is kept.
#[repr(C, align(4096))]
struct Work {
    planes: [Planes; 2],
    sums: [Sums; 2],
    kept: [Kept; LANES],
}

/// The scores of a row that are wanted, and their places among the pixels that are worked on.
struct Kept {
    /// Scores below the first or above the second number are wanted.
    outside: (i16, i16),
    count: usize,
    // A register more than there can be is written.
    scores: [i16; PIXELS + WIDTH],
    places: [u16; PIXELS + WIDTH],
}

impl Default for Work {
    fn default() -> Self {
        Work {
            planes: [[[0; TILE]; TILES]; 2],
            sums: [[[0; BLOCK]; LANES]; 2],
            kept: [const {
                Kept {
                    outside: (0, 0),
                    count: 0,
                    scores: [0; PIXELS + WIDTH],
                    places: [0; PIXELS + WIDTH],
                }
            }; LANES],
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
    assert_eq!(codes.len(), (length / BLOCK * chunks + 1) * STEP);
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
    let blocks = length / BLOCK;
    for first in (0..blocks).step_by(BLOCKS) {
        let last = blocks.min(first + BLOCKS);
        let codes = &codes[first * chunks * STEP..][..((last - first) * chunks + 1) * STEP];
        let groups = integers.chunks(chunks * LANES);
        for (integers, out) in groups.zip(out.chunks_mut(LANES)) {
            let kept = &mut work.kept[..out.len()];
            for (out, kept) in out.iter().zip(kept) {
                (kept.outside, kept.count) = (out.outside(), 0);
            }
            // SAFETY: the level proves the instructions; the asserts above are the contract.
            unsafe { blocks_of(codes, integers, chunks, out.len(), work) };
            for (out, kept) in out.iter_mut().zip(&work.kept) {
                let (places, scores) = (&kept.places[..kept.count], &kept.scores[..kept.count]);
                out.take_kept(first * BLOCK, places, scores);
            }
        }
    }
}

/// Scores of the first `lanes` of `LANES` rows over blocks of pixels: keeps those that are wanted.
///
/// # Safety
/// `integers` holds `chunks` tiles; `codes` steps of at most `BLOCKS` blocks, `chunks` each, and one
/// step more.
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi2,popcnt")]
unsafe fn blocks_of(
    codes: &[u8],
    integers: &[[u8; LINE]],
    chunks: usize,
    lanes: usize,
    work: &mut Work,
) {
    let blocks = (codes.len() / STEP - 1) / chunks;
    debug_assert!(integers.len() == chunks * LANES && (1..=BLOCKS).contains(&blocks));
    debug_assert!(codes.len() == (blocks * chunks + 1) * STEP);
    let ([planes, next], [sums, before]) = (&mut work.planes, &mut work.sums);
    let (mut planes, mut next, mut sums, mut before) = (planes, next, sums, before);
    let kept = &mut work.kept[..lanes];
    let both = kept.iter().any(|kept| kept.outside.0 > i16::MIN);
    // SAFETY: codes of as many steps as are read, one behind the last included; blocks are kept once.
    unsafe {
        let tiles = Tiles::configured();
        expand(codes.as_ptr(), planes);
        for block in 0..=blocks {
            if block < blocks {
                let codes = codes.as_ptr().add((block * chunks + 1) * STEP);
                tiles.multiply(codes, integers.as_ptr(), chunks, planes, next, sums);
                if chunks % 2 == 1 {
                    swap(&mut planes, &mut next);
                }
            }
            // The sums of the block before can be read without waiting.
            match block.checked_sub(1) {
                Some(block) if both => keep::<true>(block, before, kept),
                Some(block) => keep::<false>(block, before, kept),
                None => {}
            }
            swap(&mut sums, &mut before);
        }
    }
}

/// Keeps the scores of a block that are wanted. It asks for no score whether it is: a branch that is
/// guessed wrongly holds up the tiles for longer than all else here takes.
///
/// # Safety
/// What is kept already are scores of blocks before this one, of `BLOCKS`.
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi2,popcnt")]
unsafe fn keep<const BOTH: bool>(block: usize, sums: &Sums, kept: &mut [Kept]) {
    let first = _mm512_set1_epi16((block * BLOCK) as i16);
    for (sums, kept) in sums.iter().zip(kept) {
        let lowest = _mm512_set1_epi16(kept.outside.0);
        let highest = _mm512_set1_epi16(kept.outside.1);
        for (half, places) in PLACES.iter().enumerate() {
            // SAFETY: a half has two tiles' sums, 16 each; of so many blocks no more than there is
            // room for are kept, and a register.
            unsafe {
                let tile = sums.as_ptr().add(half * WIDTH);
                let [a, b] = [0, COLUMNS].map(|at| _mm512_loadu_si512(tile.add(at).cast()));
                let scores = _mm512_packs_epi32(a, b);
                let mut mask = _mm512_cmpgt_epi16_mask(scores, highest);
                if BOTH {
                    mask |= _mm512_cmplt_epi16_mask(scores, lowest);
                }
                let scores = _mm512_maskz_compress_epi16(mask, scores);
                let places = _mm512_loadu_si512(places.as_ptr().cast());
                let places = _mm512_maskz_compress_epi16(mask, _mm512_add_epi16(places, first));
                let to_scores = kept.scores.as_mut_ptr().add(kept.count);
                let to_places = kept.places.as_mut_ptr().add(kept.count);
                // Whole registers would mostly lie on two cache lines.
                if mask.count_ones() <= 8 {
                    _mm_storeu_si128(to_scores.cast(), _mm512_castsi512_si128(scores));
                    _mm_storeu_si128(to_places.cast(), _mm512_castsi512_si128(places));
                } else {
                    _mm512_storeu_si512(to_scores.cast(), scores);
                    _mm512_storeu_si512(to_places.cast(), places);
                }
                kept.count += mask.count_ones() as usize;
            }
        }
    }
}

/// Of a block.
const PLACES: [[u16; WIDTH]; BLOCK / WIDTH] = {
    let mut places = [[0; WIDTH]; BLOCK / WIDTH];
    let mut place = 0;
    while place < BLOCK {
        places[place / WIDTH][place % WIDTH] = place as u16;
        place += 1;
    }
    places
};
