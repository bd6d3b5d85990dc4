//! WebSocket streams that break the protocol, never end, or close with a reason that is too long: each is closed
//! with the right code and a reason.

use std::time::Duration;

use ghostlight_proto::Code;
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use super::client::{Client, Event, TestServer, frame, patient};
use super::fake::Fake;

/// Everything that a server sends until it closes: texts, and code and reason of its close frame.
async fn last_words(tcp: &mut TcpStream) -> (String, u16, String) {
    let mut bytes = Vec::new();
    let _ = patient("the end", tcp.read_to_end(&mut bytes)).await;
    let (mut rest, mut texts) = (bytes.as_slice(), String::new());
    while rest.len() >= 2 {
        let (start, length) = match rest[1] {
            126 => (4, usize::from(u16::from_be_bytes([rest[2], rest[3]]))),
            127 => panic!("nothing this long is expected"),
            short => (2, usize::from(short)),
        };
        let payload = &rest[start..start + length];
        match rest[0] {
            0x81 => texts += std::str::from_utf8(payload).unwrap(),
            0x88 => {
                let code = u16::from_be_bytes([payload[0], payload[1]]);
                let reason = String::from_utf8(payload[2..].to_vec()).unwrap();
                return (texts, code, reason);
            }
            _ => {}
        }
        rest = &rest[start + length..];
    }
    panic!("closed without a reason: {texts}");
}

/// A masked frame whose mask is zero; at most 125 bytes.
fn masked(first: u8, payload: &[u8]) -> Vec<u8> {
    let mut bytes = vec![first, 0x80 | payload.len() as u8, 0, 0, 0, 0];
    bytes.extend_from_slice(payload);
    bytes
}

#[tokio::test]
async fn each_breach_of_the_protocol_has_its_close_code() {
    let server = TestServer::start(Fake::default(), |c| {
        c.bounds.message_bytes = 10_000;
        c.bounds.sessions = 16;
    })
    .await;
    let huge = [&[0x82, 0xFF][..], &(1u64 << 40).to_be_bytes(), &[0; 4]].concat();
    let cases: [(&str, Vec<u8>, u16); 9] = [
        ("reserved bits", masked(0xF1, b"{}"), 1002),
        ("unknown data frame", masked(0x83, b"x"), 1002),
        ("unknown control frame", masked(0x8B, b"x"), 1002),
        ("not masked", vec![0x81, 2, b'{', b'}'], 1002),
        ("nothing to continue", masked(0x80, b"x"), 1002),
        ("a ping in fragments", masked(0x09, b"x"), 1002),
        (
            "text within a message",
            [masked(0x01, b"{"), masked(0x81, b"}")].concat(),
            1002,
        ),
        ("not UTF-8", masked(0x81, b"\xFF\xFE"), 1007),
        ("huge", huge, 1009),
    ];
    for hello in [true, false] {
        let breach = |(name, bytes, expected): (&'static str, Vec<u8>, u16)| {
            let server = &server;
            async move {
                let client = match hello {
                    true => Client::producer(server).await.0,
                    false => Client::connect(server).await,
                };
                let mut tcp = client.ws.into_inner();
                tcp.write_all(&bytes).await.unwrap();
                let (texts, code, reason) = last_words(&mut tcp).await;
                // Before its hello, a client may send no large message, however large.
                let large = name == "huge" && !hello;
                let expected = if large { 1008 } else { expected };
                assert_eq!(code, expected, "{name}, hello: {hello}: {texts} {reason}");
                assert!(texts.contains("\"fatal\":true"), "{name}: {texts}");
                assert!(!reason.is_empty(), "{name}");
            }
        };
        futures_util::future::join_all(cases.clone().map(breach)).await;
    }
}

#[tokio::test]
async fn a_message_in_dribs_is_closed_and_says_why() {
    let server = TestServer::start(Fake::default(), |c| {
        c.bounds.message = Duration::from_millis(400);
    })
    .await;
    let (mut good, _) = Client::producer(&server).await;
    let (slow, _) = Client::producer(&server).await;
    let mut tcp = slow.ws.into_inner();
    tcp.write_all(&masked(0x02, b"begun")).await.unwrap();
    let dribbling = async {
        loop {
            // Pings between its fragments do not extend the deadline of a message.
            let more = [masked(0x89, b"here"), masked(0x00, b"x")].concat();
            if tcp.write_all(&more).await.is_err() {
                break;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
            if server
                .metric("ghostlight_turned_away_total{reason=\"slow_message\"}")
                .await
                > 0
            {
                break;
            }
        }
    };
    patient("the close", dribbling).await;
    let (texts, code, reason) = last_words(&mut tcp).await;
    assert_eq!(code, 1008, "{texts}");
    assert!(reason.contains("within 0.4 s"), "{reason}");
    good.send_bytes(frame(1, 3)).await;
    good.composite().await;
}

#[tokio::test]
async fn unfinished_messages_of_all_clients_have_one_bound() {
    const MIB: u64 = 1 << 20;
    let server = TestServer::start(Fake::default(), |c| {
        c.bounds.unfinished_bytes = 8 * MIB;
        c.bounds.connections = 24;
        c.bounds.waiting = 8;
    })
    .await;
    let (mut good, _) = Client::producer(&server).await;
    // 4 MiB are shared and each client has 128 KiB of its own: room for three messages of 1.2 MB at a time.
    let head = [&[0x82, 0xFF][..], &4_000_000u64.to_be_bytes(), &[0; 4]].concat();
    let mut all = Vec::new();
    for _ in 0..6 {
        let (client, _) = Client::producer(&server).await;
        let mut tcp = client.ws.into_inner();
        tcp.write_all(&head).await.unwrap();
        // The server may stop reading in the middle of it.
        let _ = tokio::time::timeout(Duration::from_secs(3), tcp.write_all(&[0; 1_300_000])).await;
        all.push(tcp);
    }
    server
        .until_metric("ghostlight_turned_away_total{reason=\"unfinished\"}", |n| {
            n == 3
        })
        .await;
    let (texts, code, _) = last_words(&mut all[5]).await;
    assert_eq!(code, 1013, "{texts}");
    assert!(texts.contains("unfinished"), "{texts}");
    // Messages of ordinary size fit in each client's own part.
    for number in 0..5 {
        good.send_bytes(frame(number, 3)).await;
        good.composite().await;
        good.credit().await;
    }
    // The memory of the unfinished messages is free again.
    drop(all);
    server
        .until_metric("ghostlight_connections", |n| n == 1)
        .await;
    good.send_bytes(vec![7; 4_000_000]).await;
    assert_eq!(good.error().await.code, Code::Malformed);
}

#[tokio::test]
async fn a_hello_has_a_size() {
    let server = TestServer::start(Fake::default(), |c| c.bounds.hello_bytes = 5000).await;
    let client = Client::connect(&server).await;
    let mut tcp = client.ws.into_inner();
    // Only the header: the announced size is enough.
    let head = [&[0x81, 0xFE][..], &5001u16.to_be_bytes(), &[0; 4]].concat();
    tcp.write_all(&head).await.unwrap();
    let (texts, code, _) = last_words(&mut tcp).await;
    assert_eq!(code, 1008, "{texts}");
    assert!(texts.contains("too large"), "{texts}");
    let name = "x".repeat(60);
    let (mut good, _) = Client::join(
        &server,
        json!({"role": "viewer", "name": name, "pad": "y".repeat(4000)}),
    )
    .await;
    // After that, messages may be as large as the server's limit.
    good.send(json!({"type": "settings", "id": 3, "settings": {}, "pad": "y".repeat(20_000)}))
        .await;
    assert_eq!(good.answer(3).await, Ok(()));
}

#[tokio::test]
async fn a_reason_comes_back_no_longer_than_a_close_holds() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut client, _) = Client::producer(&server).await;
    client
        .send(json!({"type": "bye", "reason": "é".repeat(100_000)}))
        .await;
    let bye = loop {
        if let Event::Reply(ghostlight_proto::control::Reply::Bye(bye)) = client.event().await {
            break bye;
        }
    };
    assert_eq!(bye.reason, "é".repeat(61));
    assert_eq!(client.close().await, (1000, bye.reason));
}

#[tokio::test]
async fn a_request_that_is_too_large_is_refused_by_its_number() {
    let server = TestServer::start(Fake::default(), |c| c.bounds.scene_bytes = 20_000).await;
    let (mut client, _) = Client::producer(&server).await;
    let pad = "x".repeat(30_000);
    for text in [
        format!("{{\"type\":\"scene\",\"id\":41,\"scene\":{{\"pad\":\"{pad}\"}}}}"),
        format!("{{\"type\":\"scene\",\"scene\":{{\"pad\":\"{pad}\"}},\"id\":41}}"),
    ] {
        client.send(serde_json::from_str(&text).unwrap()).await;
        let error = client.error().await;
        assert_eq!((error.code, error.id), (Code::TooLarge, Some(41)));
    }
}

#[tokio::test]
async fn a_hellos_scene_that_does_not_fit_the_first_frame_is_told() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    for role in ["viewer", "producer"] {
        let hello = json!({"type": "hello", "version": 1, "id": 77, "role": role, "scene": "misfit",
            "composite": {"image": "png"}});
        let mut client = Client::connect(&server).await;
        client.send(hello).await;
        let mut number = 0;
        let error = patient("its error", async {
            loop {
                if role == "producer" && number < 2 {
                    number += 1;
                    client.send_bytes(frame(number, 3)).await;
                }
                match client.event().await {
                    Event::Reply(ghostlight_proto::control::Reply::Error(e)) => return e,
                    Event::Composite(_) => client.credit().await,
                    _ => {}
                }
            }
        })
        .await;
        assert_eq!((error.code, error.id), (Code::Scene, Some(77)), "{role}");
        assert!(!error.fatal, "{role}");
        // The session continues without this client.
        if role == "producer" {
            client.send_bytes(frame(9, 3)).await;
        }
        client.composite().await;
    }
}
