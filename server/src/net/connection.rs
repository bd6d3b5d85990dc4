//! One client: its messages in, composites and answers out.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message, WebSocket, close_code};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use ghostlight_proto::control::{Bye, ErrorReport, Hello, Reply, Request, Role, Welcome};
use ghostlight_proto::{Code, WireError};
use tokio::sync::{mpsc, watch};
use tokio::time::timeout;

use super::clock;
use super::hub::{Hub, Seat};
use super::inbound::Inbound;
use super::metrics::{count, uncount};
use super::outbound::{Outbound, UnderWay};
use crate::render::Stage;

/// Answers that may wait for the socket. A client that sends without reading is not read
/// either once they are full.
const MAX_ANSWERS: usize = 64;

/// How long a close waits for the other side's.
const LINGER: Duration = Duration::from_secs(2);

/// Why a connection ends, as its close frame says.
pub(super) struct Ending {
    /// WebSocket close code.
    pub(super) code: u16,
    /// For people.
    pub(super) reason: String,
}

impl Ending {
    /// With one of the codes that the format lists.
    pub(super) fn new(code: u16, reason: impl Into<String>) -> Self {
        Self {
            code,
            reason: reason.into(),
        }
    }

    /// After an error that ends the connection.
    pub(super) fn after(error: &WireError) -> Self {
        let code = match error.code {
            Code::Version => close_code::PROTOCOL,
            Code::TooLarge => close_code::SIZE,
            Code::Limit => close_code::AGAIN,
            _ => close_code::POLICY,
        };
        Self::new(code, error.to_string())
    }
}

/// A place among the connections that a server allows; given back when dropped.
pub(super) struct Place(Arc<Hub>);

impl Place {
    /// Unless all are taken.
    pub(super) fn take(hub: &Arc<Hub>) -> Option<Self> {
        let bound = hub.config.bounds.connections;
        let taken = hub.n_connections.send_if_modified(|n| {
            let free = *n < bound;
            *n += usize::from(free);
            free
        });
        taken.then(|| {
            count(&hub.metrics.connections);
            Self(Arc::clone(hub))
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        uncount(&self.0.metrics.connections);
        self.0.n_connections.send_modify(|n| *n -= 1);
    }
}

/// Serves a client until it leaves or is closed.
pub(super) async fn serve(place: Place, socket: WebSocket) {
    let hub = Arc::clone(&place.0);
    let (mut sink, mut stream) = socket.split();
    let ending = match greet(&hub, &mut stream).await {
        Ok((hello, seat)) => converse(&hub, hello, seat, &mut sink, &mut stream).await,
        Err(Some(error)) => {
            hub.metrics.error(error.code);
            let ending = Ending::after(&error);
            let report = Reply::Error(ErrorReport::new(error, None, None, true));
            let _ = send(&mut sink, text(&report), LINGER).await;
            Some(ending)
        }
        Err(None) => None,
    };
    if let Some(ending) = ending {
        close(sink, stream, ending).await;
    }
}

/// Waits for the hello and finds the client its session. `Err(None)`: the client is gone.
async fn greet(
    hub: &Arc<Hub>,
    stream: &mut SplitStream<WebSocket>,
) -> Result<(Hello, Seat), Option<WireError>> {
    let refuse = |got: &str| Some(WireError::new(Code::Hello, "first message", "a hello", got));
    let mut stopping = hub.stopping.subscribe();
    let first = async {
        loop {
            match stream.next().await {
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                other => return other,
            }
        }
    };
    let message = tokio::select! {
        message = timeout(hub.config.bounds.hello, first) => message,
        _ = stopping.wait_for(|&s| s) => {
            let error = WireError::new(Code::Limit, "connection", "a server that runs", "one that stops");
            return Err(Some(error));
        }
    };
    let text = match message {
        Err(_) => return Err(refuse("nothing in time")),
        Ok(Some(Ok(Message::Text(text)))) if text.len() <= hub.config.bounds.scene_bytes => text,
        Ok(Some(Ok(Message::Text(_)))) => return Err(refuse("a text message too large for one")),
        Ok(Some(Ok(Message::Binary(_)))) => return Err(refuse("a binary message")),
        Ok(Some(Err(error))) => return Err(unreadable(hub, &error)),
        Ok(_) => return Err(None),
    };
    let hello = match Request::parse(&text).1? {
        Request::Hello(hello) => hello,
        other => return Err(refuse(other.kind())),
    };
    let bound = hub.config.bounds.credits;
    if hello.credits > bound {
        let error = WireError::new(
            Code::Limit,
            "hello, credits",
            format_args!("1 to {bound}"),
            hello.credits,
        );
        return Err(Some(error));
    }
    let (hub, asked) = (Arc::clone(hub), hello.clone());
    let seat = tokio::task::spawn_blocking(move || hub.join(&asked))
        .await
        .map_err(|e| Some(WireError::new(Code::Internal, "hello", "a session", e)))??;
    Ok((hello, seat))
}

/// Both directions, until one ends. `None`: the client is gone, there is nobody to close.
async fn converse(
    hub: &Arc<Hub>,
    hello: Hello,
    seat: Seat,
    sink: &mut SplitSink<WebSocket, Message>,
    stream: &mut SplitStream<WebSocket>,
) -> Option<Ending> {
    let bounds = &hub.config.bounds;
    let (answers, queue) = mpsc::channel(MAX_ANSWERS);
    let under_way = watch::Sender::new(UnderWay::new());
    let welcome = Reply::Welcome(Welcome {
        version: u64::from(ghostlight_proto::VERSION),
        revision: ghostlight_proto::REVISION,
        server: concat!("ghostlight ", env!("CARGO_PKG_VERSION")).to_owned(),
        session: seat.session.id.clone(),
        role: hello.role,
        control: seat.control,
        credits: hello.credits,
        clock_us: clock::now_us(),
        stages: Stage::ALL.iter().map(|s| s.name().to_owned()).collect(),
        limits: bounds.limits(),
    });
    tracing::info!(session = seat.session.id, role = ?hello.role, name = hello.name, "joined");
    if send(sink, text(&welcome), bounds.idle).await.is_err() {
        return None;
    }
    if seat.is_owner() {
        seat.session.set_owner_reply(answers.clone());
    }
    let mut outbound = Outbound::new(&seat, &hello, queue, under_way.subscribe(), bounds.idle);
    let mut inbound = Inbound::new(
        hub,
        &seat,
        hello.role == Role::Producer,
        answers,
        &under_way,
    );
    let ending = tokio::select! {
        ending = outbound.run(sink, &under_way) => ending,
        ending = inbound.run(stream) => ending,
    };
    if seat.is_owner() {
        // Not only after the last words: whatever it renders now is for nobody.
        seat.session.stop("the session's owner left");
    }
    if ending.is_some() {
        // An error that ends the connection may still wait in the queue.
        outbound.flush(sink).await;
    }
    tracing::info!(
        session = seat.session.id,
        reason = ending.as_ref().map(|e| e.reason.as_str()),
        "left"
    );
    ending
}

/// What a failed read is answered with: the transport refuses messages more than twice as large
/// as allowed, and text that is none. After anything else there is nobody left to answer.
pub(super) fn unreadable(hub: &Hub, error: &axum::Error) -> Option<WireError> {
    use tokio_tungstenite::tungstenite::Error as Transport;
    let source = std::error::Error::source(error)?;
    match source.downcast_ref::<Transport>()? {
        Transport::Capacity(_) => Some(WireError::new(
            Code::TooLarge,
            "message",
            format_args!("at most {} bytes", hub.config.bounds.message_bytes),
            error,
        )),
        Transport::Utf8(_) => Some(WireError::new(
            Code::Malformed,
            "text message",
            "UTF-8",
            "other bytes",
        )),
        _ => None,
    }
}

/// A control message.
pub(super) fn text(reply: &Reply) -> Message {
    Message::text(reply.to_text())
}

/// Sends one message; a client that does not take it in time is as good as gone.
pub(super) async fn send(
    sink: &mut SplitSink<WebSocket, Message>,
    message: Message,
    patience: Duration,
) -> Result<(), ()> {
    match timeout(patience, sink.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) | Err(_) => Err(()),
    }
}

/// Says why, closes, and gives the client time to read it: closing the socket with unread data
/// would reset it, and the reason would be lost.
async fn close(
    mut sink: SplitSink<WebSocket, Message>,
    mut stream: SplitStream<WebSocket>,
    ending: Ending,
) {
    let bye = Reply::Bye(Bye {
        reason: ending.reason.clone(),
    });
    if send(&mut sink, text(&bye), LINGER).await.is_err() {
        return;
    }
    let mut reason = ending.reason;
    // A close frame holds at most 125 bytes, two of them the code.
    let mut end = reason.len().min(123);
    while !reason.is_char_boundary(end) {
        end -= 1;
    }
    reason.truncate(end);
    let frame = CloseFrame {
        code: ending.code,
        reason: reason.into(),
    };
    if send(&mut sink, Message::Close(Some(frame)), LINGER)
        .await
        .is_err()
    {
        return;
    }
    if ending.code == close_code::SIZE {
        // Within a message that is not read nothing after it can be: only time is left.
        tokio::time::sleep(LINGER).await;
        return;
    }
    let answered = async { while let Some(Ok(_)) = stream.next().await {} };
    let _ = timeout(LINGER, answered).await;
}
