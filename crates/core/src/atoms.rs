//! Atoms: spots of light of several sizes, one of each size at every projector pixel.
//!
//! All atoms of one size form a plane. The column of the atom of plane s at pixel j is
//! g_s sum_i h_s(i - j) a_i, with h_s the kernel of the plane, a_i the columns of the patterns, and g_s a
//! gain that makes the planes' columns comparable. Light beyond the projector's edge is lost. Atoms are
//! numbered plane by plane.

use crate::columns::{Columns, DenseColumns};
use crate::simd::{multiversion, Level};
use crate::vector::{fold, padded, SUMS};
use crate::words::{to_words, WordColumns};
use rayon::prelude::*;

/// Image columns that are blurred together: their sums fit into vector registers.
const STRETCH: usize = 64;

/// Values of an image that are blurred together: 128 kB fit into the second cache with those around them.
const BLURRED: usize = 1 << 15;

/// Rows and columns of pixels that are blurred together. What they and those around them take under 64
/// patterns, 230 kB, fits into the second cache.
const BLOCK: [usize; 2] = [32, 16];

/// The spots of one size.
#[derive(Clone, Debug)]
pub struct Plane {
    /// One side of the separable, symmetric kernel, from its middle outwards.
    pub kernel: Vec<f32>,
    /// The factor of the plane's columns, in (0, 1].
    pub gain: f32,
}

/// The planes of atoms over a projector.
#[derive(Clone, Debug)]
pub struct Atoms {
    /// Rows and columns of the projector.
    pub grid: [usize; 2],
    pub planes: Vec<Plane>,
}

impl Atoms {
    /// Projector pixels.
    pub fn pixels(&self) -> usize {
        self.grid[0] * self.grid[1]
    }

    /// Number of atoms.
    pub fn count(&self) -> usize {
        self.pixels() * self.planes.len()
    }

    /// The columns of all atoms, computed from the patterns' `columns`; or of the `wanted` ones only. Those of
    /// all others are zero then, and take no memory as long as nothing is written into them.
    pub fn columns(
        &self,
        level: Level,
        columns: &Columns,
        patterns: usize,
        wanted: Option<&[u32]>,
    ) -> DenseColumns {
        let stride = padded(patterns);
        let mut values = vec![0f32; self.count() * stride];
        self.fill(level, columns, stride, wanted, &mut values, |sum, out| {
            out.copy_from_slice(sum)
        });
        DenseColumns::from_padded(values, stride, 1.0)
    }

    /// The same in half the memory, with rounded values.
    pub fn words(
        &self,
        level: Level,
        columns: &Columns,
        patterns: usize,
        wanted: Option<&[u32]>,
    ) -> WordColumns {
        let stride = padded(patterns);
        let mut values = vec![0u16; self.count() * stride];
        self.fill(level, columns, stride, wanted, &mut values, |sum, out| {
            to_words(level, sum, out)
        });
        WordColumns::from_padded(values, stride)
    }

    /// Computes the columns, `stride` values each, and stores them by `keep`.
    fn fill<T: Send>(
        &self,
        level: Level,
        columns: &Columns,
        stride: usize,
        wanted: Option<&[u32]>,
        kept: &mut [T],
        keep: impl Fn(&[f32], &mut [T]) + Sync,
    ) {
        match wanted {
            None => self.each(level, columns, stride, kept, keep),
            Some(wanted) => self.some(level, columns, stride, wanted, kept, keep),
        }
    }

    /// Computes the columns of some atoms, each by itself, and stores them by `keep`.
    fn some<T>(
        &self,
        level: Level,
        columns: &Columns,
        stride: usize,
        wanted: &[u32],
        kept: &mut [T],
        keep: impl Fn(&[f32], &mut [T]),
    ) {
        let [rows, cols] = self.grid;
        let mut sums = vec![0f32; wanted.len() * stride];
        let each = wanted.par_iter().zip(sums.par_chunks_exact_mut(stride));
        each.for_each_init(
            || vec![0f64; stride],
            |sum, (&atom, out)| {
                let plane = &self.planes[atom as usize / self.pixels()];
                let pixel = atom as usize % self.pixels();
                let (row, col) = (pixel / cols, pixel % cols);
                let reach = plane.kernel.len() - 1;
                sum.fill(0.0);
                for r in row.saturating_sub(reach)..rows.min(row + reach + 1) {
                    let down = plane.gain * plane.kernel[r.abs_diff(row)];
                    for c in col.saturating_sub(reach)..cols.min(col + reach + 1) {
                        let weight = down * plane.kernel[c.abs_diff(col)];
                        columns.add(level, (r * cols + c) as u32, weight.into(), sum);
                    }
                }
                for (out, sum) in out.iter_mut().zip(&*sum) {
                    *out = *sum as f32;
                }
            },
        );
        for (&atom, sum) in wanted.iter().zip(sums.chunks_exact(stride)) {
            keep(sum, &mut kept[atom as usize * stride..][..stride]);
        }
    }

    /// Computes the column of each atom, `stride` values, and stores those of pixels side by side by
    /// `keep`.
    fn each<T: Send>(
        &self,
        level: Level,
        columns: &Columns,
        stride: usize,
        kept: &mut [T],
        keep: impl Fn(&[f32], &mut [T]) + Sync,
    ) {
        let [rows, cols] = self.grid;
        // Rows of pixels lie between margins of zeros, as wide as the widest spot reaches.
        let margin = (self.planes.iter()).map(|plane| plane.kernel.len() - 1);
        let margin = margin.max().unwrap_or(0);
        let width = (cols.next_multiple_of(BLOCK[1]) + 2 * margin) * stride;
        let mut plain = vec![0f32; rows * width];
        (plain.par_chunks_exact_mut(width).enumerate()).for_each(|(row, line)| {
            let pixels = line[margin * stride..].chunks_exact_mut(stride).take(cols);
            for (col, out) in pixels.enumerate() {
                columns.copy_scaled(level, (row * cols + col) as u32, 1.0, out);
            }
        });
        let planes = self
            .planes
            .par_iter()
            .zip(kept.par_chunks_exact_mut(rows * cols * stride));
        planes.for_each(|(plane, kept)| {
            let reach = plane.kernel.len() - 1;
            let blocks = kept.par_chunks_mut(BLOCK[0] * cols * stride).enumerate();
            blocks.for_each_init(Vec::new, |buffer, (block, kept)| {
                let top = block * BLOCK[0];
                let step = BLOCK[1] * stride;
                buffer.clear();
                buffer.resize((BLOCK[0] + 2 * reach + 1) * step, 0f32);
                let (out, middle) = buffer.split_at_mut(step);
                for left in (0..cols).step_by(BLOCK[1]) {
                    // Blurred across, with as many rows above and below as spots reach.
                    let lines = middle.chunks_exact_mut(step).enumerate();
                    for (line, across) in lines.take(kept.len() / (cols * stride) + 2 * reach) {
                        match (top + line).checked_sub(reach).filter(|&row| row < rows) {
                            Some(row) => {
                                let first = row * width + (left + margin - reach) * stride;
                                along(level, &plane.kernel, 1.0, stride, &plain[first..], across);
                            }
                            None => across.fill(0.0),
                        }
                    }
                    for (row, kept) in kept.chunks_exact_mut(cols * stride).enumerate() {
                        let kept = &mut kept[left * stride..];
                        let count = kept.len().min(step);
                        along(
                            level,
                            &plane.kernel,
                            plane.gain,
                            step,
                            &middle[row * step..],
                            out,
                        );
                        keep(&out[..count], &mut kept[..count]);
                    }
                }
            });
        });
    }
}

/// Sum, and sum of squares, of all values of images under the plane's kernel.
///
/// # Panics
/// If the images are not whole.
pub fn moments(level: Level, grid: [usize; 2], plane: &Plane, images: &[f32]) -> [f64; 2] {
    let pixels = grid[0] * grid[1];
    assert!(images.len().is_multiple_of(pixels));
    let sums_of_images: Vec<[f64; 2]> = images
        .par_chunks_exact(pixels)
        .map_init(Blurring::default, |blurring, image| {
            let mut whole = [0.0; 2];
            blurring.run(level, grid, plane, image, |blurred| {
                let part = sums(level, blurred);
                whole = [whole[0] + part[0], whole[1] + part[1]];
            });
            whole
        })
        .collect();
    // Summed in the order of the images, so that the result does not depend on threads.
    (sums_of_images.iter()).fold([0.0; 2], |all, one| [all[0] + one[0], all[1] + one[1]])
}

multiversion! {
    /// Sum and sum of squares.
    fn sums(values: &[f32]) -> [f64; 2] {
        let (mut total, mut squares) = ([0.0; SUMS], [0.0; SUMS]);
        for values in values.chunks(SUMS) {
            for (i, &value) in values.iter().enumerate() {
                let value = f64::from(value);
                total[i] += value;
                squares[i] += value * value;
            }
        }
        [fold(total), fold(squares)]
    }
}

/// One thread's buffers for blurring images.
#[derive(Default)]
pub struct Blurring {
    line: Vec<f32>,
    middle: Vec<f32>,
    blurred: Vec<f32>,
}

impl Blurring {
    /// Calls `take` for the rows of gain times the image (rows, columns) under the plane's kernel, several of
    /// them at a time.
    ///
    /// # Panics
    /// If the image has another size.
    pub fn run(
        &mut self,
        level: Level,
        [rows, cols]: [usize; 2],
        plane: &Plane,
        image: &[f32],
        mut take: impl FnMut(&[f32]),
    ) {
        assert_eq!(image.len(), rows * cols);
        let reach = plane.kernel.len() - 1;
        let stride = cols.next_multiple_of(STRETCH);
        let block = (BLURRED / stride).clamp(1, rows.max(1));
        let Blurring {
            line,
            middle,
            blurred,
        } = self;
        // A row lies between margins of zeros.
        line.clear();
        line.resize(stride + 2 * reach, 0.0);
        blurred.resize(block * stride, 0.0);
        // The rows of a block, blurred across, between those above and below; zeros beyond the image.
        middle.resize((block + 2 * reach) * stride, 0.0);
        middle[..reach * stride].fill(0.0);
        let mut across = |row: usize, out: &mut [f32]| match image.get(row * cols..(row + 1) * cols)
        {
            Some(values) => {
                line[reach..reach + cols].copy_from_slice(values);
                along(level, &plane.kernel, 1.0, 1, line, out);
            }
            None => out.fill(0.0),
        };
        let lines = middle.chunks_exact_mut(stride).skip(reach);
        for (row, out) in lines.take(reach).enumerate() {
            across(row, out);
        }
        for top in (0..rows).step_by(block) {
            let lines = middle.chunks_exact_mut(stride).skip(2 * reach);
            for (row, out) in lines.enumerate() {
                across(top + reach + row, out);
            }
            let count = block.min(rows - top);
            let lines = &middle[..(count + 2 * reach) * stride];
            let whole = &mut blurred[..count * stride];
            along(level, &plane.kernel, plane.gain, stride, lines, whole);
            if cols < stride {
                for row in 1..count {
                    whole.copy_within(row * stride..row * stride + cols, row * cols);
                }
            }
            take(&whole[..count * cols]);
            middle.copy_within(block * stride.., 0);
        }
    }
}

multiversion! {
    /// out[i] = gain sum_t kernel[|t|] values[i + (reach + t) step], for t from -reach to reach.
    fn along(kernel: &[f32], gain: f32, step: usize, values: &[f32], out: &mut [f32]) {
        let reach = kernel.len() - 1;
        for (block, out) in out.chunks_exact_mut(STRETCH).enumerate() {
            let first = block * STRETCH;
            let mut sums = [0f32; STRETCH];
            let values = &values[first..];
            let middle = &values[reach * step..][..STRETCH];
            for i in 0..STRETCH {
                sums[i] = kernel[0] * middle[i];
            }
            for (t, weight) in kernel.iter().enumerate().skip(1) {
                let before = &values[(reach - t) * step..][..STRETCH];
                let after = &values[(reach + t) * step..][..STRETCH];
                for i in 0..STRETCH {
                    sums[i] += weight * (before[i] + after[i]);
                }
            }
            for i in 0..STRETCH {
                out[i] = gain * sums[i];
            }
        }
    }
}
