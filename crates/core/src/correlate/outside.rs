//! Collects the scores outside two thresholds, and their places.

use crate::simd::{Kind, Level};

/// Number of scores in an AVX-512 register.
pub const WIDTH: usize = 32;
/// Number of scores that are first tested together, as few lie outside.
const GROUP: usize = 64;

/// Appends the places (from `first` on) and the values of scores outside `below..=above`.
pub fn collect_outside(
    level: Level,
    first: usize,
    scores: &[i16],
    (below, above): (i16, i16),
    places: &mut Vec<u32>,
    collected: &mut Vec<i16>,
) {
    match level.kind() {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the level proves the instructions.
        Kind::Avx512 => unsafe {
            if below == i16::MIN {
                avx512::collect::<false>(first as u32, scores, below, above, places, collected);
            } else {
                avx512::collect::<true>(first as u32, scores, below, above, places, collected);
            }
        },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the level proves the instructions.
        Kind::Avx2 => unsafe {
            avx2::collect(first as u32, scores, below, above, places, collected);
        },
        Kind::Portable => collect_plain(first as u32, scores, below, above, places, collected),
    }
}

fn collect_plain(
    first: u32,
    scores: &[i16],
    below: i16,
    above: i16,
    places: &mut Vec<u32>,
    collected: &mut Vec<i16>,
) {
    for (block, group) in scores.chunks(GROUP).enumerate() {
        let outside = |any, &score: &i16| any | (score > above) | (score < below);
        if group.iter().fold(false, outside) {
            for (i, &score) in group.iter().enumerate() {
                if score > above || score < below {
                    places.push(first + (block * GROUP + i) as u32);
                    collected.push(score);
                }
            }
        }
    }
}

/// Appends the places (from `first` on) and the values of the scores whose bits are set.
#[cfg(target_arch = "x86_64")]
pub fn collect_marked(
    level: Level,
    first: usize,
    scores: &[i16; WIDTH],
    mask: u32,
    places: &mut Vec<u32>,
    collected: &mut Vec<i16>,
) {
    assert!(level.kind() == Kind::Avx512);
    let mut appender = avx512::Appender::new(places, collected, WIDTH);
    // SAFETY: the level proves the instructions; there is room for all.
    unsafe { appender.append(first as u32, scores, mask) };
    appender.finish();
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    /// Number of scores in a register.
    const WIDTH: usize = 16;

    #[target_feature(enable = "avx2,bmi1")]
    pub fn collect(
        first: u32,
        scores: &[i16],
        below: i16,
        above: i16,
        places: &mut Vec<u32>,
        collected: &mut Vec<i16>,
    ) {
        assert!(scores.len().is_multiple_of(2 * WIDTH));
        let (lowest, highest) = (_mm256_set1_epi16(below), _mm256_set1_epi16(above));
        // Two registers are tested together, as few scores lie outside.
        for (pair, scores) in scores.as_chunks::<{ 2 * WIDTH }>().0.iter().enumerate() {
            // SAFETY: there are two registers of scores.
            let values =
                [0, WIDTH].map(|at| unsafe { _mm256_loadu_si256(scores[at..].as_ptr().cast()) });
            let marks = values.map(|values| {
                _mm256_or_si256(
                    _mm256_cmpgt_epi16(values, highest),
                    _mm256_cmpgt_epi16(lowest, values),
                )
            });
            let any = _mm256_or_si256(marks[0], marks[1]);
            if _mm256_testz_si256(any, any) == 1 {
                continue;
            }
            // A byte for each score, in order.
            let bytes =
                _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_packs_epi16(marks[0], marks[1]));
            let mut mask = _mm256_movemask_epi8(bytes) as u32;
            while mask != 0 {
                let place = mask.trailing_zeros();
                places.push(first + (pair * 2 * WIDTH) as u32 + place);
                collected.push(scores[place as usize]);
                mask &= mask - 1;
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::WIDTH;
    use std::arch::x86_64::*;

    /// Number of registers that are first tested together, as few scores lie outside.
    const STRETCH: usize = 16;
    const LANES: [i32; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi2,popcnt,bmi1")]
    pub fn collect<const BOTH: bool>(
        first: u32,
        scores: &[i16],
        below: i16,
        above: i16,
        places: &mut Vec<u32>,
        collected: &mut Vec<i16>,
    ) {
        assert!(scores.len().is_multiple_of(WIDTH));
        let mut appender = Appender::new(places, collected, scores.len());
        let (lowest, highest) = (_mm512_set1_epi16(below), _mm512_set1_epi16(above));
        for (stretch, scores) in scores.chunks(STRETCH * WIDTH).enumerate() {
            let groups = scores.as_chunks::<WIDTH>().0;
            let mut masks = [0u32; STRETCH];
            for (group, mask) in groups.iter().zip(&mut masks) {
                // SAFETY: a group holds one register.
                let values = unsafe { _mm512_loadu_si512(group.as_ptr().cast()) };
                *mask = _mm512_cmpgt_epi16_mask(values, highest);
                if BOTH {
                    *mask |= _mm512_cmplt_epi16_mask(values, lowest);
                }
            }
            // SAFETY: the masks fill a register.
            let all = unsafe { _mm512_loadu_si512(masks.as_ptr().cast()) };
            let mut any = _mm512_test_epi32_mask(all, all);
            while any != 0 {
                let group = any.trailing_zeros() as usize;
                let place = first + ((stretch * STRETCH + group) * WIDTH) as u32;
                // SAFETY: each score once.
                unsafe { appender.append(place, &groups[group], masks[group]) };
                any &= any - 1;
            }
        }
        appender.finish();
    }

    /// Appends to a list of places and a list of their scores without checking their capacity each time.
    pub struct Appender<'a> {
        places: &'a mut Vec<u32>,
        collected: &'a mut Vec<i16>,
        count: usize,
    }

    impl<'a> Appender<'a> {
        /// Reserves space for `most` scores.
        pub fn new(places: &'a mut Vec<u32>, collected: &'a mut Vec<i16>, most: usize) -> Self {
            debug_assert_eq!(places.len(), collected.len());
            // Whole registers are written, also behind the last score.
            places.reserve(most + WIDTH);
            collected.reserve(most + WIDTH);
            let count = collected.len();
            Appender {
                places,
                collected,
                count,
            }
        }

        /// Appends the scores whose bits are set.
        ///
        /// # Safety
        /// At most `most` scores are appended in all.
        #[target_feature(enable = "avx512f,avx512bw,avx512vbmi2,popcnt")]
        pub unsafe fn append(&mut self, place: u32, scores: &[i16; WIDTH], mask: u32) {
            let lower = (mask as u16).count_ones() as usize;
            // SAFETY: as this function's.
            unsafe {
                let scores = _mm512_loadu_si512(scores.as_ptr().cast());
                let kept = _mm512_maskz_compress_epi16(mask, scores);
                _mm512_storeu_si512(self.collected.as_mut_ptr().add(self.count).cast(), kept);
                let at = self.places.as_mut_ptr().add(self.count);
                let lanes = _mm512_loadu_si512(LANES.as_ptr().cast());
                let half = _mm512_add_epi32(lanes, _mm512_set1_epi32(place as i32));
                let kept = _mm512_maskz_compress_epi32(mask as u16, half);
                _mm512_storeu_si512(at.cast(), kept);
                let half = _mm512_add_epi32(half, _mm512_set1_epi32(16));
                let kept = _mm512_maskz_compress_epi32((mask >> 16) as u16, half);
                _mm512_storeu_si512(at.add(lower).cast(), kept);
            }
            self.count += mask.count_ones() as usize;
        }

        pub fn finish(self) {
            // SAFETY: `append` wrote this many.
            unsafe {
                self.places.set_len(self.count);
                self.collected.set_len(self.count);
            }
        }
    }
}
