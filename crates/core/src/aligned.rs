//! An allocator that aligns memory to cache lines.
//!
//! The system's allocator aligns to 16 bytes only. Then every second load of 32 bytes and every load of 64
//! bytes crosses a cache line, which makes solving rows 7 to 10 % slower.

use std::alloc::{GlobalAlloc, Layout, System};

/// Bytes of a cache line, and of the widest vector register.
const LINE: usize = 64;
/// Smaller allocations (in bytes) keep their alignment: aligning them would waste memory.
const SMALLEST: usize = 4 * LINE;
/// Larger allocations (in bytes) keep theirs too, so that the system can still grow them without copying
/// and zero them without touching them.
const LARGEST: usize = 16 << 20;

/// The system's allocator, aligned to cache lines. A program that links this library installs it by:
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

// SAFETY: the system's allocator does all the work. How a layout is changed depends on its size and
// alignment alone, so that every method changes it in the same way.
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
        // SAFETY: as above. If the alignment changes, new memory is allocated and the contents copied.
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
    fn growing_and_shrinking_keeps_the_contents() {
        let mut layout = Layout::array::<u8>(100).unwrap();
        // SAFETY: sizes are not zero, and memory is freed with the layout it was allocated with.
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
