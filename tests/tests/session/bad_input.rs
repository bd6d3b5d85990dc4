//! Bad messages: one clear error each, and the next frame unharmed.

use futures_util::{SinkExt, StreamExt};
use ghostlight_proto::{Code, Codec, Composite, Frame, SUBPROTOCOL};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;

use super::client::{Client, Event, TestServer, frame, patient};
use super::fake::Fake;

enum Bad {
    Bytes(Vec<u8>),
    Text(String),
}

/// A frame with other payloads.
fn with(color_codec: Codec, color: &[u8], depth_codec: Codec, depth: &[u8]) -> Bad {
    let raw = frame(1, 1);
    let plain = Frame::decode(&raw).unwrap();
    let mut header = plain.header;
    (header.color_codec, header.depth_codec) = (color_codec, depth_codec);
    let color = if color.is_empty() { plain.color } else { color };
    let depth = if depth.is_empty() { plain.depth } else { depth };
    Bad::Bytes(
        Frame {
            header,
            color,
            depth,
        }
        .encode()
        .unwrap(),
    )
}

fn picture(width: u32, height: u32, format: image::ImageFormat) -> Vec<u8> {
    let mut out = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(width, height)
        .write_to(&mut out, format)
        .unwrap();
    out.into_inner()
}

fn cases() -> Vec<(&'static str, Code, Bad)> {
    let put = |offset: usize, value: &[u8]| {
        let mut bytes = frame(1, 1);
        bytes[offset..offset + value.len()].copy_from_slice(value);
        Bad::Bytes(bytes)
    };
    let text = |text: &str| Bad::Text(text.to_owned());
    let good = frame(1, 1);
    let jpeg = picture(32, 24, image::ImageFormat::Jpeg);
    let png = picture(32, 24, image::ImageFormat::Png);
    let mut corrupt = png.clone();
    corrupt[60] ^= 0xFF;
    // 26 MB of zeros in 26 KB.
    let bomb = picture(3000, 3000, image::ImageFormat::Png);
    let zeros = ghostlight_proto::depth::encode_delta_zstd(&vec![0; 8 << 20]).unwrap();
    let rvl = ghostlight_proto::depth::encode_rvl(&vec![7; 32 * 24]);
    vec![
        ("empty", Code::Malformed, Bad::Bytes(vec![])),
        ("garbage", Code::Malformed, Bad::Bytes(vec![7; 300])),
        (
            "truncated header",
            Code::Malformed,
            Bad::Bytes(good[..100].to_vec()),
        ),
        (
            "truncated payload",
            Code::Length,
            Bad::Bytes(good[..good.len() - 9].to_vec()),
        ),
        (
            "trailing bytes",
            Code::Length,
            Bad::Bytes([&good[..], b"x"].concat()),
        ),
        ("version", Code::Version, put(2, &[9])),
        ("kind", Code::UnknownType, put(3, &[77])),
        ("a composite", Code::UnknownType, put(3, &[2])),
        ("NaN pose", Code::Pose, put(32, &f64::NAN.to_le_bytes())),
        ("not a rotation", Code::Pose, put(48, &3f64.to_le_bytes())),
        (
            "NaN extrinsics",
            Code::Pose,
            put(160, &f64::NAN.to_le_bytes()),
        ),
        ("zero fx", Code::Intrinsics, put(88, &0f64.to_le_bytes())),
        (
            "negative fy",
            Code::Intrinsics,
            put(96, &(-1f64).to_le_bytes()),
        ),
        ("zero width", Code::Size, put(80, &0u32.to_le_bytes())),
        ("other size", Code::Size, put(80, &33u32.to_le_bytes())),
        ("colour codec", Code::Codec, put(224, &[18])),
        ("depth codec", Code::Codec, put(225, &[1])),
        (
            "no JPEG",
            Code::Decode,
            with(Codec::Jpeg, b"not a JPEG", Codec::U16, b""),
        ),
        (
            "cut JPEG",
            Code::Decode,
            with(Codec::Jpeg, &jpeg[..jpeg.len() / 2], Codec::U16, b""),
        ),
        (
            "PNG as JPEG",
            Code::Decode,
            with(Codec::Jpeg, &png, Codec::U16, b""),
        ),
        (
            "corrupt PNG",
            Code::Decode,
            with(Codec::Png, &corrupt, Codec::U16, b""),
        ),
        (
            "PNG bomb",
            Code::Size,
            with(Codec::Png, &bomb, Codec::U16, b""),
        ),
        (
            "depth not grey",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::Png, &png),
        ),
        (
            "cut RVL",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::Rvl, &rvl[..rvl.len() - 4]),
        ),
        (
            "RVL noise",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::Rvl, &[0xFF; 64]),
        ),
        (
            "zstd noise",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::DeltaZstd, &[0xFF; 64]),
        ),
        (
            "zstd bomb",
            Code::Decode,
            with(Codec::Rgb8, b"", Codec::DeltaZstd, &zeros),
        ),
        ("not JSON", Code::Malformed, text("{")),
        ("no object", Code::Malformed, text("3")),
        (
            "unknown type",
            Code::UnknownType,
            text(r#"{"type":"dance"}"#),
        ),
        (
            "second hello",
            Code::Hello,
            text(r#"{"type":"hello","version":1,"role":"viewer"}"#),
        ),
        (
            "settings",
            Code::Settings,
            text(r#"{"type":"settings","settings":{"bounces":1}}"#),
        ),
        (
            "setting's range",
            Code::Settings,
            text(r#"{"type":"settings","settings":{"max_bounces":99}}"#),
        ),
        (
            "setting's kind",
            Code::Settings,
            text(r#"{"type":"settings","settings":{"max_bounces":"a"}}"#),
        ),
        (
            "absent asset",
            Code::Scene,
            text(r#"{"type":"scene","scene":{"mesh":"b.obj"}}"#),
        ),
        (
            "absent scene",
            Code::NotFound,
            text(r#"{"type":"scene","scene":"nowhere"}"#),
        ),
        (
            "absent object",
            Code::Object,
            text(r#"{"type":"turn","object":"cup","angle":1}"#),
        ),
        (
            "play on live",
            Code::Forbidden,
            text(r#"{"type":"play","recording":"room"}"#),
        ),
        (
            "large message",
            Code::TooLarge,
            Bad::Bytes(vec![0; 300_000]),
        ),
        (
            "large text",
            Code::TooLarge,
            Bad::Text(format!("[{}]", "1,".repeat(20_000))),
        ),
    ]
}

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
        // Any second error would come before this composite.
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
        2
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
    // None of them harmed the session.
    owner.send_bytes(frame(6, 6)).await;
    owner.composite().await;
    drop(owner);
    server
        .until_metric("ghostlight_connections", |n| n == 0)
        .await;
    assert_eq!(server.get("/metrics", "").await.0, 401);
}

#[tokio::test]
async fn a_message_far_too_large_is_told_before_the_close() {
    let server = TestServer::start(Fake::default(), |c| c.bounds.message_bytes = 10_000).await;
    let (producer, _) = Client::producer(&server).await;
    let (mut sink, stream) = producer.ws.split();
    // The server stops reading within the message, so writing it may never end.
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
    let server = TestServer::start(Fake::default(), |c| c.bounds.connections = 1).await;
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
    let first = try_it(|r| r.with_sub_protocol(SUBPROTOCOL)).await;
    assert!(first.is_ok());
    let second = try_it(|r| r.with_sub_protocol(SUBPROTOCOL)).await;
    assert_eq!(second.err(), Some(503));
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
