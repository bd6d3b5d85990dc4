//! Listens, and stops without losing a frame.

use std::future::Future;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use futures_util::future::join_all;
use tokio::net::TcpListener;
use tokio::time::timeout;
use tokio_rustls::TlsAcceptor;

use crate::output::end_signal;

use super::accept::accept;
use super::catalog::Catalog;
use super::config::ServeConfig;
use super::hub::Hub;

/// Longest time to stop: for the current frames and the close handshake with every client.
const STOP: Duration = Duration::from_secs(10);

/// The server warns of a token with fewer characters.
const SHORT_TOKEN: usize = 8;

/// A server that listens but does not serve yet.
pub struct Server {
    /// Never empty.
    listeners: Vec<TcpListener>,
    tls: Option<TlsAcceptor>,
    hub: Arc<Hub>,
}

impl Server {
    /// Binds the address.
    pub async fn bind(config: ServeConfig, catalog: Arc<dyn Catalog>) -> Result<Self> {
        config.check()?;
        let tls = config.tls.acceptor()?;
        if config.token.as_ref().is_some_and(|t| t.len() < SHORT_TOKEN) {
            tracing::warn!("token: shorter than {SHORT_TOKEN} characters, which can be guessed");
        }
        Ok(Self {
            listeners: config.listen.bind().await?,
            tls,
            hub: Hub::new(config, catalog),
        })
    }

    /// URL for a browser on this machine.
    pub fn url(&self) -> Result<String> {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        Ok(format!("{scheme}://{}", self.address()?))
    }

    /// The address taken.
    pub fn address(&self) -> Result<SocketAddr> {
        let first = self.listeners.first().context("listen: no address")?;
        Ok(first.local_addr()?)
    }

    /// Serves until `stop` resolves, then finishes the frames in flight, closes every client with a reason and
    /// returns. `hurry` cuts that short.
    pub async fn run(
        self,
        stop: impl Future<Output = ()> + Send + 'static,
        hurry: impl Future<Output = ()>,
    ) -> Result<()> {
        let Self {
            listeners,
            tls,
            hub,
        } = self;
        let accepting = listeners
            .iter()
            .map(|listener| accept(listener, tls.clone(), &hub));
        tokio::pin!(hurry);
        tokio::select! {
            _ = join_all(accepting) => {}
            () = stop => {}
            () = &mut hurry => return Ok(()),
        }
        drop(listeners);
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

/// A request to stop: Ctrl-C, SIGTERM or SIGHUP.
pub(super) async fn stop_signal() {
    end_signal().await;
}
