//! Compares sweeps with the definition of coordinate descent, on every instruction set.

use super::*;
use crate::bits::Bits;
use crate::columns::{BitColumns, Columns};
use crate::correlate::Correlator;
use crate::problem::Dictionary;
use crate::vector::{padded, DataTerm};

const PATTERNS: usize = 90;
const PIXELS: usize = 40;
const LAMBDA: f64 = 0.7;

fn dictionary(level: Level, packed: &[u8]) -> Dictionary {
    let bits = Bits::new(packed, PATTERNS, PIXELS);
    Dictionary {
        level,
        columns: Columns::Bits(BitColumns::new(bits)),
        correlator: Correlator::lookup(level, bits),
        means: vec![0.0; padded(PATTERNS)],
        patterns: PATTERNS,
        pixels: PIXELS,
    }
}

/// One sweep over `set`, straight from the definition; returns the largest change of a slope.
fn sweep(model: &Model, set: &[u32], signed: bool, x: &mut [f64], slope: &mut [f64]) -> f64 {
    let relaxation = if set.len() <= FEW { 1.0 } else { RELAXATION };
    let mut most: f64 = 0.0;
    for &j in set {
        let j = j as usize;
        let (row, square) = (model.row(j), model.diagonal[j]);
        let free = x[j] * square + slope[j];
        let next = if signed {
            ((free - LAMBDA).max(0.0) + (free + LAMBDA).min(0.0)) / square
        } else {
            (x[j] + relaxation * (slope[j] - LAMBDA) / square).max(0.0)
        };
        let moved = next - x[j];
        x[j] = next;
        most = most.max(moved.abs() * square);
        for (slope, row) in slope.iter_mut().zip(row) {
            *slope -= moved * row;
        }
    }
    most
}

#[test]
fn sweeps_as_defined() {
    let packed: Vec<u8> = (0..PATTERNS * PIXELS / 8)
        .map(|i| (i * i * 7 + i / 3) as u8 ^ 0x5a)
        .collect();
    let n = padded(PATTERNS);
    let data = DataTerm {
        y: vec![1.0; n],
        weights: vec![1.0; n],
        inverse: vec![1.0; n],
        lower: vec![f64::NEG_INFINITY; n],
    };
    for level in Level::available() {
        let dictionary = dictionary(level, &packed);
        let pixels: Vec<u32> = (0..PIXELS as u32).collect();
        // One set must leave nothing behind that changes the next.
        let mut packed = Packed::default();
        let mut model = Model::new(level);
        model.load_row(&data);
        model.load_pixels(&dictionary, &pixels);
        let mut curvature = vec![0.0; n];
        curvature[..PATTERNS].fill(1.0);
        model.set_curvature(&dictionary.means, &mut curvature);
        for set in [
            vec![],
            vec![3],
            (0..9).collect(),
            (0..20).filter(|j| j % 3 > 0).collect::<Vec<u32>>(),
            (0..40).collect(),
            (0..9).chain(32..40).collect(),
        ] {
            for &j in &set {
                model.make_row(&dictionary, &pixels, j as usize);
            }
            for signed in [false, true] {
                let mut x = vec![0.0; model.stride];
                if let Some(&j) = set.first() {
                    x[j as usize] = 0.25;
                }
                let mut slope: Vec<f64> = (0..model.stride)
                    .map(|j| (j as f64 * 1.7).sin() * if signed { 3.0 } else { 2.0 } + 0.5)
                    .collect();
                let mut chosen = vec![0; model.stride / WIDTH];
                for &j in &set {
                    chosen[j as usize / WIDTH] |= 1 << (j as usize % WIDTH);
                }
                packed.load(&model, &chosen, LAMBDA, signed, &x, &slope);
                let before = x.clone();
                for _ in 0..4 {
                    let change = packed.sweep(level, 0.0, 1);
                    let expected = sweep(&model, &set, signed, &mut x, &mut slope);
                    assert!((change - expected).abs() < 1e-4);
                    for (place, &j) in set.iter().enumerate() {
                        let moved = packed.moved(place, before[j as usize]);
                        assert!((moved - x[j as usize]).abs() < 1e-6);
                        assert_eq!(moved == 0.0, x[j as usize] == 0.0);
                    }
                }
            }
        }
    }
}
