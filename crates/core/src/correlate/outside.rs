//! Scores outside two thresholds, and where they are.

use crate::simd::{multiversion, Kind, Level};

/// Scores of which it is first seen whether any lies outside: few do.
const GROUP: usize = 64;

/// Appends the places (from `first` on) and the values of scores outside `below..=above`.
pub fn collect_outside(
    level: Level,
    first: usize,
    scores: &[i16],
    (below, above): (i16, i16),
    places: &mut Vec<u32>,
    found: &mut Vec<i16>,
) {
    match level.kind() {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the level proves the instructions.
        Kind::Avx512 => unsafe {
            if below == i16::MIN {
                avx512::collect::<false>(first as u32, scores, below, above, places, found);
            } else {
                avx512::collect::<true>(first as u32, scores, below, above, places, found);
            }
        },
        _ => collect_plain(level, first as u32, scores, below, above, places, found),
    }
}

multiversion! {
    fn collect_plain(
        first: u32, scores: &[i16], below: i16, above: i16, places: &mut Vec<u32>, found: &mut Vec<i16>
    ) {
        for (block, group) in scores.chunks(GROUP).enumerate() {
            let outside = |any, &score: &i16| any | (score > above) | (score < below);
            if group.iter().fold(false, outside) {
                for (i, &score) in group.iter().enumerate() {
                    if score > above || score < below {
                        places.push(first + (block * GROUP + i) as u32);
                        found.push(score);
                    }
                }
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use std::arch::x86_64::*;

    /// Scores of a register.
    const WIDTH: usize = 32;
    /// Registers of which it is first seen whether any score lies outside: few do.
    const STRETCH: usize = 16;
    const LANES: [i32; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi2,popcnt,bmi1")]
    pub fn collect<const BOTH: bool>(
        first: u32,
        scores: &[i16],
        below: i16,
        above: i16,
        places: &mut Vec<u32>,
        found: &mut Vec<i16>,
    ) {
        assert!(scores.len().is_multiple_of(WIDTH));
        // A register more than can be kept is written.
        places.reserve(scores.len() + WIDTH);
        found.reserve(scores.len() + WIDTH);
        let (lowest, highest) = (_mm512_set1_epi16(below), _mm512_set1_epi16(above));
        let mut count = found.len();
        debug_assert_eq!(count, places.len());
        for (stretch, scores) in scores.chunks(STRETCH * WIDTH).enumerate() {
            let groups = scores.as_chunks::<WIDTH>().0;
            // SAFETY: a group holds one register.
            let load = |group: &[i16; WIDTH]| unsafe { _mm512_loadu_si512(group.as_ptr().cast()) };
            let mut masks = [0u32; STRETCH];
            for (group, mask) in groups.iter().zip(&mut masks) {
                let values = load(group);
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
                let mask = masks[group];
                let place = first + ((stretch * STRETCH + group) * WIDTH) as u32;
                let lower = (mask as u16).count_ones() as usize;
                // SAFETY: there is room for as many as there are scores, and one register more.
                unsafe {
                    let kept = _mm512_maskz_compress_epi16(mask, load(&groups[group]));
                    _mm512_storeu_si512(found.as_mut_ptr().add(count).cast(), kept);
                    let at = places.as_mut_ptr().add(count);
                    let lanes = _mm512_loadu_si512(LANES.as_ptr().cast());
                    let half = _mm512_add_epi32(lanes, _mm512_set1_epi32(place as i32));
                    let kept = _mm512_maskz_compress_epi32(mask as u16, half);
                    _mm512_storeu_si512(at.cast(), kept);
                    let half = _mm512_add_epi32(half, _mm512_set1_epi32(16));
                    let kept = _mm512_maskz_compress_epi32((mask >> 16) as u16, half);
                    _mm512_storeu_si512(at.add(lower).cast(), kept);
                }
                count += mask.count_ones() as usize;
                any &= any - 1;
            }
        }
        // SAFETY: so many were written.
        unsafe {
            places.set_len(count);
            found.set_len(count);
        }
    }
}
