//! Which rows lie around a row, and where their light lies once it is moved back to it.

use std::ops::Range;

/// So close to a whole number of pixels footprints are taken to have moved by it.
const CLOSE: f32 = 0.1;

/// The rows within `reach` camera pixels of a row, itself among them, on a camera of rows, columns
/// and channels; and of each the displacements that its footprint may have, with shares of one.
pub(super) fn neighbours(
    [rows, cols, channels]: [usize; 3],
    movement: &[f32],
    row: usize,
    reach: usize,
) -> impl Iterator<Item = (usize, impl Iterator<Item = ([isize; 2], f32)>)> + '_ {
    let (pixel, channel) = (row / channels, row % channels);
    let (r, c) = (pixel / cols, pixel % cols);
    let movement = &movement[4 * row..][..4];
    around(r, reach, rows).flat_map(move |other_r| {
        around(c, reach, cols).map(move |other_c| {
            let other = (other_r * cols + other_c) * channels + channel;
            (other, moved(movement, [r, c], [other_r, other_c]))
        })
    })
}

/// By how many projector rows and columns the footprint of one camera pixel, whose `movement` this
/// is, lies away from that of another: the whole numbers that it may be, with shares of one.
fn moved(
    movement: &[f32],
    from: [usize; 2],
    to: [usize; 2],
) -> impl Iterator<Item = ([isize; 2], f32)> {
    let down = to[0] as f32 - from[0] as f32;
    let right = to[1] as f32 - from[1] as f32;
    let rows = whole(movement[0] * down + movement[1] * right);
    let cols = whole(movement[2] * down + movement[3] * right);
    rows.into_iter()
        .flat_map(move |(r, a)| cols.into_iter().map(move |(c, b)| ([r, c], a * b)))
        .filter(|&(_, share)| share > 0.0)
}

/// The whole numbers around a number, and how far it is each.
fn whole(number: f32) -> [(isize, f32); 2] {
    let below = number.floor();
    let beyond = ((number - below - CLOSE) / (1.0 - 2.0 * CLOSE)).clamp(0.0, 1.0);
    let below = below as i32 as isize;
    [(below, 1.0 - beyond), (below + 1, beyond)]
}

/// The atom at the place that one lies at once it is moved back; None beyond the projector.
pub(super) fn moved_back(
    [_, rows, cols]: [usize; 3],
    atom: i32,
    moved: [isize; 2],
) -> Option<usize> {
    let (plane, pixel) = (atom as usize / (rows * cols), atom as usize % (rows * cols));
    let r = (pixel / cols) as isize - moved[0];
    let c = (pixel % cols) as isize - moved[1];
    let inside = (0..rows as isize).contains(&r) && (0..cols as isize).contains(&c);
    inside.then(|| (plane * rows + r as usize) * cols + c as usize)
}

/// Places within `reach` of a place, on a line of `length`.
pub(super) fn around(place: usize, reach: usize, length: usize) -> Range<usize> {
    place.saturating_sub(reach)..place.saturating_add(reach).saturating_add(1).min(length)
}
