//! Compares every kernel with the definition, and the kernels with each other.

use super::scores::MANY;
use super::*;
use crate::atoms::Plane;
use crate::columns::{BitColumns, DenseColumns};
use crate::simd::Level;
use crate::vector::padded;

struct Random(u64);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 33) as u32
    }

    /// In [-1, 1).
    fn value(&mut self) -> f64 {
        f64::from(self.next()) / f64::from(1u32 << 30) - 1.0
    }
}

fn bytes(patterns: usize, pixels: usize, random: &mut Random) -> Vec<u8> {
    (0..patterns * pixels.div_ceil(8))
        .map(|_| random.next() as u8)
        .collect()
}

fn rows(count: usize, patterns: usize, random: &mut Random) -> Vec<Vec<f64>> {
    (0..count)
        .map(|_| {
            let mut row: Vec<f64> = (0..patterns).map(|_| random.value()).collect();
            row.resize(padded(patterns), 0.0);
            row
        })
        .collect()
}

fn run(correlator: &Correlator, columns: &Columns, rows: &[Vec<f64>]) -> Vec<Scores> {
    let mut scores = vec![Scores::default(); rows.len()];
    let e: Vec<&[f64]> = rows.iter().map(Vec::as_slice).collect();
    let mut out: Vec<&mut Scores> = scores.iter_mut().collect();
    correlator.run(columns, &e, &mut out, &mut Scratch::default());
    scores
}

/// Asserts that scores bound the exact correlations, and tightly.
fn check(
    correlator: &Correlator,
    scores: &[Scores],
    rows: &[Vec<f64>],
    exact: impl Fn(u32, &[f64]) -> f64,
) {
    for (scores, row) in scores.iter().zip(rows) {
        let total: f64 = row.iter().map(|v| v.abs()).sum();
        let mut seen = 0;
        for (place, &score) in scores.values.iter().enumerate() {
            let Some(pixel) = correlator.pixel(place) else {
                continue;
            };
            seen += 1;
            let middle = f64::from(score) + scores.offset;
            let (low, high) = (middle - scores.down, middle + scores.up);
            let value = exact(pixel, row);
            assert!(scores.unit * low <= value && value <= scores.unit * high);
            assert!(scores.unit * (high - low) <= 0.01 * total * (1.0 + row.len() as f64 / 100.0));
        }
        assert_eq!(seen, correlator.pixels);
    }
}

const SIZES: [(usize, usize); 9] = [
    (1, 1),
    (2, 63),
    (5, 64),
    (6, 65),
    (12, 200),
    (13, 2047),
    (24, 2049),
    (25, 130),
    (257, 4100),
];

#[test]
fn scores_of_bits_bound_the_exact_correlations() {
    for (patterns, pixels) in SIZES {
        let mut random = Random(patterns as u64);
        let packed = bytes(patterns, pixels, &mut random);
        let bits = Bits::new(&packed, patterns, pixels);
        let columns = Columns::Bits(BitColumns::new(bits));
        let rows = rows(3, patterns, &mut random);
        let mut first: Option<Vec<Scores>> = None;
        for level in Level::available() {
            let correlator = Correlator::lookup(level, bits);
            for count in 1..=BATCH {
                let scores = run(&correlator, &columns, &rows[..count]);
                check(&correlator, &scores, &rows, |pixel, row| {
                    (0..patterns)
                        .filter(|&k| bits.lit(k, pixel as usize))
                        .map(|k| row[k])
                        .sum()
                });
                let first = first.get_or_insert_with(|| run(&correlator, &columns, &rows));
                for (a, b) in scores.iter().zip(first) {
                    assert_eq!(a.values, b.values);
                    assert_eq!((a.unit, a.up, a.down), (b.unit, b.up, b.down));
                }
            }
        }
    }
}

#[test]
fn rows_that_share_a_reading_have_the_scores_of_rows_by_themselves() {
    // Patterns beyond the caches, two parts of patterns, and tiles of pixels of which one is smaller.
    let (patterns, pixels) = (600, 230_000);
    let mut random = Random(7);
    let packed = bytes(patterns, pixels, &mut random);
    let bits = Bits::new(&packed, patterns, pixels);
    let columns = Columns::Bits(BitColumns::new(bits));
    let rows = rows(MANY - 1, patterns, &mut random);
    for level in Level::available() {
        let correlator = Correlator::lookup(level, bits);
        assert!(correlator.batch() > rows.len());
        let together = run(&correlator, &columns, &rows);
        for (row, scores) in rows.chunks(1).zip(&together) {
            let alone = run(&correlator, &columns, row);
            assert_eq!(alone[0].values, scores.values);
            assert_eq!(alone[0].unit, scores.unit);
        }
    }
}

#[test]
fn scores_by_transform_bound_the_exact_correlations() {
    for (length, pixels, patterns) in [
        (1, 1, 1),
        (2, 2, 1),
        (16, 9, 5),
        (64, 64, 64),
        (1024, 700, 300),
    ] {
        let mut random = Random(pixels as u64);
        let mut order: Vec<u32> = (0..length as u32).collect();
        for i in (1..length).rev() {
            order.swap(i, random.next() as usize % (i + 1));
        }
        let (selected, position) = (&order[length - patterns..], &order[..pixels]);
        let lit = |k: usize, pixel: u32| {
            (selected[k] & position[pixel as usize])
                .count_ones()
                .is_multiple_of(2)
        };
        let mut packed = vec![0u8; patterns * pixels.div_ceil(8)];
        for k in 0..patterns {
            for pixel in (0..pixels).filter(|&pixel| lit(k, pixel as u32)) {
                packed[k * pixels.div_ceil(8) + pixel / 8] |= 1 << (pixel % 8);
            }
        }
        let columns = Columns::Bits(BitColumns::new(Bits::new(&packed, patterns, pixels)));
        let rows = rows(2, patterns, &mut random);
        let mut first: Option<Vec<Scores>> = None;
        for level in Level::available() {
            let correlator = Correlator::transform(level, length, selected, position);
            let scores = run(&correlator, &columns, &rows);
            check(&correlator, &scores, &rows, |pixel, row| {
                (0..patterns)
                    .filter(|&k| lit(k, pixel))
                    .map(|k| row[k])
                    .sum()
            });
            let first = first.get_or_insert_with(|| scores.clone());
            assert!(scores.iter().zip(first).all(|(a, b)| a.values == b.values));
        }
    }
}

#[test]
fn scores_of_dense_patterns_bound_the_exact_correlations() {
    for (patterns, pixels) in SIZES {
        let mut random = Random(pixels as u64);
        let p: Vec<f32> = (0..patterns * pixels)
            .map(|_| random.value().abs() as f32)
            .collect();
        let columns = Columns::Dense(DenseColumns::new(&p, patterns, pixels));
        let rows = rows(3, patterns, &mut random);
        for level in Level::available() {
            let correlator = Correlator::dense(level, patterns, pixels);
            let scores = run(&correlator, &columns, &rows);
            check(&correlator, &scores, &rows, |pixel, row| {
                (0..patterns)
                    .map(|k| f64::from(p[k * pixels + pixel as usize]) * row[k])
                    .sum()
            });
        }
    }
}

#[test]
fn sums_do_not_leave_sixteen_bits() {
    // All of one sign, and more values than are rounded to nearest.
    for patterns in [300, 40_000] {
        let packed = vec![0xff; patterns];
        let bits = Bits::new(&packed, patterns, 3);
        let columns = Columns::Bits(BitColumns::new(bits));
        let mut row = vec![0.37; patterns];
        row.resize(padded(patterns), 0.0);
        for level in Level::available() {
            let correlator = Correlator::lookup(level, bits);
            let scores = run(&correlator, &columns, std::slice::from_ref(&row));
            let exact = 0.37 * patterns as f64;
            let score = f64::from(scores[0].values[2]);
            assert!(score >= 0.0);
            assert!(scores[0].unit * (score + scores[0].up) >= exact);
            assert!(scores[0].unit * (score - scores[0].down) <= exact);
        }
    }
}

#[test]
fn residuals_of_nothing_give_scores_of_nothing() {
    let packed = [0xff];
    let bits = Bits::new(&packed, 1, 5);
    let columns = Columns::Bits(BitColumns::new(bits));
    let row = vec![0.0; padded(1)];
    let correlator = Correlator::lookup(Level::detect(), bits);
    let scores = run(&correlator, &columns, &[row]);
    assert!(scores[0].values.iter().all(|&v| v == 0));
}

#[test]
fn scores_beyond_a_value_are_those_among_all() {
    for (patterns, pixels) in SIZES {
        let mut random = Random(patterns as u64);
        let packed = bytes(patterns, pixels, &mut random);
        let bits = Bits::new(&packed, patterns, pixels);
        let columns = Columns::Bits(BitColumns::new(bits));
        for level in Level::available() {
            let correlator = Correlator::lookup(level, bits);
            let rows = rows(correlator.batch() - 1, patterns, &mut random);
            let e: Vec<&[f64]> = rows.iter().map(Vec::as_slice).collect();
            let all = run(&correlator, &columns, &rows);
            // A threshold that most, some and none exceed.
            for (value, both) in [(-0.1, false), (0.1, true), (0.5, false), (1e3, true)] {
                let mut scores = vec![Scores::default(); e.len()];
                for scores in &mut scores {
                    scores.filter = ScoreFilter::Beyond { value, both };
                }
                let mut out: Vec<&mut Scores> = scores.iter_mut().collect();
                correlator.run(&columns, &e, &mut out, &mut Scratch::default());
                for (all, scores) in all.iter().zip(&scores) {
                    let (below, above) = all.thresholds(value, both);
                    let beyond = |&(_, &score): &(usize, &i16)| score < below || score > above;
                    let (places, found): (Vec<u32>, Vec<i16>) = (all.values.iter().enumerate())
                        .filter(beyond)
                        .map(|(place, score)| (place as u32, score))
                        .unzip();
                    assert_eq!(places, scores.places);
                    assert_eq!(found, scores.collected);
                }
            }
        }
    }
}

#[test]
fn selection_finds_all_that_may_exceed_a_value() {
    let mut random = Random(3);
    let mut scores = Scores {
        values: (0..4096)
            .map(|_| (random.value() * 30_000.0) as i16)
            .collect(),
        unit: 0.01,
        offset: 12.0,
        up: 3.5,
        down: 2.5,
        ..Scores::default()
    };
    for level in Level::available() {
        for both in [false, true] {
            for (most, floor) in [(100, 1.0), (7, 250.0), (4096, 55.5), (50, 299.0), (5, 1e4)] {
                let mut found = Vec::new();
                scores.filter = ScoreFilter::Beyond { value: floor, both };
                scores.begin();
                scores.filter_values(level);
                let (value, all) = scores.collect_largest(level, most, &mut found);
                let expected: Vec<u32> = (0..4096u32)
                    .filter(|&i| {
                        let middle = f64::from(scores.values[i as usize]) + 12.0;
                        let above = scores.unit * (middle + 3.5) > value;
                        above || (both && scores.unit * (middle - 2.5) < -value)
                    })
                    .collect();
                // The threshold may be one score lower, never higher.
                assert!(expected.iter().all(|i| found.contains(i)));
                assert!(found.len() <= expected.len() + 4);
                assert!(found.is_sorted());
                assert_eq!(all, value == floor);
                if !all {
                    assert!(found.len() <= most && 2 * found.len() >= most);
                }
            }
        }
    }
}

#[test]
fn blurred_scores_bound_the_correlations_with_atoms() {
    let mut random = Random(11);
    for (grid, patterns) in [([5, 7], 40), ([1, 70], 9), ([33, 2], 130)] {
        let pixels = grid[0] * grid[1];
        let packed = bytes(patterns, pixels, &mut random);
        let rows = rows(3, patterns, &mut random);
        let planes = [
            (vec![1.0], 0.3),
            (vec![0.5, 0.25], 0.6),
            (vec![0.2, 0.15, 0.1, 0.1, 0.05], 1.0),
        ];
        let planes = planes.map(|(kernel, gain)| Plane { kernel, gain });
        for level in Level::available() {
            let bits = Bits::new(&packed, patterns, pixels);
            let single = Columns::Bits(BitColumns::new(bits));
            let atoms = Atoms {
                grid,
                planes: planes.to_vec(),
            };
            let columns = Columns::Dense(atoms.columns(level, &single, patterns, None));
            let lookup = Correlator::lookup(level, bits);
            let inner = Correlator::lookup(level, bits);
            let pass: Pass = Box::new(move |e, out, scratch| inner.run(&single, e, out, scratch));
            let correlator = Correlator::blurred(level, patterns, atoms, &lookup, pass);
            let scores = run(&correlator, &columns, &rows);
            // From the definition: the blurred pattern at the atom's place.
            let exact = |atom: u32, row: &[f64]| {
                let (plane, pixel) = (atom as usize / pixels, atom as usize % pixels);
                let (r, c) = (pixel / grid[1], pixel % grid[1]);
                let Plane { kernel, gain } = &planes[plane];
                let at = |near: usize, far: usize| {
                    kernel
                        .get(near.abs_diff(far))
                        .map_or(0.0, |v| f64::from(*v))
                };
                let mut sum = 0.0;
                for (k, value) in row.iter().enumerate().take(patterns) {
                    for (other, weight) in (0..pixels).map(|other| {
                        let weight = at(r, other / grid[1]) * at(c, other % grid[1]);
                        (other, weight)
                    }) {
                        if bits.lit(k, other) {
                            sum += value * weight * f64::from(*gain);
                        }
                    }
                }
                sum
            };
            check(&correlator, &scores, &rows, exact);
        }
    }
}
