//! Slices of plain data in huge pages: the traversal of a large BVH reads memory at random, and with pages of 4 KiB
//! nearly every access would also miss the TLB.

use std::ops::{Deref, DerefMut};

use bytemuck::Pod;

/// A huge page, bytes; smaller slices gain nothing and stay on the heap.
#[cfg(target_os = "linux")]
const HUGE: usize = 2 << 20;

/// A slice with a fixed length.
#[derive(Debug)]
pub(crate) enum Pages<T> {
    Heap(Box<[T]>),
    #[cfg(target_os = "linux")]
    Mapped {
        memory: memmap2::MmapMut,
        /// Number of values; the mapping is rounded up to whole pages.
        length: usize,
    },
}

impl<T> Default for Pages<T> {
    fn default() -> Self {
        Self::Heap(Box::default())
    }
}

impl<T: Pod> Pages<T> {
    /// A slice of zeros. On the heap if the system has no huge pages.
    pub(crate) fn zeroed(length: usize) -> Self {
        #[cfg(target_os = "linux")]
        if let Some(memory) = map(length.saturating_mul(size_of::<T>())) {
            return Self::Mapped { memory, length };
        }
        Self::Heap(bytemuck::zeroed_slice_box(length))
    }
}

/// Zeros in huge pages as far as the system provides them; `None` for less than one page.
#[cfg(target_os = "linux")]
fn map(bytes: usize) -> Option<memmap2::MmapMut> {
    if bytes < HUGE {
        return None;
    }
    // The system aligns mappings of whole huge pages to them. The rest after the last whole page uses small pages, so
    // that no more memory is touched than requested.
    let memory = memmap2::MmapMut::map_anon(bytes.checked_next_multiple_of(HUGE)?).ok()?;
    // Without huge pages a traversal is only slower.
    let _ = memory.advise_range(memmap2::Advice::HugePage, 0, bytes - bytes % HUGE);
    Some(memory)
}

impl<T: Pod> Deref for Pages<T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        match self {
            Self::Heap(values) => values,
            #[cfg(target_os = "linux")]
            Self::Mapped { memory, length } => {
                bytemuck::cast_slice(&memory[..length * size_of::<T>()])
            }
        }
    }
}

impl<T: Pod> DerefMut for Pages<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        match self {
            Self::Heap(values) => values,
            #[cfg(target_os = "linux")]
            Self::Mapped { memory, length } => {
                bytemuck::cast_slice_mut(&mut memory[..*length * size_of::<T>()])
            }
        }
    }
}
