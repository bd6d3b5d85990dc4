//! The service: RGB-D frames in over WebSocket, composites out. The wire format is in
//! `proto/README.md`.
//!
//! ```text
//! socket -> inbound -> session (newest frame) -> render thread -> session (newest composite)
//!        <- outbound (credit, newest, encode) <-----------------------------------'
//! ```
//!
//! Everything that a client can make grow has a bound in [`Bounds`]. Rendering never runs on a
//! thread that serves sockets; encoding runs on the runtime's threads for blocking work.

pub mod args;
mod backend;
mod clock;
mod config;
mod connection;
mod decode;
mod encode;
mod hub;
mod inbound;
mod library;
mod metrics;
mod outbound;
mod page;
mod player;
mod render_thread;
mod routes;
mod scene_room;
mod send;
mod send_report;
mod send_scene;
mod send_source;
mod server;
mod session;

pub use backend::{Assets, Backend, FrameSource, RecordingInfo, SceneInfo, SceneRenderer};
pub use config::{Bounds, ServeConfig};
pub use library::Library;
pub use send::{Rate, SendConfig, send};
pub use send_report::{Percentiles, SendReport};
pub use server::Server;

use std::sync::Arc;

use anyhow::{Context, Result};

/// Serves until SIGTERM or Ctrl-C; a second one ends it at once. Prints the address when it
/// listens.
pub fn serve(config: ServeConfig) -> Result<()> {
    config.check()?;
    let library = Library::open(&config)?;
    let runtime = tokio::runtime::Runtime::new().context("starting threads")?;
    runtime.block_on(async {
        let server = Server::bind(config, Arc::new(library)).await?;
        println!("listening on http://{}", server.address()?);
        let (first, second) = (signals(1), signals(2));
        server.run(first, second).await
    })?;
    // Sockets are closed; a render thread that is still busy must not hold the exit.
    runtime.shutdown_background();
    Ok(())
}

/// Waits for so many requests to stop.
async fn signals(n: usize) {
    for _ in 0..n {
        server::stop_signal().await;
    }
}
