//! The service: RGB-D frames in over WebSocket, composites out. The wire format is in
//! `proto/README.md`.
//!
//! ```text
//! accept -> door (before the hello)
//! socket -> inbound -> session (newest frame) -> render thread -> session (newest composite)
//!        <- outbound (credit, newest, encode) <-----------------------------------'
//! ```
//!
//! Everything that a client can make grow has a bound in [`Bounds`]. Rendering never runs on a
//! thread that serves sockets; encoding runs on the runtime's threads for blocking work.

mod accept;
pub mod args;
mod camera;
mod catalog;
mod close;
mod config;
mod connection;
mod decode;
mod door;
mod encode;
mod fair;
mod frame_watch;
mod hub;
mod inbound;
mod library;
mod listen;
mod loaders;
mod metrics;
mod origin;
mod outbound;
mod page;
mod peek;
mod player;
mod rate;
mod render_thread;
mod routes;
mod scene_load;
mod send;
mod send_client;
mod send_config;
mod send_report;
mod send_scene;
mod send_source;
mod send_tally;
mod server;
mod session;
mod session_scene;
mod socket;
mod tls;
mod unfinished;
mod upload_folder;
mod wrong_tokens;

pub use catalog::{
    Assets, Catalog, EncodedFrame, RecordingInfo, SceneInfo, SceneLoad, SceneRenderer, Unrendered,
};
pub use config::{Bounds, ServeConfig};
pub use library::Library;
pub use listen::Listen;
pub use send::{SendRun, Stopped, send};
pub use send_config::{ControlFlag, Rate, SendConfig};
pub use send_report::{Percentiles, SendReport};
pub use server::Server;
pub use tls::TlsFiles;

use std::io::IsTerminal;
use std::sync::Arc;

use anyhow::{Context, Result};
use tracing_subscriber::EnvFilter;

use crate::output;

/// Serves until SIGTERM or Ctrl-C; a second signal ends it at once. Prints the address when it listens.
pub fn serve(config: ServeConfig) -> Result<()> {
    config.check()?;
    log()?;
    upload_folder::remove_left_behind();
    let library = Library::open(&config)?;
    let library = Arc::new(library);
    let runtime = tokio::runtime::Runtime::new().context("starting threads")?;
    let served = runtime.block_on(async {
        let server = Server::bind(config, library.clone()).await?;
        library.describe();
        // A closed stdout does not stop the server.
        let _ = output::print(format_args!("listening on {}", server.url()?));
        let (first, second) = (signals(1), signals(2));
        server.run(first, second).await
    });
    // The sockets are closed; a render thread that is still busy must not delay the exit.
    runtime.shutdown_background();
    upload_folder::remove_own();
    served
}

/// Logs to stderr, at the level that `RUST_LOG` sets.
fn log() -> Result<()> {
    let filter = match std::env::var("RUST_LOG") {
        Ok(text) if !text.trim().is_empty() => EnvFilter::try_new(&text)
            .with_context(|| format!("RUST_LOG: expected a level or a filter, got {text:?}"))?,
        _ => EnvFilter::new("info"),
    };
    // Fails if the process has installed its own logger, which then stays.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        // Otherwise it panics when stderr is closed.
        .log_internal_errors(false)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .try_init();
    Ok(())
}

/// Waits for `n` stop signals.
async fn signals(n: usize) {
    for _ in 0..n {
        server::stop_signal().await;
    }
}
