//! One connection of `send`: hello, scene, frames out, composites in.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, anyhow};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use ghostlight_proto::control::{
    Asset, Bye, Credit, ErrorReport, Hello, Ping, Reply, Request, Role, SceneChoice, SetScene,
    SetSettings,
};
use ghostlight_proto::{AssetChunk, Code, SUBPROTOCOL};
use tokio::net::TcpStream;
use tokio::time::{Instant, timeout};
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;
use tokio_tungstenite::tungstenite::protocol::{CloseFrame, WebSocketConfig};
use tokio_tungstenite::tungstenite::{Bytes, Error as SocketError, Message};
use tokio_tungstenite::{
    Connector, MaybeTlsStream, WebSocketStream, connect_async_tls_with_config,
};

use super::send_config::SendConfig;
use super::send_scene::Package;
use super::send_tally::Tally;
use super::tls;
use crate::clock;

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

/// Longest wait for an answer and for the composites of the last frames.
pub(super) const PATIENCE: Duration = Duration::from_secs(10);

/// Longest wait for the server's close frame.
const FAREWELL: Duration = Duration::from_secs(2);

/// Bytes of an upload per message.
const CHUNK: usize = 1 << 20;

/// Largest message of the server, bytes.
const MAX_MESSAGE: usize = 256 << 20;

/// Why a connection ended.
#[derive(Debug)]
pub(super) enum Ended {
    /// The connection was lost, or the server is full: a new connection may succeed.
    Lost(anyhow::Error),
    /// A new connection would fail as well.
    Refused(anyhow::Error),
}

/// The server asks the client to come back later.
#[derive(Debug, thiserror::Error)]
#[error("the server is busy: {0}")]
pub(super) struct Busy(String);

impl Ended {
    /// The reason, for a run that does not reconnect.
    pub(super) fn into_error(self) -> anyhow::Error {
        match self {
            Self::Lost(error) | Self::Refused(error) => error,
        }
    }

    /// The ending for an error after which the server closes the connection.
    fn after(e: &ErrorReport) -> Self {
        let text = format!("{}: expected {}, got {}", e.what, e.expected, e.got);
        match e.code {
            Code::Limit => Self::Lost(Busy(text).into()),
            Code::Internal => lost(text),
            _ => Self::Refused(anyhow!(text)),
        }
    }
}

impl From<SocketError> for Ended {
    fn from(error: SocketError) -> Self {
        match error {
            SocketError::Http(ref answer) if answer.status().is_server_error() => {
                Self::Lost(error.into())
            }
            SocketError::Http(_) | SocketError::Url(_) | SocketError::HttpFormat(_) => {
                Self::Refused(error.into())
            }
            error => Self::Lost(error.into()),
        }
    }
}

fn refused(error: impl Into<anyhow::Error>) -> Ended {
    Ended::Refused(error.into())
}

fn lost(text: impl std::fmt::Display) -> Ended {
    Ended::Lost(anyhow!("{text}"))
}

/// A connection that has been welcomed.
pub(super) struct Client {
    sink: SplitSink<Socket, Message>,
    stream: SplitStream<Socket>,
    /// The server's clock minus this machine's.
    offset_ns: i64,
}

impl Client {
    /// Connects, says hello, and sends settings and scene.
    pub(super) async fn connect(
        config: &SendConfig,
        package: Option<&Package>,
        tally: &mut Tally,
    ) -> Result<Self, Ended> {
        let mut client = Self::reach(config).await?;
        client.handshake(config, tally).await?;
        client.match_clocks().await?;
        client.prepare(config, package).await?;
        Ok(client)
    }

    async fn reach(config: &SendConfig) -> Result<Self, Ended> {
        let url = || config.url.clone();
        let address = config.url.parse().with_context(url).map_err(refused)?;
        let request = ClientRequestBuilder::new(address).with_sub_protocol(SUBPROTOCOL);
        let limits = WebSocketConfig::default()
            .max_message_size(Some(MAX_MESSAGE))
            .max_frame_size(Some(MAX_MESSAGE));
        if config.ca.is_some() && !config.url.starts_with("wss://") {
            let error = anyhow!("--ca: expected a wss:// address, got {}", config.url);
            return Err(refused(error));
        }
        let connector = match &config.ca {
            Some(ca) => Some(Connector::Rustls(Arc::new(
                tls::trusting(ca).map_err(refused)?,
            ))),
            None => None,
        };
        let connecting = connect_async_tls_with_config(request, Some(limits), true, connector);
        let socket = match timeout(PATIENCE, connecting).await {
            Ok(Ok((socket, _))) => socket,
            Ok(Err(error)) => {
                return Err(match Ended::from(error) {
                    Ended::Lost(error) => Ended::Lost(error.context(url())),
                    Ended::Refused(error) => Ended::Refused(error.context(url())),
                });
            }
            Err(_) => return Err(lost(format_args!("{}: no answer", config.url))),
        };
        let (sink, stream) = socket.split();
        Ok(Self {
            sink,
            stream,
            offset_ns: 0,
        })
    }

    async fn handshake(&mut self, config: &SendConfig, tally: &mut Tally) -> Result<(), Ended> {
        let mut hello = Hello::new(Role::Producer);
        hello.token.clone_from(&config.token);
        hello.name = "ghostlight send".to_owned();
        hello.scene.clone_from(&config.server_scene);
        hello.control = config.control.into();
        self.request(&Request::Hello(hello), None).await?;
        match self.reply().await? {
            Reply::Welcome(welcome) => {
                tally.stages = welcome.stages;
                Ok(())
            }
            Reply::Error(e) if e.code == Code::Unauthorized => Err(refused(match config.token {
                Some(_) => anyhow!("{}: wrong token", config.url),
                None => anyhow!(
                    "{}: this server wants a token: --token or GHOSTLIGHT_TOKEN",
                    config.url
                ),
            })),
            Reply::Error(e) => Err(Ended::after(&e)),
            other => Err(refused(anyhow!(
                "hello: expected a welcome, got {}",
                other.to_text()
            ))),
        }
    }

    async fn request(&mut self, request: &Request, id: Option<u64>) -> Result<(), Ended> {
        self.write(Message::text(request.to_text(id))).await
    }

    async fn write(&mut self, message: Message) -> Result<(), Ended> {
        match timeout(PATIENCE, self.sink.send(message)).await {
            Ok(sent) => Ok(sent?),
            Err(_) => Err(lost("the server does not read")),
        }
    }

    /// The next message of the server.
    pub(super) async fn next(&mut self) -> Result<Message, Ended> {
        match self.stream.next().await {
            Some(message) => Ok(message?),
            None => Err(lost("the server closed the connection")),
        }
    }

    /// The next control message; used before the first frame is sent.
    async fn reply(&mut self) -> Result<Reply, Ended> {
        loop {
            match timeout(PATIENCE, self.next()).await {
                Ok(Ok(Message::Text(text))) => return Reply::parse(&text).map_err(refused),
                Ok(Ok(Message::Close(frame))) => return Err(closed(frame.as_ref())),
                Ok(Ok(_)) => {}
                Ok(Err(ended)) => return Err(ended),
                Err(_) => return Err(lost("the server did not answer in time")),
            }
        }
    }

    /// Waits for the answer to a request.
    async fn answered(&mut self, id: u64) -> Result<(), Ended> {
        loop {
            match self.reply().await? {
                Reply::Done(done) if done.id == Some(id) => return Ok(()),
                Reply::Error(e) => return Err(Ended::after(&e)),
                Reply::Bye(bye) => {
                    return Err(lost(format_args!("the server closed: {}", bye.reason)));
                }
                _ => {}
            }
        }
    }

    /// Estimates the clock offset from the ping with the shortest round trip.
    async fn match_clocks(&mut self) -> Result<(), Ended> {
        let mut best = i64::MAX;
        for _ in 0..8 {
            let sent = clock::now_ns();
            self.request(&Request::Ping(Ping { t: 0.0 }), None).await?;
            let pong = loop {
                match self.reply().await? {
                    Reply::Pong(pong) => break pong,
                    Reply::Error(e) if e.fatal => return Err(Ended::after(&e)),
                    _ => {}
                }
            };
            let received = clock::now_ns();
            if received - sent < best {
                best = received - sent;
                // The server truncates its clock to microseconds, which loses half a microsecond on average.
                self.offset_ns = pong.clock_us as i64 * 1000 + 500 - (sent + received) / 2;
            }
        }
        Ok(())
    }

    /// Sends settings, uploads and scene.
    async fn prepare(
        &mut self,
        config: &SendConfig,
        package: Option<&Package>,
    ) -> Result<(), Ended> {
        if let Some(settings) = config.settings
            && let serde_json::Value::Object(settings) =
                serde_json::to_value(settings).map_err(refused)?
        {
            let request = Request::Settings(SetSettings { settings });
            self.request(&request, Some(1)).await?;
            self.answered(1).await?;
        }
        let Some(package) = package else {
            return Ok(());
        };
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
                let chunk = chunk.encode().map_err(refused)?;
                self.write(Message::binary(chunk)).await?;
            }
            self.answered(id).await.map_err(|ended| match ended {
                Ended::Refused(error) => Ended::Refused(error.context(name.clone())),
                lost => lost,
            })?;
        }
        let request = Request::Scene(SetScene {
            scene: SceneChoice::Document(package.document.clone()),
        });
        self.request(&request, Some(2)).await?;
        self.answered(2).await
    }

    /// Sends a frame with the next number and the current time as capture time.
    pub(super) async fn send_frame(
        &mut self,
        message: &[u8],
        tally: &mut Tally,
    ) -> Result<(), Ended> {
        let captured_ns = clock::now_ns();
        let mut message = message.to_vec();
        message[8..16].copy_from_slice(&tally.next.to_le_bytes());
        message[16..24].copy_from_slice(&captured_ns.to_le_bytes());
        tally.bytes_up += message.len() as u64;
        tally.under_way.insert(tally.next, captured_ns);
        tally.next += 1;
        self.write(Message::Binary(Bytes::from(message))).await
    }

    /// Handles one message of the server.
    pub(super) async fn take(&mut self, message: Message, tally: &mut Tally) -> Result<(), Ended> {
        let arrived_ns = clock::now_ns();
        match message {
            Message::Binary(bytes) => {
                tally
                    .composite(&bytes, arrived_ns, self.offset_ns)
                    .map_err(refused)?;
                self.request(&Request::Credit(Credit::default()), None)
                    .await
            }
            Message::Text(text) => match Reply::parse(&text).map_err(refused)? {
                Reply::Error(e) if e.fatal => Err(Ended::after(&e)),
                Reply::Error(e) => {
                    tally.error(&e);
                    Ok(())
                }
                Reply::Bye(bye) => Err(lost(format_args!("the server closed: {}", bye.reason))),
                _ => Ok(()),
            },
            Message::Close(frame) => Err(closed(frame.as_ref())),
            _ => Ok(()),
        }
    }

    /// Receives the composites of the last frames.
    pub(super) async fn drain(&mut self, tally: &mut Tally) -> Result<(), Ended> {
        let end = Instant::now() + PATIENCE;
        while !tally.under_way.is_empty() {
            match tokio::time::timeout_at(end, self.next()).await {
                Ok(message) => self.take(message?, tally).await?,
                Err(_) => break,
            }
        }
        Ok(())
    }

    /// Says good-bye and closes the connection.
    pub(super) async fn part(mut self, reason: &str) {
        let bye = Request::Bye(Bye {
            reason: reason.to_owned(),
        });
        // Waits for the server's close frame; a server that does not answer cannot change the result.
        let _ = timeout(FAREWELL, async {
            if self.request(&bye, None).await.is_err() {
                return;
            }
            while let Some(Ok(message)) = self.stream.next().await {
                if message.is_close() {
                    break;
                }
            }
        })
        .await;
    }
}

fn closed(frame: Option<&CloseFrame>) -> Ended {
    match frame {
        Some(frame) if frame.code == CloseCode::Again => {
            Ended::Lost(Busy(frame.reason.to_string()).into())
        }
        Some(frame) => lost(format_args!("the server closed: {}", frame.reason)),
        None => lost("the server closed the connection"),
    }
}
