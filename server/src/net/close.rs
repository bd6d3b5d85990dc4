//! Closing a connection: the reason sent to the client, and a close handshake that lets the client read it.

use std::time::Duration;

use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use ghostlight_proto::control::{Bye, Reply};
use ghostlight_proto::{Code, WireError};
use tokio::io::AsyncReadExt;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::error::ProtocolError;

use super::hub::Hub;
use super::metrics::Turned;
use super::socket::{self, CloseFrame, Message, Socket, SocketError, close_code};
use super::unfinished::Fault;

/// How long the server waits for the client's close frame.
pub(super) const LINGER: Duration = Duration::from_secs(2);

/// Buffer for data that is read only to be discarded, bytes.
const WASTE: usize = 16 << 10;

/// Why a connection ends, as sent in its close frame.
pub(super) struct CloseReason {
    /// WebSocket close code.
    pub(super) code: u16,
    /// Text for people.
    pub(super) reason: String,
    /// The client's stream is corrupt: message boundaries are lost.
    pub(super) broken: bool,
}

impl CloseReason {
    /// With one of the close codes of `proto/README.md`. The reason is truncated to fit a close frame.
    pub(super) fn new(code: u16, reason: impl Into<String>) -> Self {
        let mut reason = reason.into();
        socket::cut_reason(&mut reason);
        Self {
            code,
            reason,
            broken: false,
        }
    }

    pub(super) fn into_frame(self) -> CloseFrame {
        CloseFrame {
            code: self.code.into(),
            reason: self.reason.into(),
        }
    }

    /// The close reason for an error that ends the connection.
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

/// The fault for which [`super::unfinished`] stopped reading, if that is the cause of the error.
pub(super) fn fault_of(error: &SocketError) -> Option<Fault> {
    match error {
        SocketError::Io(error) => error.get_ref()?.downcast_ref().copied(),
        _ => None,
    }
}

/// The error and close reason that answer a failed read. `None`: the client is gone.
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

/// Sends one message; a client that does not accept it in time is treated as disconnected.
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

/// Sends the reason and a close frame, then keeps reading for [`LINGER`]: closing a socket with unread data
/// resets the connection, and the client would never read the reason.
pub(super) async fn close(
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
        // Discarded: this may be the rest of the refused message.
        let Ok(socket) = sink.reunite(stream) else {
            return;
        };
        let mut bytes = socket.into_inner().into_inner();
        let mut waste = vec![0; WASTE];
        while matches!(bytes.read(&mut waste).await, Ok(1..)) {}
    };
    let _ = timeout(LINGER, last_words).await;
}

/// Reads until the client's close frame. Returns false if a message cannot be read.
async fn all_read(stream: &mut SplitStream<Socket>) -> bool {
    loop {
        match stream.next().await {
            Some(Ok(_)) => {}
            Some(Err(_)) => return false,
            None => return true,
        }
    }
}
