//! A test client that sees every message, and a server for it.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use ghostlight::net::{Catalog, ServeConfig, Server};
use ghostlight_proto::control::{ErrorReport, Reply, Welcome};
use ghostlight_proto::{Code, Codec, Frame, FrameHeader, Intrinsics, Pose, SUBPROTOCOL};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

/// Longest wait of any test: a server that never answers fails the test, a slow machine does not.
const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) async fn patient<T>(what: &str, future: impl Future<Output = T>) -> T {
    match tokio::time::timeout(PATIENCE, future).await {
        Ok(value) => value,
        Err(_) => panic!("{what}: nothing within {PATIENCE:?}"),
    }
}

pub(crate) struct TestServer {
    pub(crate) address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    running: JoinHandle<anyhow::Result<()>>,
}

impl TestServer {
    pub(crate) async fn start(
        backend: impl Catalog,
        change: impl FnOnce(&mut ServeConfig),
    ) -> Self {
        let mut config = ServeConfig::local(0);
        change(&mut config);
        let server = Server::bind(config, Arc::new(backend)).await.unwrap();
        let address = server.address().unwrap();
        let (stop, stopped) = oneshot::channel();
        let running = tokio::spawn(server.run(
            async {
                let _ = stopped.await;
            },
            std::future::pending(),
        ));
        Self {
            address,
            stop: Some(stop),
            running,
        }
    }

    pub(crate) fn stop(&mut self) {
        let _ = self.stop.take().unwrap().send(());
    }

    pub(crate) async fn ended(self) {
        patient("the server's end", self.running)
            .await
            .unwrap()
            .unwrap();
    }

    /// Status and body of a GET.
    pub(crate) async fn get(&self, path: &str, headers: &str) -> (u16, String) {
        use tokio::io::{AsyncReadExt, AsyncWriteExt};
        let mut stream = TcpStream::connect(self.address).await.unwrap();
        let request = format!(
            "GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n{headers}\r\n",
            self.address
        );
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut answer = String::new();
        patient(path, stream.read_to_string(&mut answer))
            .await
            .unwrap();
        let status = answer[9..12].parse().unwrap();
        let body = answer.split_once("\r\n\r\n").map_or("", |(_, body)| body);
        (status, body.to_owned())
    }

    /// A value of `/metrics`.
    pub(crate) async fn metric(&self, name: &str) -> u64 {
        // A server without a token accepts any token.
        let (_, text) = self
            .get("/metrics", "Authorization: Bearer right\r\n")
            .await;
        let line = text
            .lines()
            .find_map(|l| l.strip_prefix(name)?.strip_prefix(' '));
        line.unwrap_or_else(|| panic!("{name} in {text}"))
            .trim()
            .parse()
            .unwrap()
    }

    /// Polls until a metric satisfies `is`.
    pub(crate) async fn until_metric(&self, name: &str, is: impl Fn(u64) -> bool) {
        patient(name, async {
            while !is(self.metric(name).await) {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        })
        .await;
    }
}

pub(crate) enum Event {
    Reply(Reply),
    Composite(Vec<u8>),
    Closed(u16, String),
}

pub(crate) struct Client {
    pub(crate) ws: WebSocketStream<TcpStream>,
}

impl Client {
    pub(crate) async fn connect(server: &TestServer) -> Self {
        let url = format!("ws://{}/ws", server.address).parse().unwrap();
        let request = ClientRequestBuilder::new(url).with_sub_protocol(SUBPROTOCOL);
        let tcp = TcpStream::connect(server.address).await.unwrap();
        let (ws, _) = patient("handshake", client_async(request, tcp))
            .await
            .unwrap();
        Self { ws }
    }

    /// Connects and says hello; omitted fields take their defaults.
    pub(crate) async fn join(server: &TestServer, hello: Value) -> (Self, Welcome) {
        let mut client = Self::connect(server).await;
        client.hello(hello).await;
        match client.event().await {
            Event::Reply(Reply::Welcome(welcome)) => (client, welcome),
            Event::Reply(other) => panic!("{}", other.to_text()),
            _ => panic!("no welcome"),
        }
    }

    /// A producer that requests PNG composites.
    pub(crate) async fn producer(server: &TestServer) -> (Self, Welcome) {
        let hello = json!({"role": "producer", "composite": {"image": "png"}, "scene": "invert"});
        Self::join(server, hello).await
    }

    pub(crate) async fn hello(&mut self, mut hello: Value) {
        hello["type"] = "hello".into();
        if hello.get("version").is_none() {
            hello["version"] = 1.into();
        }
        self.send(hello).await;
    }

    pub(crate) async fn send(&mut self, message: Value) {
        self.ws
            .send(Message::text(message.to_string()))
            .await
            .unwrap();
    }

    pub(crate) async fn send_bytes(&mut self, message: Vec<u8>) {
        self.ws.send(Message::binary(message)).await.unwrap();
    }

    pub(crate) async fn credit(&mut self) {
        self.send(json!({"type": "credit"})).await;
    }

    pub(crate) async fn event(&mut self) -> Event {
        loop {
            match patient("a message", self.ws.next()).await {
                Some(Ok(Message::Text(text))) => return Event::Reply(Reply::parse(&text).unwrap()),
                Some(Ok(Message::Binary(bytes))) => return Event::Composite(bytes.to_vec()),
                Some(Ok(Message::Close(Some(frame)))) => {
                    return Event::Closed(frame.code.into(), frame.reason.to_string());
                }
                Some(Ok(_)) => {}
                None | Some(Err(Error::ConnectionClosed | Error::AlreadyClosed)) => {
                    panic!("closed without a reason")
                }
                Some(Err(error)) => panic!("{error}"),
            }
        }
    }

    /// The next composite; control messages before it are skipped, errors are not.
    pub(crate) async fn composite(&mut self) -> Vec<u8> {
        loop {
            match self.event().await {
                Event::Composite(bytes) => return bytes,
                Event::Reply(Reply::Error(e)) => panic!("{e:?}"),
                Event::Reply(_) => {}
                Event::Closed(code, reason) => panic!("closed: {code} {reason}"),
            }
        }
    }

    /// The next error; composites before it are acknowledged.
    pub(crate) async fn error(&mut self) -> ErrorReport {
        loop {
            match self.event().await {
                Event::Reply(Reply::Error(e)) => return e,
                Event::Composite(_) => self.credit().await,
                Event::Reply(_) => {}
                Event::Closed(code, reason) => panic!("closed: {code} {reason}"),
            }
        }
    }

    /// Waits for the answer to a request.
    pub(crate) async fn answer(&mut self, id: u64) -> Result<(), Code> {
        loop {
            match self.event().await {
                Event::Reply(Reply::Done(done)) if done.id == Some(id) => return Ok(()),
                Event::Reply(Reply::Error(e)) if e.id == Some(id) => return Err(e.code),
                Event::Reply(_) => {}
                Event::Composite(_) => self.credit().await,
                Event::Closed(code, reason) => panic!("closed: {code} {reason}"),
            }
        }
    }

    /// Code and reason of the close; everything before it is skipped.
    pub(crate) async fn close(&mut self) -> (u16, String) {
        loop {
            if let Event::Closed(code, reason) = self.event().await {
                return (code, reason);
            }
        }
    }
}

/// A message with an uncompressed frame of one shade of grey.
pub(crate) fn frame(sequence: u64, shade: u8) -> Vec<u8> {
    let (width, height) = (super::fake::WIDTH, super::fake::HEIGHT);
    let camera = Intrinsics {
        width,
        height,
        fx: 30.0,
        fy: 30.0,
        cx: 15.5,
        cy: 11.5,
    };
    let n = camera.n_pixels();
    let header = FrameHeader {
        sequence,
        capture_ns: -1_000 + sequence as i64,
        pose: Pose {
            translation: [1.0, 2.0, 3.0],
            quaternion: [0.0, 0.6, 0.0, 0.8],
        },
        color: camera,
        depth: camera,
        color_from_depth: Pose::IDENTITY,
        metres_per_unit: 0.001,
        color_codec: Codec::Rgb8,
        depth_codec: Codec::U16,
        max_depth_m: 0.0,
    };
    let (color, depth) = (vec![shade; 3 * n], vec![1; 2 * n]);
    Frame {
        header,
        color: &color,
        depth: &depth,
    }
    .encode()
    .unwrap()
}

/// The decoded pixels of a picture.
pub(crate) fn pixels(png_or_jpeg: &[u8]) -> image::RgbImage {
    image::load_from_memory(png_or_jpeg).unwrap().to_rgb8()
}
