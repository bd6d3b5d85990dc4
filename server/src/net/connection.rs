//! One client: its messages in, composites and answers out.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use ghostlight_proto::control::{Bye, ErrorReport, Hello, Reply, Request, Role, Welcome};
use ghostlight_proto::{Code, WireError};
use tokio::io::AsyncReadExt;
use tokio::sync::{mpsc, watch};
use tokio::time::{sleep, timeout};
use tokio_tungstenite::tungstenite::error::ProtocolError;

use super::door::Ticket;
use super::hub::{Hub, SessionHandle};
use super::inbound::Inbound;
use super::metrics::Turned;
use super::outbound::{Outbound, UnderWay};
use super::socket::{self, CloseFrame, Message, Socket, SocketError, close_code};
use super::unfinished::{Fault, Most};
use crate::clock;
use crate::render::Stage;

/// Answers that may wait for the socket. A client that sends without reading is not read
/// either once they are full.
const MAX_ANSWERS: usize = 64;

/// How long a close waits for the other side's.
const LINGER: Duration = Duration::from_secs(2);

/// Time to take a close for a connection whose place is already another's.
const AT_ONCE: Duration = Duration::from_millis(100);

/// Bytes thrown away at a time.
const WASTE: usize = 16 << 10;

/// Why a connection ends, as its close frame says.
pub(super) struct CloseReason {
    /// WebSocket close code.
    pub(super) code: u16,
    /// For people.
    pub(super) reason: String,
    /// The client's messages cannot be told apart any more.
    broken: bool,
}

impl CloseReason {
    /// With one of the codes that the format lists. The reason is cut to what a close holds.
    pub(super) fn new(code: u16, reason: impl Into<String>) -> Self {
        let mut reason = reason.into();
        socket::cut_reason(&mut reason);
        Self {
            code,
            reason,
            broken: false,
        }
    }

    fn into_frame(self) -> CloseFrame {
        CloseFrame {
            code: self.code.into(),
            reason: self.reason.into(),
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

/// Why there is no conversation.
enum NoHello {
    /// The client is gone, or is owed no answer.
    Gone,
    /// It made room for another: it is told, if it takes it at once.
    Dropped,
    /// It is told, and closed.
    Refused(WireError, CloseReason),
}

impl NoHello {
    /// The same, within a message that is not read.
    fn unread(mut self) -> Self {
        if let Self::Refused(_, close_reason) = &mut self {
            close_reason.broken = true;
        }
        self
    }
}

impl From<WireError> for NoHello {
    fn from(error: WireError) -> Self {
        let close_reason = CloseReason::after(&error);
        Self::Refused(error, close_reason)
    }
}

/// Serves a client until it leaves or is closed.
pub(super) async fn serve(hub: &Arc<Hub>, ticket: &Ticket, (socket, most): (Socket, Most)) {
    let (mut sink, mut stream) = socket.split();
    let (answers, queue) = mpsc::channel(MAX_ANSWERS);
    let close_reason = match handshake(hub, ticket, &most, &answers, &mut stream).await {
        Ok((hello, handle)) => {
            let answers = (answers, queue);
            converse(hub, hello, handle, answers, &mut sink, &mut stream).await
        }
        Err(NoHello::Refused(error, close_reason)) => {
            hub.metrics.error(error.code);
            let report = Reply::Error(ErrorReport::new(error, None, None, true));
            let _ = send(&mut sink, text(&report), LINGER).await;
            Some(close_reason)
        }
        Err(NoHello::Dropped) => {
            let reason = "others waited for a place, and no hello had come";
            let frame = CloseReason::new(close_code::AGAIN, reason).into_frame();
            let _ = send(&mut sink, Message::Close(Some(frame)), AT_ONCE).await;
            None
        }
        Err(NoHello::Gone) => None,
    };
    if let Some(close_reason) = close_reason {
        tokio::select! {
            () = close(sink, stream, close_reason) => {}
            () = ticket.dropped() => {}
        }
    }
}

/// Waits for the hello and finds the client its session.
async fn handshake(
    hub: &Arc<Hub>,
    ticket: &Ticket,
    most: &Most,
    answers: &mpsc::Sender<Reply>,
    stream: &mut SplitStream<Socket>,
) -> Result<(Hello, SessionHandle), NoHello> {
    let mut stopping = hub.stopping.subscribe();
    let (id, hello) = tokio::select! {
        hello = first_message(hub, ticket, stream) => hello?,
        () = ticket.dropped() => return Err(NoHello::Dropped),
        _ = stopping.wait_for(|&s| s) => {
            let error = WireError::new(Code::Limit, "connection", "a server that runs", "one that stops");
            return Err(error.into());
        }
    };
    let bound = hub.config.bounds.credits;
    if hello.credits > bound {
        let error = WireError::new(
            Code::Limit,
            "hello, credits",
            format_args!("1 to {bound}"),
            hello.credits,
        );
        return Err(error.into());
    }
    if !ticket.enter() {
        let bound = hub.config.bounds.connections;
        let expected = format_args!("at most {bound}");
        return Err(WireError::new(Code::Limit, "clients", expected, "one more").into());
    }
    most.store(u64::MAX, Ordering::Relaxed);
    let asker = (id, answers.clone());
    let (hub, asked) = (Arc::clone(hub), hello.clone());
    let handle = tokio::task::spawn_blocking(move || hub.join(&asked, asker))
        .await
        .map_err(|e| WireError::new(Code::Internal, "hello", "a session", e))??;
    Ok((hello, handle))
}

/// The hello, with the right token.
async fn first_message(
    hub: &Hub,
    ticket: &Ticket,
    stream: &mut SplitStream<Socket>,
) -> Result<(Option<u64>, Hello), NoHello> {
    let refuse =
        |got: &str| Err(WireError::new(Code::Hello, "first message", "a hello", got).into());
    let first = async {
        loop {
            match stream.next().await {
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                other => return other,
            }
        }
    };
    let text = match timeout(hub.config.bounds.hello, first).await {
        Err(_) => {
            hub.metrics.turned(Turned::TimedOut);
            return refuse("nothing in time");
        }
        Ok(Some(Ok(Message::Text(text)))) => text,
        Ok(Some(Ok(Message::Binary(_)))) => return refuse("a binary message"),
        Ok(Some(Err(error))) if fault_of(&error) == Some(Fault::Large) => {
            let refused = refuse("a message too large for one");
            return refused.map_err(NoHello::unread);
        }
        Ok(Some(Err(error))) => {
            let refused =
                unreadable(hub, &error).map(|(e, close_reason)| NoHello::Refused(e, close_reason));
            return Err(refused.unwrap_or(NoHello::Gone));
        }
        Ok(_) => return Err(NoHello::Gone),
    };
    let (id, request) = Request::parse(&text);
    let hello = match request? {
        Request::Hello(hello) => hello,
        other => return refuse(other.kind()),
    };
    if !hub.token_fits(hello.token.as_deref()) {
        let got = match &hello.token {
            Some(_) => {
                sleep(hub.wrong_token(ticket.peer())).await;
                "a wrong token"
            }
            None => "none",
        };
        let what = "hello, token";
        let expected = "the server's token";
        return Err(WireError::new(Code::Unauthorized, what, expected, got).into());
    }
    Ok((id, hello))
}

/// Both directions, until one ends. `None`: the client is gone, there is nobody to close.
async fn converse(
    hub: &Arc<Hub>,
    hello: Hello,
    handle: SessionHandle,
    (answers, queue): (mpsc::Sender<Reply>, mpsc::Receiver<Reply>),
    sink: &mut SplitSink<Socket, Message>,
    stream: &mut SplitStream<Socket>,
) -> Option<CloseReason> {
    let bounds = &hub.config.bounds;
    let under_way = watch::Sender::new(UnderWay::new());
    let welcome = Reply::Welcome(Welcome {
        version: u64::from(ghostlight_proto::VERSION),
        revision: ghostlight_proto::REVISION,
        server: concat!("ghostlight ", env!("CARGO_PKG_VERSION")).to_owned(),
        session: handle.session.id.clone(),
        role: hello.role,
        control: handle.control,
        credits: hello.credits,
        clock_us: clock::now_us(),
        stages: Stage::ALL.iter().map(|s| s.name().to_owned()).collect(),
        limits: bounds.limits(),
    });
    tracing::info!(session = handle.session.id, role = ?hello.role, name = hello.name, "joined");
    if send(sink, text(&welcome), bounds.idle).await.is_err() {
        return None;
    }
    if handle.is_owner() {
        handle.session.set_owner_reply(answers.clone());
    }
    let mut outbound = Outbound::new(&handle, &hello, queue, under_way.subscribe(), bounds.idle);
    let mut inbound = Inbound::new(
        hub,
        &handle,
        hello.role == Role::Producer,
        answers,
        &under_way,
    );
    let close_reason = tokio::select! {
        close_reason = outbound.run(sink, &under_way) => close_reason,
        close_reason = inbound.run(stream) => close_reason,
    };
    if handle.is_owner() {
        // Not only after the last words: whatever it renders now is for nobody.
        handle.session.stop("the session's owner left");
    }
    if close_reason.is_some() {
        // An error that ends the connection may still wait in the queue.
        outbound.flush(sink).await;
    }
    tracing::info!(
        session = handle.session.id,
        reason = close_reason.as_ref().map(|e| e.reason.as_str()),
        "left"
    );
    close_reason
}

/// Why the watch over its messages ended a client's.
fn fault_of(error: &SocketError) -> Option<Fault> {
    match error {
        SocketError::Io(error) => error.get_ref()?.downcast_ref().copied(),
        _ => None,
    }
}

/// What a failed read is answered with: an error, and the close after it. `None`: the client is
/// gone, and there is nobody left to answer.
pub(super) fn unreadable(hub: &Hub, error: &SocketError) -> Option<(WireError, CloseReason)> {
    let bounds = &hub.config.bounds;
    let too_large = |got: &dyn std::fmt::Display| {
        let limit = bounds.message_bytes;
        let expected = format_args!("at most {limit} bytes");
        let error = WireError::new(Code::TooLarge, "message", expected, got);
        (close_code::SIZE, error)
    };
    let (code, error) = match error {
        SocketError::Capacity(error) => too_large(error),
        SocketError::Utf8(_) => {
            hub.metrics.turned(Turned::Protocol);
            let error = WireError::new(Code::Malformed, "text message", "UTF-8", "other bytes");
            (close_code::INVALID, error)
        }
        SocketError::Protocol(
            ProtocolError::ResetWithoutClosingHandshake
            | ProtocolError::ReceivedAfterClosing
            | ProtocolError::SendAfterClosing,
        ) => return None,
        SocketError::Protocol(error) => {
            hub.metrics.turned(Turned::Protocol);
            let error = WireError::new(Code::Malformed, "frame", "a WebSocket's (RFC 6455)", error);
            (close_code::PROTOCOL, error)
        }
        other => match fault_of(other)? {
            Fault::Large => too_large(&Fault::Large),
            Fault::Slow => {
                hub.metrics.turned(Turned::SlowMessage);
                let expected = format_args!("its end within {} s", bounds.message.as_secs_f64());
                let error = WireError::new(Code::Limit, "message", expected, "a part of it");
                (close_code::POLICY, error)
            }
            Fault::Full => {
                hub.metrics.turned(Turned::Unfinished);
                let limit = bounds.unfinished_bytes;
                let expected = format_args!("at most {limit} bytes, of all clients");
                let error = WireError::new(Code::Limit, "unfinished messages", expected, "more");
                (close_code::AGAIN, error)
            }
        },
    };
    let mut close_reason = CloseReason::new(code, error.to_string());
    close_reason.broken = true;
    Some((error, close_reason))
}

/// A control message.
pub(super) fn text(reply: &Reply) -> Message {
    Message::text(reply.to_text())
}

/// Sends one message; a client that does not take it in time is as good as gone.
pub(super) async fn send(
    sink: &mut SplitSink<Socket, Message>,
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
    mut sink: SplitSink<Socket, Message>,
    mut stream: SplitStream<Socket>,
    close_reason: CloseReason,
) {
    let bye = Reply::Bye(Bye {
        reason: close_reason.reason.clone(),
    });
    if send(&mut sink, text(&bye), LINGER).await.is_err() {
        return;
    }
    let broken = close_reason.broken;
    let frame = Message::Close(Some(close_reason.into_frame()));
    if send(&mut sink, frame, LINGER).await.is_err() {
        return;
    }
    let last_words = async {
        if !broken && all_read(&mut stream).await {
            return;
        }
        // What still comes is thrown away: it may be the rest of what was refused.
        let Ok(socket) = sink.reunite(stream) else {
            return;
        };
        let mut bytes = socket.into_inner().into_inner();
        let mut waste = vec![0; WASTE];
        while matches!(bytes.read(&mut waste).await, Ok(1..)) {}
    };
    let _ = timeout(LINGER, last_words).await;
}

/// Reads up to the client's own close; false if something comes that cannot be read.
async fn all_read(stream: &mut SplitStream<Socket>) -> bool {
    loop {
        match stream.next().await {
            Some(Ok(_)) => {}
            Some(Err(_)) => return false,
            None => return true,
        }
    }
}
