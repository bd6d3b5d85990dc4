//! Buffers that outlive a frame: a thread borrows one while it works on a tile, so that frames
//! allocate nothing once all have grown.

use crossbeam_queue::ArrayQueue;

/// Buffers to lend, at most one kept per thread. Borrowing never waits.
pub(crate) struct ScratchPool<T> {
    free: ArrayQueue<Box<T>>,
}

impl<T: Default> ScratchPool<T> {
    /// For so many threads.
    pub(crate) fn new(threads: usize) -> Self {
        Self {
            free: ArrayQueue::new(threads.max(1)),
        }
    }

    /// Calls `work` with a buffer, a new one if none is free. It holds whatever it did last.
    pub(crate) fn with(&self, work: impl FnOnce(&mut T)) {
        let mut buffer = self.free.pop().unwrap_or_default();
        work(&mut buffer);
        // No room: a helper left an item of this frame for another one of it. One buffer too many is freed.
        let _ = self.free.push(buffer);
    }
}
