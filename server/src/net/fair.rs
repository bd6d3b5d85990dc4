//! Shares the processor fairly among sessions.
//!
//! All sessions share one set of threads ([`crate::render::Threads`]), so the resource that is shared is time:
//! how long a session's frames ran recently. Only as many frames run at a time as are needed to keep the threads
//! busy, one on a small machine; the others are held, mostly before they begin. Frames that take turns finish
//! earlier on average than frames that run side by side, and need only one set of buffers.
//!
//! The session that has used the least time is next. A running frame may be held in the middle if its session has
//! used more time than a waiting one. If its frames take long, a small lead is enough, so that a short frame
//! every 33 ms is on time beside frames that take seconds. Otherwise the lead must be large, so that ordinary
//! frames are rarely interrupted.
//!
//! Scheduling changes only when a picture is finished, never the picture.

use crate::clock;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Time constant of the recent use, seconds: time used this long ago counts 1/e.
const MEMORY_S: f64 = 1.0;

/// A session has long frames if its last few all took `LONG_FRAME_S`, seconds, or the last one took
/// `VERY_LONG_FRAME_S`. A single frame of `LONG_FRAME_S` is not enough, because a session's first frame may take
/// that long to allocate its buffers.
const LONG_FRAME_S: f64 = 0.1;
const VERY_LONG_FRAME_S: f64 = 0.5;

/// The running frame counts as long after this time, seconds.
const LONG_NOW_S: f64 = 0.25;

/// How much more time than a waiting session, seconds, a session with long frames may have used: short beside a
/// frame of 33 ms, long enough to be worth a switch.
const LEAD_LONG_S: f64 = 0.005;

/// The same for a session with ordinary frames: more than the difference between sessions of similar load.
const LEAD_ORDINARY_S: f64 = 0.25;

/// How long an ordinary frame runs before it may be held, seconds: most frames are done by then, and a frame
/// every 33 ms is still on time after it.
const WHOLE_S: f64 = 0.02;

/// How often shares are updated while no frame begins or ends.
const LOOK_NS: i64 = 500_000;

/// Threads that one frame keeps busy.
const THREADS_PER_FRAME: usize = 4;

/// Longest sleep of a held frame before it checks whether it was cancelled.
pub(super) const NAP: Duration = Duration::from_millis(5);

/// The time account of one session.
#[derive(Debug, Default)]
struct Share {
    /// Time used recently, seconds.
    used_s: f64,
    /// How long the running frame has run and how long the last few frames ran, seconds.
    frame_s: f64,
    last_s: [f64; 4],
    /// The session has a frame that was begun and has not ended.
    active: bool,
    /// Whether that frame must wait; its threads read this without a lock.
    held: Arc<AtomicBool>,
}

impl Share {
    fn is_held(&self) -> bool {
        self.held.load(Ordering::Relaxed)
    }

    fn hold(&self, held: bool) {
        self.held.store(held, Ordering::Relaxed);
    }

    /// Whether the running frame of this session is to be held in favour of a waiting session.
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

/// The accounts of all sessions. Reads no clock: the time is passed in.
#[derive(Debug)]
struct Shares {
    of: BTreeMap<u64, Share>,
    /// Number of frames that run at the same time.
    at_once: usize,
    /// The time up to which sessions have been charged.
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

    /// Charges the time since the last call to the running sessions, in equal parts, and decides which frames
    /// run.
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

    /// Lets waiting frames run while there is room, then exchanges running frames for waiting ones where
    /// [`Share::makes_room_for`] allows it. Terminates: each exchange lowers the time that the running sessions
    /// have used.
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

    /// Begins a frame of a session. Returns the flag that says whether it is held, now and later.
    fn begin(&mut self, session: u64, now_ns: i64) -> Arc<AtomicBool> {
        self.advance(now_ns);
        // A new session starts with the largest used time, so it has no advantage over the others.
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

/// The scheduler shared by all sessions of a server; frames call it at their checkpoints.
#[derive(Debug)]
pub(super) struct Gate {
    shares: Mutex<Shares>,
    changed: Condvar,
    /// Frames that have begun and not ended.
    n_active: AtomicUsize,
    /// When shares are next updated, on the process's clock.
    look_ns: AtomicU64,
}

/// A frame being rendered; it ends when this is dropped.
pub(super) struct Turn<'a> {
    gate: &'a Gate,
    session: u64,
    held: Arc<AtomicBool>,
}

impl Gate {
    /// For frames that share `n_threads` threads.
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

    /// Forgets a session that has ended.
    pub(super) fn forget(&self, session: u64) {
        self.shares().of.remove(&session);
    }
}

impl Turn<'_> {
    /// Whether this is the only frame. One atomic load.
    pub(super) fn is_alone(&self) -> bool {
        self.gate.n_active.load(Ordering::Relaxed) <= 1
    }

    /// Whether this frame must wait for others. Does not block.
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

    /// Sleeps until this frame's turn may have come, at most [`NAP`].
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

    /// Simulates sessions in steps of a millisecond. Each is (period, processor time per frame) in milliseconds;
    /// a period of 0 means frames without a pause. Returns for each session the number of finished frames and the
    /// longest time that one took.
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
                    // All begin with equal accounts; differences show only after a second.
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
            // A few frames at the start come before the other session is known to have long frames.
            assert!(good + 10 >= 60_000 / 33, "{done:?}");
            // In the worst case a frame of the other session has just begun.
            assert!(longest <= cost + 24, "{done:?}");
            // The other session gets all remaining time but a few milliseconds.
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
        // The sessions want more time than there is: the one that asks for more than half gets half.
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
        // The next frame of the first session begins while the second runs, and waits for its end.
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
        // Each is charged half of the time; one of them, far ahead of the third, makes room.
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
        // Sleeps at most [`NAP`], because no frame ends meanwhile.
        heavy.wait();
        assert!(heavy.is_held());
        drop(light);
        assert!(!heavy.is_held() && heavy.is_alone());
    }
}
