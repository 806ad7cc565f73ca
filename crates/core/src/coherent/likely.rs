//! Which projector pixels a camera pixel probably sees, from what its neighbours see.

use super::around::{around, moved_back, neighbours};
use crate::problem::Sparse;
use rayon::prelude::*;

/// Rows that one thread takes on at a time.
const TASK: usize = 64;

/// Where no neighbour holds light, twice as far is looked, again and again up to so many camera
/// pixels: so light that was found in few rows reaches the others in few rounds.
pub(super) const FURTHEST: usize = 16;

/// The grids that rows and columns of the matrix lie on, and the windows.
#[derive(Clone, Copy)]
pub struct Windows<'a> {
    /// Rows, columns and channels of the camera.
    pub camera: [usize; 3],
    /// Planes of atoms, one for each size, and rows and columns of the projector.
    pub projector: [usize; 3],
    /// How far footprints move, in projector rows and columns, a camera row and a camera column
    /// on: four numbers for each row.
    pub movement: &'a [f32],
    /// One side of each plane's kernel over its middle. Single pixels, which are the first plane,
    /// become likely within the spots of the others:
    pub spots: &'a [&'a [f32]],
    /// by this share.
    pub within: f32,
    /// At the same place the next wider spot becomes likely by this share, one for each plane.
    pub wider: &'a [f32],
    /// How far single pixels are believed in, in [0, 1], for each row.
    pub singles: &'a [f32],
    /// Half widths of the box windows, in camera and projector pixels.
    pub camera_reach: usize,
    pub projector_reach: usize,
    /// Pixels kept of each row.
    pub most: usize,
}

/// For each of the rows `asked` the strongest atoms, ascending, of the sum of its neighbours' rows
/// (itself among them), each moved back, over its own maximum and blurred by the projector window;
/// and the sums, relative to the strongest.
pub fn likely(matrix: Sparse<f32>, windows: Windows, asked: &[usize]) -> Vec<(Vec<i32>, Vec<f32>)> {
    let pixels = windows.projector.iter().product();
    asked
        .par_iter()
        .with_min_len(TASK)
        .map_init(
            || Sums {
                values: vec![0.0; pixels],
                touched: Vec::new(),
            },
            |sums, &row| {
                let mut reach = windows.camera_reach;
                sums.add_neighbours(matrix, windows, row, reach);
                while sums.touched.is_empty() && 0 < reach && reach < FURTHEST {
                    reach *= 2;
                    sums.add_neighbours(matrix, windows, row, reach);
                }
                sums.believe(windows, windows.singles[row]);
                sums.take(windows.most)
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

/// Rows of likely atoms with shares s, joined; s becomes the penalty 2 e / (e + s), with one e of
/// `doubts` for each row.
pub fn penalties(rows: &[(Vec<i32>, Vec<f32>)], doubts: &[f64]) -> Penalties {
    assert_eq!(rows.len(), doubts.len());
    let mut indptr = vec![0];
    for (atoms, _) in rows {
        indptr.push(indptr[indptr.len() - 1] + atoms.len() as i64);
    }
    let whole = indptr[rows.len()] as usize;
    let (mut atoms, mut values) = (vec![0; whole], vec![0.0; whole]);
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
        .for_each(|(((atoms, values), (found, shares)), doubt)| {
            atoms.copy_from_slice(found);
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

/// A dense row, and which of its pixels differ from zero.
struct Sums {
    values: Vec<f32>,
    touched: Vec<i32>,
}

impl Sums {
    fn add_neighbours(&mut self, matrix: Sparse<f32>, windows: Windows, row: usize, reach: usize) {
        for (other, places) in neighbours(windows.camera, windows.movement, row, reach) {
            let (pixels, values) = matrix.row(other);
            let most = values.iter().fold(0f32, |most, &v| most.max(v));
            for (moved, share) in places {
                for (&pixel, &value) in pixels.iter().zip(values).filter(|(_, &v)| v > 0.0) {
                    if let Some(place) = moved_back(windows.projector, pixel, moved) {
                        let vote = share * value / most;
                        self.add_blurred(windows, place, vote);
                        self.add_within(windows, place, vote);
                        self.add_wider(windows, place, vote);
                    }
                }
            }
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

    /// A spot makes the single pixels within it a little likely: its shape may be another.
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

    /// Several spots may be one that is wider: where it is not, the samples object.
    fn add_wider(&mut self, windows: Windows, atom: usize, value: f32) {
        let [planes, rows, cols] = windows.projector;
        let plane = atom / (rows * cols);
        if plane + 1 < planes && windows.wider[plane] > 0.0 {
            self.add(atom + rows * cols, windows.wider[plane] * value);
        }
    }

    /// Scale the sums of single pixels.
    fn believe(&mut self, windows: Windows, share: f32) {
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

    /// The strongest pixels and their share of the strongest; all sums become zero.
    fn take(&mut self, most: usize) -> (Vec<i32>, Vec<f32>) {
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
        for j in self.touched.drain(..) {
            sums[j as usize] = 0.0;
        }
        (kept, shares)
    }
}
