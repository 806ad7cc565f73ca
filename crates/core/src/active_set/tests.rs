//! The solver on small problems; the thorough tests are in Python, against independent solvers.

use super::*;
use crate::bits::Bits;
use crate::columns::{BitColumns, Columns};
use crate::correlate::Correlator;
use crate::problem::{Fidelity, Values};
use crate::simd::Level;

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
