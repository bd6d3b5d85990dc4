//! Plays a recording in a loop, at its recorded rate.

use std::time::Instant;

use ghostlight_proto::{Code, WireError};

use crate::clock;
use crate::frame::{FrameSource, RgbdFrame};

/// Gap between the last frame and the first of the next round for a recording of a single frame, nanoseconds: 30
/// Hz.
const NOMINAL_PERIOD_NS: i64 = 33_333_333;

/// A recording and the position in it.
pub(super) struct Player {
    name: String,
    source: Box<dyn FrameSource>,
    /// When the first frame of the first round was due, on the service's clock.
    start_ns: i64,
    /// Time from the first frame of a round to the first of the next.
    round_ns: i64,
    /// Number of the next frame, counted over all rounds.
    next: u64,
}

/// A frame that is due.
pub(super) struct Due {
    /// Index in the recording.
    index: usize,
    /// Frame number, counted over all rounds.
    count: u64,
    /// When it was due, on the service's clock.
    pub(super) time_ns: i64,
    /// Earlier frames that were due as well and are dropped.
    pub(super) skipped: u64,
}

impl Player {
    /// Starts now.
    pub(super) fn new(name: &str, source: Box<dyn FrameSource>) -> Self {
        let n = source.n_frames();
        let length = match (source.time_ns(0), source.time_ns(n.saturating_sub(1))) {
            (Some(first), Some(last)) => last.saturating_sub(first).max(0),
            _ => 0,
        };
        let gap = match n {
            0 | 1 => NOMINAL_PERIOD_NS,
            n => (length / (n as i64 - 1)).max(1),
        };
        Self {
            name: name.to_owned(),
            start_ns: clock::now_ns(),
            round_ns: length + gap,
            next: 0,
            source,
        }
    }

    /// Restarts the recording now.
    pub(super) fn restart(&mut self) {
        self.start_ns = clock::now_ns();
        self.next = 0;
    }

    /// Name that `play` messages use.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Mean time between two frames, nanoseconds, if there are several.
    pub(super) fn period_ns(&self) -> Option<i64> {
        let n = self.source.n_frames() as i64;
        (n > 1).then(|| self.round_ns / n)
    }

    /// When the next frame is due.
    pub(super) fn due(&self) -> Instant {
        clock::instant_at(self.time_of(self.next))
    }

    /// The newest frame that is due; frames before it are skipped.
    pub(super) fn take_due(&mut self) -> Option<Due> {
        let now = clock::now_ns();
        if self.time_of(self.next) > now {
            return None;
        }
        let mut skipped = 0;
        // After a long pause (a machine that slept) whole rounds are skipped at once.
        let n = self.n_frames();
        let rounds = ((now - self.time_of(self.next)) / self.round_ns).max(0) as u64;
        self.next += rounds * n;
        skipped += rounds * n;
        while self.time_of(self.next + 1) <= now {
            self.next += 1;
            skipped += 1;
        }
        let due = Due {
            index: (self.next % n) as usize,
            count: self.next,
            time_ns: self.time_of(self.next),
            skipped,
        };
        self.next += 1;
        Some(due)
    }

    /// The first frame, without waiting or counting.
    pub(super) fn first(&self) -> Due {
        Due {
            index: 0,
            count: 0,
            time_ns: self.start_ns,
            skipped: 0,
        }
    }

    /// Reads a frame; it says when it was due, and its number over all rounds.
    pub(super) fn read(&mut self, due: &Due) -> Result<RgbdFrame, WireError> {
        let unread = |e| WireError::new(Code::Decode, "recording", "a frame that can be read", e);
        let mut frame = self.source.frame(due.index).map_err(unread)?;
        frame.index = due.count;
        frame.time_ns = due.time_ns;
        Ok(frame)
    }

    fn n_frames(&self) -> u64 {
        self.source.n_frames().max(1) as u64
    }

    fn time_of(&self, count: u64) -> i64 {
        let (round, index) = (count / self.n_frames(), (count % self.n_frames()) as usize);
        let within = match (self.source.time_ns(0), self.source.time_ns(index)) {
            (Some(first), Some(time)) => time.saturating_sub(first),
            _ => 0,
        };
        self.start_ns + round as i64 * self.round_ns + within
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Intrinsics, Pose};
    use crate::frame::{BoxError, ColorImage, DepthImage};

    struct Three([i64; 3]);

    impl FrameSource for Three {
        fn n_frames(&self) -> usize {
            3
        }
        fn time_ns(&self, index: usize) -> Option<i64> {
            self.0.get(index).copied()
        }
        fn frame(&mut self, index: usize) -> Result<RgbdFrame, BoxError> {
            Ok(RgbdFrame {
                index: 0,
                time_ns: self.0[index],
                color: ColorImage::filled(1, 1, [index as u8, 0, 0, 255]),
                depth: DepthImage::from_metres(1, 1, vec![1.0]),
                intrinsics: Intrinsics::new(1.0, 1.0, 0.0, 0.0, 1, 1).unwrap(),
                pose: Pose::IDENTITY,
            })
        }
    }

    #[test]
    fn late_frames_are_skipped_and_counted_over_rounds() {
        // Unevenly spaced, absolute times; the mean gap of 10 ns closes the round.
        let mut player = Player::new("three", Box::new(Three([1_000, 1_005, 1_020])));
        assert_eq!(player.round_ns, 30);
        player.start_ns = clock::now_ns() - 1_000_000_000;
        let due = player.take_due().unwrap();
        // Whatever the moment, no frame is lost from the count and none comes early.
        assert_eq!(due.count, due.skipped);
        assert_eq!(due.index as u64, due.count % 3);
        let round = (due.count / 3) as i64;
        let within = [0, 5, 20][due.index];
        assert_eq!(due.time_ns, player.start_ns + 30 * round + within);
        assert!(due.count >= 99_999_999, "{}", due.count);
        let frame = player.read(&due).unwrap();
        assert_eq!((frame.index, frame.time_ns), (due.count, due.time_ns));
        assert_eq!(usize::from(frame.color.rgba[0][0]), due.index);
    }

    #[test]
    fn a_frame_that_is_not_due_waits() {
        let second = 1_000_000_000;
        let mut player = Player::new("three", Box::new(Three([0, 3600 * second, 7200 * second])));
        assert_eq!(player.take_due().unwrap().index, 0);
        assert!(player.take_due().is_none());
    }
}
