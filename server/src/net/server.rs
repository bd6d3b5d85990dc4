//! Listening, and stopping without losing a frame.

use std::future::Future;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use tokio::net::TcpListener;
use tokio::time::timeout;
use tokio_rustls::TlsAcceptor;

use super::accept::accept;
use super::backend::Backend;
use super::config::ServeConfig;
use super::hub::Hub;

/// Longest time to stop in: a frame, and a close that every client answers.
const STOP: Duration = Duration::from_secs(10);

/// A token of fewer characters is warned of.
const SHORT_TOKEN: usize = 8;

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
        if config.token.as_ref().is_some_and(|t| t.len() < SHORT_TOKEN) {
            tracing::warn!("token: shorter than {SHORT_TOKEN} characters, which can be guessed");
        }
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
        tokio::pin!(hurry);
        tokio::select! {
            () = accept(&listener, tls, &hub) => {}
            () = stop => {}
            () = &mut hurry => return Ok(()),
        }
        drop(listener);
        tracing::info!("stopping");
        hub.stop("the server stops");
        let mut open = hub.door.open();
        let all_gone = open.wait_for(|&n| n == 0);
        tokio::select! {
            // The channel lives as long as the hub, which is held here.
            _ = timeout(STOP, all_gone) => {}
            () = &mut hurry => {}
        }
        Ok(())
    }
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
