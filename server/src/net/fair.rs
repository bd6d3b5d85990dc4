//! Sessions share the processor fairly.
//!
//! Frames of all sessions share the cores, so what is divided is time: each session is charged for the
//! time that its frames run, divided by the number of sessions that run at that moment. While only one
//! session renders, nothing is charged and nobody waits. Otherwise a frame whose session was charged
//! more than the least-charged active one pauses at its next checkpoint, until that session's frame is
//! done or has caught up. A session that was idle starts behind the others and so goes first for a
//! while: a short frame every 33 ms stays on time beside one that takes seconds.
//!
//! The picture does not depend on any of this; only its time does.

use crate::clock;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A frame pauses when its session is ahead by this much, until it is level: time slices short
/// enough for a frame of 33 ms, and long enough to be worth a switch.
const SLICE_NS: u64 = 5_000_000;

/// Most that a session that was idle is behind the others when it returns: so long it may have the
/// processor to itself.
const CREDIT_NS: u64 = 100_000_000;

/// How often shares are updated while nobody waits.
const LOOK_NS: i64 = 500_000;

/// Longest sleep of a paused frame before it checks whether it was cancelled.
pub(super) const NAP: Duration = Duration::from_millis(5);

/// One session's account.
#[derive(Debug, Default, Clone, Copy)]
struct Share {
    /// Nanoseconds charged.
    used_ns: u64,
    /// A frame of it is being rendered.
    active: bool,
    /// It waits until it is level with the least-charged session.
    held: bool,
}

/// The accounts of all sessions. Reads no clock: the time is an argument.
#[derive(Debug, Default)]
struct Shares {
    of: BTreeMap<u64, Share>,
    /// The time up to which sessions were charged.
    at_ns: i64,
    /// The least charge of an active session; never falls.
    least_ns: u64,
}

impl Shares {
    fn active(&self) -> impl Iterator<Item = &Share> {
        self.of.values().filter(|share| share.active)
    }

    /// Charges the time up to now to the sessions that run, in equal parts.
    fn advance(&mut self, now_ns: i64) {
        let passed = u64::try_from(now_ns - self.at_ns).unwrap_or(0);
        self.at_ns = self.at_ns.max(now_ns);
        let n = self.active().filter(|share| !share.held).count() as u64;
        if n > 0 {
            let running = self.of.values_mut().filter(|s| s.active && !s.held);
            running.for_each(|share| share.used_ns += passed / n);
        }
        if let Some(least) = self.active().map(|share| share.used_ns).min() {
            self.least_ns = self.least_ns.max(least);
        }
    }

    fn begin(&mut self, session: u64, now_ns: i64) {
        self.advance(now_ns);
        let least_ns = self.least_ns;
        let share = self.of.entry(session).or_default();
        share.active = true;
        share.held = false;
        share.used_ns = share.used_ns.max(least_ns.saturating_sub(CREDIT_NS));
    }

    fn end(&mut self, session: u64, now_ns: i64) {
        self.advance(now_ns);
        if let Some(share) = self.of.get_mut(&session) {
            share.active = false;
            share.held = false;
        }
    }

    fn may_run(&mut self, session: u64, now_ns: i64) -> bool {
        self.advance(now_ns);
        let least = self.active().map(|share| share.used_ns).min();
        let (Some(least), Some(share)) = (least, self.of.get_mut(&session)) else {
            return true;
        };
        let ahead = share.used_ns.saturating_sub(least);
        share.held = share.active && ahead > if share.held { 0 } else { SLICE_NS };
        !share.held
    }
}

/// Shared by all sessions of a server; frames call it at their checkpoints.
#[derive(Debug, Default)]
pub(super) struct Gate {
    shares: Mutex<Shares>,
    changed: Condvar,
    /// Frames under way.
    n_active: AtomicUsize,
    /// When shares are updated next, on the process's clock.
    look_ns: AtomicU64,
}

/// A frame being rendered; it ends when this is dropped.
pub(super) struct Turn<'a> {
    gate: &'a Gate,
    session: u64,
}

impl Gate {
    fn shares(&self) -> MutexGuard<'_, Shares> {
        // Every critical section leaves its data consistent.
        self.shares.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A frame of a session begins.
    pub(super) fn begin(&self, session: u64) -> Turn<'_> {
        self.shares().begin(session, clock::now_ns());
        self.n_active.fetch_add(1, Ordering::Relaxed);
        self.look_ns.store(0, Ordering::Relaxed);
        Turn {
            gate: self,
            session,
        }
    }

    /// Forgets a session that is over.
    pub(super) fn forget(&self, session: u64) {
        self.shares().of.remove(&session);
    }
}

impl Turn<'_> {
    /// Whether this frame is the only one. One atomic load.
    pub(super) fn is_alone(&self) -> bool {
        self.gate.n_active.load(Ordering::Relaxed) <= 1
    }

    /// Waits for this session's turn; false as soon as `wanted` says that the frame is cancelled.
    pub(super) fn wait(&self, wanted: impl Fn() -> bool) -> bool {
        let now_ns = clock::now_ns();
        if (now_ns as u64) < self.gate.look_ns.load(Ordering::Relaxed) {
            return true;
        }
        let mut shares = self.gate.shares();
        while !shares.may_run(self.session, clock::now_ns()) {
            // The frame's other threads pause at their next checkpoint.
            self.gate.look_ns.store(0, Ordering::Relaxed);
            let waited = self.gate.changed.wait_timeout(shares, NAP);
            shares = waited.unwrap_or_else(PoisonError::into_inner).0;
            if !wanted() {
                return false;
            }
        }
        if !shares.active().any(|share| share.held) {
            let next = (now_ns + LOOK_NS) as u64;
            self.gate.look_ns.store(next, Ordering::Relaxed);
        }
        true
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.gate.shares().end(self.session, clock::now_ns());
        self.gate.n_active.fetch_sub(1, Ordering::Relaxed);
        self.gate.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// Plays sessions against each other in steps of a millisecond: each is (period, milliseconds of
    /// processor that a frame takes), a period of 0 means frames without a pause. Returns for each the
    /// frames finished and the longest time that one took.
    fn play(sessions: &[(i64, i64)], length_ms: i64) -> Vec<(usize, i64)> {
        let mut shares = Shares::default();
        let n = sessions.len();
        let mut left = vec![0.0_f64; n];
        let mut begun = vec![None; n];
        let mut done = vec![(0, 0); n];
        for t in 0..length_ms {
            for (i, &(period, cost)) in sessions.iter().enumerate() {
                if begun[i].is_none() && (period == 0 || t % period == 0) {
                    shares.begin(i as u64, t * MS);
                    (begun[i], left[i]) = (Some(t), cost as f64);
                }
            }
            let runs: Vec<bool> = (0..n)
                .map(|i| begun[i].is_some() && shares.may_run(i as u64, t * MS))
                .collect();
            let running = runs.iter().filter(|&&r| r).count();
            assert!(running > 0 || begun.iter().all(Option::is_none));
            for i in (0..n).filter(|&i| runs[i]) {
                left[i] -= 1.0 / running as f64;
                if left[i] <= 0.0 {
                    shares.end(i as u64, (t + 1) * MS);
                    let (count, longest) = &mut done[i];
                    *count += 1;
                    let took = t + 1 - begun[i].take().unwrap();
                    // All begin level; who is short of time shows after that.
                    if t > 1000 {
                        *longest = (*longest).max(took);
                    }
                }
            }
        }
        done
    }

    #[test]
    fn a_short_frame_every_33_ms_is_on_time_beside_one_that_takes_seconds() {
        let done = play(&[(33, 12), (0, 4000)], 60_000);
        let (good, longest) = done[0];
        assert!(good >= 60_000 / 33, "{done:?}");
        assert!(longest <= 14, "{done:?}");
        // What is left is the other's, to the last millisecond but few.
        assert!(done[1].0 >= 8, "{done:?}");
    }

    #[test]
    fn nobody_starves_and_equals_share_alike() {
        let done = play(&[(0, 100), (0, 100), (0, 1000)], 60_000);
        assert!(done[0].0.abs_diff(done[1].0) <= 2, "{done:?}");
        assert!((190..=210).contains(&done[0].0), "{done:?}");
        assert!((19..=21).contains(&done[2].0), "{done:?}");
        // More wanted than there is: the one that asks for more than its half gets its half.
        let done = play(&[(33, 30), (0, 500)], 60_000);
        assert!((900..=1100).contains(&done[0].0), "{done:?}");
        assert!((55..=65).contains(&done[1].0), "{done:?}");
    }

    #[test]
    fn frames_that_fit_side_by_side_do_not_wait_for_each_other() {
        let mut shares = Shares::default();
        shares.begin(1, 0);
        shares.begin(2, 0);
        for t in 0..100 {
            assert!(shares.may_run(1, t * MS) && shares.may_run(2, t * MS));
        }
        assert_eq!(shares.of[&1].used_ns, 49_500_000);
        // One that comes later has the processor to itself for its credit at most.
        shares.begin(3, 100 * MS);
        assert!(!shares.may_run(1, 100 * MS));
        assert!(!shares.may_run(2, 100 * MS));
        assert!(shares.may_run(3, 100 * MS));
        assert!(!shares.may_run(1, 140 * MS));
        assert!(shares.may_run(1, 151 * MS));
        shares.end(3, 152 * MS);
        assert!(shares.may_run(2, 152 * MS));
    }

    #[test]
    fn a_frame_that_waits_is_given_up_when_nobody_wants_it() {
        let gate = Gate::default();
        let heavy = gate.begin(1);
        assert!(heavy.is_alone());
        gate.shares().of.get_mut(&1).unwrap().used_ns = 1 << 60;
        let light = gate.begin(2);
        assert!(!heavy.is_alone());
        assert!(light.wait(|| true));
        gate.look_ns.store(0, Ordering::Relaxed);
        assert!(!heavy.wait(|| false));
        drop(light);
        assert!(heavy.wait(|| true) && heavy.is_alone());
    }
}
