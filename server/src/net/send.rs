//! A client over the network: plays a recording to a server and measures the composites that it returns. A lost
//! connection is replaced, and the run continues.

use std::time::Duration;

use anyhow::{Context, Result};
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep, sleep_until, timeout};

use super::send_client::{Busy, Client, Ended, PATIENCE};
use super::send_config::{Rate, SendConfig};
use super::send_report::SendReport;
use super::send_scene::{self, Package};
use super::send_source::{self, Prepared};
use super::send_tally::Tally;
use super::server::stop_signal;
use crate::clock;

/// Frames in flight at [`Rate::Max`]: one is rendered while the next is sent.
const WINDOW: usize = 2;

/// Delay before the first reconnection attempt; each further one doubles it.
const FIRST_WAIT: Duration = Duration::from_millis(250);

/// Longest delay before a reconnection attempt.
const MAX_WAIT: Duration = Duration::from_secs(5);

/// A run and how it ended.
#[derive(Debug)]
pub struct SendRun {
    /// The measurements up to the end of the run.
    pub report: SendReport,
    /// Why it ended before everything was sent; [`Stopped`] after a stop signal.
    pub result: Result<()>,
}

/// The process got a stop signal, Ctrl-C or SIGTERM.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("stopped by a signal")]
pub struct Stopped;

/// Plays a recording to a server, until all is sent, the connection is lost for good, or the process gets a stop
/// signal. Fails if the run cannot begin.
pub fn send(config: &SendConfig) -> Result<SendRun> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("starting")?;
    runtime.block_on(play(config))
}

async fn play(config: &SendConfig) -> Result<SendRun> {
    let mut run = Run::open(config)?;
    let result = tokio::select! {
        result = run.drive() => result,
        () = stop_signal() => Err(Stopped.into()),
    };
    if let Some(client) = run.client.take() {
        let reason = match &result {
            Ok(()) => "all frames sent",
            Err(_) => "the sender stops",
        };
        client.part(reason).await;
    }
    let ended = result.as_ref().err().map(|error| format!("{error:#}"));
    Ok(SendRun {
        report: run.tally.report(config, ended),
        result,
    })
}

/// State that outlives a connection.
struct Run<'a> {
    config: &'a SendConfig,
    package: Option<Package>,
    frames: mpsc::Receiver<Result<Prepared>>,
    /// The next frame to send.
    pending: Option<Prepared>,
    client: Option<Client>,
    tally: Tally,
    /// When the recording's first frame was due; postponed by each time without a connection.
    start: Instant,
    end: Option<Instant>,
}

impl<'a> Run<'a> {
    fn open(config: &'a SendConfig) -> Result<Self> {
        let rounds = match config.duration {
            Some(_) => u64::MAX,
            None => 1,
        };
        let start = Instant::now();
        let mut package = config
            .scene
            .as_deref()
            .map(send_scene::package)
            .transpose()?;
        if let (Some(package), true) = (&mut package, config.settings.is_some()) {
            // Settings of the command line override the scene's own.
            package.document.remove("settings");
        }
        Ok(Self {
            package,
            frames: send_source::frames(&config.recording, &config.open, rounds, config.quality)?,
            config,
            pending: None,
            client: None,
            tally: Tally::default(),
            start,
            end: None,
        })
    }

    async fn drive(&mut self) -> Result<()> {
        let mut tries = 0;
        match self.connect().await {
            Ok(()) => {}
            // The server is full: worth another attempt.
            Err(Ended::Lost(error)) if error.is::<Busy>() => {
                self.reconnect(error, &mut tries).await?;
            }
            // A wrong address is reported at once.
            Err(ended) => return Err(ended.into_error()),
        }
        self.start = Instant::now();
        self.end = self.config.duration.map(|d| self.start + d);
        self.tally.start_ns = clock::now_ns();
        loop {
            let before = self.tally.composites;
            let lost = match self.converse().await {
                Ok(()) => return Ok(()),
                Err(Ended::Refused(error)) => return Err(error),
                Err(Ended::Lost(error)) => error,
            };
            let down = Instant::now();
            self.client = None;
            self.tally.session_over();
            if self.tally.composites > before {
                tries = 0;
            }
            self.reconnect(lost, &mut tries).await?;
            self.start += down.elapsed();
            self.tally.reconnects += 1;
        }
    }

    async fn connect(&mut self) -> Result<(), Ended> {
        let package = self.package.as_ref();
        let client = Client::connect(self.config, package, &mut self.tally).await?;
        self.client = Some(client);
        Ok(())
    }

    /// Tries to reconnect; fails with the reason of the loss.
    async fn reconnect(&mut self, lost: anyhow::Error, tries: &mut u32) -> Result<()> {
        self.tally.note(format!("no connection: {lost:#}"));
        let mut newest = None;
        loop {
            let late = self.end.is_some_and(|end| Instant::now() >= end);
            if *tries >= self.config.retries || late {
                return Err(match newest {
                    Some(newest) => {
                        let newest: anyhow::Error = newest;
                        anyhow::anyhow!("{lost:#}; then, {tries} tries later: {newest:#}")
                    }
                    None => lost,
                });
            }
            let wait = FIRST_WAIT.saturating_mul(1 << (*tries).min(10));
            sleep(wait.min(MAX_WAIT)).await;
            *tries += 1;
            match self.connect().await {
                Ok(()) => return Ok(()),
                Err(Ended::Refused(error)) => return Err(error),
                Err(Ended::Lost(error)) => newest = Some(error),
            }
        }
    }

    /// Sends until no frame is left or the time is over, then receives the last composites.
    async fn converse(&mut self) -> Result<(), Ended> {
        let Some(client) = &mut self.client else {
            return Err(Ended::Lost(anyhow::anyhow!("no connection")));
        };
        let tally = &mut self.tally;
        loop {
            if self.pending.is_none() {
                // Composites that arrive while a frame is encoded are received at once, so that their
                // latency does not include the encoding.
                self.pending = loop {
                    tokio::select! {
                        frame = self.frames.recv() => {
                            break frame.transpose().map_err(Ended::Refused)?;
                        }
                        message = client.next() => client.take(message?, tally).await?,
                    }
                };
            }
            let Some(frame) = &self.pending else { break };
            let due = match self.config.rate {
                Rate::Realtime => Some(self.start + Duration::from_nanos(frame.due_ns as u64)),
                Rate::Max => None,
            };
            if self
                .end
                .is_some_and(|end| due.unwrap_or_else(Instant::now) >= end)
            {
                break;
            }
            let free = match due {
                Some(due) => {
                    tokio::select! {
                        () = sleep_until(due) => true,
                        message = client.next() => {
                            client.take(message?, tally).await?;
                            false
                        }
                    }
                }
                None if tally.under_way.len() < WINDOW => true,
                None => {
                    let message = timeout(PATIENCE, client.next()).await.map_err(|_| {
                        Ended::Lost(anyhow::anyhow!("no composite arrived in time"))
                    })?;
                    client.take(message?, tally).await?;
                    false
                }
            };
            if free && let Some(frame) = self.pending.take() {
                client.send_frame(&frame.message, tally).await?;
            }
        }
        match client.drain(tally).await {
            // Everything was sent, so there is no reason to reconnect.
            Err(Ended::Lost(error)) => Err(Ended::Refused(error)),
            drained => drained,
        }
    }
}
