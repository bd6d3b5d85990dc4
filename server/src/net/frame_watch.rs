//! Decides when a session's frame is cancelled:
//!
//! - At once when the session is over: its owner left, or it was closed.
//! - At its deadline. Time spent waiting for other sessions ([`super::fair`]) counts.
//! - When scene or settings have changed, but only after the frame has run for [`PATIENCE`]: dragging a slider
//!   changes a setting thirty times a second, and shorter frames are better finished. Each further cancelled
//!   frame in a row doubles this time, so that pictures keep coming however slow frames and however frequent
//!   changes are.

use std::sync::OnceLock;
use std::time::{Duration, Instant};

use super::fair::{Gate, Turn};
use super::session::Session;
use crate::render::Checkpoint;

/// How long a frame runs before a change cancels it.
const PATIENCE: Duration = Duration::from_millis(200);

/// Most doublings of [`PATIENCE`].
const MOST_DOUBLINGS: u32 = 4;

/// How long a frame may still run when the server stops.
const LAST_FRAME: Duration = Duration::from_secs(1);

/// Why a frame was cancelled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Why {
    /// The session is over.
    Stopped,
    /// Scene or settings changed.
    Changed,
    /// It missed its deadline.
    TooSlow,
}

/// The checkpoint of a session's frame; the frame ends when this is dropped.
pub(super) struct FrameWatch<'a> {
    session: &'a Session,
    turn: Turn<'a>,
    /// When the frame passed its first checkpoint, which is the start of rendering.
    begun: OnceLock<Instant>,
    deadline: Duration,
    patience: Duration,
    why: OnceLock<Why>,
}

impl<'a> FrameWatch<'a> {
    /// Begins a frame after `given_up` cancelled ones in a row.
    pub(super) fn begin(
        session: &'a Session,
        gate: &'a Gate,
        deadline: Duration,
        given_up: u32,
    ) -> Self {
        Self {
            session,
            turn: gate.begin(session.number),
            begun: OnceLock::new(),
            deadline,
            patience: PATIENCE * (1 << given_up.min(MOST_DOUBLINGS)),
            why: OnceLock::new(),
        }
    }

    /// Why it was cancelled, if it was.
    pub(super) fn why(&self) -> Option<Why> {
        self.why.get().copied()
    }

    fn verdict(&self, ran: Duration) -> Option<Why> {
        let session = self.session;
        if session.is_over() || (session.is_ending() && ran >= LAST_FRAME) {
            Some(Why::Stopped)
        } else if ran >= self.deadline {
            Some(Why::TooSlow)
        } else if session.has_changes() && ran >= self.patience {
            Some(Why::Changed)
        } else {
            None
        }
    }
}

impl Checkpoint for FrameWatch<'_> {
    fn go_on(&self) -> bool {
        let ran = self.begun.get_or_init(Instant::now).elapsed();
        match self.verdict(ran) {
            None => true,
            Some(why) => {
                self.why.get_or_init(|| why);
                false
            }
        }
    }

    fn is_held(&self) -> bool {
        self.turn.is_held()
    }

    fn wait(&self) {
        self.turn.wait();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use ghostlight_proto::control::{Control, Request};
    use tokio::sync::mpsc;

    use super::super::session::Command;
    use super::*;

    fn session() -> Arc<Session> {
        let memory = crate::memory::Budget::unlimited();
        Session::new(1, None, Control::Owner, 1, Arc::default(), memory).0
    }

    const S: Duration = Duration::from_secs(1);

    #[test]
    fn a_frame_ends_at_its_deadline_and_when_nobody_wants_it() {
        let (session, gate) = (session(), Gate::new(1));
        let watch = FrameWatch::begin(&session, &gate, 5 * S, 0);
        assert!(watch.go_on());
        assert_eq!(watch.verdict(4 * S), None);
        assert_eq!(watch.verdict(5 * S), Some(Why::TooSlow));
        session.finish("the server stops");
        assert_eq!(watch.verdict(S / 2), None);
        assert_eq!(watch.verdict(S), Some(Why::Stopped));
        session.stop("the session's owner left");
        assert_eq!(watch.verdict(Duration::ZERO), Some(Why::Stopped));
        assert_eq!(watch.why(), None);
        assert!(!watch.go_on());
        assert_eq!(watch.why(), Some(Why::Stopped));
    }

    #[test]
    fn a_change_ends_a_frame_that_has_run_long_and_others_later() {
        let (session, gate) = (session(), Gate::new(1));
        let (reply, _answers) = mpsc::channel(1);
        let (id, request) = Request::parse(r#"{"type": "settings", "settings": {}}"#);
        let request = request.unwrap();
        session.request(Command { id, request, reply });
        let ends_after = |given_up| {
            let watch = FrameWatch::begin(&session, &gate, 100 * S, given_up);
            let ends = |ms: &u64| watch.verdict(Duration::from_millis(*ms)) == Some(Why::Changed);
            (0..10_000).find(ends).unwrap()
        };
        assert_eq!([0, 1, 2].map(ends_after), [200, 400, 800]);
        assert_eq!(ends_after(u32::MAX), 3200);
        // A change that the session has already taken is no longer a change.
        assert_eq!(session.wait(None).commands.len(), 1);
        let watch = FrameWatch::begin(&session, &gate, 100 * S, 0);
        assert_eq!(watch.verdict(50 * S), None);
    }
}
