//! Buffers that are kept between frames: a thread borrows one while it processes a tile, so that frames allocate
//! nothing after the first ones.

use crossbeam_queue::ArrayQueue;

/// Buffers to lend; at most one per thread is kept. Borrowing never blocks.
pub(crate) struct ScratchPool<T> {
    free: ArrayQueue<Box<T>>,
}

impl<T: Default> ScratchPool<T> {
    /// For `threads` threads.
    pub(crate) fn new(threads: usize) -> Self {
        Self {
            free: ArrayQueue::new(threads.max(1)),
        }
    }

    /// Calls `work` with a buffer; a new one if none is free. The buffer has the contents of its last use.
    pub(crate) fn with(&self, work: impl FnOnce(&mut T)) {
        let mut buffer = self.free.pop().unwrap_or_default();
        work(&mut buffer);
        // The pool is full: a helper that had an item of this frame in progress worked on another of its items.
        // The surplus buffer is freed.
        let _ = self.free.push(buffer);
    }
}
