//! HTTP routes and access control.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use axum::extract::{Extension, Path, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Router, http};
use ghostlight_proto::SUBPROTOCOL;
use serde_json::json;

use super::connection::serve;
use super::door::Ticket;
use super::hub::Hub;
use super::metrics::{CONTENT_TYPE, Turned};
use super::origin::{host_allowed, origin_allowed, page_policy};
use super::{page, socket};

type Shared = State<Arc<Hub>>;

/// The client that sent a request.
type From = Extension<Arc<Ticket>>;

/// Longest host name repeated in an error message, characters.
const MAX_HOST: usize = 80;

/// The router with all routes.
pub(super) fn router(hub: Arc<Hub>) -> Router {
    Router::new()
        .route("/", get(index))
        .route("/client/{*path}", get(client_file))
        .route("/ws", get(websocket))
        .route("/healthz", get(|| async { "ok\n" }))
        .route("/readyz", get(ready))
        .route("/version", get(version))
        .route("/metrics", get(metrics))
        .route("/api/v1/recordings", get(recordings))
        .route("/api/v1/scenes", get(scenes))
        .route("/api/v1/sessions", get(sessions))
        .layer(from_fn_with_state(Arc::clone(&hub), under_own_name))
        .with_state(hub)
}

/// Refuses requests under host names that are not this server's.
async fn under_own_name(State(hub): Shared, request: Request, next: Next) -> Response {
    if let Err(host) = host_allowed(request.headers(), &hub.config) {
        hub.metrics.turned(Turned::Foreign);
        let host: String = host.chars().take(MAX_HOST).collect();
        let text = format!(
            "host: expected localhost or this machine's own address, got {host:?} \
             (--token or --allow-origin opens it to other names)\n"
        );
        return (StatusCode::MISDIRECTED_REQUEST, text).into_response();
    }
    next.run(request).await
}

async fn index(headers: HeaderMap) -> Response {
    client_file(Path("index.html".to_owned()), headers).await
}

async fn client_file(Path(path): Path<String>, headers: HeaderMap) -> Response {
    let policy = HeaderValue::try_from(page_policy(&headers))
        .unwrap_or(HeaderValue::from_static("default-src 'self'"));
    match page::file(&path) {
        Some((kind, bytes)) => (
            [
                (header::CONTENT_TYPE, HeaderValue::from_static(kind)),
                (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
                (header::CONTENT_SECURITY_POLICY, policy),
                (
                    header::X_CONTENT_TYPE_OPTIONS,
                    HeaderValue::from_static("nosniff"),
                ),
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

async fn metrics(State(hub): Shared, from: From, headers: HeaderMap) -> Response {
    if let Some(refused) = unauthorized(&hub, &from, &headers).await {
        return refused;
    }
    (
        [(header::CONTENT_TYPE, CONTENT_TYPE)],
        hub.metrics.to_text(),
    )
        .into_response()
}

async fn recordings(State(hub): Shared, from: From, headers: HeaderMap) -> Response {
    if let Some(refused) = unauthorized(&hub, &from, &headers).await {
        return refused;
    }
    axum::Json(hub.catalog.recordings()).into_response()
}

async fn scenes(State(hub): Shared, from: From, headers: HeaderMap) -> Response {
    if let Some(refused) = unauthorized(&hub, &from, &headers).await {
        return refused;
    }
    axum::Json(hub.catalog.scenes()).into_response()
}

async fn sessions(State(hub): Shared, from: From, headers: HeaderMap) -> Response {
    if let Some(refused) = unauthorized(&hub, &from, &headers).await {
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

async fn websocket(State(hub): Shared, from: From, mut request: Request) -> Response {
    if !origin_allowed(request.headers(), &hub.config) {
        hub.metrics.turned(Turned::Foreign);
        let text = "origin: expected this server's own page or one of --allow-origin\n";
        return (StatusCode::FORBIDDEN, text).into_response();
    }
    if *hub.stopping.borrow() {
        let retry = [(header::RETRY_AFTER, "5")];
        let text = "the server stops\n";
        return (StatusCode::SERVICE_UNAVAILABLE, retry, text).into_response();
    }
    if request.version() < http::Version::HTTP_11 {
        let text = "HTTP version: expected 1.1\n";
        return (StatusCode::BAD_REQUEST, text).into_response();
    }
    let answer = match socket::handshake(request.headers()) {
        Ok(answer) => answer,
        Err(refused) => return refused.into_response(),
    };
    let upgrade = hyper::upgrade::on(&mut request);
    let Extension(ticket) = from;
    tokio::spawn(async move {
        match upgrade.await {
            Ok(upgraded) => {
                let opened = socket::open(upgraded, &hub.config.bounds, &hub.room).await;
                serve(&hub, &ticket, opened).await;
            }
            Err(error) => tracing::debug!(%error, "upgrade"),
        }
    });
    answer
}

/// Refuses a request without the token, if there is one.
async fn unauthorized(
    hub: &Hub,
    Extension(ticket): &From,
    headers: &HeaderMap,
) -> Option<Response> {
    let given = headers
        .get(header::AUTHORIZATION)
        .and_then(|v| v.to_str().ok())
        .and_then(bearer);
    if hub.token_fits(given) {
        return None;
    }
    let text = match given {
        Some(_) => {
            tokio::time::sleep(hub.wrong_token(ticket.peer())).await;
            "token: expected the server's, got a wrong token\n"
        }
        None => "token: expected the server's (Authorization: Bearer ...), got none\n",
    };
    let challenge = [(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"))];
    Some((StatusCode::UNAUTHORIZED, challenge, text).into_response())
}

/// The token of an `Authorization` header. The scheme's name is compared in any case (RFC 9110,
/// section 11.1).
fn bearer(value: &str) -> Option<&str> {
    let (scheme, token) = value.trim().split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scheme_is_read_in_any_case() {
        for value in ["Bearer x", "bearer x", "BEARER   x ", " bEaReR x"] {
            assert_eq!(bearer(value), Some("x"), "{value}");
        }
        for value in ["Basic x", "Bearer", "Bearerx", "", "x"] {
            assert_eq!(bearer(value), None, "{value}");
        }
    }
}
