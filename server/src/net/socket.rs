//! A WebSocket on the server's side: its handshake, and the stream after it.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use ghostlight_proto::SUBPROTOCOL;
use hyper::upgrade::Upgraded;
use hyper_util::rt::TokioIo;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};

pub(super) use tokio_tungstenite::tungstenite::protocol::CloseFrame;
pub(super) use tokio_tungstenite::tungstenite::{Error as SocketError, Message};

use super::config::Bounds;
use super::unfinished::{Most, Room, Watched};

/// The close codes of the wire format and their meaning.
pub(super) mod close_code {
    pub(in super::super) const NORMAL: u16 = 1000;
    pub(in super::super) const AWAY: u16 = 1001;
    pub(in super::super) const PROTOCOL: u16 = 1002;
    pub(in super::super) const INVALID: u16 = 1007;
    pub(in super::super) const POLICY: u16 = 1008;
    pub(in super::super) const SIZE: u16 = 1009;
    pub(in super::super) const ERROR: u16 = 1011;
    pub(in super::super) const AGAIN: u16 = 1013;
}

/// Longest reason of a close, bytes: a close frame holds 125, two of which are the code.
const MAX_REASON: usize = 123;

/// Buffer space beyond one composite while that is written, bytes.
const WRITE_SLACK: usize = 1 << 16;

/// Bytes read at a time; also the memory held by a silent client.
const READ_BUFFER: usize = 32 << 10;

/// An upgraded connection.
pub(super) type Socket = WebSocketStream<Watched<TokioIo<Upgraded>>>;

/// Truncates a reason to fit a close frame, at a character boundary.
pub(super) fn cut_reason(reason: &mut String) {
    let mut end = reason.len().min(MAX_REASON);
    while !reason.is_char_boundary(end) {
        end -= 1;
    }
    reason.truncate(end);
}

/// The stream after the handshake. Only messages of at most `hello_bytes` are read until `most` is raised.
pub(super) async fn open(upgraded: Upgraded, bounds: &Bounds, room: &Arc<Room>) -> (Socket, Most) {
    let most = Arc::new(AtomicU64::new(
        bounds.hello_bytes.min(bounds.scene_bytes) as u64
    ));
    let io = Watched::new(
        TokioIo::new(upgraded),
        room,
        bounds.message,
        Arc::clone(&most),
    );
    let config = WebSocketConfig::default()
        // Messages of up to twice the limit are read, so that they can be answered with an error.
        .max_message_size(Some(2 * bounds.message_bytes))
        .max_frame_size(Some(2 * bounds.message_bytes))
        .read_buffer_size(READ_BUFFER)
        // Every message is flushed before the next; the buffer holds one composite.
        .write_buffer_size(0)
        .max_write_buffer_size(bounds.composite_bytes() + WRITE_SLACK);
    let socket = WebSocketStream::from_raw_socket(io, Role::Server, Some(config)).await;
    (socket, most)
}

/// The response that completes the handshake (RFC 6455, section 4.2), or the refusal.
pub(super) fn handshake(headers: &HeaderMap) -> Result<Response, (StatusCode, String)> {
    let refuse = |text: String| Err((StatusCode::BAD_REQUEST, text));
    let has = |name: &HeaderName, wanted: &str| {
        headers
            .get_all(name)
            .iter()
            .filter_map(|v| v.to_str().ok())
            .flat_map(|v| v.split(','))
            .any(|item| item.trim().eq_ignore_ascii_case(wanted))
    };
    if !has(&header::CONNECTION, "upgrade") || !has(&header::UPGRADE, "websocket") {
        return refuse("request: expected an upgrade to a WebSocket\n".to_owned());
    }
    if !has(&header::SEC_WEBSOCKET_VERSION, "13") {
        return refuse("WebSocket version: expected 13\n".to_owned());
    }
    let Some(key) = headers.get(header::SEC_WEBSOCKET_KEY) else {
        return refuse("Sec-WebSocket-Key: expected one, got none\n".to_owned());
    };
    // Names of subprotocols are compared exactly.
    let offered = headers
        .get_all(header::SEC_WEBSOCKET_PROTOCOL)
        .iter()
        .filter_map(|v| v.to_str().ok())
        .flat_map(|v| v.split(','))
        .any(|item| item.trim() == SUBPROTOCOL);
    if !offered {
        return refuse(format!(
            "subprotocol: expected {SUBPROTOCOL} to be offered\n"
        ));
    }
    let accept = HeaderValue::from_str(&derive_accept_key(key.as_bytes()))
        .map_err(|e| (StatusCode::INTERNAL_SERVER_ERROR, e.to_string()))?;
    let fields = [
        (header::CONNECTION, HeaderValue::from_static("upgrade")),
        (header::UPGRADE, HeaderValue::from_static("websocket")),
        (header::SEC_WEBSOCKET_ACCEPT, accept),
        (
            header::SEC_WEBSOCKET_PROTOCOL,
            HeaderValue::from_static(SUBPROTOCOL),
        ),
    ];
    Ok((StatusCode::SWITCHING_PROTOCOLS, fields).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(fields: &[(&'static str, &'static str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in fields {
            headers.append(*name, HeaderValue::from_static(value));
        }
        headers
    }

    #[test]
    fn handshakes_are_answered_as_the_standard_has_it() {
        let good = [
            ("connection", "keep-alive, Upgrade"),
            ("upgrade", "WebSocket"),
            ("sec-websocket-version", "13"),
            ("sec-websocket-key", "dGhlIHNhbXBsZSBub25jZQ=="),
            ("sec-websocket-protocol", "other, ghostlight.v1"),
        ];
        let answer = handshake(&headers(&good)).unwrap();
        assert_eq!(answer.status(), 101);
        assert_eq!(
            answer.headers()["sec-websocket-accept"],
            "s3pPLMBiTxaQ9kYGzzhZRbK+xOo="
        );
        // Each header is needed.
        for i in 0..good.len() {
            let mut less = good.to_vec();
            less.remove(i);
            assert_eq!(handshake(&headers(&less)).unwrap_err().0, 400);
        }
    }

    #[test]
    fn reasons_are_cut_between_characters() {
        let mut reason = "é".repeat(100);
        cut_reason(&mut reason);
        assert_eq!(reason, "é".repeat(61));
        let mut short = "bye".to_owned();
        cut_reason(&mut short);
        assert_eq!(short, "bye");
    }
}
