//! Cancels a frame before it is finished, or lets other frames go first.
//!
//! Rendering reads no clock and no network, so the caller passes in a [`Checkpoint`]. Every render thread calls
//! it between pieces of work that take well under 50 milliseconds with any settings, mostly under one: before a
//! tile, and inside the long loops of a tile.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::helper::make_way;

/// Decides whether a frame continues.
pub trait Checkpoint: Sync {
    /// Called by every render thread between small pieces of work; must not block. False cancels the frame, with
    /// [`RenderError::Cancelled`](super::RenderError::Cancelled).
    fn go_on(&self) -> bool;

    /// Whether the frame currently leaves its threads to other frames; must not block.
    fn is_held(&self) -> bool {
        false
    }

    /// Sleeps while the frame is held, a few milliseconds at most. Called by the thread that requested the frame.
    fn wait(&self) {
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// The checkpoint of a frame that is never cancelled.
#[derive(Debug, Clone, Copy, Default)]
pub struct Uninterrupted;

impl Checkpoint for Uninterrupted {
    fn go_on(&self) -> bool {
        true
    }
}

/// A flag that cancels frames; clones share it.
#[derive(Debug, Clone, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// A flag that is not set.
    pub fn new() -> Self {
        Self::default()
    }

    /// Cancels the frame being rendered, and all later ones.
    pub fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether the flag is set.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl Checkpoint for Cancel {
    fn go_on(&self) -> bool {
        !self.is_set()
    }
}

/// The checkpoint of one frame. After it has returned false to one thread, no thread calls it again.
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

    /// Calls the checkpoint; false if the frame is cancelled.
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

    /// Whether the frame currently leaves its threads to other frames.
    pub(crate) fn is_held(&self) -> bool {
        self.checkpoint.is_held()
    }

    /// Whether the frame was cancelled; only an atomic load.
    pub(crate) fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    /// Returns an error if the frame was cancelled, to end a stage.
    pub(crate) fn check(&self) -> Result<(), Cancelled> {
        if self.go_on() { Ok(()) } else { Err(Cancelled) }
    }
}

/// The frame was cancelled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cancelled;
