//! A bounded pool of threads that load scenes for all sessions. The load of a session that has ended keeps its
//! thread until it sees its stop flag; loads of new sessions then wait in a queue.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// One load and its stop flag.
pub(super) struct Job {
    /// Cancels the load, also before it begins.
    pub(super) stop: Arc<AtomicBool>,
    /// Performs the load. Must not panic.
    pub(super) run: Box<dyn FnOnce() + Send>,
}

#[derive(Default)]
struct State {
    n_threads: usize,
    /// First come, first served.
    queue: VecDeque<Job>,
}

/// The pool.
pub(super) struct Loaders {
    most: usize,
    state: Mutex<State>,
}

impl Loaders {
    /// A pool of at most `most` threads, started on demand.
    pub(super) fn new(most: usize) -> Arc<Self> {
        Arc::new(Self {
            most: most.max(1),
            state: Mutex::default(),
        })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // Every critical section leaves its data consistent.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs a load on a new thread or, at the limit, when a thread is free. Fails if the system cannot start a
    /// thread; the load then does not run.
    pub(super) fn start(self: &Arc<Self>, job: Job) -> std::io::Result<()> {
        let mut state = self.state();
        // Cancelled loads end at once instead of waiting for a thread.
        let queue = std::mem::take(&mut state.queue).into_iter();
        let (stopped, wanted): (VecDeque<Job>, VecDeque<Job>) =
            queue.partition(|job| job.stop.load(Ordering::Relaxed));
        state.queue = wanted;
        if state.n_threads < self.most {
            state.n_threads += 1;
            drop(state);
            let loaders = Arc::clone(self);
            let spawned = std::thread::Builder::new()
                .name("scene".to_owned())
                .spawn(move || loaders.work(job));
            if let Err(error) = spawned {
                self.state().n_threads -= 1;
                return Err(error);
            }
        } else {
            state.queue.push_back(job);
            drop(state);
        }
        for job in stopped {
            (job.run)();
        }
        Ok(())
    }

    /// Runs one load after the other until none waits.
    fn work(&self, mut job: Job) {
        loop {
            (job.run)();
            let mut state = self.state();
            match state.queue.pop_front() {
                Some(next) => job = next,
                None => {
                    state.n_threads -= 1;
                    return;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Sender, channel};

    use super::*;

    #[test]
    fn loads_wait_for_a_thread_in_their_order_and_what_is_stopped_for_none() {
        let loaders = Loaders::new(2);
        let (begun, begins) = channel();
        let job = |name: &'static str| {
            let (end, ends) = channel::<()>();
            let (stop, begun) = (Arc::<AtomicBool>::default(), begun.clone());
            let flag = Arc::clone(&stop);
            let run = Box::new(move || {
                let stopped = flag.load(Ordering::Relaxed);
                begun.send((name, stopped)).unwrap();
                if !stopped {
                    // Blocks until its sender is dropped.
                    let _ = ends.recv();
                }
            });
            let start = loaders.start(Job {
                stop: Arc::clone(&stop),
                run,
            });
            start.unwrap();
            (stop, end)
        };
        let next = || begins.recv().unwrap();
        let (_, a) = job("a");
        let (_, b) = job("b");
        let mut first = [next(), next()];
        first.sort_unstable();
        assert_eq!(first, [("a", false), ("b", false)]);
        let (stop_c, _c) = job("c");
        let (_, d) = job("d");
        assert_eq!(loaders.state().queue.len(), 2);
        // The next load that arrives removes cancelled loads from the queue.
        stop_c.store(true, Ordering::Relaxed);
        let (_, e) = job("e");
        assert_eq!(next(), ("c", true));
        assert_eq!(loaders.state().queue.len(), 2);
        drop(a);
        assert_eq!(next(), ("d", false));
        drop(b);
        assert_eq!(next(), ("e", false));
        let all: [Sender<()>; 2] = [d, e];
        drop(all);
        while loaders.state().n_threads > 0 {
            std::thread::yield_now();
        }
        assert!(loaders.state().queue.is_empty());
    }
}
