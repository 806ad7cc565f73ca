//! Predicts which atoms a row holds from its neighbours' rows.

use super::camera_window::{around, neighbours, Footprint};
use crate::problem::Sparse;
use rayon::prelude::*;

/// Rows that one thread handles at a time, enough to hide the cost of starting a task.
const TASK: usize = 64;

/// Where no neighbour holds light, the camera window is doubled until it reaches this many pixels, so that
/// light that only few rows hold spreads to the others in few rounds. Chosen by hand.
pub(super) const FURTHEST: usize = 16;

/// The grids of camera and projector, and the windows in which rows vote for atoms.
#[derive(Clone, Copy)]
pub struct Windows<'a> {
    /// Rows, columns and channels of the camera.
    pub camera: [usize; 3],
    /// Planes of atoms, rows and columns of the projector.
    pub projector: [usize; 3],
    /// The Jacobian of the correspondence, four numbers for each row: (projector row, projector column) by
    /// (camera row, camera column), in pixels.
    pub jacobian: &'a [f32],
    /// One side of each plane's kernel, divided by its middle. A spot also votes for the single pixels
    /// (the first plane) within it.
    pub spots: &'a [&'a [f32]],
    /// The weight of these votes.
    pub within: f32,
    /// The weight of a spot's vote for the next wider spot at its place, one for each plane.
    pub wider: &'a [f32],
    /// The factor of the votes for single pixels, in [0, 1], one for each row.
    pub singles: &'a [f32],
    /// Half widths of the box windows, in camera and projector pixels.
    pub camera_reach: usize,
    pub projector_reach: usize,
    /// Number of atoms to keep for a row.
    pub most: usize,
}

/// For each of the rows `selected`, the atoms with the most votes, ascending, and their votes relative to
/// the most. Each neighbour (and the row itself) votes by its coefficients, divided by its maximum, moved
/// back, and blurred by the projector window.
pub fn likely(
    matrix: Sparse<f32>,
    windows: Windows,
    selected: &[usize],
) -> Vec<(Vec<i32>, Vec<f32>)> {
    let pixels = windows.projector.iter().product();
    selected
        .par_iter()
        .with_min_len(TASK)
        .map_init(
            || (Votes::new(pixels), Votes::new(pixels), Footprint::default()),
            |(moved, spread, footprint), &row| {
                let mut reach = windows.camera_reach;
                moved.add_neighbours(matrix, windows, row, reach, footprint);
                while moved.touched.is_empty() && 0 < reach && reach < FURTHEST {
                    reach *= 2;
                    moved.add_neighbours(matrix, windows, row, reach, footprint);
                }
                // Neighbours mostly vote for the same few atoms, so votes are spread after they are added.
                moved.drain(|atom, vote| {
                    spread.add_blurred(windows, atom, vote);
                    spread.add_within(windows, atom, vote);
                    spread.add_wider(windows, atom, vote);
                });
                spread.scale_single_pixels(windows, windows.singles[row]);
                spread.strongest(windows.most)
            },
        )
        .collect()
}

/// The parts of a CSR matrix of likely atoms and their penalties.
pub struct Penalties {
    pub indptr: Vec<i64>,
    pub atoms: Vec<i32>,
    pub values: Vec<f32>,
}

/// Joins rows of likely atoms to a CSR matrix. The share s of an atom becomes its penalty 2 e / (e + s),
/// where e is the row's entry of `doubts`: the larger e, the more alike are the penalties.
pub fn penalties(rows: &[(Vec<i32>, Vec<f32>)], doubts: &[f64]) -> Penalties {
    assert_eq!(rows.len(), doubts.len());
    let mut indptr = vec![0];
    for (atoms, _) in rows {
        indptr.push(indptr[indptr.len() - 1] + atoms.len() as i64);
    }
    let count = indptr[rows.len()] as usize;
    let (mut atoms, mut values) = (vec![0; count], vec![0.0; count]);
    let mut places = Vec::with_capacity(rows.len());
    let (mut rest_atoms, mut rest_values) = (&mut atoms[..], &mut values[..]);
    for (atoms, _) in rows {
        places.push((
            rest_atoms
                .split_off_mut(..atoms.len())
                .expect("room for all"),
            rest_values
                .split_off_mut(..atoms.len())
                .expect("room for all"),
        ));
    }
    let each = places.into_par_iter().zip(rows).zip(doubts);
    each.with_min_len(TASK)
        .for_each(|(((atoms, values), (row_atoms, shares)), doubt)| {
            atoms.copy_from_slice(row_atoms);
            for (value, share) in values.iter_mut().zip(shares) {
                *value = (2.0 * doubt / (doubt + f64::from(*share))) as f32;
            }
        });
    Penalties {
        indptr,
        atoms,
        values,
    }
}

/// The votes for all atoms, and the list of those with votes.
struct Votes {
    values: Vec<f32>,
    touched: Vec<i32>,
}

impl Votes {
    fn new(atoms: usize) -> Self {
        Votes {
            values: vec![0.0; atoms],
            touched: Vec::new(),
        }
    }

    /// Adds the votes of a row's neighbours, moved back.
    fn add_neighbours(
        &mut self,
        matrix: Sparse<f32>,
        windows: Windows,
        row: usize,
        reach: usize,
        footprint: &mut Footprint,
    ) {
        for (other, places) in neighbours(windows.camera, windows.jacobian, row, reach) {
            let (atoms, values) = matrix.row(other);
            footprint.load(windows.projector, atoms, values);
            let most = footprint.most();
            for (displacement, share) in places {
                let factor = share / most;
                for (atom, value) in footprint.moved_back(windows.projector, displacement) {
                    self.add(atom as usize, factor * value);
                }
            }
        }
    }

    /// Calls `take` for each atom with votes, and sets all votes to zero.
    fn drain(&mut self, mut take: impl FnMut(usize, f32)) {
        for atom in self.touched.drain(..) {
            take(
                atom as usize,
                std::mem::take(&mut self.values[atom as usize]),
            );
        }
    }

    fn add_blurred(&mut self, windows: Windows, atom: usize, value: f32) {
        let [_, rows, cols] = windows.projector;
        let reach = windows.projector_reach;
        let (plane, pixel) = (atom / (rows * cols), atom % (rows * cols));
        let across = around(pixel % cols, reach, cols);
        for r in around(pixel / cols, reach, rows) {
            let start = (plane * rows + r) * cols;
            for j in start + across.start..start + across.end {
                self.add(j, value);
            }
        }
    }

    /// Votes for the single pixels within a spot, whose true shape may differ.
    fn add_within(&mut self, windows: Windows, atom: usize, value: f32) {
        let [_, rows, cols] = windows.projector;
        let (plane, pixel) = (atom / (rows * cols), atom % (rows * cols));
        if plane == 0 {
            return;
        }
        let spot = windows.spots[plane];
        let (r, c) = (pixel / cols, pixel % cols);
        for other_r in around(r, spot.len() - 1, rows) {
            let across = windows.within * value * spot[other_r.abs_diff(r)];
            for other_c in around(c, spot.len() - 1, cols) {
                let share = across * spot[other_c.abs_diff(c)];
                if share > 0.0 {
                    self.add(other_r * cols + other_c, share);
                }
            }
        }
    }

    /// Votes for the next wider spot, which may replace several spots. The samples reject a wrong one.
    fn add_wider(&mut self, windows: Windows, atom: usize, value: f32) {
        let [planes, rows, cols] = windows.projector;
        let plane = atom / (rows * cols);
        if plane + 1 < planes && windows.wider[plane] > 0.0 {
            self.add(atom + rows * cols, windows.wider[plane] * value);
        }
    }

    /// Scales the votes for single pixels.
    fn scale_single_pixels(&mut self, windows: Windows, share: f32) {
        let [_, rows, cols] = windows.projector;
        for &atom in &self.touched {
            if (atom as usize) < rows * cols {
                self.values[atom as usize] *= share;
            }
        }
    }

    fn add(&mut self, atom: usize, value: f32) {
        if self.values[atom] == 0.0 {
            self.touched.push(atom as i32);
        }
        self.values[atom] += value;
    }

    /// The atoms with the most votes and their share of the most; sets all votes to zero.
    fn strongest(&mut self, most: usize) -> (Vec<i32>, Vec<f32>) {
        let sums = &mut self.values;
        let strongest = (self.touched.iter()).fold(0f32, |m, &j| m.max(sums[j as usize]));
        let mut kept = self.touched.clone();
        if kept.len() > most {
            kept.select_nth_unstable_by(most, |&a, &b| {
                let (x, y) = (sums[a as usize], sums[b as usize]);
                y.total_cmp(&x).then(a.cmp(&b))
            });
            kept.truncate(most);
        }
        kept.sort_unstable();
        let shares = kept.iter().map(|&j| sums[j as usize] / strongest).collect();
        self.drain(|_, _| ());
        (kept, shares)
    }
}
