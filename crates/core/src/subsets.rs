//! Tables of partial sums ('four Russians'): entry i sums the values of the bits of i.

use std::ops::Add;

/// Fills the table with the sums over all subsets of `values`. Further entries stay as they are.
///
/// # Panics
/// If the table is too short.
#[inline(always)]
pub fn subset_sums<T: Copy + Default + Add<Output = T>>(values: &[T], table: &mut [T]) {
    table[0] = T::default();
    for (bit, &value) in values.iter().enumerate() {
        let (low, high) = table.split_at_mut(1 << bit);
        for (high, low) in high[..1 << bit].iter_mut().zip(low) {
            *high = *low + value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_entry_sums_the_values_of_its_bits() {
        let values = [3i16, -5, 11, 40, -200, 7, 1000, 1];
        for count in 0..=values.len() {
            let mut table = [77i16; 256];
            subset_sums(&values[..count], &mut table);
            for (i, sum) in table.iter().enumerate() {
                let direct = (0..count)
                    .filter(|bit| i >> bit & 1 == 1)
                    .map(|bit| values[bit]);
                let expected = if i < 1 << count { direct.sum() } else { 77 };
                assert_eq!(*sum, expected);
            }
        }
    }
}
