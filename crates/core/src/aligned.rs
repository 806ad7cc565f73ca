//! Memory that begins where a vector register's worth of it does.
//!
//! An allocator aligns to 16 bytes, which makes every other register of 32 bytes, and every one of
//! 64, lie on two cache lines: that costs rows 7 to 10 % of their time.

use std::alloc::{GlobalAlloc, Layout, System};

/// A cache line, and the widest register.
const LINE: usize = 64;
/// Smaller pieces are not worth the room,
const SMALLEST: usize = 4 * LINE;
/// and larger ones keep the system's ways of growing them without a copy, and of zeroing them
/// without touching them.
const LARGEST: usize = 16 << 20;

/// The system's allocator, aligned to cache lines. For the program that links this library:
///
/// ```
/// #[global_allocator]
/// static ALLOCATOR: lightmatrix_core::aligned::Aligned = lightmatrix_core::aligned::Aligned;
/// ```
pub struct Aligned;

fn aligned(layout: Layout) -> Layout {
    if (SMALLEST..LARGEST).contains(&layout.size()) {
        layout.align_to(LINE).unwrap_or(layout)
    } else {
        layout
    }
}

// SAFETY: the system's allocator does all the work; a layout is changed in the same way, by its size
// and alignment alone, wherever it comes along.
unsafe impl GlobalAlloc for Aligned {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promises hold for a larger alignment too.
        unsafe { System.alloc(aligned(layout)) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above; this is the layout that `alloc` took.
        unsafe { System.dealloc(pointer, aligned(layout)) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(aligned(layout)) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller's promises, of which `size` is one, make this layout a sound one.
        let next = unsafe { Layout::from_size_align_unchecked(size, layout.align()) };
        let (old, new) = (aligned(layout), aligned(next));
        // SAFETY: as above; memory of another alignment is got anew, and what was there copied.
        unsafe {
            if old.align() == new.align() {
                return System.realloc(pointer, old, size);
            }
            let moved = System.alloc(new);
            if !moved.is_null() {
                pointer.copy_to_nonoverlapping(moved, layout.size().min(size));
                System.dealloc(pointer, old);
            }
            moved
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_what_it_held_when_it_grows_and_shrinks_across_the_sizes() {
        let mut layout = Layout::array::<u8>(100).unwrap();
        // SAFETY: sizes are not zero, layouts those that the memory was got with.
        unsafe {
            let mut pointer = Aligned.alloc_zeroed(layout);
            pointer.write_bytes(7, 100);
            for size in [300, 5000, LARGEST + 1, 900, 100] {
                pointer = Aligned.realloc(pointer, layout, size);
                layout = Layout::array::<u8>(size).unwrap();
                if (SMALLEST..LARGEST).contains(&size) {
                    assert_eq!(pointer as usize % LINE, 0);
                }
                assert!((0..100).all(|i| pointer.add(i).read() == 7));
            }
            Aligned.dealloc(pointer, layout);
        }
    }
}
