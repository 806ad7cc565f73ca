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
) -> impl Iterator<Item = (usize, impl Iterator<Item = ([i32; 2], f32)>)> + '_ {
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
) -> impl Iterator<Item = ([i32; 2], f32)> {
    let down = to[0] as f32 - from[0] as f32;
    let right = to[1] as f32 - from[1] as f32;
    let rows = whole(jacobian[0] * down + jacobian[1] * right);
    let cols = whole(jacobian[2] * down + jacobian[3] * right);
    rows.into_iter()
        .flat_map(move |(r, a)| cols.into_iter().map(move |(c, b)| ([r, c], a * b)))
        .filter(|&(_, share)| share > 0.0)
}

/// The two whole numbers around a number, and the share of each.
fn whole(number: f32) -> [(i32, f32); 2] {
    let below = number.floor();
    let beyond = ((number - below - CLOSE) / (1.0 - 2.0 * CLOSE)).clamp(0.0, 1.0);
    let below = below as i32;
    [(below, 1.0 - beyond), (below.wrapping_add(1), beyond)]
}

/// The lit atoms of one row, ready to be moved.
#[derive(Default)]
pub(super) struct Footprint {
    atoms: Vec<Atom>,
}

struct Atom {
    /// The number of its plane's first atom.
    plane: u32,
    row: i32,
    col: i32,
    value: f32,
}

impl Footprint {
    /// Takes the atoms of a row that hold light. The numbers are split here, once, as a row is moved to
    /// several places and divisions are slow.
    pub fn load(&mut self, [_, rows, cols]: [usize; 3], atoms: &[i32], values: &[f32]) {
        let (pixels, cols) = ((rows * cols) as u32, cols as u32);
        let lit = atoms.iter().zip(values).filter(|(_, &value)| value > 0.0);
        self.atoms.clear();
        self.atoms.extend(lit.map(|(&atom, &value)| {
            let pixel = atom as u32 % pixels;
            Atom {
                plane: atom as u32 - pixel,
                row: (pixel / cols) as i32,
                col: (pixel % cols) as i32,
                value,
            }
        }));
    }

    /// The largest value; 0 without light.
    pub fn most(&self) -> f32 {
        self.atoms
            .iter()
            .fold(0.0, |most, atom| most.max(atom.value))
    }

    /// The atoms after moving them back by a displacement, and their values; without those that then lie
    /// beyond the projector.
    pub fn moved_back(
        &self,
        [_, rows, cols]: [usize; 3],
        displacement: [i32; 2],
    ) -> impl Iterator<Item = (u32, f32)> + '_ {
        let [down, right] = displacement;
        self.atoms.iter().filter_map(move |atom| {
            // Below 0 they wrap around to large numbers.
            let row = atom.row.wrapping_sub(down) as u32;
            let col = atom.col.wrapping_sub(right) as u32;
            let inside = (row as usize) < rows && (col as usize) < cols;
            inside.then(|| (atom.plane + row * cols as u32 + col, atom.value))
        })
    }
}

/// The places within `reach` of a place, on a line of `length`.
pub(super) fn around(place: usize, reach: usize, length: usize) -> Range<usize> {
    place.saturating_sub(reach)..place.saturating_add(reach).saturating_add(1).min(length)
}
