//! Inner products of the columns of a working set, by counting common bits.

use crate::columns::Columns;
use crate::octet::WIDTH;
use crate::simd::{multiversion, Kind, Level};

/// From this many columns on, tables of partial sums save more than they cost.
#[cfg(target_arch = "x86_64")]
const MANY: usize = 24;

/// The columns of a working set, ready for inner products.
///
/// Columns of bits are stored in groups of `WIDTH`, word by word, so that a row of the Gram matrix takes
/// a few vector instructions per word and group.
#[derive(Default)]
pub struct GramSource {
    /// Whether products of columns that allow it are summed in float32.
    pub quick: bool,
    packed: Vec<u64>,
    scaled: Vec<f64>,
    quickly_scaled: Vec<f32>,
    products: Vec<f64>,
    query: Vec<u64>,
    tables: Vec<f64>,
}

impl GramSource {
    /// Loads the columns of a new working set.
    pub fn load(&mut self, columns: &Columns, pixels: &[u32]) {
        if let Columns::Bits(bits) = columns {
            let group = bits.stride() * WIDTH;
            self.packed.clear();
            self.packed.resize(pixels.len().div_ceil(WIDTH) * group, 0);
            for (i, &pixel) in pixels.iter().enumerate() {
                let packed = &mut self.packed[i / WIDTH * group..][..group];
                for (words, word) in packed.chunks_exact_mut(WIDTH).zip(bits.column(pixel)) {
                    words[i % WIDTH] = *word;
                }
            }
        }
    }

    /// a_j . e for every column of the working set `pixels`.
    pub fn correlate(
        &mut self,
        level: Level,
        columns: &Columns,
        pixels: &[u32],
        e: &[f64],
        out: &mut [f64],
    ) {
        #[cfg(target_arch = "x86_64")]
        if let (Columns::Bits(bits), Kind::Avx512, MANY..) = (columns, level.kind(), pixels.len()) {
            let groups = pixels.len().div_ceil(WIDTH);
            assert!(out.len() == pixels.len() && e.len() == 64 * bits.stride());
            assert!(self.packed.len() == groups * WIDTH * bits.stride());
            self.tables.resize(4 * e.len(), 0.0);
            // SAFETY: the level proves the instructions; the lengths were just compared.
            unsafe { avx512::correlate(&self.packed, e, &mut self.tables, out) };
            return;
        }
        columns.correlate(level, pixels, e, out);
    }

    /// out_i = sum_k d_k a_ik a_jk + factor coupling_i for every column i of the working set, by
    /// counting bits. Returns false if columns or d are not bits.
    ///
    /// `out` and `coupling` are padded to whole groups. `active` holds the bits of d if d is only 0 or
    /// 1, and is empty otherwise.
    // The arguments are parts of the row's state; a struct would only name them again.
    #[allow(clippy::too_many_arguments)]
    pub fn count_row(
        &mut self,
        level: Level,
        columns: &Columns,
        pixel: u32,
        active: &[u64],
        factor: f64,
        coupling: &[f64],
        out: &mut [f64],
    ) -> bool {
        let Columns::Bits(bits) = columns else {
            return false;
        };
        if active.is_empty() {
            return false;
        }
        self.query.clear();
        let column = bits.column(pixel);
        self.query
            .extend(column.iter().zip(active).map(|(c, a)| c & a));
        common_bits(level, &self.packed, &self.query, factor, coupling, out);
        true
    }

    /// sum_k d_k a_ik a_jk for the columns `others`, with j = `pixel`, for any values.
    pub fn products(
        &mut self,
        level: Level,
        columns: &Columns,
        pixel: u32,
        d: &[f64],
        others: &[u32],
    ) -> &[f64] {
        self.scaled.resize(d.len(), 0.0);
        columns.scaled(level, pixel, d, &mut self.scaled);
        self.products.resize(others.len(), 0.0);
        if self.quick {
            self.quickly_scaled.clear();
            let scaled = self.scaled.iter().map(|&value| value as f32);
            self.quickly_scaled.extend(scaled);
            columns.quick_products(level, others, &self.quickly_scaled, &mut self.products);
        } else {
            columns.correlate(level, others, &self.scaled, &mut self.products);
        }
        &self.products
    }
}

/// The number of bits that each packed column shares with the query, plus `factor coupling`.
fn common_bits(
    level: Level,
    packed: &[u64],
    query: &[u64],
    factor: f64,
    coupling: &[f64],
    out: &mut [f64],
) {
    assert_eq!(out.len(), coupling.len());
    assert_eq!(packed.len(), out.len() * query.len());
    match level.kind() {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the level proves the instructions; the lengths were just compared.
        Kind::Avx512 => unsafe { avx512::common_bits(packed, query, factor, coupling, out) },
        _ => common_bits_plain(level, packed, query, factor, coupling, out),
    }
}

multiversion! {
    fn common_bits_plain(
        packed: &[u64], query: &[u64], factor: f64, coupling: &[f64], out: &mut [f64]
    ) {
        let groups = packed.chunks_exact(WIDTH * query.len());
        let out = out.chunks_exact_mut(WIDTH);
        for ((out, coupling), group) in out.zip(coupling.chunks_exact(WIDTH)).zip(groups) {
            for (i, (out, coupling)) in out.iter_mut().zip(coupling).enumerate() {
                let words = group[i..].iter().step_by(WIDTH).zip(query);
                let common: u32 = words.map(|(word, query)| (word & query).count_ones()).sum();
                *out = f64::from(common) + factor * coupling;
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::WIDTH;
    use std::arch::x86_64::*;

    /// Number of groups of columns that share one reading of the tables: their sums fit into registers.
    const GROUPS: usize = 4;

    /// For each packed column the sum of the values whose bits are set, by tables of the sums of four
    /// values: one look-up serves eight columns.
    ///
    /// # Safety
    /// `e` holds 64 values for each word of a column, `tables` four times as many, and `packed` the
    /// columns of `out`, in whole groups.
    #[target_feature(enable = "avx512f")]
    pub unsafe fn correlate(packed: &[u64], e: &[f64], tables: &mut [f64], out: &mut [f64]) {
        let zero = _mm512_setzero_pd();
        for (values, table) in e
            .as_chunks::<4>()
            .0
            .iter()
            .zip(tables.as_chunks_mut::<16>().0)
        {
            let [a, b, c, d] = values.map(|value| _mm512_set1_pd(value));
            let low = _mm512_mask_mov_pd(zero, 0xaa, a);
            let low = _mm512_mask_add_pd(low, 0xcc, low, b);
            let low = _mm512_mask_add_pd(low, 0xf0, low, c);
            // SAFETY: a table holds two registers.
            unsafe {
                _mm512_storeu_pd(table.as_mut_ptr(), low);
                _mm512_storeu_pd(table.as_mut_ptr().add(WIDTH), _mm512_add_pd(low, d));
            }
        }
        let group = e.len() / 64 * WIDTH;
        let many = packed.chunks(GROUPS * group);
        for (packed, out) in many.zip(out.chunks_mut(GROUPS * WIDTH)) {
            // SAFETY: `packed` holds as many whole groups as the parameter says; each four bits have a
            // table.
            unsafe {
                match packed.len() / group {
                    1 => look_up::<1>(packed, tables, out),
                    2 => look_up::<2>(packed, tables, out),
                    3 => look_up::<3>(packed, tables, out),
                    _ => look_up::<GROUPS>(packed, tables, out),
                }
            }
        }
    }

    /// # Safety
    /// `packed` holds `G` groups of columns, `tables` 16 values for every four of their bits.
    #[target_feature(enable = "avx512f")]
    unsafe fn look_up<const G: usize>(packed: &[u64], tables: &[f64], out: &mut [f64]) {
        let group = packed.len() / G;
        let mut sums = [_mm512_setzero_pd(); G];
        for (w, tables) in tables.as_chunks::<{ 16 * 16 }>().0.iter().enumerate() {
            // SAFETY: w is below the number of words of a column.
            let word = |g: usize| unsafe {
                _mm512_loadu_si512(packed.as_ptr().add(g * group + w * WIDTH).cast())
            };
            let mut words: [__m512i; G] = std::array::from_fn(word);
            for table in tables.as_chunks::<16>().0 {
                // SAFETY: a table holds two registers.
                let (low, high) = unsafe {
                    let low = table.as_ptr();
                    (_mm512_loadu_pd(low), _mm512_loadu_pd(low.add(WIDTH)))
                };
                for (sum, word) in sums.iter_mut().zip(&mut words) {
                    // The four lowest bits count.
                    let found = _mm512_permutex2var_pd(low, *word, high);
                    *sum = _mm512_add_pd(*sum, found);
                    *word = _mm512_srli_epi64::<4>(*word);
                }
            }
        }
        for (sum, out) in sums.into_iter().zip(out.chunks_mut(WIDTH)) {
            let mut lanes = [0.0; WIDTH];
            // SAFETY: eight numbers.
            unsafe { _mm512_storeu_pd(lanes.as_mut_ptr(), sum) };
            out.copy_from_slice(&lanes[..out.len()]);
        }
    }

    /// # Safety
    /// `coupling` and `out` have one length, a multiple of eight, and `packed` a word for each of
    /// them and of `query`.
    #[target_feature(enable = "avx512f,avx512vpopcntdq,avx512dq")]
    pub unsafe fn common_bits(
        packed: &[u64],
        query: &[u64],
        factor: f64,
        coupling: &[f64],
        out: &mut [f64],
    ) {
        let (factor, query_len) = (_mm512_set1_pd(factor), query.len());
        for group in 0..out.len() / WIDTH {
            let mut counts = _mm512_setzero_si512();
            for (w, &query) in query.iter().enumerate() {
                let at = WIDTH * (group * query_len + w);
                // SAFETY: the words of all groups before, and of this one up to w, fit `packed`.
                let words = unsafe { _mm512_loadu_si512(packed.as_ptr().add(at).cast()) };
                let common = _mm512_and_si512(words, _mm512_set1_epi64(query as i64));
                counts = _mm512_add_epi64(counts, _mm512_popcnt_epi64(common));
            }
            // SAFETY: 8 group + 8 <= the length of both.
            unsafe {
                let coupling = _mm512_loadu_pd(coupling.as_ptr().add(WIDTH * group));
                let shift = _mm512_mul_pd(factor, coupling);
                let sum = _mm512_add_pd(_mm512_cvtepu64_pd(counts), shift);
                _mm512_storeu_pd(out.as_mut_ptr().add(WIDTH * group), sum);
            }
        }
    }
}
