//! Listening, and stopping without losing a frame.

use std::future::Future;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use axum::serve::{Listener, ListenerExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;
use tokio_rustls::TlsAcceptor;

use super::backend::Backend;
use super::config::ServeConfig;
use super::hub::Hub;
use super::routes;
use super::tls::TlsListener;

/// Longest time to stop in: a frame, and a close that every client answers.
const STOP: Duration = Duration::from_secs(10);

/// A server that listens but does not serve yet.
pub struct Server {
    listener: TcpListener,
    tls: Option<TlsAcceptor>,
    hub: Arc<Hub>,
}

impl Server {
    /// Takes the address.
    pub async fn bind(config: ServeConfig, backend: Arc<dyn Backend>) -> Result<Self> {
        config.check()?;
        let tls = config.tls.acceptor()?;
        let listener = TcpListener::bind(config.listen)
            .await
            .with_context(|| format!("listen {}", config.listen))?;
        Ok(Self {
            listener,
            tls,
            hub: Hub::new(config, backend),
        })
    }

    /// Where a browser finds it.
    pub fn url(&self) -> Result<String> {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        Ok(format!("{scheme}://{}", self.address()?))
    }

    /// The address taken.
    pub fn address(&self) -> Result<SocketAddr> {
        Ok(self.listener.local_addr()?)
    }

    /// Serves until `stop` is done, then finishes the frames in flight, closes every client
    /// with a reason and returns. `hurry` cuts that short.
    pub async fn run(
        self,
        stop: impl Future<Output = ()> + Send + 'static,
        hurry: impl Future<Output = ()>,
    ) -> Result<()> {
        let Self { listener, tls, hub } = self;
        match tls {
            Some(acceptor) => {
                let listener = TlsListener::new(listener, acceptor);
                serve_on(listener, hub, stop, hurry).await
            }
            None => {
                let listener = listener.tap_io(|tcp| set_nodelay(tcp));
                serve_on(listener, hub, stop, hurry).await
            }
        }
    }
}

/// Composites are written whole; waiting for more to send would only delay them.
pub(super) fn set_nodelay(tcp: &TcpStream) {
    if let Err(error) = tcp.set_nodelay(true) {
        tracing::debug!(%error, "TCP_NODELAY");
    }
}

async fn serve_on<L>(
    listener: L,
    hub: Arc<Hub>,
    stop: impl Future<Output = ()> + Send + 'static,
    hurry: impl Future<Output = ()>,
) -> Result<()>
where
    L: Listener,
    L::Addr: std::fmt::Debug,
{
    let router = routes::router(Arc::clone(&hub));
    let stopping = Arc::clone(&hub);
    let serving = axum::serve(listener, router).with_graceful_shutdown(async move {
        stop.await;
        tracing::info!("stopping");
        stopping.stop("the server stops");
    });
    let mut stopped = hub.stopping.subscribe();
    let mut connections = hub.n_connections.subscribe();
    let winding_down = async {
        // The channels live as long as the hub, which is held here.
        let _ = stopped.wait_for(|&s| s).await;
        let _ = timeout(STOP, connections.wait_for(|&n| n == 0)).await;
    };
    tokio::pin!(hurry, winding_down);
    let serving = async move { serving.await };
    tokio::pin!(serving);
    tokio::select! {
        result = &mut serving => {
            result.context("serving")?;
            // Ordinary requests are done; WebSockets go on until they are closed.
            tokio::select! { () = &mut winding_down => {} () = &mut hurry => {} }
        }
        () = &mut winding_down => {}
        () = &mut hurry => {}
    }
    Ok(())
}

/// The first request to stop: SIGTERM or Ctrl-C.
pub(super) async fn stop_signal() {
    let interrupt = async {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    #[cfg(unix)]
    let terminate = async {
        match tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) {
            Ok(mut signal) => {
                signal.recv().await;
            }
            Err(_) => std::future::pending().await,
        }
    };
    #[cfg(not(unix))]
    let terminate = std::future::pending::<()>();
    tokio::select! { () = interrupt => {} () = terminate => {} }
}
