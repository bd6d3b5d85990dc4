//! Slices of plain data in huge pages: a walk through a large tree jumps about, and with pages of
//! 4 KiB nearly every jump also misses the table of translated addresses.

use std::ops::{Deref, DerefMut};

use bytemuck::Pod;

/// A huge page, bytes; smaller slices gain nothing and stay on the heap.
#[cfg(target_os = "linux")]
const HUGE: usize = 2 << 20;

/// A slice whose length is fixed when it is made.
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
    /// Zeros. On the heap where the system offers nothing better.
    pub(crate) fn zeroed(length: usize) -> Self {
        #[cfg(target_os = "linux")]
        if let Some(memory) = map(length.saturating_mul(size_of::<T>())) {
            return Self::Mapped { memory, length };
        }
        Self::Heap(bytemuck::zeroed_slice_box(length))
    }
}

/// Zeros, in huge pages as far as the system has them; `None` for less than one page's worth.
#[cfg(target_os = "linux")]
fn map(bytes: usize) -> Option<memmap2::MmapMut> {
    if bytes < HUGE {
        return None;
    }
    // The system aligns mappings of whole huge pages to them. What is beyond the last whole one is
    // left to small pages, so that no more memory is touched than is asked for.
    let memory = memmap2::MmapMut::map_anon(bytes.checked_next_multiple_of(HUGE)?).ok()?;
    // Without huge pages a walk is slower and nothing else.
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
