//! Buffers that outlive a frame: a thread borrows one while it works on a tile, so that frames
//! allocate nothing once all have grown.

use crossbeam_queue::ArrayQueue;

/// Buffers to lend, at most one per thread at a time. Borrowing never waits.
pub(super) struct Lending<T> {
    free: ArrayQueue<Box<T>>,
}

impl<T: Default> Lending<T> {
    /// For so many threads.
    pub(super) fn new(threads: usize) -> Self {
        Self {
            free: ArrayQueue::new(threads.max(1)),
        }
    }

    /// Calls `work` with a buffer, a new one if none is free. It holds whatever it did last.
    pub(super) fn with(&self, work: impl FnOnce(&mut T)) {
        let mut buffer = self.free.pop().unwrap_or_default();
        work(&mut buffer);
        // No thread has two, so there is always room.
        let _ = self.free.push(buffer);
    }
}
