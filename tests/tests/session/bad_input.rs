//! Bad messages: each gives one clear error, and the next frame is rendered normally.

use futures_util::{SinkExt, StreamExt};
use ghostlight_proto::{Code, Composite, SUBPROTOCOL};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;

use super::bad_messages::{Bad, cases};
use super::client::{Client, Event, TestServer, frame, patient};
use super::fake::Fake;

#[tokio::test]
async fn each_bad_message_is_answered_once_and_the_next_frame_is_unharmed() {
    let server = TestServer::start(Fake::default(), |c| {
        c.bounds.message_bytes = 200_000;
        c.bounds.scene_bytes = 20_000;
    })
    .await;
    let (mut producer, _) = Client::producer(&server).await;
    let mut number = 1000;
    for (name, code, bad) in cases() {
        match bad {
            Bad::Bytes(bytes) => producer.send_bytes(bytes).await,
            Bad::Text(text) => producer.ws.send(Message::text(text)).await.unwrap(),
        }
        let error = producer.error().await;
        assert_eq!(error.code, code, "{name}: {error:?}");
        assert!(!error.fatal, "{name}");
        for part in [&error.what, &error.expected, &error.got] {
            assert!(!part.is_empty() && part.len() < 400, "{name}: {error:?}");
        }
        // A second error would arrive before this composite.
        number += 1;
        producer.send_bytes(frame(number, 10)).await;
        let bytes = producer.composite().await;
        producer.credit().await;
        let composite = Composite::decode(&bytes).unwrap();
        assert_eq!(composite.header.sequence, number, "{name}");
        assert_eq!(
            super::client::pixels(composite.planes.image).get_pixel(0, 0)[0],
            245
        );
    }
    assert_eq!(
        server
            .metric("ghostlight_errors_total{code=\"intrinsics\"}")
            .await,
        7
    );
}

#[tokio::test]
async fn images_beyond_the_limits_are_refused_before_they_are_decoded() {
    let server = TestServer::start(Fake::default(), |c| c.bounds.pixels = 700).await;
    let (mut producer, _) = Client::producer(&server).await;
    producer.send_bytes(frame(4, 4)).await;
    let error = producer.error().await;
    assert_eq!((error.code, error.sequence), (Code::TooLarge, Some(4)));
    assert!(
        error.expected.contains("700") && error.got.contains("32x24"),
        "{error:?}"
    );
}

#[tokio::test]
async fn hellos_that_cannot_be_met_end_the_connection() {
    let server = TestServer::start(Fake::default(), |c| {
        c.token = Some("right".to_owned());
        c.bounds.sessions = 1;
        c.bounds.viewers = 2;
    })
    .await;
    let (mut owner, welcome) =
        Client::join(&server, json!({"role": "producer", "token": "right"})).await;
    let session = welcome.session;
    let hello = json!({"role": "viewer", "token": "right", "session": session});
    let (_second, _) = Client::join(&server, hello.clone()).await;
    let cases: [(Value, Code, u16); 9] = [
        (json!({"type": "ping", "t": 1}), Code::Hello, 1008),
        (
            json!({"type": "hello", "role": "viewer"}),
            Code::Malformed,
            1008,
        ),
        (
            json!({"type": "hello", "version": 2, "role": "viewer"}),
            Code::Version,
            1002,
        ),
        (
            json!({"type": "hello", "version": 1, "role": "viewer"}),
            Code::Unauthorized,
            1008,
        ),
        (
            json!({"type": "hello", "version": 1, "role": "viewer", "token": "wrong"}),
            Code::Unauthorized,
            1008,
        ),
        (
            json!({"type": "hello", "version": 1, "role": "viewer", "token": "right", "session": "s99"}),
            Code::NotFound,
            1008,
        ),
        (
            json!({"type": "hello", "version": 1, "role": "producer", "token": "right"}),
            Code::Limit,
            1013,
        ),
        (
            json!({"type": "hello", "version": 1, "role": "viewer", "token": "right", "credits": 99}),
            Code::Limit,
            1013,
        ),
        (
            json!({"type": "hello", "version": 1, "role": "viewer", "token": "right", "session": session}),
            Code::Limit,
            1013,
        ),
    ];
    for (first, code, close) in cases {
        let mut client = Client::connect(&server).await;
        client.send(first.clone()).await;
        let error = client.error().await;
        assert_eq!(
            (error.code, error.fatal),
            (code, true),
            "{first}: {error:?}"
        );
        let (got, reason) = client.close().await;
        assert_eq!(got, close, "{first}: {reason}");
    }
    let mut client = Client::connect(&server).await;
    client.send_bytes(frame(1, 1)).await;
    assert_eq!(client.error().await.code, Code::Hello);
    // No bad message has damaged the session.
    owner.send_bytes(frame(6, 6)).await;
    owner.composite().await;
    drop(owner);
    server
        .until_metric("ghostlight_connections", |n| n == 0)
        .await;
    assert_eq!(server.get("/metrics", "").await.0, 401);
}

#[tokio::test]
async fn first_messages_that_never_come_or_are_none_end_the_connection() {
    let server = TestServer::start(Fake::default(), |c| {
        c.bounds.scene_bytes = 2000;
        c.bounds.hello = std::time::Duration::from_millis(500);
    })
    .await;
    let mut silent = Client::connect(&server).await;
    let mut long = Client::connect(&server).await;
    long.hello(json!({"role": "viewer", "name": "x".repeat(3000)}))
        .await;
    for client in [&mut silent, &mut long] {
        let error = client.error().await;
        assert_eq!((error.code, error.fatal), (Code::Hello, true), "{error:?}");
        assert_eq!(client.close().await.0, 1008);
    }
}

#[tokio::test]
async fn text_that_is_not_utf8_is_told_before_the_close() {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (client, _) = Client::producer(&server).await;
    let mut tcp = client.ws.into_inner();
    // A masked text message of two bytes that are not valid UTF-8.
    tcp.write_all(&[0x81, 0x82, 0, 0, 0, 0, 0xFF, 0xFE])
        .await
        .unwrap();
    let mut told = Vec::new();
    patient("the end", tcp.read_to_end(&mut told))
        .await
        .unwrap();
    let told = String::from_utf8_lossy(&told);
    assert!(
        told.contains("malformed") && told.contains("UTF-8"),
        "{told}"
    );
    assert!(told.contains("\"fatal\":true"), "{told}");
}

#[tokio::test]
async fn a_message_far_too_large_is_told_before_the_close() {
    let server = TestServer::start(Fake::default(), |c| c.bounds.message_bytes = 10_000).await;
    let (producer, _) = Client::producer(&server).await;
    let (mut sink, stream) = producer.ws.split();
    // The server stops reading in the middle of the message, so writing it may never finish.
    let writing = tokio::spawn(async move {
        let _ = sink.send(Message::binary(vec![0; 30_000_000])).await;
        sink
    });
    let events = stream.filter_map(|m| async {
        match m {
            Ok(Message::Text(text)) => Some(text.to_string()),
            Ok(Message::Close(Some(frame))) => Some(format!("close {}", u16::from(frame.code))),
            _ => None,
        }
    });
    let mut events = std::pin::pin!(events);
    let mut told = Vec::new();
    while let Some(text) = patient("the close", events.next()).await {
        let closed = text.starts_with("close");
        told.push(text);
        if closed {
            break;
        }
    }
    writing.abort();
    assert!(
        told.iter()
            .any(|t| t.contains("too_large") && t.contains("\"fatal\":true")),
        "{told:?}"
    );
    assert_eq!(
        told.last().map(String::as_str),
        Some("close 1009"),
        "{told:?}"
    );
}

#[tokio::test]
async fn handshakes_without_the_subprotocol_or_from_other_pages_are_refused() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let url = format!("ws://{}/ws", server.address);
    let try_it = |change: fn(ClientRequestBuilder) -> ClientRequestBuilder| {
        let request = change(ClientRequestBuilder::new(url.parse().unwrap()));
        async move {
            let tcp = TcpStream::connect(server.address).await.unwrap();
            match client_async(request, tcp).await {
                Ok(connected) => Ok(connected),
                Err(tokio_tungstenite::tungstenite::Error::Http(answer)) => {
                    Err(answer.status().as_u16())
                }
                Err(other) => panic!("{other}"),
            }
        }
    };
    assert_eq!(try_it(|r| r).await.err(), Some(400));
    assert_eq!(
        try_it(|r| r.with_sub_protocol("ghostlight.v9")).await.err(),
        Some(400)
    );
    let evil = |r: ClientRequestBuilder| {
        r.with_sub_protocol(SUBPROTOCOL)
            .with_header("Origin", "http://evil.example")
    };
    assert_eq!(try_it(evil).await.err(), Some(403));
    let good = try_it(|r| r.with_sub_protocol(SUBPROTOCOL)).await;
    assert!(good.is_ok());
}

#[tokio::test]
async fn pings_are_answered_with_the_clock() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut producer, welcome) = Client::producer(&server).await;
    producer.send(json!({"type": "ping", "t": 12.5})).await;
    let pong = loop {
        if let Event::Reply(ghostlight_proto::control::Reply::Pong(pong)) = producer.event().await {
            break pong;
        }
    };
    assert!((pong.t - 12.5).abs() < 1e-12);
    assert!(pong.clock_us >= welcome.clock_us);
    producer
        .send(json!({"type": "bye", "reason": "enough"}))
        .await;
    assert_eq!(producer.close().await, (1000, "enough".to_owned()));
}
