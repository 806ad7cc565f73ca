//! Which projector pixels a camera pixel probably sees, from what its neighbours see.

use crate::problem::Sparse;
use rayon::prelude::*;
use std::ops::Range;

/// Rows that one thread takes on at a time.
const TASK: usize = 64;

/// The grids that rows and columns of the matrix lie on, and the windows.
#[derive(Clone, Copy)]
pub struct Windows {
    /// Rows, columns and channels of the camera.
    pub camera: [usize; 3],
    /// Rows and columns of the projector.
    pub projector: [usize; 2],
    /// Half widths of the box windows, in camera and projector pixels.
    pub camera_reach: usize,
    pub projector_reach: usize,
    /// Pixels kept of each row.
    pub most: usize,
}

/// For each row of `range` the strongest pixels, ascending, of the sum of its neighbours' rows
/// (itself among them), each over its own maximum and blurred by the projector window; and the
/// sums, relative to the strongest.
pub fn likely(
    matrix: Sparse<f32>,
    windows: Windows,
    range: Range<usize>,
) -> Vec<(Vec<i32>, Vec<f32>)> {
    let pixels = windows.projector[0] * windows.projector[1];
    range
        .into_par_iter()
        .with_min_len(TASK)
        .map_init(
            || Sums {
                values: vec![0.0; pixels],
                touched: Vec::new(),
            },
            |sums, row| {
                sums.add_neighbours(matrix, windows, row);
                sums.take(windows.most)
            },
        )
        .collect()
}

/// A dense row, and which of its pixels differ from zero.
struct Sums {
    values: Vec<f32>,
    touched: Vec<i32>,
}

impl Sums {
    fn add_neighbours(&mut self, matrix: Sparse<f32>, windows: Windows, row: usize) {
        let [camera_rows, camera_cols, channels] = windows.camera;
        let (pixel, channel) = (row / channels, row % channels);
        let (r, c) = (pixel / camera_cols, pixel % camera_cols);
        for r in around(r, windows.camera_reach, camera_rows) {
            for c in around(c, windows.camera_reach, camera_cols) {
                let (pixels, values) = matrix.row((r * camera_cols + c) * channels + channel);
                let most = values.iter().fold(0f32, |most, &v| most.max(v));
                for (&pixel, &value) in pixels.iter().zip(values) {
                    if value > 0.0 {
                        self.add_blurred(windows, pixel as usize, value / most);
                    }
                }
            }
        }
    }

    fn add_blurred(&mut self, windows: Windows, pixel: usize, value: f32) {
        let [rows, cols] = windows.projector;
        let reach = windows.projector_reach;
        let across = around(pixel % cols, reach, cols);
        for r in around(pixel / cols, reach, rows) {
            let start = r * cols;
            for j in start + across.start..start + across.end {
                if self.values[j] == 0.0 {
                    self.touched.push(j as i32);
                }
                self.values[j] += value;
            }
        }
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

/// Places within `reach` of a place, on a line of `length`.
pub(super) fn around(place: usize, reach: usize, length: usize) -> Range<usize> {
    place.saturating_sub(reach)..place.saturating_add(reach).saturating_add(1).min(length)
}
