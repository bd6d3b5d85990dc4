//! Giving a frame up before it is finished, and letting others go first meanwhile.
//!
//! Rendering knows no clock and no network, so whoever asks for a frame hands in a [`Checkpoint`].
//! Every render thread passes it between pieces of work that take well under 50 milliseconds with
//! any settings, mostly under one: before a tile, and inside the long loops of a tile.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::helper::make_way;

/// What decides whether a frame goes on.
pub trait Checkpoint: Sync {
    /// Called by every render thread between small pieces of work; never waits. False: the frame is
    /// given up, with [`RenderError::Cancelled`](super::RenderError::Cancelled).
    fn go_on(&self) -> bool;

    /// Whether the frame leaves its threads to other frames for now; never waits.
    fn is_held(&self) -> bool {
        false
    }

    /// Sleeps while the frame is held, a few milliseconds at most. Called by the thread that asked for the
    /// frame.
    fn wait(&self) {
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A frame that is always finished.
#[derive(Debug, Clone, Copy, Default)]
pub struct Uninterrupted;

impl Checkpoint for Uninterrupted {
    fn go_on(&self) -> bool {
        true
    }
}

/// A flag that gives frames up; clones share it.
#[derive(Debug, Clone, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Not set.
    pub fn new() -> Self {
        Self::default()
    }

    /// Gives up the frame being rendered, and all after it.
    pub fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether it was set.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl Checkpoint for Cancel {
    fn go_on(&self) -> bool {
        !self.is_set()
    }
}

/// The checkpoint of one frame. Once it has said no to one thread, no thread asks again.
pub(crate) struct Pulse<'a> {
    checkpoint: &'a dyn Checkpoint,
    stopped: AtomicBool,
}

impl<'a> Pulse<'a> {
    pub(crate) fn new(checkpoint: &'a dyn Checkpoint) -> Self {
        Self {
            checkpoint,
            stopped: AtomicBool::new(false),
        }
    }

    /// Passes the checkpoint.
    pub(crate) fn go_on(&self) -> bool {
        if self.is_stopped() {
            return false;
        }
        let checkpoint = self.checkpoint;
        let on = checkpoint.go_on()
            && make_way(
                || checkpoint.is_held(),
                || checkpoint.go_on(),
                || checkpoint.wait(),
            );
        if !on {
            self.stopped.store(true, Ordering::Relaxed);
        }
        on
    }

    /// Whether the frame leaves its threads to other frames for now.
    pub(crate) fn is_held(&self) -> bool {
        self.checkpoint.is_held()
    }

    /// Whether the frame was given up; a load, no more.
    pub(crate) fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    /// Ends a stage of a frame that was given up in it.
    pub(crate) fn check(&self) -> Result<(), Cancelled> {
        if self.go_on() { Ok(()) } else { Err(Cancelled) }
    }
}

/// The frame was given up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cancelled;
