//! A client over the network: plays a recording to a server and measures what comes back.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use ghostlight_proto::control::{
    Asset, Bye, Control, Credit, Hello, Ping, Reply, Request, Role, SceneChoice, SetScene,
    SetSettings,
};
use ghostlight_proto::{AssetChunk, Code, Composite, SUBPROTOCOL};
use tokio::net::TcpStream;
use tokio::time::{Instant, sleep_until, timeout};
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{Bytes, Message};
use tokio_tungstenite::{
    Connector, MaybeTlsStream, WebSocketStream, connect_async_tls_with_config,
};

use super::clock;
use super::send_report::{Gathered, Percentiles, SendReport};
use super::send_scene;
use super::send_source::{self, Prepared};
use super::tls;
use crate::render::RenderSettings;

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

/// Longest wait for an answer, and for the composites of the last frames.
const PATIENCE: Duration = Duration::from_secs(10);

/// Frames under way at [`Rate::Max`]: one is rendered while the next is on its way.
const WINDOW: usize = 2;

/// Bytes of an upload per message.
const CHUNK: usize = 1 << 20;

/// Errors of the server kept for the report.
const MAX_ERRORS: usize = 10;

/// How fast frames are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum Rate {
    /// As they were captured, whether the server keeps up or not.
    #[default]
    Realtime,
    /// As soon as the server has answered an earlier one.
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
}

impl SendConfig {
    /// A recording once, at its own rate, without a scene.
    pub fn new(recording: PathBuf, url: String) -> Self {
        Self {
            recording,
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
        }
    }
}

/// Plays a recording to a server.
pub fn send(config: &SendConfig) -> Result<SendReport> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("starting")?;
    runtime.block_on(play(config))
}

async fn play(config: &SendConfig) -> Result<SendReport> {
    let rounds = if config.duration.is_some() {
        u64::MAX
    } else {
        1
    };
    let mut frames = send_source::frames(&config.recording, rounds, config.quality)?;
    let mut client = Client::connect(config).await?;
    client.prepare(config).await?;
    let start = Instant::now();
    let start_ns = clock::now_ns();
    let end = config.duration.map(|d| start + d);
    let mut pending: Option<Prepared> = None;
    let mut done = false;
    while !done {
        if pending.is_none() {
            // Composites that arrive while a frame is being encoded are taken at once, or
            // their latency would include it.
            pending = loop {
                tokio::select! {
                    frame = frames.recv() => break frame.transpose()?,
                    message = client.stream.next() => client.take(message).await?,
                }
            };
        }
        let Some(frame) = &pending else { break };
        let due = match config.rate {
            Rate::Realtime => Some(start + Duration::from_nanos(frame.due_ns as u64)),
            Rate::Max => None,
        };
        done = match (end, due) {
            (Some(end), Some(due)) => due >= end,
            (Some(end), None) => Instant::now() >= end,
            (None, _) => false,
        };
        if done {
            break;
        }
        let free = match due {
            Some(due) => {
                tokio::select! {
                    () = sleep_until(due) => true,
                    message = client.stream.next() => {
                        client.take(message).await?;
                        false
                    }
                }
            }
            None if client.under_way.len() < WINDOW => true,
            None => {
                let message = timeout(PATIENCE, client.stream.next()).await;
                client
                    .take(message.context("waiting for a composite")?)
                    .await?;
                false
            }
        };
        if free && let Some(frame) = pending.take() {
            client.send_frame(&frame.message).await?;
        }
    }
    client.drain().await?;
    let seconds = (client.last_ns.max(start_ns) - start_ns) as f64 * 1e-9;
    Ok(client.report(config, seconds))
}

struct Client {
    sink: SplitSink<Socket, Message>,
    stream: SplitStream<Socket>,
    stages: Vec<String>,
    /// The server's clock less this one.
    offset_ns: i64,
    next: u64,
    /// Capture times of frames not heard of yet, by number.
    under_way: BTreeMap<u64, i64>,
    gathered: Gathered,
    last_ns: i64,
    frames_dropped: u64,
    composites_dropped: u64,
    refused: u64,
    composites: u64,
    bytes_up: u64,
    bytes_down: u64,
    errors: Vec<String>,
}

impl Client {
    async fn connect(config: &SendConfig) -> Result<Self> {
        let url = || config.url.clone();
        let request = ClientRequestBuilder::new(config.url.parse().with_context(url)?)
            .with_sub_protocol(SUBPROTOCOL);
        let limits = WebSocketConfig::default()
            .max_message_size(Some(256 << 20))
            .max_frame_size(Some(256 << 20));
        if config.ca.is_some() && !config.url.starts_with("wss://") {
            bail!("--ca: expected a wss:// address, got {}", config.url);
        }
        let connector = match &config.ca {
            Some(ca) => Some(Connector::Rustls(Arc::new(tls::trusting(ca)?))),
            None => None,
        };
        let (socket, _) = timeout(
            PATIENCE,
            connect_async_tls_with_config(request, Some(limits), true, connector),
        )
        .await
        .with_context(url)?
        .with_context(url)?;
        let (sink, stream) = socket.split();
        let mut client = Self {
            sink,
            stream,
            stages: Vec::new(),
            offset_ns: 0,
            next: 0,
            under_way: BTreeMap::new(),
            gathered: Gathered::default(),
            last_ns: 0,
            frames_dropped: 0,
            composites_dropped: 0,
            refused: 0,
            composites: 0,
            bytes_up: 0,
            bytes_down: 0,
            errors: Vec::new(),
        };
        let mut hello = Hello::new(Role::Producer);
        hello.token.clone_from(&config.token);
        hello.name = "ghostlight send".to_owned();
        hello.scene.clone_from(&config.server_scene);
        hello.control = config.control.into();
        client.request(&Request::Hello(hello), None).await?;
        match client.reply().await? {
            Reply::Welcome(welcome) => client.stages = welcome.stages,
            Reply::Error(e) if e.code == Code::Unauthorized => match config.token {
                Some(_) => bail!("{}: wrong token", config.url),
                None => bail!(
                    "{}: this server wants a token: --token or GHOSTLIGHT_TOKEN",
                    config.url
                ),
            },
            Reply::Error(e) => bail!("{}: expected {}, got {}", e.what, e.expected, e.got),
            other => bail!("hello: expected a welcome, got {}", other.to_text()),
        }
        client.match_clocks().await?;
        Ok(client)
    }

    async fn request(&mut self, request: &Request, id: Option<u64>) -> Result<()> {
        self.sink.send(Message::text(request.to_text(id))).await?;
        Ok(())
    }

    /// The next control message; for before the first frame.
    async fn reply(&mut self) -> Result<Reply> {
        loop {
            let message = timeout(PATIENCE, self.stream.next()).await;
            match message.context("waiting for an answer")? {
                Some(Ok(Message::Text(text))) => return Ok(Reply::parse(&text)?),
                Some(Ok(Message::Close(frame))) => bail!("the server closed: {frame:?}"),
                Some(Ok(_)) => {}
                Some(Err(error)) => return Err(error.into()),
                None => bail!("the server closed the connection"),
            }
        }
    }

    /// Waits for the answer to a request.
    async fn answered(&mut self, id: u64) -> Result<()> {
        loop {
            match self.reply().await? {
                Reply::Done(done) if done.id == Some(id) => return Ok(()),
                Reply::Error(e) => bail!("{}: expected {}, got {}", e.what, e.expected, e.got),
                Reply::Bye(bye) => bail!("the server closed: {}", bye.reason),
                _ => {}
            }
        }
    }

    /// The ping with the shortest round trip tells best.
    async fn match_clocks(&mut self) -> Result<()> {
        let mut best = i64::MAX;
        for _ in 0..8 {
            let sent = clock::now_ns();
            self.request(&Request::Ping(Ping { t: 0.0 }), None).await?;
            let pong = loop {
                if let Reply::Pong(pong) = self.reply().await? {
                    break pong;
                }
            };
            let received = clock::now_ns();
            if received - sent < best {
                best = received - sent;
                // The server's clock is cut to microseconds: half of one is missing on average.
                self.offset_ns = pong.clock_us as i64 * 1000 + 500 - (sent + received) / 2;
            }
        }
        Ok(())
    }

    /// Settings, uploads and scene.
    async fn prepare(&mut self, config: &SendConfig) -> Result<()> {
        if let Some(settings) = config.settings
            && let serde_json::Value::Object(settings) = serde_json::to_value(settings)?
        {
            let request = Request::Settings(SetSettings { settings });
            self.request(&request, Some(1)).await?;
            self.answered(1).await?;
        }
        let Some(scene) = &config.scene else {
            return Ok(());
        };
        let mut package = send_scene::package(scene)?;
        if config.settings.is_some() {
            // Sent already: those of the command line win over the scene's own.
            package.document.remove("settings");
        }
        for (upload, (name, content)) in package.files.iter().enumerate() {
            let id = 100 + upload as u64;
            let upload = upload as u32;
            let asset = Asset {
                upload,
                name: name.clone(),
                bytes: content.len() as u64,
            };
            self.request(&Request::Asset(asset), Some(id)).await?;
            for (i, bytes) in content.chunks(CHUNK).enumerate() {
                let chunk = AssetChunk {
                    upload,
                    offset: (i * CHUNK) as u64,
                    bytes,
                };
                self.sink.send(Message::binary(chunk.encode()?)).await?;
            }
            self.answered(id).await.with_context(|| name.clone())?;
        }
        let request = Request::Scene(SetScene {
            scene: SceneChoice::Document(package.document),
        });
        self.request(&request, Some(2)).await?;
        self.answered(2).await
    }

    async fn send_frame(&mut self, message: &[u8]) -> Result<()> {
        let captured_ns = clock::now_ns();
        let mut message = message.to_vec();
        message[8..16].copy_from_slice(&self.next.to_le_bytes());
        message[16..24].copy_from_slice(&captured_ns.to_le_bytes());
        self.bytes_up += message.len() as u64;
        self.under_way.insert(self.next, captured_ns);
        self.next += 1;
        let mut sending = std::pin::pin!(self.sink.send(Message::Binary(Bytes::from(message))));
        let result = timeout(PATIENCE, &mut sending).await;
        result.context("the server does not take frames")??;
        Ok(())
    }

    /// One message of the server.
    async fn take(
        &mut self,
        message: Option<Result<Message, tokio_tungstenite::tungstenite::Error>>,
    ) -> Result<()> {
        let arrived_ns = clock::now_ns();
        match message.context("the server closed the connection")?? {
            Message::Binary(bytes) => {
                self.composite(&bytes, arrived_ns)?;
                self.request(&Request::Credit(Credit::default()), None)
                    .await
            }
            Message::Text(text) => {
                match Reply::parse(&text)? {
                    Reply::Error(e) => {
                        let text = format!("{}: expected {}, got {}", e.what, e.expected, e.got);
                        if e.fatal {
                            bail!(text);
                        }
                        if let Some(sequence) = e.sequence {
                            self.refused += 1;
                            self.under_way.remove(&sequence);
                        }
                        if self.errors.len() < MAX_ERRORS {
                            self.errors.push(text);
                        }
                    }
                    Reply::Bye(bye) => bail!("the server closed: {}", bye.reason),
                    _ => {}
                }
                Ok(())
            }
            Message::Close(frame) => bail!("the server closed: {frame:?}"),
            _ => Ok(()),
        }
    }

    fn composite(&mut self, bytes: &[u8], arrived_ns: i64) -> Result<()> {
        let header = Composite::decode(bytes)?.header;
        self.bytes_down += bytes.len() as u64;
        (self.frames_dropped, self.composites_dropped) =
            (header.dropped_frames, header.dropped_composites);
        // A frame rendered again after a change is no new one.
        if let Some(captured_ns) = self.under_way.remove(&header.sequence) {
            self.composites += 1;
            self.last_ns = arrived_ns;
            self.gathered.add(
                captured_ns,
                arrived_ns,
                self.offset_ns,
                &header.stamps,
                &header.stage_us,
            );
        }
        // Frames come out in order: earlier ones were dropped on the way.
        self.under_way = self.under_way.split_off(&header.sequence);
        Ok(())
    }

    /// Takes the composites of the last frames and says good-bye.
    async fn drain(&mut self) -> Result<()> {
        let end = Instant::now() + PATIENCE;
        while !self.under_way.is_empty() {
            match tokio::time::timeout_at(end, self.stream.next()).await {
                Ok(message) => self.take(message).await?,
                Err(_) => break,
            }
        }
        let bye = Request::Bye(Bye {
            reason: "all frames sent".to_owned(),
        });
        self.request(&bye, None).await?;
        // The server's close ends it; a server that does not answer cannot change the result.
        let _ = timeout(Duration::from_secs(2), async {
            while let Some(Ok(message)) = self.stream.next().await {
                if message.is_close() {
                    break;
                }
            }
        })
        .await;
        Ok(())
    }

    fn report(&self, config: &SendConfig, seconds: f64) -> SendReport {
        let heard = self.composites + self.frames_dropped + self.composites_dropped + self.refused;
        SendReport {
            url: config.url.clone(),
            recording: config.recording.display().to_string(),
            rate: match config.rate {
                Rate::Realtime => "realtime",
                Rate::Max => "max",
            },
            seconds,
            frames_sent: self.next,
            composites: self.composites,
            fps: self.composites as f64 / seconds.max(1e-9),
            frames_dropped: self.frames_dropped,
            composites_dropped: self.composites_dropped,
            frames_refused: self.refused,
            frames_lost: self.next.saturating_sub(heard),
            latency: Percentiles::of(&self.gathered.latency_ns),
            drift_ms: self.gathered.drift_ms(),
            steps: self.gathered.steps(),
            stages: self.gathered.stages(&self.stages),
            bytes_up: self.bytes_up,
            bytes_down: self.bytes_down,
            errors: self.errors.clone(),
        }
    }
}
