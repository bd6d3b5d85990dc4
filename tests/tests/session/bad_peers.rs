//! Clients that are slow, silent, disconnected or impatient; ordinary clients are not affected.

use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use ghostlight_proto::Composite;
use ghostlight_proto::control::Reply;
use serde_json::json;
use tokio::io::AsyncWriteExt;
use tokio_tungstenite::tungstenite::Message;

use super::client::{Client, Event, TestServer, frame};
use super::fake::Fake;

fn sequence(bytes: &[u8]) -> u64 {
    Composite::decode(bytes).unwrap().header.sequence
}

#[tokio::test]
async fn a_slow_viewer_sees_fewer_but_never_older_pictures() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut producer, welcome) = Client::producer(&server).await;
    let hello = json!({"role": "viewer", "session": welcome.session, "credits": 1});
    let (mut slow, _) = Client::join(&server, hello).await;
    let mut number = 0;
    let mut received = 0;
    for _ in 0..8 {
        // Six frames pass while the slow viewer does not return its only credit.
        for _ in 0..6 {
            number += 1;
            producer.send_bytes(frame(number, 3)).await;
            assert_eq!(sequence(&producer.composite().await), number);
            producer.credit().await;
        }
        if received > 0 {
            slow.credit().await;
        }
        let bytes = slow.composite().await;
        let header = Composite::decode(&bytes).unwrap().header;
        received += 1;
        // The first composite was sent as soon as there was one; later ones are the newest each time.
        let expected = if received == 1 { 1 } else { number };
        assert_eq!(header.sequence, expected);
        assert_eq!(header.dropped_composites, header.sequence - received);
    }
    server
        .until_metric("ghostlight_composites_dropped_total", |n| {
            n == number - received
        })
        .await;
}

#[tokio::test]
async fn a_viewer_that_never_reads_costs_two_composites_and_then_its_place() {
    let server =
        TestServer::start(Fake::default(), |c| c.bounds.idle = Duration::from_secs(2)).await;
    let (mut producer, welcome) = Client::producer(&server).await;
    let hello = json!({"role": "viewer", "session": welcome.session});
    let (silent, _) = Client::join(&server, hello).await;
    for number in 0..200 {
        producer.send_bytes(frame(number, 3)).await;
        assert_eq!(sequence(&producer.composite().await), number);
        producer.credit().await;
    }
    let sent = server.metric("ghostlight_composites_sent_total").await;
    assert!((200..=202).contains(&sent), "{sent}");
    // The viewer does not answer pings either, so it is closed; the producer answers and stays.
    let mut number = 200;
    while server.metric("ghostlight_viewers").await > 1 {
        producer.send_bytes(frame(number, 3)).await;
        assert_eq!(sequence(&producer.composite().await), number);
        producer.credit().await;
        number += 1;
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    drop(silent);
}

#[tokio::test]
async fn clients_that_vanish_mid_message_leave_nothing_behind() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut producer, welcome) = Client::producer(&server).await;
    for cut in [1, 5, 100] {
        let hello = json!({"role": "viewer", "session": welcome.session});
        let (viewer, _) = Client::join(&server, hello).await;
        let mut tcp = viewer.ws.into_inner();
        // A masked binary frame of 64 KiB, of which only the beginning is sent.
        let mut begun = vec![0x82, 0xFF, 0, 0, 0, 0, 0, 1, 0, 0, 1, 2, 3, 4];
        begun.resize(200, 0x55);
        tcp.write_all(&begun[..cut]).await.unwrap();
        drop(tcp);
        // And a producer that disconnects with a frame half sent.
        let (other, _) = Client::producer(&server).await;
        let mut tcp = other.ws.into_inner();
        tcp.write_all(&begun[..cut]).await.unwrap();
        drop(tcp);
        producer.send_bytes(frame(cut as u64, 3)).await;
        assert_eq!(sequence(&producer.composite().await), cut as u64);
        producer.credit().await;
    }
    server
        .until_metric("ghostlight_connections", |n| n == 1)
        .await;
    server.until_metric("ghostlight_sessions", |n| n == 1).await;
}

#[tokio::test]
async fn a_flood_of_frames_is_thinned_to_the_newest() {
    let fake = Fake {
        render: Duration::from_millis(15),
        ..Fake::default()
    };
    let server = TestServer::start(fake, |_| {}).await;
    let (mut good, _) = Client::producer(&server).await;
    let (flood, _) = Client::producer(&server).await;
    let (mut sink, mut stream) = flood.ws.split();
    const N: u64 = 400;
    let writing = tokio::spawn(async move {
        for number in 0..N {
            sink.send(Message::binary(frame(number, 3))).await.unwrap();
        }
        sink
    });
    // The ordinary session is served throughout.
    for number in 0..10 {
        good.send_bytes(frame(number, 3)).await;
        assert_eq!(sequence(&good.composite().await), number);
        good.credit().await;
    }
    let mut sink = writing.await.unwrap();
    let mut last = None;
    let dropped = loop {
        match stream.next().await.unwrap().unwrap() {
            Message::Binary(bytes) => {
                let header = Composite::decode(&bytes).unwrap().header;
                assert!(last < Some(header.sequence));
                last = Some(header.sequence);
                if last == Some(N - 1) {
                    break header.dropped_frames;
                }
                sink.send(Message::text(r#"{"type":"credit"}"#))
                    .await
                    .unwrap();
            }
            Message::Text(text) => {
                let reply = Reply::parse(&text).unwrap();
                assert!(!matches!(reply, Reply::Error(_)), "{text}");
            }
            _ => {}
        }
    };
    assert!(dropped > 0);
    // Every frame is counted.
    let rendered = server.metric("ghostlight_frames_rendered_total").await;
    assert_eq!(
        rendered + server.metric("ghostlight_frames_dropped_total").await,
        N + 10
    );
    assert_eq!(
        server.metric("ghostlight_frames_dropped_total").await,
        dropped
    );
}

#[tokio::test]
async fn a_flood_of_errors_waits_for_its_reader() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut good, _) = Client::producer(&server).await;
    let (flood, _) = Client::producer(&server).await;
    let (mut sink, mut stream) = flood.ws.split();
    const N: usize = 3000;
    let writing = tokio::spawn(async move {
        for _ in 0..N {
            sink.send(Message::text("{}")).await.unwrap();
        }
        sink
    });
    good.send_bytes(frame(1, 3)).await;
    assert_eq!(sequence(&good.composite().await), 1);
    let mut errors = 0;
    while errors < N {
        if let Message::Text(text) = stream.next().await.unwrap().unwrap() {
            errors += usize::from(matches!(Reply::parse(&text).unwrap(), Reply::Error(_)));
        }
    }
    drop(writing.await.unwrap());
}

#[tokio::test]
async fn stopping_finishes_the_frame_in_flight_and_says_why() {
    let fake = Fake {
        render: Duration::from_millis(300),
        ..Fake::default()
    };
    let mut server = TestServer::start(fake, |_| {}).await;
    let (mut producer, welcome) = Client::producer(&server).await;
    let hello = json!({"role": "viewer", "session": welcome.session});
    let (mut viewer, _) = Client::join(&server, hello).await;
    producer.send_bytes(frame(42, 3)).await;
    // The frame has arrived and is being rendered when the server is told to stop. Frames of the watcher's
    // recording count as well, and come later.
    server
        .until_metric("ghostlight_frames_received_total", |n| n >= 1)
        .await;
    let (mut watcher, _) = Client::join(&server, json!({"role": "viewer"})).await;
    let mut waiting = Client::connect(&server).await;
    server.stop();
    for client in [&mut producer, &mut viewer] {
        assert_eq!(sequence(&client.composite().await), 42);
        let bye = loop {
            if let Event::Reply(Reply::Bye(bye)) = client.event().await {
                break bye;
            }
        };
        let closed = client.close().await;
        assert_eq!(closed, (1001, bye.reason));
        assert!(closed.1.contains("stops"), "{}", closed.1);
    }
    assert_eq!(watcher.close().await.0, 1001);
    assert_eq!(waiting.error().await.code.name(), "limit");
    assert_eq!(waiting.close().await.0, 1013);
    drop((producer, viewer, watcher, waiting));
    server.ended().await;
}
