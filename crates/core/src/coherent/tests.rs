use super::likely::FURTHEST;
use super::*;
use crate::bits::Bits;
use crate::columns::{BitColumns, Columns};
use crate::correlate::Correlator;
use crate::problem::{Dictionary, Fidelity, Rows, Settings, Sparse, Start, Values};
use crate::simd::Level;
use crate::vector::padded;
use std::sync::atomic::{AtomicBool, AtomicUsize};

const PATTERNS: usize = 40;
const PIXELS: usize = 24;

fn random(state: &mut u64) -> u64 {
    *state = state
        .wrapping_mul(6364136223846793005)
        .wrapping_add(1442695040888963407);
    *state >> 33
}

fn bit(packed: &[u8], k: usize, j: usize) -> f64 {
    f64::from(packed[k * PIXELS / 8 + j / 8] >> (j % 8) & 1)
}

fn dictionary(level: Level, packed: &[u8]) -> Dictionary {
    let bits = Bits::new(packed, PATTERNS, PIXELS);
    let mut means: Vec<f64> = (0..PATTERNS)
        .map(|k| (0..PIXELS).map(|j| bit(packed, k, j)).sum::<f64>() / PIXELS as f64)
        .collect();
    means.resize(padded(PATTERNS), 0.0);
    Dictionary {
        level,
        columns: Columns::Bits(BitColumns::new(bits)),
        correlator: Correlator::lookup(level, bits),
        means,
        patterns: PATTERNS,
        pixels: PIXELS,
    }
}

fn settings() -> Settings {
    Settings {
        regularization: 0.05,
        fidelity: Fidelity::OneSided,
        nonnegative: true,
        background: false,
        tolerance: 1e-9,
        max_passes: 200,
    }
}

/// Slopes of the data term at the solution: a_j . theta for the pixels, then the shared columns.
fn slopes(packed: &[u8], shared_columns: &[f32], y: &[f64], solved: &Weighted) -> Vec<f64> {
    let theta: Vec<f64> = (0..PATTERNS)
        .map(|k| {
            let pixels = solved.row.pixels.iter().zip(&solved.row.x);
            let u: f64 = pixels.map(|(&j, x)| bit(packed, k, j as usize) * x).sum();
            let shared = solved.shared.iter().enumerate();
            let v: f64 = shared
                .map(|(i, g)| f64::from(shared_columns[i * PATTERNS + k]) * g)
                .sum();
            y[k] - u - v
        })
        .collect();
    let dot = |value: &dyn Fn(usize) -> f64| (0..PATTERNS).map(|k| value(k) * theta[k]).sum();
    let pixels = (0..PIXELS).map(|j| dot(&|k| bit(packed, k, j)));
    let shared = (0..shared_columns.len() / PATTERNS)
        .map(|i| dot(&|k| f64::from(shared_columns[i * PATTERNS + k])));
    pixels.chain(shared).collect()
}

#[test]
fn every_pixel_meets_the_optimality_condition_of_its_own_penalty() {
    let mut state = 7;
    let packed: Vec<u8> = (0..PATTERNS * PIXELS / 8)
        .map(|_| random(&mut state) as u8)
        .collect();
    let shared_columns: Vec<f32> = (0..2 * PATTERNS)
        .map(|_| (random(&mut state) % 1000) as f32 / 1000.0)
        .collect();
    let y: Vec<f64> = (0..PATTERNS)
        .map(|k| {
            0.7 * bit(&packed, k, 3) + 0.2 * bit(&packed, k, 9) + 0.1 * f64::from(shared_columns[k])
        })
        .collect();
    let pixels: Vec<i32> = (0..PIXELS as i32).filter(|j| j % 2 == 1).collect();
    let penalties: Vec<f32> = pixels.iter().map(|&j| 0.1 + 0.2 * j as f32).collect();
    let shared = [0.5f32, 3.0];
    let lambda = settings().regularization;
    for level in Level::available() {
        let dictionary = dictionary(level, &packed);
        let solve_from = |start: Option<Start>, shared_start: Option<&[f32]>| {
            let rows = Rows {
                count: 1,
                samples: Values::F64(&y),
                clipped: &[false; PATTERNS],
                weights: None,
                start,
            };
            let knowledge = Knowledge {
                candidates: Sparse {
                    indptr: &[0, pixels.len() as i64],
                    indices: &pixels,
                    values: &penalties,
                },
                shared_columns: SharedColumns {
                    columns: &shared_columns,
                    penalties: &shared,
                    start: shared_start,
                },
                pseudo_samples: None,
                background: None,
            };
            let (cancelled, finished) = (AtomicBool::new(false), AtomicUsize::new(0));
            let solved = solve(
                &dictionary,
                rows,
                knowledge,
                settings(),
                &cancelled,
                &finished,
            );
            solved.expect("not cancelled").remove(0)
        };
        let solved = solve_from(None, None);
        assert!(solved.row.converged);
        assert!(solved.row.pixels.contains(&3) && solved.row.pixels.contains(&9));
        let slopes = slopes(&packed, &shared_columns, &y, &solved);
        for (&pixel, &penalty) in pixels.iter().zip(&penalties) {
            let excess = slopes[pixel as usize] / (lambda * f64::from(penalty)) - 1.0;
            assert!(excess < 1e-3);
            if solved.row.pixels.contains(&(pixel as u32)) {
                assert!(excess.abs() < 1e-3);
            }
        }
        for i in 0..2 {
            let excess = slopes[PIXELS + i] / (lambda * f64::from(shared[i])) - 1.0;
            assert!(excess < 1e-3);
            if solved.shared[i] > 0.0 {
                assert!(excess.abs() < 1e-3);
            }
        }
        // Starting at the solution, the solver only needs to certify it.
        let indices: Vec<i32> = solved.row.pixels.iter().map(|&j| j as i32).collect();
        let shared_start: Vec<f32> = solved.shared.iter().map(|&g| g as f32).collect();
        let again = solve_from(
            Some(Start {
                rows: Sparse {
                    indptr: &[0, indices.len() as i64],
                    indices: &indices,
                    values: &solved.row.x,
                },
                background: &[0.0],
            }),
            Some(&shared_start),
        );
        assert!(again.row.converged && again.row.passes <= solved.row.passes);
        assert!((again.row.objective - solved.row.objective).abs() < 1e-8);
    }
}

#[test]
fn likely_pixels_are_the_neighbours_rows_over_their_maximum_blurred() {
    // A camera of 2 x 3, a projector of 4 x 5, one entry in each of three rows.
    let (camera, projector) = ([2, 3, 1], [1, 4, 5]);
    let indptr = [0i64, 1, 2, 2, 2, 4, 4];
    let matrix = Sparse {
        indptr: &indptr,
        indices: &[0, 7, 7, 13],
        values: &[2.0, 0.5, 1.0, 4.0],
    };
    let still = [0.0; 4 * 6];
    let spots: [&[f32]; 1] = [&[1.0]];
    let windows = |camera_reach, projector_reach, most| Windows {
        camera,
        projector,
        jacobian: &still,
        spots: &spots,
        within: 0.1,
        wider: &[2.0],
        singles: &[1.0; 6],
        camera_reach,
        projector_reach,
        most,
    };
    // Row 3 has the neighbours 0, 1 and 4: pixel 0 once, pixel 7 by 1 and 1/4, pixel 13 once.
    let atoms = likely(matrix, windows(1, 0, 9), &[3]);
    assert_eq!(atoms, [(vec![0, 7, 13], vec![0.8, 1.0, 0.8])]);
    assert_eq!(
        likely(matrix, windows(1, 0, 1), &[3]),
        [(vec![7], vec![1.0])]
    );
    // Without neighbours, row 0 is blurred into the corner of the projector.
    let atoms = likely(matrix, windows(0, 1, 9), &[0]);
    assert_eq!(atoms, [(vec![0, 1, 5, 6], vec![1.0; 4])]);
    // A row without neighbours that hold light.
    assert_eq!(likely(matrix, windows(0, 2, 9), &[5]), [(vec![], vec![])]);
}

#[test]
fn the_penalty_of_an_atom_falls_with_its_share() {
    let rows = [
        (vec![3, 7], vec![1.0, 0.5]),
        (vec![], vec![]),
        (vec![2], vec![1.0]),
    ];
    let rows = penalties(&rows, &[0.5, 1.0, 3.0]);
    assert_eq!(rows.indptr, [0, 2, 2, 3]);
    assert_eq!(rows.atoms, [3, 7, 2]);
    assert_eq!(rows.values, [2.0 * 0.5 / 1.5, 1.0, 1.5]);
}

#[test]
fn likely_atoms_are_moved_back_and_make_single_pixels_within_them_likely() {
    // Two planes over a projector of 3 x 4, and a camera of 1 x 2 with footprints one column apart.
    let jacobian = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let spots: [&[f32]; 2] = [&[1.0], &[1.0, 0.5]];
    let windows = Windows {
        camera: [1, 2, 1],
        projector: [2, 3, 4],
        jacobian: &jacobian,
        spots: &spots,
        within: 0.1,
        wider: &[0.5, 2.0],
        singles: &[1.0, 0.4],
        camera_reach: 1,
        projector_reach: 0,
        most: 99,
    };
    // Row 1 holds the spot around pixel (1, 2), and light at (0, 0), which lies beyond the projector
    // after moving it back to row 0.
    let matrix = Sparse {
        indptr: &[0, 0, 2],
        indices: &[0, 12 + 6],
        values: &[1.0, 2.0],
    };
    let atoms = likely(matrix, windows, &[0]).remove(0);
    // Row 0 gets the spot around (1, 1), and a tenth of it as votes for the single pixels within.
    assert_eq!(atoms.0, [0, 1, 2, 4, 5, 6, 8, 9, 10, 12 + 5]);
    let expected = [0.025, 0.05, 0.025, 0.05, 0.1, 0.05, 0.025, 0.05, 0.025, 1.0];
    for (share, expected) in atoms.1.iter().zip(expected) {
        assert!((share - expected).abs() < 1e-6);
    }
    // In row 1 the pixel, half as bright as the spot, votes with half its weight for the spot at its
    // place. All votes for single pixels are scaled by two fifths.
    let atoms = likely(matrix, windows, &[1]).remove(0);
    let share = |atom| atoms.1[atoms.0.iter().position(|&other| other == atom).unwrap()];
    for (atom, expected) in [(0, 0.2), (6, 0.04), (12, 0.25), (12 + 6, 1.0)] {
        assert!((share(atom) - expected).abs() < 1e-6);
    }
}

#[test]
fn light_that_moved_by_part_of_a_pixel_is_likely_in_both_places() {
    // A camera of 1 x 2 whose footprints are a part of a projector column apart.
    let likely_at = |part: f32| {
        let jacobian = [0.0, 0.0, 0.0, part, 0.0, 0.0, 0.0, part];
        let windows = Windows {
            camera: [1, 2, 1],
            projector: [1, 3, 4],
            jacobian: &jacobian,
            spots: &[&[1.0]],
            within: 0.1,
            wider: &[0.5],
            singles: &[1.0; 2],
            camera_reach: 1,
            projector_reach: 0,
            most: 9,
        };
        let matrix = Sparse {
            indptr: &[0, 0, 1],
            indices: &[6],
            values: &[2.0],
        };
        likely(matrix, windows, &[0]).remove(0)
    };
    assert_eq!(likely_at(0.5), (vec![5, 6], vec![1.0; 2]));
    let (atoms, shares) = likely_at(-0.3);
    assert_eq!((atoms, shares[0]), (vec![6, 7], 1.0));
    assert!((shares[1] - 1.0 / 3.0).abs() < 1e-6);
    // Measured displacements are never quite whole.
    assert_eq!(likely_at(0.06), (vec![6], vec![1.0]));
    assert_eq!(likely_at(-1.06), (vec![7], vec![1.0]));
}

#[test]
fn where_no_neighbour_holds_light_the_window_grows() {
    // A camera of 1 x 40 of which only the first pixel holds light, in two projector pixels.
    const ROWS: usize = 40;
    let mut indptr = [2i64; ROWS + 1];
    indptr[0] = 0;
    let matrix = Sparse {
        indptr: &indptr,
        indices: &[3, 6],
        values: &[1.0, 4.0],
    };
    let spots: [&[f32]; 1] = [&[1.0]];
    let windows = |camera_reach| Windows {
        camera: [1, ROWS, 1],
        projector: [1, 4, 5],
        jacobian: &[0.0; 4 * ROWS],
        spots: &spots,
        within: 0.1,
        wider: &[2.0],
        singles: &[1.0; ROWS],
        camera_reach,
        projector_reach: 0,
        most: 9,
    };
    let rows = likely(matrix, windows(2), &(0..ROWS).collect::<Vec<_>>());
    for (row, atoms) in rows.iter().enumerate() {
        let lit = (vec![3, 6], vec![0.25, 1.0]);
        let expected = if row <= FURTHEST {
            lit
        } else {
            (vec![], vec![])
        };
        assert_eq!(*atoms, expected, "row {row}");
    }
    // A window of one pixel does not grow.
    assert_eq!(likely(matrix, windows(0), &[1]), [(vec![], vec![])]);
}
