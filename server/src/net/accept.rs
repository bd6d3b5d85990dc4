//! Accepts connections: TLS if configured, then HTTP, within the limits of [`super::door`].
//!
//! Accepting never waits for a connection: each is a task of its own, with a place in the pool and a
//! deadline.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::Request;
use axum::response::Response;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::Service;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{sleep, timeout};
use tokio_rustls::TlsAcceptor;

use super::door::Ticket;
use super::hub::Hub;
use super::metrics::Turned;
use super::routes;

/// Largest request head, and largest buffered part of a response, bytes.
const MAX_BUFFER: usize = 16 << 10;

/// Pause after the listener returns an error, for example when the process has no file handle left.
const RETRY: Duration = Duration::from_millis(50);

/// Time to finish the current response when a connection is to be closed.
const GRACE: Duration = Duration::from_secs(2);

/// Accepts connections forever.
pub(super) async fn accept(listener: &TcpListener, tls: Option<TlsAcceptor>, hub: &Arc<Hub>) {
    let router = routes::router(Arc::clone(hub));
    loop {
        let (tcp, address) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::debug!(%error, "accept");
                sleep(RETRY).await;
                continue;
            }
        };
        // Composites are written whole: Nagle's algorithm would only delay them.
        if let Err(error) = tcp.set_nodelay(true) {
            tracing::debug!(%error, "TCP_NODELAY");
        }
        let ticket = hub.door.take(address.ip());
        let (hub, tls, router) = (Arc::clone(hub), tls.clone(), router.clone());
        tokio::spawn(async move {
            let served = connection(&hub, tcp, tls, router, &ticket);
            tokio::select! {
                () = ticket.dropped() => {}
                () = served => {}
            }
        });
    }
}

async fn connection(
    hub: &Arc<Hub>,
    tcp: TcpStream,
    tls: Option<TlsAcceptor>,
    router: Router,
    ticket: &Arc<Ticket>,
) {
    let Some(tls) = tls else {
        return http(hub, tcp, router, ticket).await;
    };
    let mut stopping = hub.stopping.subscribe();
    let shaken = tokio::select! {
        shaken = timeout(hub.config.bounds.handshake, tls.accept(tcp)) => shaken,
        _ = stopping.wait_for(|&s| s) => return,
    };
    match shaken {
        Ok(Ok(stream)) => http(hub, stream, router, ticket).await,
        Ok(Err(error)) => tracing::debug!(%error, "TLS handshake"),
        Err(_) => hub.metrics.turned(Turned::TimedOut),
    }
}

/// Serves the HTTP requests of one connection, until it ends or becomes a WebSocket.
async fn http<S>(hub: &Arc<Hub>, stream: S, router: Router, ticket: &Arc<Ticket>)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let bounds = &hub.config.bounds;
    let answers = Answers {
        router: TowerToHyperService::new(router),
        ticket: Arc::clone(ticket),
    };
    let serving = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(bounds.handshake)
        .max_buf_size(MAX_BUFFER)
        .serve_connection(TokioIo::new(stream), answers)
        .with_upgrades();
    tokio::pin!(serving);
    let mut stopping = hub.stopping.subscribe();
    let ended = tokio::select! {
        ended = serving.as_mut() => Some(ended),
        () = sleep(bounds.request) => None,
        _ = stopping.wait_for(|&s| s) => None,
    };
    let ended = match ended {
        Some(ended) => ended,
        None => {
            serving.as_mut().graceful_shutdown();
            match timeout(GRACE, serving).await {
                Ok(ended) => ended,
                Err(_) => return hub.metrics.turned(Turned::TimedOut),
            }
        }
    };
    if let Err(error) = ended {
        if error.is_timeout() {
            hub.metrics.turned(Turned::TimedOut);
        }
        tracing::debug!(%error, "connection");
    }
}

/// The routes, with the client's address and ticket in each request.
struct Answers {
    router: TowerToHyperService<Router>,
    ticket: Arc<Ticket>,
}

impl Service<Request<Incoming>> for Answers {
    type Response = Response;
    type Error = std::convert::Infallible;
    type Future = <TowerToHyperService<Router> as Service<Request<Body>>>::Future;

    fn call(&self, request: Request<Incoming>) -> Self::Future {
        self.ticket.renew();
        let mut request = request.map(Body::new);
        request.extensions_mut().insert(Arc::clone(&self.ticket));
        self.router.call(request)
    }
}
