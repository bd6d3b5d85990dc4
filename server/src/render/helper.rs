//! Helper threads, and what a helper does while the frame that it works on is held.
//!
//! A frame may be held ([`Checkpoint::is_held`](super::Checkpoint::is_held)) in the middle of an item. Its own
//! thread then sleeps. A helper works for other frames meanwhile, with the interrupted item below them on its
//! stack. It does so for at most [`NESTED_NS`] at a time, and never in more than one further level, which bounds
//! its stack.

use std::cell::{Cell, OnceCell};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use super::stage::Clock;

/// How long a helper works for another frame before it checks its own frame again; at least one item.
const NESTED_NS: u64 = 1_000_000;

/// How long a helper sleeps if no frame has work: short compared with a stage, long compared with a poll.
const NAP: Duration = Duration::from_micros(100);

thread_local! {
    /// Set on helpers.
    static HELPER: OnceCell<Arc<Load>> = const { OnceCell::new() };
    /// Lists of items on which this helper is working, nested.
    static DEPTH: Cell<usize> = const { Cell::new(0) };
}

/// How busy the helpers are.
#[derive(Debug)]
pub(super) struct Load {
    n_helpers: usize,
    /// Helpers that were claimed and have not finished. A helper whose frame is held does not count.
    n_claimed: AtomicUsize,
    clock: Clock,
}

impl Load {
    /// The load of `n_helpers` helpers; `clock` reads nanoseconds since any moment.
    pub(super) fn new(n_helpers: usize, clock: Clock) -> Self {
        Self {
            n_helpers,
            n_claimed: AtomicUsize::new(0),
            clock,
        }
    }

    /// Number of helpers.
    pub(super) fn n_helpers(&self) -> usize {
        self.n_helpers
    }

    /// Claims a helper, if one is free.
    pub(super) fn claim(&self) -> bool {
        let add = |n: usize| (n < self.n_helpers).then_some(n + 1);
        let claimed = self
            .n_claimed
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, add);
        claimed.is_ok()
    }

    /// Whether a helper is free.
    #[cfg(test)]
    pub(super) fn is_free(&self) -> bool {
        self.n_claimed.load(Ordering::Relaxed) < self.n_helpers
    }

    fn release(&self) {
        self.n_claimed.fetch_sub(1, Ordering::Relaxed);
    }

    /// Whether a frame has claimed a helper that is still busy elsewhere.
    fn is_awaited(&self) -> bool {
        self.n_claimed.load(Ordering::Relaxed) > self.n_helpers
    }
}

/// A helper that works on a list of items; ended when dropped, even by a panic.
pub(super) struct Helping<'a> {
    load: &'a Load,
    depth: usize,
    start_ns: u64,
}

impl<'a> Helping<'a> {
    /// Begins work on a helper that was claimed.
    pub(super) fn begin(load: &'a Load) -> Self {
        let depth = DEPTH.get() + 1;
        DEPTH.set(depth);
        Self {
            load,
            depth,
            start_ns: (load.clock)(),
        }
    }

    /// Whether the helper should return to the item that it interrupted for this frame; `is_held` says whether
    /// this frame is held.
    pub(super) fn is_enough(&self, is_held: impl Fn() -> bool) -> bool {
        let too_long = || (self.load.clock)().saturating_sub(self.start_ns) > NESTED_NS;
        self.depth > 1 && (is_held() || too_long())
    }
}

impl Drop for Helping<'_> {
    fn drop(&mut self) {
        DEPTH.set(self.depth - 1);
        self.load.release();
    }
}

/// Turns this thread into a helper, permanently.
pub(super) fn become_helper(load: Arc<Load>) {
    // Each thread starts only once, so the cell is empty.
    HELPER.with(|helper| drop(helper.set(load)));
}

/// Whether this thread is a helper.
pub(super) fn is_helper() -> bool {
    HELPER.with(|helper| helper.get().is_some())
}

/// Waits while a frame is held; on the frame's own thread by calling `wait`. False once `go_on` returns false.
/// Called at every checkpoint.
pub(super) fn make_way(
    is_held: impl Fn() -> bool,
    go_on: impl Fn() -> bool,
    wait: impl Fn(),
) -> bool {
    HELPER.with(|helper| {
        let Some(load) = helper.get() else {
            while is_held() {
                wait();
                if !go_on() {
                    return false;
                }
            }
            return true;
        };
        if DEPTH.get() > 1 {
            return true;
        }
        if load.is_awaited() {
            rayon::yield_now();
        }
        if !is_held() {
            return true;
        }
        load.release();
        let on = loop {
            if rayon::yield_now() != Some(rayon::Yield::Executed) {
                std::thread::sleep(NAP);
            }
            if !go_on() {
                break false;
            }
            if !is_held() {
                break true;
            }
        };
        load.n_claimed.fetch_add(1, Ordering::Relaxed);
        on
    })
}
