//! A client over the network: plays a recording to a server and measures what comes back. A
//! connection that is lost is replaced, and the run goes on.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result};
use ghostlight_proto::control::Control;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep, sleep_until, timeout};

use super::send_client::{Busy, Client, Ended, PATIENCE};
use super::send_report::SendReport;
use super::send_scene::{self, Package};
use super::send_source::{self, Prepared};
use super::send_tally::Tally;
use super::server::stop_signal;
use crate::clock;
use crate::recording::OpenOptions;
use crate::render::RenderSettings;

/// Frames under way at [`Rate::Max`]: one is rendered while the next is on its way.
const WINDOW: usize = 2;

/// Wait before the first try to connect again; every further one doubles it.
const FIRST_WAIT: Duration = Duration::from_millis(250);

/// Longest wait before a try.
const MAX_WAIT: Duration = Duration::from_secs(5);

/// How fast frames are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum Rate {
    /// At the recording's rate, whether the server keeps up or not.
    #[default]
    Realtime,
    /// As soon as the server has answered an earlier frame.
    Max,
}

/// Who may change what is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum ControlFlag {
    /// The sender alone.
    #[default]
    Owner,
    /// Its viewers too.
    Anyone,
}

impl From<ControlFlag> for Control {
    fn from(flag: ControlFlag) -> Self {
        match flag {
            ControlFlag::Owner => Self::Owner,
            ControlFlag::Anyone => Self::Anyone,
        }
    }
}

/// What to send, and where.
#[derive(Debug, Clone)]
pub struct SendConfig {
    /// Recording, of any layout that can be read.
    pub recording: PathBuf,
    /// How to read it.
    pub open: OpenOptions,
    /// `ws://host:port/ws`, or `wss://`.
    pub url: String,
    /// Certificate that signs a `wss://` server's; the system's if not given.
    pub ca: Option<PathBuf>,
    /// How fast.
    pub rate: Rate,
    /// The server's token.
    pub token: Option<String>,
    /// Who may change what is shown.
    pub control: ControlFlag,
    /// Scene document to upload with its meshes, or a mesh.
    pub scene: Option<PathBuf>,
    /// Name of a scene of the server's.
    pub server_scene: Option<String>,
    /// Render settings; the server's own if not given.
    pub settings: Option<RenderSettings>,
    /// Stop after this time; until then the recording is repeated. Once over if not given.
    pub duration: Option<Duration>,
    /// JPEG quality of the colour sent, 1..=100.
    pub quality: u8,
    /// Tries to connect again after a connection was lost; composites in between start the
    /// count anew.
    pub retries: u32,
}

impl SendConfig {
    /// Tries to connect again unless told otherwise: eight seconds of them.
    pub const RETRIES: u32 = 5;

    /// A recording once, at its own rate, without a scene.
    pub fn new(recording: PathBuf, url: String) -> Self {
        Self {
            recording,
            open: OpenOptions::default(),
            url,
            ca: None,
            rate: Rate::Realtime,
            token: None,
            control: ControlFlag::Owner,
            scene: None,
            server_scene: None,
            settings: None,
            duration: None,
            quality: 90,
            retries: Self::RETRIES,
        }
    }
}

/// A run, whatever came of it.
#[derive(Debug)]
pub struct SendRun {
    /// What was measured until its end.
    pub report: SendReport,
    /// Why it ended, if not because all was sent; [`Stopped`] if it was told to.
    pub result: Result<()>,
}

/// The process was told to stop, by Ctrl-C or SIGTERM.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("stopped by a signal")]
pub struct Stopped;

/// Plays a recording to a server, until all is sent, the server is gone for good, or the
/// process is told to stop. An error: it could not begin.
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

/// What outlives a connection.
struct Run<'a> {
    config: &'a SendConfig,
    package: Option<Package>,
    frames: mpsc::Receiver<Result<Prepared>>,
    /// The frame to be sent next.
    pending: Option<Prepared>,
    client: Option<Client>,
    tally: Tally,
    /// When the recording's first frame was due; later by every time without a connection.
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
            // Those of the command line win over the scene's own.
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
            // A server is there, and had no place.
            Err(Ended::Lost(error)) if error.is::<Busy>() => {
                self.reconnect(error, &mut tries).await?;
            }
            // An address that is wrong is told at once.
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

    /// Tries until a connection stands; gives up with the reason of the loss.
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

    /// Sends until nothing is left or the time is over, and takes the last composites.
    async fn converse(&mut self) -> Result<(), Ended> {
        let Some(client) = &mut self.client else {
            return Err(Ended::Lost(anyhow::anyhow!("no connection")));
        };
        let tally = &mut self.tally;
        loop {
            if self.pending.is_none() {
                // Composites that arrive while a frame is being encoded are taken at once, or
                // their latency would include it.
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
                        Ended::Lost(anyhow::anyhow!("waiting for a composite: none came"))
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
            // Everything was sent: another connection would have nothing to do.
            Err(Ended::Lost(error)) => Err(Ended::Refused(error)),
            drained => drained,
        }
    }
}
