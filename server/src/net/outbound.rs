//! Writes to a client: answers first, then the newest composite whenever the client has a credit.
//!
//! The order is: wait for a credit, take the newest composite, encode it. So a slow client gets the composite
//! that is newest when it is ready, and no composite is encoded without being sent.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use futures_util::stream::SplitSink;
use ghostlight_proto::Composite;
use ghostlight_proto::control::{CompositeRequest, Hello, Reply, State, Stats};
use tokio::sync::{mpsc, watch};
use tokio::time::{MissedTickBehavior, interval};

use super::close::{CloseReason, send, text};
use super::encode::Output;
use super::hub::SessionHandle;
use super::session::Session;
use super::socket::{Message, Socket, close_code};
use crate::clock;

/// Arrival times of the frames whose composites were sent and not yet acknowledged, oldest first; never more than
/// the client's credits.
pub(super) type UnderWay = VecDeque<i64>;

/// How often counters are sent.
const STATS_PERIOD: Duration = Duration::from_secs(1);

/// The writing half of a connection.
pub(super) struct Outbound {
    session: Arc<Session>,
    queue: mpsc::Receiver<Reply>,
    state: watch::Receiver<Arc<State>>,
    composites: Option<Composites>,
    ended: watch::Receiver<Option<Arc<Output>>>,
    idle: Duration,
    sent: u64,
}

/// The stream of composites to one client.
struct Composites {
    planes: watch::Receiver<Option<CompositeRequest>>,
    output: watch::Receiver<Option<Arc<Output>>>,
    under_way: watch::Receiver<UnderWay>,
    credits: u32,
    /// The client requested other planes: the newest composite is sent again, with them.
    again: bool,
    /// Serial of the newest composite sent, or of the newest one when the client joined.
    seen: u64,
    dropped: u64,
}

impl Composites {
    /// Waits for a credit, then for a composite not sent yet. Cancel-safe.
    async fn next(&mut self) -> Result<Arc<Output>, watch::error::RecvError> {
        let credits = self.credits as usize;
        self.under_way.wait_for(|u| u.len() < credits).await?;
        loop {
            let newest = self.output.borrow_and_update().clone();
            if let Some(output) = newest.filter(|o| o.serial > self.seen || self.again) {
                return Ok(output);
            }
            tokio::select! {
                changed = self.output.changed() => changed?,
                changed = self.planes.changed() => {
                    changed?;
                    self.again = true;
                }
            }
        }
    }
}

impl Outbound {
    /// Sends the answers of `queue` and the session's composites.
    pub(super) fn new(
        handle: &SessionHandle,
        hello: &Hello,
        queue: mpsc::Receiver<Reply>,
        under_way: watch::Receiver<UnderWay>,
        idle: Duration,
    ) -> Self {
        let output = handle.session.output.clone();
        let mut state = handle.session.state.clone();
        state.mark_changed();
        // The newest composite is sent at once; earlier ones do not count as skipped.
        let newest = output.borrow().as_ref().map_or(0, |o| o.serial);
        Self {
            queue,
            state,
            composites: hello.composite.map(|_| Composites {
                planes: handle.planes(),
                again: false,
                seen: newest.saturating_sub(1),
                output,
                under_way,
                credits: hello.credits,
                dropped: 0,
            }),
            ended: handle.session.output.clone(),
            session: Arc::clone(&handle.session),
            idle,
            sent: 0,
        }
    }

    /// Sends until the session ends or the client does not read in time.
    pub(super) async fn run(
        &mut self,
        sink: &mut SplitSink<Socket, Message>,
        under_way: &watch::Sender<UnderWay>,
    ) -> Option<CloseReason> {
        let mut stats = interval(STATS_PERIOD);
        let mut ping = interval(self.idle / 3);
        for ticks in [&mut stats, &mut ping] {
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        }
        loop {
            let message = tokio::select! {
                biased;
                Some(reply) = self.queue.recv() => text(&reply),
                Ok(()) = self.state.changed() => {
                    let state = Arc::clone(&self.state.borrow_and_update());
                    text(&Reply::State(State::clone(&state)))
                }
                _ = stats.tick() => text(&Reply::Stats(self.stats())),
                _ = ping.tick() => Message::Ping(axum::body::Bytes::new()),
                Ok(output) = next_of(&mut self.composites) => {
                    match self.composite(sink, output, under_way).await {
                        Ok(()) => continue,
                        Err(close_reason) => return close_reason,
                    }
                }
                _ = closed(&mut self.ended) => {
                    return Some(CloseReason::new(close_code::AWAY, self.session.end_reason()));
                }
            };
            if send(sink, message, self.idle).await.is_err() {
                return None;
            }
        }
    }

    async fn composite(
        &mut self,
        sink: &mut SplitSink<Socket, Message>,
        output: Arc<Output>,
        under_way: &watch::Sender<UnderWay>,
    ) -> Result<(), Option<CloseReason>> {
        let Some(composites) = &mut self.composites else {
            return Ok(());
        };
        let Some(request) = *composites.planes.borrow_and_update() else {
            return Ok(());
        };
        under_way.send_modify(|u| u.push_back(output.stamps.received_ns));
        let metrics = self.session.metrics();
        let missed = output.serial.saturating_sub(composites.seen + 1);
        composites.dropped += missed;
        composites.seen = output.serial;
        composites.again = false;
        metrics.composites_dropped.inc_by(missed);
        let dropped = composites.dropped;
        let encoded = tokio::task::spawn_blocking(move || output.message(&request, dropped)).await;
        let (mut message, mut stamps) = match encoded {
            Ok(Ok(encoded)) => encoded,
            Ok(Err(error)) => {
                tracing::error!(session = self.session.id, %error, "composite");
                return Err(Some(CloseReason::after(&error)));
            }
            Err(error) => {
                tracing::error!(session = self.session.id, %error, "composite");
                return Err(Some(CloseReason::new(close_code::ERROR, "encoding failed")));
            }
        };
        let bytes = message.len();
        stamps.sent_ns = clock::now_ns();
        Composite::stamp_sent(&mut message, stamps.sent_ns);
        if send(sink, Message::binary(message), self.idle)
            .await
            .is_err()
        {
            return Err(None);
        }
        self.sent += 1;
        metrics.sent(&stamps, clock::now_ns(), bytes);
        Ok(())
    }

    /// Sends the queued answers that the client accepts without waiting.
    pub(super) async fn flush(&mut self, sink: &mut SplitSink<Socket, Message>) {
        while let Ok(reply) = self.queue.try_recv() {
            if send(sink, text(&reply), Duration::from_secs(1))
                .await
                .is_err()
            {
                return;
            }
        }
    }

    fn stats(&self) -> Stats {
        Stats {
            composites_sent: self.sent,
            composites_dropped: self.composites.as_ref().map_or(0, |c| c.dropped),
            ..self.session.stats()
        }
    }
}

/// The next composite; pending forever for a client that wants none.
async fn next_of(
    composites: &mut Option<Composites>,
) -> Result<Arc<Output>, watch::error::RecvError> {
    match composites {
        Some(composites) => composites.next().await,
        None => std::future::pending().await,
    }
}

/// Waits until the render thread has ended.
async fn closed(output: &mut watch::Receiver<Option<Arc<Output>>>) {
    while output.changed().await.is_ok() {}
}
