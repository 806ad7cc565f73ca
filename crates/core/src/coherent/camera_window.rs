//! The rows of the camera window around a row, and where their light lies after moving it back.

use std::ops::Range;

/// A displacement this close to a whole number of projector pixels counts as that number. Measured
/// displacements are never quite whole. Chosen by hand.
const CLOSE: f32 = 0.1;

/// The rows within `reach` camera pixels of a row, itself included, and for each one the possible
/// displacements of its footprint with their shares, which sum to 1. The camera has rows, columns and
/// channels.
pub(super) fn neighbours(
    [rows, cols, channels]: [usize; 3],
    jacobian: &[f32],
    row: usize,
    reach: usize,
) -> impl Iterator<Item = (usize, impl Iterator<Item = ([isize; 2], f32)>)> + '_ {
    let (pixel, channel) = (row / channels, row % channels);
    let (r, c) = (pixel / cols, pixel % cols);
    let jacobian = &jacobian[4 * row..][..4];
    around(r, reach, rows).flat_map(move |other_r| {
        around(c, reach, cols).map(move |other_c| {
            let other = (other_r * cols + other_c) * channels + channel;
            (other, displacements(jacobian, [r, c], [other_r, other_c]))
        })
    })
}

/// The displacements of the footprint of camera pixel `to` from that of `from`, in whole projector rows and
/// columns: up to four possibilities with their shares. `jacobian` is that of `from`.
fn displacements(
    jacobian: &[f32],
    from: [usize; 2],
    to: [usize; 2],
) -> impl Iterator<Item = ([isize; 2], f32)> {
    let down = to[0] as f32 - from[0] as f32;
    let right = to[1] as f32 - from[1] as f32;
    let rows = whole(jacobian[0] * down + jacobian[1] * right);
    let cols = whole(jacobian[2] * down + jacobian[3] * right);
    rows.into_iter()
        .flat_map(move |(r, a)| cols.into_iter().map(move |(c, b)| ([r, c], a * b)))
        .filter(|&(_, share)| share > 0.0)
}

/// The two whole numbers around a number, and the share of each.
fn whole(number: f32) -> [(isize, f32); 2] {
    let below = number.floor();
    let beyond = ((number - below - CLOSE) / (1.0 - 2.0 * CLOSE)).clamp(0.0, 1.0);
    let below = below as i32 as isize;
    [(below, 1.0 - beyond), (below + 1, beyond)]
}

/// The atom at the place of `atom` after moving it back by `displacement`; None beyond the projector.
pub(super) fn moved_back(
    [_, rows, cols]: [usize; 3],
    atom: i32,
    displacement: [isize; 2],
) -> Option<usize> {
    let (plane, pixel) = (atom as usize / (rows * cols), atom as usize % (rows * cols));
    let r = (pixel / cols) as isize - displacement[0];
    let c = (pixel % cols) as isize - displacement[1];
    let inside = (0..rows as isize).contains(&r) && (0..cols as isize).contains(&c);
    inside.then(|| (plane * rows + r as usize) * cols + c as usize)
}

/// The places within `reach` of a place, on a line of `length`.
pub(super) fn around(place: usize, reach: usize, length: usize) -> Range<usize> {
    place.saturating_sub(reach)..place.saturating_add(reach).saturating_add(1).min(length)
}
