//! Clients without a token: silent, half-sent, guessing tokens, and far too many. A client with the token always
//! gets in, and admitted clients are not affected.

use std::time::{Duration, Instant};

use futures_util::StreamExt;
use ghostlight_proto::{Code, Composite};
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;

use super::client::{Client, TestServer, frame, patient};
use super::fake::Fake;

const TURNED: &str = "ghostlight_turned_away_total";

fn turned(reason: &str) -> String {
    format!("{TURNED}{{reason=\"{reason}\"}}")
}

/// A server with a token and with timeouts too long to matter.
async fn guarded() -> TestServer {
    TestServer::start(Fake::default(), |c| {
        c.token = Some("right".to_owned());
        c.bounds.handshake = Duration::from_secs(60);
        c.bounds.hello = Duration::from_secs(60);
    })
    .await
}

/// A client with the token joins, sends a frame and gets its composite.
async fn owner_is_served(server: &TestServer, number: u64) -> Client {
    let hello = json!({"role": "producer", "token": "right", "composite": {"image": "png"}});
    let (mut owner, _) = Client::join(server, hello).await;
    owner.send_bytes(frame(number, 3)).await;
    let bytes = owner.composite().await;
    owner.credit().await;
    assert_eq!(Composite::decode(&bytes).unwrap().header.sequence, number);
    owner
}

/// Reads until the server closes the connection.
async fn end_of(tcp: &mut TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    // A connection reset counts as the end too.
    let _ = patient("the end", tcp.read_to_end(&mut bytes)).await;
    bytes
}

#[tokio::test]
async fn silent_upgrades_never_keep_the_owner_out() {
    let server = guarded().await;
    let mut inside = owner_is_served(&server, 1).await;
    let mut silent = Vec::new();
    for _ in 0..64 {
        silent.push(Client::connect(&server).await);
    }
    // Until now they were too young to be replaced.
    tokio::time::sleep(Duration::from_millis(1100)).await;
    for number in 0..20 {
        let owner = owner_is_served(&server, number).await;
        drop(owner);
        silent.push(Client::connect(&server).await);
    }
    assert!(server.metric(&turned("dropped")).await >= 48);
    assert_eq!(server.metric(&turned("full")).await, 0);
    // The oldest connection is told why it is closed.
    let told = patient("its close", silent[0].ws.next()).await;
    let Some(Ok(Message::Close(Some(frame)))) = told else {
        panic!("{told:?}");
    };
    assert_eq!(u16::from(frame.code), 1013);
    assert!(frame.reason.contains("hello"), "{}", frame.reason);
    inside.send_bytes(frame_of(2)).await;
    inside.composite().await;
}

fn frame_of(number: u64) -> Vec<u8> {
    frame(number, 3)
}

#[tokio::test]
async fn silent_and_half_sent_requests_never_keep_the_owner_out() {
    let server = guarded().await;
    let mut strangers = Vec::new();
    for i in 0..100 {
        let mut tcp = TcpStream::connect(server.address).await.unwrap();
        let begun: &[u8] = match i % 3 {
            0 => b"",
            1 => b"GET / HTTP/1.1\r\nHost: local",
            _ => b"\x16\x03\x01\x02\x00\x01\x00",
        };
        // The connection may have been replaced already.
        let _ = tcp.write_all(begun).await;
        strangers.push(tcp);
    }
    tokio::time::sleep(Duration::from_millis(1100)).await;
    for number in 0..5 {
        owner_is_served(&server, number).await;
    }
    assert!(end_of(&mut strangers[0]).await.is_empty());
}

#[tokio::test]
async fn requests_that_do_not_come_in_time_are_closed() {
    let server = TestServer::start(Fake::default(), |c| {
        c.bounds.handshake = Duration::from_millis(300);
        c.bounds.request = Duration::from_millis(900);
    })
    .await;
    let host = server.address;
    for begun in [
        String::new(),
        "GET / HT".to_owned(),
        format!("GET / HTTP/1.1\r\nHost: {host}\r\nX: "),
        // An idle connection after its response.
        format!("GET /healthz HTTP/1.1\r\nHost: {host}\r\n\r\n"),
        // A body that never arrives.
        format!("GET /healthz HTTP/1.1\r\nHost: {host}\r\nContent-Length: 99\r\n\r\n"),
    ] {
        let mut tcp = TcpStream::connect(host).await.unwrap();
        tcp.write_all(begun.as_bytes()).await.unwrap();
        end_of(&mut tcp).await;
    }
    // And one that sends a byte of its request head now and then.
    let tcp = TcpStream::connect(host).await.unwrap();
    let (mut reading, mut writing) = tcp.into_split();
    let dribbling = tokio::spawn(async move {
        while writing.write_all(b"x").await.is_ok() {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    });
    let _ = patient("the end", reading.read_to_end(&mut Vec::new())).await;
    dribbling.abort();
    server.until_metric("ghostlight_waiting", |n| n <= 1).await;
    assert!(server.metric(&turned("timed_out")).await >= 3);
}

#[tokio::test]
async fn clients_beyond_the_limit_are_told_after_their_hello() {
    let server = TestServer::start(Fake::default(), |c| c.bounds.connections = 1).await;
    let (first, _) = Client::producer(&server).await;
    let mut second = Client::connect(&server).await;
    second.hello(json!({"role": "viewer"})).await;
    let error = second.error().await;
    assert_eq!((error.code, error.fatal), (Code::Limit, true), "{error:?}");
    assert_eq!(second.close().await.0, 1013);
    drop((first, second));
    server
        .until_metric("ghostlight_connections", |n| n == 0)
        .await;
    Client::producer(&server).await;
}

#[tokio::test]
async fn wrong_tokens_are_slowed_and_the_right_one_is_not() {
    let server = guarded().await;
    let mut slowest = Duration::ZERO;
    for tries in 0..4u32 {
        let mut guesser = Client::connect(&server).await;
        let start = Instant::now();
        guesser
            .hello(json!({"role": "viewer", "token": "guess"}))
            .await;
        let error = guesser.error().await;
        slowest = start.elapsed();
        // Never faster than the delay; slower is allowed.
        assert!(
            slowest >= Duration::from_millis(100 << tries),
            "{slowest:?}"
        );
        assert_eq!(error.code, Code::Unauthorized);
        assert!(error.got.contains("wrong token"), "{error:?}");
        let (code, reason) = guesser.close().await;
        assert_eq!(code, 1008);
        assert!(reason.contains("wrong token"), "{reason}");
    }
    let mut waiting = Client::connect(&server).await;
    waiting
        .hello(json!({"role": "viewer", "token": "guess"}))
        .await;
    server
        .until_metric(&turned("wrong_token"), |n| n == 5)
        .await;
    // The right token is accepted from the same address while the answer to the wrong one is delayed.
    owner_is_served(&server, 1).await;
    waiting.error().await;
    let (status, text) = server
        .get("/metrics", "Authorization: Bearer guess\r\n")
        .await;
    assert_eq!(status, 401);
    assert!(text.contains("wrong token"), "{text}");
    assert!(slowest >= Duration::from_millis(800));
}

#[tokio::test]
async fn tokens_are_read_under_any_case_of_their_scheme() {
    let server = guarded().await;
    for scheme in ["Bearer", "bearer", "BEARER"] {
        let header = format!("Authorization: {scheme} right\r\n");
        assert_eq!(server.get("/metrics", &header).await.0, 200, "{scheme}");
    }
    for header in ["", "Authorization: Basic right\r\n"] {
        assert_eq!(server.get("/metrics", header).await.0, 401, "{header}");
    }
}

/// Status and body of a GET with another host name.
async fn status_as(server: &TestServer, host: &str, path: &str) -> (u16, String) {
    let mut tcp = TcpStream::connect(server.address).await.unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    tcp.write_all(request.as_bytes()).await.unwrap();
    let answer = String::from_utf8(end_of(&mut tcp).await).unwrap();
    (answer[9..12].parse().unwrap(), answer)
}

#[tokio::test]
async fn foreign_names_of_this_machine_are_answered_only_under_a_token() {
    let open = TestServer::start(Fake::default(), |_| {}).await;
    for path in ["/", "/api/v1/recordings", "/client/src/main.js"] {
        let (status, answer) = status_as(&open, "evil.example:8080", path).await;
        assert_eq!(status, 421, "{path}: {answer}");
        assert!(answer.contains("evil.example"), "{answer}");
        for host in ["localhost", "127.0.0.1:1", "[::1]:8080"] {
            assert_eq!(status_as(&open, host, path).await.0, 200, "{path} {host}");
        }
    }
    let with_token = guarded().await;
    let (status, answer) = status_as(&with_token, "ghost.example", "/").await;
    assert_eq!(status, 200);
    assert!(
        answer.contains("connect-src 'self' ws://ghost.example wss://ghost.example;"),
        "{answer}"
    );
}
