use std::collections::HashSet;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use super::*;
use crate::render::checkpoint::{Checkpoint, Uninterrupted};

fn clock() -> u64 {
    crate::clock::render_clock()
}

/// Waits for a condition that another thread fulfils.
fn until(what: impl Fn() -> bool) {
    let start = Instant::now();
    while !what() {
        assert!(start.elapsed() < Duration::from_secs(60));
        std::thread::yield_now();
    }
}

/// A checkpoint that is held or cancelled by the test.
#[derive(Default)]
struct Switch {
    held: AtomicBool,
    over: AtomicBool,
}

impl Checkpoint for Switch {
    fn go_on(&self) -> bool {
        !self.over.load(Ordering::Relaxed)
    }
    fn is_held(&self) -> bool {
        self.held.load(Ordering::Relaxed)
    }
}

#[test]
fn every_item_is_worked_on_once_on_any_number_of_threads() {
    for n in [1, 2, 3, 8] {
        let mut counts = vec![0; 1000];
        with_workers(n, |workers| {
            for n_items in [0, 1, 2, 1000] {
                let items = counts[..n_items].iter_mut();
                workers.for_each(items, |count| *count += 1);
            }
            let (a, b) = workers.join(|| 1, || 2);
            assert_eq!((a, b), (1, 2));
        });
        assert_eq!(counts[..2], [3, 2]);
        assert!(counts[2..].iter().all(|&count| count == 1), "{n}");
    }
}

#[test]
fn helpers_take_part_and_there_are_no_more_than_said() {
    let threads = Threads::new(3, clock).unwrap();
    assert_eq!(threads.count(), 3);
    let pulse = &Pulse::new(&Uninterrupted);
    let workers = Workers {
        threads: &threads,
        pulse,
    };
    // Each item waits until all three threads have one.
    let (arrived, ids) = (AtomicUsize::new(0), Mutex::new(HashSet::new()));
    workers.for_each(0..3, |_| {
        arrived.fetch_add(1, Ordering::Relaxed);
        until(|| arrived.load(Ordering::Relaxed) == 3);
        ids.lock().unwrap().insert(std::thread::current().id());
    });
    assert_eq!(ids.into_inner().unwrap().len(), 3);
    // Nested parallel work runs on the thread that starts it.
    let sum = AtomicUsize::new(0);
    workers.for_each(0..10, |i| {
        workers.for_each(0..10, |j| {
            sum.fetch_add(i * j, Ordering::Relaxed);
        });
    });
    assert_eq!(sum.into_inner(), 45 * 45);
}

#[test]
fn a_frame_that_is_given_up_begins_nothing_more() {
    for n in [1, 2] {
        let threads = Threads::new(n, clock).unwrap();
        let switch = Switch::default();
        let pulse = &Pulse::new(&switch);
        let workers = Workers {
            threads: &threads,
            pulse,
        };
        let done = AtomicUsize::new(0);
        workers.for_each(0..1000, |_| {
            done.fetch_add(1, Ordering::Relaxed);
            switch.over.store(true, Ordering::Relaxed);
        });
        assert!(done.into_inner() <= n);
        assert!(pulse.is_stopped());
    }
}

#[test]
fn a_frame_that_waits_is_given_up_when_nobody_wants_it() {
    let switch = Switch::default();
    switch.held.store(true, Ordering::Relaxed);
    let pulse = Pulse::new(&switch);
    std::thread::scope(|scope| {
        let waits = scope.spawn(|| pulse.go_on());
        std::thread::sleep(Duration::from_millis(5));
        assert!(!waits.is_finished());
        switch.over.store(true, Ordering::Relaxed);
        assert!(!waits.join().unwrap());
    });
}

#[test]
fn the_helper_of_a_frame_that_waits_works_for_another_in_the_middle_of_its_item() {
    let threads = Threads::new(2, clock).unwrap();
    let heavy = Switch::default();
    let heavy_pulse = &Pulse::new(&heavy);
    let n_waiting = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        let caller = std::thread::current().id();
        scope.spawn(|| {
            let workers = Workers {
                threads: &threads,
                pulse: heavy_pulse,
            };
            // Two long items: one for the caller, one for the helper.
            let both = AtomicUsize::new(0);
            workers.for_each(0..2, |_| {
                both.fetch_add(1, Ordering::Relaxed);
                until(|| both.load(Ordering::Relaxed) == 2);
                heavy.held.store(true, Ordering::Relaxed);
                n_waiting.fetch_add(1, Ordering::Relaxed);
                assert!(heavy_pulse.go_on());
            });
        });
        // Waits for both; otherwise the slower one would hold the frame again at the end.
        until(|| n_waiting.load(Ordering::Relaxed) == 2);
        until(|| threads.load.is_free());
        let pulse = &Pulse::new(&Uninterrupted);
        let light = Workers {
            threads: &threads,
            pulse,
        };
        // Two threads can be here at the same time only with the helper.
        let both = AtomicUsize::new(0);
        light.for_each(0..2, |_| {
            both.fetch_add(1, Ordering::Relaxed);
            until(|| both.load(Ordering::Relaxed) == 2);
        });
        assert_eq!(std::thread::current().id(), caller);
        heavy.held.store(false, Ordering::Relaxed);
    });
}

#[test]
fn a_busy_helper_of_a_frame_that_does_not_wait_keeps_nobody_up() {
    let threads = Threads::new(2, clock).unwrap();
    let (both, end) = (AtomicUsize::new(0), AtomicBool::new(false));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let pulse = &Pulse::new(&Uninterrupted);
            let workers = Workers {
                threads: &threads,
                pulse,
            };
            workers.for_each(0..2, |_| {
                both.fetch_add(1, Ordering::Relaxed);
                until(|| end.load(Ordering::Relaxed));
            });
        });
        until(|| both.load(Ordering::Relaxed) == 2);
        // Neither waits for the helper, which comes only after `end`.
        let pulse = &Pulse::new(&Uninterrupted);
        let workers = Workers {
            threads: &threads,
            pulse,
        };
        let done = AtomicUsize::new(0);
        workers.for_each(0..100, |_| {
            done.fetch_add(1, Ordering::Relaxed);
        });
        assert_eq!(workers.join(|| 1, || 2), (1, 2));
        assert_eq!(done.into_inner(), 100);
        end.store(true, Ordering::Relaxed);
    });
}
