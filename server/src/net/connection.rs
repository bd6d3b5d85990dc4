//! One client's connection: handshake, reading and writing, close.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use futures_util::StreamExt;
use futures_util::stream::{SplitSink, SplitStream};
use ghostlight_proto::control::{ErrorReport, Hello, Reply, Request, Role, Welcome};
use ghostlight_proto::{Code, WireError};
use tokio::sync::{mpsc, watch};
use tokio::time::{sleep, timeout};

use super::close::{CloseReason, LINGER, close, fault_of, send, text, unreadable};
use super::door::Ticket;
use super::hub::{Hub, SessionHandle};
use super::inbound::Inbound;
use super::metrics::Turned;
use super::outbound::{Outbound, UnderWay};
use super::socket::{Message, Socket, close_code};
use super::unfinished::{Fault, Most};
use crate::clock;
use crate::render::Stage;

/// Answers queued for the socket. While the queue is full, no further messages of the client are read.
const MAX_ANSWERS: usize = 64;

/// Time to send the close frame to a connection that was replaced by a newer one.
const AT_ONCE: Duration = Duration::from_millis(100);

/// Why the handshake failed.
enum NoHello {
    /// The client is gone, or is not to be answered.
    Gone,
    /// The connection was replaced by a newer one; it gets a close frame if it reads it at once.
    Dropped,
    /// The client gets the error and is closed.
    Refused(WireError, CloseReason),
}

impl NoHello {
    /// The same, but in the middle of a message, the rest of which is not read.
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
            let reason = "no hello yet, and a newer connection took the place";
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

/// Waits for the hello and joins or starts the requested session.
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
            let error = WireError::new(Code::Limit, "connection", "a running server", "one that is stopping");
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

/// The first message, which must be a hello with the right token.
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

/// Reads and writes until one of the two ends. `None`: the client is gone and there is nothing to close.
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
        // Before the close handshake, so that no further frame is rendered for nobody.
        handle.session.stop("the session's owner left");
    }
    if close_reason.is_some() {
        // The error that ends the connection may still be queued.
        outbound.flush(sink).await;
    }
    tracing::info!(
        session = handle.session.id,
        reason = close_reason.as_ref().map(|e| e.reason.as_str()),
        "left"
    );
    close_reason
}
