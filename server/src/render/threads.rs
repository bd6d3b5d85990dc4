//! The render threads, shared by all frames in progress.
//!
//! A frame is rendered by the thread that requested it and by [helpers](super::helper), which are shared: one
//! fewer than there are cores, however many frames are in progress. Parallel work is a list of items that caller
//! and helpers take one by one, so a helper can join and leave between any two items.
//!
//! Rayon starts the helpers and gives them work. Its parallel iterators are not used, because a thread that waits
//! inside a `join` takes any available work: a short frame could be delayed by an item of another frame that
//! takes seconds. Here a helper takes items of another frame only while its own frame is held.

use std::sync::{Arc, Mutex, PoisonError};

use super::checkpoint::Pulse;
use super::helper::{Helping, Load, become_helper, is_helper};
use super::stage::Clock;

/// Threads shared by frames: the caller's own, and helpers.
#[derive(Debug)]
pub struct Threads {
    /// `None` for a single thread.
    helpers: Option<rayon::ThreadPool>,
    load: Arc<Load>,
}

impl Threads {
    /// `n` threads, including the caller's; 0: one per core. `clock` reads nanoseconds since any moment.
    pub fn new(n: usize, clock: Clock) -> Result<Self, rayon::ThreadPoolBuildError> {
        let n_cores = || std::thread::available_parallelism().map_or(1, usize::from);
        let n = if n == 0 { n_cores() } else { n };
        let load = Arc::new(Load::new(n - 1, clock));
        let of_thread = Arc::clone(&load);
        let pool = || {
            rayon::ThreadPoolBuilder::new()
                .num_threads(n - 1)
                .thread_name(|i| format!("render-{i}"))
                .start_handler(move |_| become_helper(Arc::clone(&of_thread)))
                .build()
        };
        Ok(Self {
            helpers: if n > 1 { Some(pool()?) } else { None },
            load,
        })
    }

    /// Number of threads that may work on one frame.
    pub fn count(&self) -> usize {
        self.load.n_helpers() + 1
    }

    /// The helpers, if there are any. A helper runs its own parallel work alone, because it must not wait for
    /// others.
    fn helpers(&self) -> Option<&rayon::ThreadPool> {
        self.helpers.as_ref().filter(|_| !is_helper())
    }
}

/// The threads for one frame, and the frame's checkpoint.
#[derive(Clone, Copy)]
pub(crate) struct Workers<'a> {
    pub(crate) threads: &'a Threads,
    pub(crate) pulse: &'a Pulse<'a>,
}

impl Workers<'_> {
    /// Calls `work` for every item, in any order, on all free threads. Calls the checkpoint before each item; the
    /// remaining items of a cancelled frame are skipped.
    pub(crate) fn for_each<I>(&self, items: I, work: impl Fn(I::Item) + Sync)
    where
        I: Iterator<Item: Send> + Send,
    {
        let pulse = self.pulse;
        let Some(pool) = self.threads.helpers() else {
            for item in items {
                if !pulse.go_on() {
                    return;
                }
                work(item);
            }
            return;
        };
        let load = &*self.threads.load;
        let items = Mutex::new(items);
        // The next item, and whether there may be more.
        let take = || {
            let mut items = items.lock().unwrap_or_else(PoisonError::into_inner);
            let item = items.next()?;
            Some((item, items.size_hint().1 != Some(0)))
        };
        let help = || {
            let helping = Helping::begin(load);
            while pulse.go_on() {
                let Some((item, _)) = take() else { return };
                work(item);
                if helping.is_enough(|| pulse.is_held()) {
                    return;
                }
            }
        };
        pool.in_place_scope(|scope| {
            while pulse.go_on() {
                let Some((item, more)) = take() else { return };
                while more && load.claim() {
                    scope.spawn(|_| help());
                }
                work(item);
            }
        });
    }

    /// Runs both functions, `other` on another thread if one is free. `here` may have parallel work of its own;
    /// `other` should have almost none.
    pub(crate) fn join<A, B: Send>(
        &self,
        here: impl FnOnce() -> A,
        other: impl FnOnce() -> B + Send,
    ) -> (A, B) {
        let load = &*self.threads.load;
        let Some(pool) = self.threads.helpers().filter(|_| load.claim()) else {
            return (here(), other());
        };
        let other = Mutex::new(Some(other));
        let take = || other.lock().unwrap_or_else(PoisonError::into_inner).take();
        let mut of_helper = None;
        let (a, of_caller) = pool.in_place_scope(|scope| {
            let of_helper = &mut of_helper;
            scope.spawn(move |_| {
                let _helping = Helping::begin(load);
                *of_helper = take().map(|other| other());
            });
            let a = here();
            (a, take().map(|other| other()))
        });
        match of_caller.or(of_helper) {
            Some(b) => (a, b),
            None => unreachable!("one of the two takes it; a panic does not come here"),
        }
    }
}

/// Calls `work` with `n` threads and the checkpoint of a frame that is never cancelled.
#[cfg(test)]
pub(crate) fn with_workers<T>(n: usize, work: impl FnOnce(Workers<'_>) -> T) -> T {
    let threads = Threads::new(n, || 0).unwrap();
    work(Workers {
        threads: &threads,
        pulse: &Pulse::new(&super::checkpoint::Uninterrupted),
    })
}

#[cfg(test)]
mod tests;
