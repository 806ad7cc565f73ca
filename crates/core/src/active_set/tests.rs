//! The solver on small problems; the thorough tests are in Python, against independent solvers.

use super::model::Model;
use super::*;
use crate::bits::Bits;
use crate::columns::{BitColumns, Columns, DenseColumns};
use crate::correlate::Correlator;
use crate::problem::{Fidelity, Values};
use crate::simd::Level;
use crate::vector::DataTerm;

fn dictionary(level: Level, packed: &[u8], patterns: usize, pixels: usize) -> Dictionary {
    let bits = Bits::new(packed, patterns, pixels);
    let mut means: Vec<f64> = (0..patterns)
        .map(|k| (0..pixels).filter(|&n| bits.lit(k, n)).count() as f64 / pixels as f64)
        .collect();
    means.resize(padded(patterns), 0.0);
    Dictionary {
        level,
        columns: Columns::Bits(BitColumns::new(bits)),
        correlator: Correlator::lookup(level, bits),
        means,
        patterns,
        pixels,
    }
}

const SETTINGS: Settings = Settings {
    regularization: 0.1,
    fidelity: Fidelity::OneSided,
    nonnegative: true,
    background: true,
    tolerance: 1e-6,
    max_passes: 100,
};

fn example() -> (Vec<u8>, Vec<f64>, Vec<bool>) {
    let (patterns, pixels, rows) = (70usize, 150usize, 33);
    let mut state = 11u64;
    let mut next = move || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) as u32
    };
    let packed: Vec<u8> = (0..patterns * pixels.div_ceil(8))
        .map(|_| next() as u8)
        .collect();
    let bits = Bits::new(&packed, patterns, pixels);
    let mut samples = Vec::new();
    for _ in 0..rows {
        let lit: Vec<usize> = (0..3).map(|_| next() as usize % pixels).collect();
        for k in 0..patterns {
            let light = lit.iter().filter(|&&n| bits.lit(k, n)).count() as f64;
            samples.push((0.4 * light + f64::from(next() % 100) * 1e-4).min(0.7));
        }
    }
    let clipped = samples.iter().map(|&y| y >= 0.7).collect();
    (packed, samples, clipped)
}

fn rows<'a>(samples: &'a [f64], clipped: &'a [bool]) -> Rows<'a> {
    Rows {
        count: samples.len() / 70,
        samples: Values::F64(samples),
        clipped,
        weights: None,
        start: None,
    }
}

fn solved(level: Level, samples: &[f64], clipped: &[bool], packed: &[u8]) -> Vec<Solution> {
    let dictionary = dictionary(level, packed, 70, 150);
    let (never, count) = (AtomicBool::new(false), AtomicUsize::new(0));
    let solutions = solve(
        &dictionary,
        rows(samples, clipped),
        SETTINGS,
        &never,
        &count,
    );
    let solutions = solutions.expect("nothing cancels");
    assert_eq!(count.into_inner(), solutions.len());
    solutions
}

#[test]
fn solves_to_the_tolerance_on_every_level() {
    let (packed, samples, clipped) = example();
    for level in Level::available() {
        for solution in solved(level, &samples, &clipped, &packed) {
            assert!(solution.converged && solution.gap <= 1e-6);
            assert!(solution.x.iter().all(|&x| x > 0.0));
            assert!(solution.pixels.is_sorted());
        }
    }
}

#[test]
fn a_row_depends_on_no_other() {
    let (packed, samples, clipped) = example();
    let level = Level::detect();
    let all = solved(level, &samples, &clipped, &packed);
    for (i, whole) in all.iter().enumerate() {
        let range = 70 * i..70 * (i + 1);
        let alone = solved(level, &samples[range.clone()], &clipped[range], &packed);
        assert_eq!(&alone[0], whole);
    }
}

#[test]
fn stops_when_cancelled() {
    let (packed, samples, clipped) = example();
    let dictionary = dictionary(Level::detect(), &packed, 70, 150);
    let (cancelled, count) = (AtomicBool::new(true), AtomicUsize::new(0));
    let outcome = solve(
        &dictionary,
        rows(&samples, &clipped),
        SETTINGS,
        &cancelled,
        &count,
    );
    assert!(outcome.is_none());
}

#[test]
fn gram_rows_as_defined_in_whatever_order() {
    let (patterns, pixels) = (70, 150);
    let (packed, _, _) = example();
    let bits = Bits::new(&packed, patterns, pixels);
    let set: Vec<u32> = (0..40).map(|i| i * 3 + 1).collect();
    for level in Level::available() {
        let counted = dictionary(level, &packed, patterns, pixels);
        let n = counted.means.len();
        let mut columns = vec![0f32; pixels * n];
        for (pixel, column) in columns.chunks_exact_mut(n).enumerate() {
            let copied = Columns::Bits(BitColumns::new(bits));
            copied.copy_scaled(level, pixel as u32, 1.0, column);
        }
        let dense = |columns| Dictionary {
            columns: Columns::Dense(columns),
            correlator: Correlator::dense(level, patterns, pixels),
            means: counted.means.clone(),
            ..counted
        };
        let exact = dense(DenseColumns::from_padded(columns.clone(), n, 1.0));
        let quick = DenseColumns::from_padded(columns.clone(), n, 1.0).with_quick_products();
        let quick = dense(quick);
        for (dictionary, unit, rounding) in [
            (&counted, true, 1e-9),
            (&counted, false, 1e-9),
            (&exact, false, 1e-9),
            (&quick, false, 1e-6),
        ] {
            let weight = |k: usize| {
                if unit {
                    f64::from(!k.is_multiple_of(5))
                } else {
                    1.0 + k as f64
                }
            };
            let mut curvature: Vec<f64> = (0..n).map(weight).collect();
            curvature[patterns..].fill(0.0);
            let data = DataTerm {
                y: vec![0.0; n],
                weights: curvature.clone(),
                ..DataTerm::default()
            };
            let d = curvature.clone();
            let product = |a: &[f32], b: &dyn Fn(usize) -> f64| -> f64 {
                (0..n).map(|k| d[k] * f64::from(a[k]) * b(k)).sum()
            };
            let means = &dictionary.means;
            let along = (0..n).map(|k| d[k] * means[k] * means[k]).sum::<f64>();
            let mut model = Model::new(level);
            model.load_row(&data);
            model.load_pixels(dictionary, &set);
            model.set_curvature(means, &mut curvature);
            model.couple(dictionary, &set, true);
            model.centre(1.0 / along);
            for j in [7, 0, 39, 12, 8] {
                model.make_row(dictionary, &set, j);
                let own = &columns[set[j] as usize * n..][..n];
                let coupled = product(own, &|k| means[k]);
                for (i, &pixel) in set.iter().enumerate() {
                    let other = &columns[pixel as usize * n..][..n];
                    let free = product(other, &|k| f64::from(own[k]));
                    let expected = free - product(other, &|k| means[k]) * coupled / along;
                    assert!((model.row(j)[i] - expected).abs() < rounding * (1.0 + free.abs()));
                }
            }
        }
    }
}
