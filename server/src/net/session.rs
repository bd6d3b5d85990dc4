//! A session: the state that its clients share with its render thread.
//!
//! Frames enter through a slot for one frame: a newer frame replaces an older one that was not taken yet.
//! Composites leave through a `watch` channel, which also holds one. So a session's memory does not depend on how
//! fast clients send or read.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use axum::body::Bytes;
use ghostlight_proto::control::{Control, ErrorReport, Reply, Request, Source, State, Stats};
use ghostlight_proto::{Code, FrameHeader, WireError};
use tokio::sync::{mpsc, watch};

use super::catalog::Assets;
use super::config::Bounds;
use super::encode::Output;
use super::metrics::Metrics;
use super::rate::Rate;
use crate::memory::{Budget, Held};

/// Most requests that may wait for the render thread.
const MAX_REQUESTS: usize = 64;

/// A frame that arrived, its payloads still encoded.
pub(super) struct Incoming {
    /// The parsed header.
    pub(super) header: FrameHeader,
    /// The whole message.
    pub(super) message: Bytes,
    /// When the message was complete.
    pub(super) received_ns: i64,
    /// Where to send errors about it.
    pub(super) reply: mpsc::Sender<Reply>,
}

/// A request for the render thread.
pub(super) struct Command {
    /// The client's number for it.
    pub(super) id: Option<u64>,
    /// The requested action.
    pub(super) request: Request,
    /// Where to send the answer.
    pub(super) reply: mpsc::Sender<Reply>,
}

impl Command {
    /// Answers with an error. The answer is dropped if the client does not read its answers, because the render
    /// thread never waits.
    pub(super) fn refuse(&self, error: WireError) {
        let report = ErrorReport::new(error, self.id, None, false);
        let _ = self.reply.try_send(Reply::Error(report));
    }
}

/// What [`Session::wait`] returns.
#[derive(Default)]
pub(super) struct Work {
    /// The newest frame.
    pub(super) frame: Option<Incoming>,
    /// Requests, in order.
    pub(super) commands: Vec<Command>,
    /// Clients want planes that the newest composite lacks.
    pub(super) planes_changed: bool,
    /// The session is over.
    pub(super) stop: bool,
}

#[derive(Default)]
struct Inbox {
    frame: Option<Incoming>,
    commands: VecDeque<Command>,
    planes_changed: bool,
    scene_loaded: bool,
    stop: Option<String>,
    /// Rate of the frames received.
    rate: Rate,
}

/// Uploads, finished and in progress.
struct Uploads {
    files: Assets,
    /// Bytes announced by each unfinished upload.
    reserved: Vec<u64>,
    /// Their part of the memory budget.
    held: Held,
}

impl Uploads {
    /// Bytes of all uploads, as announced.
    fn bytes(&self) -> u64 {
        let files = self.files.values().map(|file| file.len() as u64);
        files.chain(self.reserved.iter().copied()).sum()
    }
}

/// Counts of one session.
#[derive(Debug, Default)]
pub(super) struct Counters {
    /// Frames received from the producer or due from the recording.
    pub(super) received: AtomicU64,
    /// Frames rendered.
    pub(super) rendered: AtomicU64,
    /// Frames replaced by newer ones.
    pub(super) dropped: AtomicU64,
    /// Frames answered with an error.
    pub(super) refused: AtomicU64,
    /// Clients that receive composites.
    pub(super) viewers: AtomicU64,
    /// Receiving clients that want the mask.
    pub(super) want_mask: AtomicU64,
    /// Receiving clients that want depth.
    pub(super) want_depth: AtomicU64,
}

/// Adds one.
pub(super) fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

/// Subtracts one.
pub(super) fn uncount(counter: &AtomicU64) {
    counter.fetch_sub(1, Ordering::Relaxed);
}

/// State shared by clients and render thread.
pub(super) struct Session {
    /// Its number.
    pub(super) number: u64,
    /// Its identifier on the wire.
    pub(super) id: String,
    /// The producer's name; `None` for a recording.
    pub(super) live: Option<String>,
    /// Who may change it.
    pub(super) control: Control,
    /// The connection that owns it.
    pub(super) owner: u64,
    /// Counts so far.
    pub(super) counters: Counters,
    /// The newest composite; closed when the session is over.
    pub(super) output: watch::Receiver<Option<Arc<Output>>>,
    /// The state that clients are told of: scene, recording, objects.
    pub(super) state: watch::Receiver<Arc<State>>,
    metrics: Arc<Metrics>,
    inbox: Mutex<Inbox>,
    wake: Condvar,
    /// Whether queued requests change the picture.
    changes: AtomicBool,
    /// The session ends after the current frame, or at once.
    ending: AtomicBool,
    over: AtomicBool,
    /// Where to send messages to the owner that answer no request.
    owner_reply: Mutex<Option<mpsc::Sender<Reply>>>,
    /// Quality reductions of the last frame.
    quality: Mutex<Quality>,
    uploads: Mutex<Uploads>,
    /// Memory budget of its scenes and uploads.
    pub(super) memory: Budget,
}

/// Quality of the last rendered frame.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Quality {
    /// Settings that were lowered to keep the time budget, as text.
    pub(super) quality_reductions: Vec<String>,
    /// Time between two frames of the source, if it has a rate.
    pub(super) period_ns: Option<i64>,
}

/// The sending ends of a session's channels.
pub(super) struct Publisher {
    /// The newest composite.
    pub(super) output: watch::Sender<Option<Arc<Output>>>,
    /// The state that clients are told of.
    pub(super) state: watch::Sender<Arc<State>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Every critical section leaves its data consistent, so a poisoned lock is usable.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Session {
    /// A session without a render thread, and the publisher for that thread.
    pub(super) fn new(
        number: u64,
        live: Option<String>,
        control: Control,
        owner: u64,
        metrics: Arc<Metrics>,
        memory: Budget,
    ) -> (Arc<Self>, Publisher) {
        let id = format!("s{number}");
        let (output, output_rx) = watch::channel(None);
        let source = match &live {
            Some(name) => Source::Live(name.clone()),
            None => Source::Recording(String::new()),
        };
        let (state, state_rx) = watch::channel(Arc::new(State {
            session: id.clone(),
            source,
            scene: None,
            objects: Vec::new(),
            settings: serde_json::Value::Null,
        }));
        let session = Self {
            number,
            id,
            live,
            control,
            owner,
            counters: Counters::default(),
            output: output_rx,
            state: state_rx,
            metrics,
            inbox: Mutex::new(Inbox::default()),
            wake: Condvar::new(),
            changes: AtomicBool::new(false),
            ending: AtomicBool::new(false),
            over: AtomicBool::new(false),
            owner_reply: Mutex::new(None),
            quality: Mutex::default(),
            uploads: Mutex::new(Uploads {
                files: Assets::new(),
                reserved: Vec::new(),
                held: memory.nothing(),
            }),
            memory,
        };
        (Arc::new(session), Publisher { output, state })
    }

    /// Puts a frame into the slot; a frame that is already there is replaced and counted as dropped.
    pub(super) fn offer(&self, frame: Incoming) {
        self.count_received(1);
        let mut inbox = lock(&self.inbox);
        inbox.rate.add(frame.header.capture_ns);
        let replaced = inbox.frame.replace(frame).is_some();
        drop(inbox);
        self.wake.notify_one();
        if replaced {
            self.count_dropped(1);
        }
    }

    /// Queues a request, unless too many wait.
    pub(super) fn request(&self, command: Command) {
        let mut inbox = lock(&self.inbox);
        if inbox.commands.len() < MAX_REQUESTS {
            inbox.commands.push_back(command);
            self.changes.store(true, Ordering::Relaxed);
            drop(inbox);
            self.wake.notify_one();
            return;
        }
        drop(inbox);
        self.metrics.error(Code::Limit);
        command.refuse(WireError::new(
            Code::Limit,
            "requests",
            format_args!("at most {MAX_REQUESTS} waiting"),
            "one more",
        ));
    }

    /// Requests that the newest frame is rendered again, with newly wanted planes.
    pub(super) fn planes_changed(&self) {
        lock(&self.inbox).planes_changed = true;
        self.wake.notify_one();
    }

    /// Tells the render thread that the load of a scene has ended, with or without success.
    pub(super) fn scene_loaded(&self) {
        let mut inbox = lock(&self.inbox);
        inbox.scene_loaded = true;
        self.changes.store(true, Ordering::Relaxed);
        drop(inbox);
        self.wake.notify_one();
    }

    /// Ends the session at once and cancels its frame. The first reason stays.
    pub(super) fn stop(&self, reason: &str) {
        self.over.store(true, Ordering::Relaxed);
        self.finish(reason);
    }

    /// Ends the session after the current frame. The first reason stays.
    pub(super) fn finish(&self, reason: &str) {
        self.ending.store(true, Ordering::Relaxed);
        let mut inbox = lock(&self.inbox);
        inbox.stop.get_or_insert_with(|| reason.to_owned());
        drop(inbox);
        self.wake.notify_one();
    }

    /// Whether the session has been stopped.
    pub(super) fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    /// Whether the session ends after the current frame.
    pub(super) fn is_ending(&self) -> bool {
        self.ending.load(Ordering::Relaxed)
    }

    /// Whether queued requests change the picture.
    pub(super) fn has_changes(&self) -> bool {
        self.changes.load(Ordering::Relaxed)
    }

    /// Time between two frames of its producer, nanoseconds, from their capture times.
    pub(super) fn producer_period_ns(&self) -> Option<i64> {
        lock(&self.inbox).rate.period_ns()
    }

    /// Sets where [`Self::tell_owner`] sends its messages from now on.
    pub(super) fn set_owner_reply(&self, reply: mpsc::Sender<Reply>) {
        *lock(&self.owner_reply) = Some(reply);
    }

    /// Sends the owner a message that answers no request. The message is dropped if the owner does not read.
    pub(super) fn tell_owner(&self, reply: Reply) {
        if let Some(owner) = &*lock(&self.owner_reply) {
            let _ = owner.try_send(reply);
        }
    }

    /// Records the quality of the last frame.
    pub(super) fn set_quality(&self, quality: Quality) {
        *lock(&self.quality) = quality;
    }

    /// Why the session has ended or is about to end.
    pub(super) fn end_reason(&self) -> String {
        lock(&self.inbox)
            .stop
            .clone()
            .unwrap_or_else(|| "the session ended".to_owned())
    }

    /// Waits for work, at the latest until `until`.
    pub(super) fn wait(&self, until: Option<Instant>) -> Work {
        let mut inbox = lock(&self.inbox);
        loop {
            let idle = inbox.frame.is_none()
                && inbox.commands.is_empty()
                && !inbox.planes_changed
                && !inbox.scene_loaded
                && inbox.stop.is_none();
            let left = until.map(|t| t.saturating_duration_since(Instant::now()));
            if !idle || left.is_some_and(|d| d.is_zero()) {
                self.changes.store(false, Ordering::Relaxed);
                inbox.scene_loaded = false;
                return Work {
                    frame: inbox.frame.take(),
                    commands: inbox.commands.drain(..).collect(),
                    planes_changed: std::mem::take(&mut inbox.planes_changed),
                    stop: inbox.stop.is_some(),
                };
            }
            inbox = match left {
                Some(left) => {
                    self.wake
                        .wait_timeout(inbox, left)
                        .unwrap_or_else(PoisonError::into_inner)
                        .0
                }
                None => self
                    .wake
                    .wait(inbox)
                    .unwrap_or_else(PoisonError::into_inner),
            };
        }
    }

    /// Counts frames that arrived or were due.
    pub(super) fn count_received(&self, n: u64) {
        self.counters.received.fetch_add(n, Ordering::Relaxed);
        self.metrics.frames_received.inc_by(n);
    }

    /// Counts frames that are never rendered.
    pub(super) fn count_dropped(&self, n: u64) {
        self.counters.dropped.fetch_add(n, Ordering::Relaxed);
        self.metrics.frames_dropped.inc_by(n);
    }

    /// Counts a frame answered with an error.
    pub(super) fn count_refused(&self, code: Code) {
        count(&self.counters.refused);
        self.metrics.frames_refused.inc();
        self.metrics.error(code);
    }

    /// The metrics of the whole server.
    pub(super) fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// The counters in wire format; a client's own counters are added by the caller.
    pub(super) fn stats(&self) -> Stats {
        let c = &self.counters;
        let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
        let Quality {
            quality_reductions,
            period_ns,
        } = lock(&self.quality).clone();
        Stats {
            frames_received: get(&c.received),
            frames_rendered: get(&c.rendered),
            frames_dropped: get(&c.dropped),
            frames_refused: get(&c.refused),
            viewers: get(&c.viewers),
            source_period_us: period_ns.and_then(|ns| u64::try_from(ns / 1000).ok()),
            lowered: quality_reductions,
            ..Stats::default()
        }
    }

    /// Reserves memory for an upload.
    pub(super) fn reserve_upload(
        &self,
        name: &str,
        bytes: u64,
        bounds: &Bounds,
    ) -> Result<(), WireError> {
        let refuse = |what: &str, expected: String, got: u64| {
            Err(WireError::new(Code::TooLarge, what, expected, got))
        };
        if bytes > bounds.asset_bytes {
            let expected = format!("at most {} bytes", bounds.asset_bytes);
            return refuse("asset, bytes", expected, bytes);
        }
        let mut uploads = lock(&self.uploads);
        // A file that is being replaced is kept until the new one is complete, so both count.
        let left = bounds.assets_bytes.saturating_sub(uploads.bytes());
        if bytes > left {
            let expected = format!("at most {left} bytes (what the session has left)");
            return refuse(&format!("asset {name:?}, bytes"), expected, bytes);
        }
        let n = uploads.files.len() + uploads.reserved.len();
        if n >= bounds.assets && !uploads.files.contains_key(name) {
            let expected = format!("at most {} of a session", bounds.assets);
            return refuse("asset, number", expected, n as u64 + 1);
        }
        uploads.held.grow(bytes, "uploads").map_err(|over| {
            let expected = format!("at most {} bytes (left for {})", over.left, over.name);
            WireError::new(
                Code::TooLarge,
                format_args!("asset {name:?}, bytes"),
                expected,
                bytes,
            )
        })?;
        uploads.reserved.push(bytes);
        Ok(())
    }

    /// Ends an upload: cancelled, or complete and now an asset.
    pub(super) fn settle_upload(&self, bytes: u64, finished: Option<(String, Vec<u8>)>) {
        let mut uploads = lock(&self.uploads);
        if let Some(i) = uploads.reserved.iter().position(|&n| n == bytes) {
            uploads.reserved.swap_remove(i);
        }
        if let Some((name, content)) = finished {
            uploads.files.insert(name, Arc::new(content));
        }
        let bytes = uploads.bytes();
        uploads.held.shrink_to(bytes);
    }

    /// The assets, shared.
    pub(super) fn assets(&self) -> Assets {
        lock(&self.uploads).files.clone()
    }
}
