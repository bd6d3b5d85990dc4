//! Sessions share the processor fairly.
//!
//! All sessions share one set of threads ([`crate::render::Threads`]), so what is shared out is time: how long
//! a session's frames ran of late. As many frames run at a time as the threads can be kept busy with, one on a
//! small machine; the others are held, mostly before they begin. Frames that take turns finish earlier on
//! average than frames that run side by side, and need one set of buffers.
//!
//! The session that has used the least is next. A running frame may be held in the middle if its session is
//! ahead of a waiting one: by little where its frames take long, so that a short frame every 33 ms is on time
//! beside one that takes seconds; by much where they do not, so that ordinary frames are seldom interrupted.
//!
//! The picture does not depend on any of this; only its time does.

use crate::clock;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Time constant of "of late", seconds: what was used so long ago counts 1/e.
const MEMORY_S: f64 = 1.0;

/// A session's frames take long, seconds, if its last few all did, or the last one this much longer. A first
/// frame, which grows its buffers, is no sign.
const LONG_FRAME_S: f64 = 0.1;
const VERY_LONG_FRAME_S: f64 = 0.5;

/// The frame under way takes long, seconds.
const LONG_NOW_S: f64 = 0.25;

/// How far ahead of a waiting session, seconds, one with long frames may run: short beside a frame of 33 ms,
/// long enough to be worth a switch.
const LEAD_LONG_S: f64 = 0.005;

/// How far ahead one with ordinary frames may run: more than sessions of like load ever are.
const LEAD_ORDINARY_S: f64 = 0.25;

/// How long an ordinary frame runs before it may be held, seconds: most are done by then, and one every 33 ms
/// is still on time after it.
const WHOLE_S: f64 = 0.02;

/// How often shares are updated while nothing begins or ends.
const LOOK_NS: i64 = 500_000;

/// Threads that one frame keeps busy.
const THREADS_PER_FRAME: usize = 4;

/// Longest sleep of a held frame before it checks whether it was cancelled.
pub(super) const NAP: Duration = Duration::from_millis(5);

/// One session's account.
#[derive(Debug, Default)]
struct Share {
    /// Seconds used of late.
    used_s: f64,
    /// How long its frame under way has run, and how long its last few did.
    frame_s: f64,
    last_s: [f64; 4],
    /// A frame of it is under way.
    active: bool,
    /// That frame waits; its threads read this without a lock.
    held: Arc<AtomicBool>,
}

impl Share {
    fn is_held(&self) -> bool {
        self.held.load(Ordering::Relaxed)
    }

    fn hold(&self, held: bool) {
        self.held.store(held, Ordering::Relaxed);
    }

    /// Whether its running frame is to be held for a session that waits.
    fn makes_room_for(&self, waiting: &Self) -> bool {
        let lead_s = self.used_s - waiting.used_s;
        let long = self.frame_s >= LONG_NOW_S
            || self.last_s[3] >= VERY_LONG_FRAME_S
            || self.last_s.iter().all(|&last| last >= LONG_FRAME_S);
        if long {
            lead_s > LEAD_LONG_S
        } else {
            lead_s > LEAD_ORDINARY_S && self.frame_s >= WHOLE_S
        }
    }
}

/// The accounts of all sessions. Reads no clock: the time is an argument.
#[derive(Debug)]
struct Shares {
    of: BTreeMap<u64, Share>,
    /// Frames that run at a time.
    at_once: usize,
    /// The time up to which sessions were charged.
    at_ns: i64,
}

impl Shares {
    fn new(at_once: usize) -> Self {
        Self {
            of: BTreeMap::new(),
            at_once,
            at_ns: 0,
        }
    }

    fn active(&self) -> impl Iterator<Item = &Share> {
        self.of.values().filter(|share| share.active)
    }

    fn running(&self) -> impl Iterator<Item = &Share> {
        self.active().filter(|share| !share.is_held())
    }

    /// Charges the time up to now to the sessions that run, in equal parts, and decides who runs.
    fn advance(&mut self, now_ns: i64) {
        let passed_s = (now_ns - self.at_ns).max(0) as f64 * 1e-9;
        self.at_ns = self.at_ns.max(now_ns);
        let kept = (-passed_s / MEMORY_S).exp();
        let each_s = passed_s / self.running().count().max(1) as f64;
        for share in self.of.values_mut() {
            share.used_s *= kept;
            if share.active && !share.is_held() {
                share.used_s += each_s;
                share.frame_s += each_s;
            }
        }
        self.choose();
    }

    /// Lets waiting frames run while there is room, then in the place of running ones that make room for
    /// them. Ends: each exchange lowers what the running sessions have used.
    fn choose(&self) {
        let by_use = |a: &&Share, b: &&Share| a.used_s.total_cmp(&b.used_s);
        loop {
            let waiting = self.active().filter(|share| share.is_held());
            let Some(next) = waiting.min_by(by_use) else {
                return;
            };
            if self.running().count() >= self.at_once {
                let ahead = self.running().filter(|share| share.makes_room_for(next));
                let Some(ahead) = ahead.max_by(by_use) else {
                    return;
                };
                ahead.hold(true);
            }
            next.hold(false);
        }
    }

    /// A frame of a session begins. Returns whether it is held, now and later.
    fn begin(&mut self, session: u64, now_ns: i64) -> Arc<AtomicBool> {
        self.advance(now_ns);
        // A new session has no claim on the others.
        let most_s = self
            .of
            .values()
            .map(|share| share.used_s)
            .fold(0.0, f64::max);
        let share = self.of.entry(session).or_insert_with(|| Share {
            used_s: most_s,
            ..Share::default()
        });
        share.active = true;
        share.frame_s = 0.0;
        share.hold(true);
        let held = Arc::clone(&share.held);
        self.choose();
        held
    }

    fn end(&mut self, session: u64, now_ns: i64) {
        self.advance(now_ns);
        if let Some(share) = self.of.get_mut(&session) {
            share.active = false;
            share.last_s.rotate_left(1);
            share.last_s[3] = share.frame_s;
            share.hold(false);
        }
        self.choose();
    }
}

/// Shared by all sessions of a server; frames call it at their checkpoints.
#[derive(Debug)]
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
    held: Arc<AtomicBool>,
}

impl Gate {
    /// For frames that share so many threads.
    pub(super) fn new(n_threads: usize) -> Self {
        let at_once = n_threads.div_ceil(THREADS_PER_FRAME).max(1);
        Self {
            shares: Mutex::new(Shares::new(at_once)),
            changed: Condvar::new(),
            n_active: AtomicUsize::new(0),
            look_ns: AtomicU64::new(0),
        }
    }

    fn shares(&self) -> MutexGuard<'_, Shares> {
        // Every critical section leaves its data consistent.
        self.shares.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A frame of a session begins.
    pub(super) fn begin(&self, session: u64) -> Turn<'_> {
        let held = self.shares().begin(session, clock::now_ns());
        self.n_active.fetch_add(1, Ordering::Relaxed);
        Turn {
            gate: self,
            session,
            held,
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

    /// Whether this frame waits for others; never waits.
    pub(super) fn is_held(&self) -> bool {
        if self.is_alone() {
            return false;
        }
        let now_ns = clock::now_ns();
        let next = (now_ns + LOOK_NS) as u64;
        let look = |at: u64| (now_ns as u64 >= at).then_some(next);
        let look_ns = &self.gate.look_ns;
        if look_ns
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, look)
            .is_ok()
        {
            self.gate.shares().advance(now_ns);
            self.gate.changed.notify_all();
        }
        self.held.load(Ordering::Relaxed)
    }

    /// Sleeps until it may be this frame's turn, at most [`NAP`].
    pub(super) fn wait(&self) {
        let shares = self.gate.shares();
        if !self.held.load(Ordering::Relaxed) {
            return;
        }
        let waited = self.gate.changed.wait_timeout(shares, NAP);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
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
        let mut shares = Shares::new(1);
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
            shares.advance(t * MS);
            let runs: Vec<bool> = (0..n)
                .map(|i| begun[i].is_some() && !shares.of[&(i as u64)].is_held())
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
        for cost in [12, 15] {
            let done = play(&[(33, cost), (0, 4000)], 60_000);
            let (good, longest) = done[0];
            // Some of the first come before it shows how long the other's take.
            assert!(good + 10 >= 60_000 / 33, "{done:?}");
            // At worst one of the other's has just begun.
            assert!(longest <= cost + 24, "{done:?}");
            // What is left is the other's, to the last millisecond but few.
            assert!(
                done[1].0 as i64 >= (33 - cost) * 60 / (33 * 4) - 2,
                "{done:?}"
            );
        }
    }

    #[test]
    fn a_short_frame_every_33_ms_is_on_time_beside_middling_ones() {
        for other in [40, 90, 150] {
            let done = play(&[(33, 12), (0, other)], 60_000);
            assert!(done[0].0 >= 1700, "{done:?}");
        }
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
    fn frames_of_like_sessions_are_not_interrupted() {
        let mut shares = Shares::new(1);
        let held = [1, 2].map(|session| shares.begin(session, 0));
        let is_held = || held.each_ref().map(|held| held.load(Ordering::Relaxed));
        for t in 0..90 {
            shares.advance(t * MS);
            assert_eq!(is_held(), [false, true]);
        }
        shares.end(1, 90 * MS);
        assert_eq!(is_held(), [false, false]);
        // The next frame of the first comes while the second runs, and waits for its end.
        shares.begin(1, 91 * MS);
        for t in 91..180 {
            shares.advance(t * MS);
            assert_eq!(is_held(), [true, false]);
        }
        shares.end(2, 180 * MS);
        assert_eq!(is_held(), [false, false]);
    }

    #[test]
    fn many_threads_run_several_frames_at_a_time() {
        let mut shares = Shares::new(2);
        let held = [1, 2, 3].map(|session| shares.begin(session, 0));
        let is_held = || held.each_ref().map(|held| held.load(Ordering::Relaxed));
        assert_eq!(is_held(), [false, false, true]);
        // Each is charged half of the time; far ahead of the third, one makes room.
        shares.advance(480 * MS);
        assert_eq!(is_held(), [false, false, true]);
        shares.advance(540 * MS);
        assert_eq!(is_held().iter().filter(|held| **held).count(), 1);
        assert!(!is_held()[2]);
    }

    #[test]
    fn a_frame_waits_while_its_session_is_ahead_and_another_is_under_way() {
        let gate = Gate::new(2);
        let heavy = gate.begin(1);
        assert!(heavy.is_alone());
        let light = gate.begin(2);
        assert!(!heavy.is_alone());
        assert!(!heavy.is_held() && light.is_held());
        gate.shares().of.get_mut(&1).unwrap().frame_s = 10.0;
        gate.shares().of.get_mut(&1).unwrap().used_s = 10.0;
        gate.look_ns.store(0, Ordering::Relaxed);
        assert!(!light.is_held());
        assert!(heavy.is_held());
        // At most as long as a nap: nothing ends meanwhile.
        heavy.wait();
        assert!(heavy.is_held());
        drop(light);
        assert!(!heavy.is_held() && heavy.is_alone());
    }
}
