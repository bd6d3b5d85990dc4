//! What is served, and to whom.

use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use axum::Router;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use ghostlight_proto::SUBPROTOCOL;
use serde_json::json;

use super::connection::{Place, serve};
use super::hub::Hub;
use super::page;

type Shared = State<Arc<Hub>>;

/// All routes.
pub(super) fn router(hub: Arc<Hub>) -> Router {
    Router::new()
        .route("/", get(|| client_file(Path("index.html".to_owned()))))
        .route("/client/{*path}", get(client_file))
        .route("/ws", get(websocket))
        .route("/healthz", get(|| async { "ok\n" }))
        .route("/readyz", get(ready))
        .route("/version", get(version))
        .route("/metrics", get(metrics))
        .route("/api/v1/recordings", get(recordings))
        .route("/api/v1/scenes", get(scenes))
        .route("/api/v1/sessions", get(sessions))
        .with_state(hub)
}

async fn client_file(Path(path): Path<String>) -> Response {
    /// Scripts only from here; pictures also from memory, where the decoder puts them.
    const POLICY: &str = "default-src 'self'; connect-src 'self' ws: wss:; \
        img-src 'self' blob: data:; worker-src 'self' blob:; base-uri 'none'; frame-ancestors 'none'";
    match page::file(&path) {
        Some((kind, bytes)) => (
            [
                (header::CONTENT_TYPE, kind),
                (header::CACHE_CONTROL, "no-cache"),
                (header::CONTENT_SECURITY_POLICY, POLICY),
                (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
            ],
            bytes,
        )
            .into_response(),
        None => (StatusCode::NOT_FOUND, "no such file\n").into_response(),
    }
}

async fn ready(State(hub): Shared) -> Response {
    if *hub.stopping.borrow() {
        return (StatusCode::SERVICE_UNAVAILABLE, "stopping\n").into_response();
    }
    "ready\n".into_response()
}

async fn version() -> Response {
    axum::Json(json!({
        "name": "ghostlight",
        "version": env!("CARGO_PKG_VERSION"),
        "subprotocol": SUBPROTOCOL,
    }))
    .into_response()
}

async fn metrics(State(hub): Shared, headers: HeaderMap) -> Response {
    if let Some(refused) = unauthorized(&hub, &headers) {
        return refused;
    }
    (
        [(
            header::CONTENT_TYPE,
            "text/plain; version=0.0.4; charset=utf-8",
        )],
        hub.metrics.to_text(),
    )
        .into_response()
}

async fn recordings(State(hub): Shared, headers: HeaderMap) -> Response {
    unauthorized(&hub, &headers)
        .unwrap_or_else(|| axum::Json(hub.backend.recordings()).into_response())
}

async fn scenes(State(hub): Shared, headers: HeaderMap) -> Response {
    unauthorized(&hub, &headers).unwrap_or_else(|| axum::Json(hub.backend.scenes()).into_response())
}

async fn sessions(State(hub): Shared, headers: HeaderMap) -> Response {
    if let Some(refused) = unauthorized(&hub, &headers) {
        return refused;
    }
    let list: Vec<_> = hub
        .list()
        .iter()
        .map(|session| {
            let state = session.state.borrow();
            json!({
                "session": session.id,
                "source": state.source,
                "scene": state.scene,
                "viewers": session.counters.viewers.load(Ordering::Relaxed),
            })
        })
        .collect();
    axum::Json(list).into_response()
}

async fn websocket(State(hub): Shared, headers: HeaderMap, upgrade: WebSocketUpgrade) -> Response {
    if !origin_allowed(&headers, &hub.config.origins, hub.config.listen.ip()) {
        let text = "origin: expected this server's own page or one of --allow-origin\n";
        return (StatusCode::FORBIDDEN, text).into_response();
    }
    let offered = upgrade
        .requested_protocols()
        .any(|p| p.as_bytes() == SUBPROTOCOL.as_bytes());
    if !offered {
        let text = format!("subprotocol: expected {SUBPROTOCOL} to be offered\n");
        return (StatusCode::BAD_REQUEST, text).into_response();
    }
    let place = match Place::take(&hub) {
        Some(place) if !*hub.stopping.borrow() => place,
        _ => {
            let retry = [(header::RETRY_AFTER, "5")];
            let text = "connections: all taken, or the server stops\n";
            return (StatusCode::SERVICE_UNAVAILABLE, retry, text).into_response();
        }
    };
    let bounds = &hub.config.bounds;
    let largest = bounds.composite_bytes();
    upgrade
        .protocols([SUBPROTOCOL])
        // Up to twice the limit is read, so that it can be answered.
        .max_message_size(2 * bounds.message_bytes)
        .max_frame_size(2 * bounds.message_bytes)
        // Every message is flushed before the next; the buffer holds one composite.
        .write_buffer_size(0)
        .max_write_buffer_size(largest + (1 << 16))
        .on_upgrade(move |socket| serve(place, socket))
}

/// Refuses a request without the token, if there is one.
fn unauthorized(hub: &Hub, headers: &HeaderMap) -> Option<Response> {
    let given = headers
        .get(header::AUTHORIZATION)
        .and_then(|v| v.to_str().ok())
        .and_then(|v| v.strip_prefix("Bearer "));
    if hub.token_fits(given) {
        return None;
    }
    let challenge = [(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"))];
    Some(
        (
            StatusCode::UNAUTHORIZED,
            challenge,
            "token: expected the server's\n",
        )
            .into_response(),
    )
}

/// Browsers send the page's origin, and let any page try: only the server's own pages may
/// connect. What is not a browser sends none. A server on this machine must also be addressed
/// as such, or a foreign name that resolves to it would pass for its own.
fn origin_allowed(headers: &HeaderMap, allowed: &[String], listen: IpAddr) -> bool {
    let text = |name: HeaderName| headers.get(name).map(|v| v.to_str().unwrap_or(""));
    let Some(origin) = text(header::ORIGIN) else {
        return true;
    };
    if allowed.iter().any(|a| a == "*" || a == origin) {
        return true;
    }
    let Some(host) = text(header::HOST) else {
        return false;
    };
    let authority = origin.split_once("://").map(|(_, authority)| authority);
    if authority != Some(host) {
        return false;
    }
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    };
    let here = name == "localhost"
        || name
            .trim_matches(['[', ']'])
            .parse::<IpAddr>()
            .is_ok_and(|ip| ip.is_loopback());
    here || !listen.is_loopback()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_servers_own_pages_connect() {
        let local = IpAddr::from([127, 0, 0, 1]);
        let public = IpAddr::from([0, 0, 0, 0]);
        for (origin, host, listen, expected) in [
            (None, "127.0.0.1:8080", local, true),
            (Some("http://127.0.0.1:8080"), "127.0.0.1:8080", local, true),
            (Some("http://localhost:8080"), "localhost:8080", local, true),
            (Some("http://[::1]:8080"), "[::1]:8080", local, true),
            (Some("http://evil.example"), "127.0.0.1:8080", local, false),
            // A foreign name that resolves here.
            (
                Some("http://evil.example:8080"),
                "evil.example:8080",
                local,
                false,
            ),
            (Some("http://ghost.example"), "ghost.example", public, true),
            (
                Some("http://ghost.example:81"),
                "ghost.example",
                public,
                false,
            ),
            (Some("null"), "127.0.0.1:8080", local, false),
            (Some("https://page.example"), "ghost.example", public, true),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, HeaderValue::from_static(host));
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, HeaderValue::from_static(origin));
            }
            let allowed = ["https://page.example".to_owned()];
            let got = origin_allowed(&headers, &allowed, listen);
            assert_eq!(got, expected, "{origin:?} to {host}");
        }
    }
}
