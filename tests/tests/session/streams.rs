//! Tests the service with ordinary clients.

use std::collections::BTreeSet;

use futures_util::SinkExt;
use ghostlight_proto::control::{Reply, Source};
use ghostlight_proto::{AssetChunk, Code, Codec, Composite, Frame, depth};
use serde_json::json;
use tokio_tungstenite::tungstenite::Message;

use super::client::{Client, Event, TestServer, frame, pixels};
use super::fake::{Fake, HEIGHT, WIDTH};

#[tokio::test]
async fn a_viewer_watches_a_recording() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut viewer, welcome) = Client::join(&server, json!({"role": "viewer"})).await;
    assert!(welcome.control);
    assert_eq!(welcome.stages.first().map(String::as_str), Some("ghost"));
    let Event::Reply(Reply::State(state)) = viewer.event().await else {
        panic!("no state after the welcome");
    };
    // The first recording and the first scene, because the client named none.
    assert_eq!(state.source, Source::Recording("room".to_owned()));
    assert_eq!(state.scene.as_deref(), Some("invert"));
    assert_eq!(state.settings["max_bounces"], 5);
    let mut last = None;
    for _ in 0..25 {
        let bytes = viewer.composite().await;
        viewer.credit().await;
        let composite = Composite::decode(&bytes).unwrap();
        let h = &composite.header;
        assert!(last < Some(h.sequence), "{last:?} {}", h.sequence);
        last = Some(h.sequence);
        let stamps = h.stamps.to_array();
        assert!(stamps.is_sorted(), "{stamps:?}");
        assert_eq!(h.capture_ns, h.stamps.received_ns);
        assert_eq!(h.stage_us.len(), welcome.stages.len());
        assert_eq!((h.virtual_pixels, h.stage_us[0]), (7, 1000));
        // JPEG, because the client named no format: shade 40 + index, inverted.
        let image = pixels(composite.planes.image);
        assert_eq!(image.dimensions(), (WIDTH, HEIGHT));
        let expected = 255 - 40 - (h.sequence % 10) as i32;
        assert!((i32::from(image.get_pixel(5, 5)[0]) - expected).abs() <= 2);
    }
}

/// A client need not wait for the welcome: a frame larger than the limit for a hello may follow in the same
/// packet. A wrong token is still refused.
#[tokio::test]
async fn a_frame_may_follow_the_hello_at_once() {
    let server = TestServer::start(Fake::default(), |config| {
        config.token = Some("right".to_owned());
        config.bounds.hello_bytes = 1000;
    })
    .await;
    for token in ["right", "wrong"] {
        let mut producer = Client::connect(&server).await;
        let hello = json!({"type": "hello", "version": 1, "role": "producer", "token": token});
        let bytes = frame(0, 10);
        assert!(bytes.len() > 1000);
        let hello = Message::text(hello.to_string());
        producer.ws.feed(hello).await.unwrap();
        producer.ws.feed(Message::binary(bytes)).await.unwrap();
        producer.ws.flush().await.unwrap();
        if token == "right" {
            producer.composite().await;
        } else {
            let error = producer.error().await;
            assert_eq!(error.code, Code::Unauthorized, "{error:?}");
        }
    }
}

#[tokio::test]
async fn a_producer_gets_its_own_frames_back() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let hello = json!({"role": "producer", "scene": "invert", "name": "tablet", "composite":
        {"image": "rgb8", "camera": "png", "mask": "png", "depth": "rvl"}});
    let (mut producer, _) = Client::join(&server, hello).await;
    let raw = frame(0, 10);
    let plain = Frame::decode(&raw).unwrap();
    let n = plain.header.color.n_pixels();
    let color = |codec| -> Vec<u8> {
        let image = image::RgbImage::from_raw(WIDTH, HEIGHT, plain.color.to_vec()).unwrap();
        let mut out = std::io::Cursor::new(Vec::new());
        match codec {
            Codec::Rgb8 => return plain.color.to_vec(),
            Codec::Rgba8 => return [10, 10, 10, 0].repeat(n),
            Codec::Png => image.write_to(&mut out, image::ImageFormat::Png).unwrap(),
            _ => image.write_to(&mut out, image::ImageFormat::Jpeg).unwrap(),
        }
        out.into_inner()
    };
    let units = vec![1500u16; n];
    let depths = |codec| -> Vec<u8> {
        match codec {
            Codec::U16 => units.iter().flat_map(|u| u.to_le_bytes()).collect(),
            Codec::Rvl => depth::encode_rvl(&units),
            Codec::DeltaZstd => depth::encode_delta_zstd(&units).unwrap(),
            _ => {
                let image: image::ImageBuffer<image::Luma<u16>, _> =
                    image::ImageBuffer::from_raw(WIDTH, HEIGHT, units.clone()).unwrap();
                let mut out = std::io::Cursor::new(Vec::new());
                image.write_to(&mut out, image::ImageFormat::Png).unwrap();
                out.into_inner()
            }
        }
    };
    let mut sequence = 1 << 40;
    for color_codec in [Codec::Rgb8, Codec::Rgba8, Codec::Png, Codec::Jpeg] {
        for depth_codec in [Codec::U16, Codec::Rvl, Codec::DeltaZstd, Codec::Png] {
            sequence += 1;
            let (color, depth) = (color(color_codec), depths(depth_codec));
            let mut header = plain.header;
            (header.sequence, header.color_codec, header.depth_codec) =
                (sequence, color_codec, depth_codec);
            let message = Frame {
                header,
                color: &color,
                depth: &depth,
            };
            producer.send_bytes(message.encode().unwrap()).await;
            // The mask may be missing in the composite that the client's joining caused.
            let bytes = producer.composite().await;
            producer.credit().await;
            let composite = Composite::decode(&bytes).unwrap();
            let h = &composite.header;
            assert_eq!((h.sequence, h.capture_ns), (sequence, header.capture_ns));
            assert_eq!(h.pose.translation, header.pose.translation);
            assert_eq!(h.camera, header.color);
            assert_eq!(composite.planes.image, vec![245; 3 * n], "{color_codec:?}");
            assert_eq!(pixels(composite.planes.camera).as_raw(), plain.color);
            assert_eq!(h.mask_codec, Codec::Png);
            assert_eq!(pixels(composite.planes.mask).get_pixel(0, 0)[0], 255);
            let mm = depth::decode_rvl(composite.planes.depth, n).unwrap();
            assert_eq!((mm[0], mm[n - 1]), (1000, 1000 + n as u16 - 1));
        }
    }
    let (_, sessions) = server.get("/api/v1/sessions", "").await;
    assert!(
        sessions.contains("\"live\"") && sessions.contains("tablet"),
        "{sessions}"
    );
}

#[tokio::test]
async fn a_camera_jpeg_comes_back_byte_for_byte() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let hello = json!({"role": "producer", "composite": {"image": "png", "camera": "jpeg"}});
    let (mut producer, _) = Client::join(&server, hello).await;
    let raw = frame(3, 77);
    let plain = Frame::decode(&raw).unwrap();
    let image = image::RgbImage::from_raw(WIDTH, HEIGHT, plain.color.to_vec()).unwrap();
    let mut jpeg = std::io::Cursor::new(Vec::new());
    image.write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
    let jpeg = jpeg.into_inner();
    let mut header = plain.header;
    header.color_codec = Codec::Jpeg;
    let message = Frame {
        header,
        color: &jpeg,
        depth: plain.depth,
    };
    producer.send_bytes(message.encode().unwrap()).await;
    let bytes = producer.composite().await;
    assert_eq!(Composite::decode(&bytes).unwrap().planes.camera, jpeg);
}

#[tokio::test]
async fn two_sessions_and_five_viewers_each_see_their_own() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut one, first) = Client::producer(&server).await;
    let (mut two, second) = Client::producer(&server).await;
    assert_ne!(first.session, second.session);
    let mut viewers = Vec::new();
    for (i, session) in [&first, &second, &first, &second, &first]
        .into_iter()
        .enumerate()
    {
        let hello = json!({"role": "viewer", "session": session.session,
            "composite": {"image": (["png", "rgba8"][i % 2])}});
        let (viewer, welcome) = Client::join(&server, hello).await;
        assert!(!welcome.control);
        viewers.push((viewer, session.session == first.session, i % 2 == 0));
    }
    for round in 0..10u8 {
        one.send_bytes(frame(u64::from(round), 50 + round)).await;
        two.send_bytes(frame(u64::from(round), 150 + round)).await;
        // A bad scene in one session does not affect either session.
        two.send(json!({"type": "scene", "id": 9, "scene": {"mesh": "absent.obj"}}))
            .await;
        assert_eq!(two.error().await.code.name(), "scene");
        for (viewer, of_first, png) in &mut viewers {
            let base = if *of_first { 50 } else { 150 };
            // The newest frame wins, so composites of earlier frames are skipped.
            loop {
                let bytes = viewer.composite().await;
                viewer.credit().await;
                let composite = Composite::decode(&bytes).unwrap();
                let shade = match png {
                    true => pixels(composite.planes.image).get_pixel(0, 0)[0],
                    false => composite.planes.image[0],
                };
                let number = composite.header.sequence;
                assert_eq!(u64::from(255 - shade), base + number);
                if number == u64::from(round) {
                    break;
                }
            }
        }
    }
    assert_eq!(server.metric("ghostlight_sessions").await, 2);
    assert_eq!(server.metric("ghostlight_viewers").await, 7);
    // The session of a producer that leaves ends; the other continues.
    drop(two);
    for (viewer, of_first, _) in &mut viewers {
        if !*of_first {
            let (code, reason) = viewer.close().await;
            assert_eq!(code, 1001, "{reason}");
            assert!(reason.contains("owner left"), "{reason}");
        }
    }
    one.send_bytes(frame(99, 99)).await;
    one.composite().await;
    server.until_metric("ghostlight_sessions", |n| n == 1).await;
}

#[tokio::test]
async fn a_late_viewer_sees_the_last_frame_at_once() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut producer, welcome) = Client::producer(&server).await;
    producer.send_bytes(frame(5, 20)).await;
    producer.composite().await;
    let hello = json!({"role": "viewer", "session": welcome.session});
    let (mut viewer, _) = Client::join(&server, hello).await;
    let bytes = viewer.composite().await;
    let header = Composite::decode(&bytes).unwrap().header;
    assert_eq!((header.sequence, header.dropped_composites), (5, 0));
    // If planes are requested for the first time, the frame is rendered again.
    let hello = json!({"role": "viewer", "session": welcome.session,
        "composite": {"mask": "gray8", "depth": "u16"}});
    let (mut viewer, _) = Client::join(&server, hello).await;
    loop {
        let bytes = viewer.composite().await;
        viewer.credit().await;
        let composite = Composite::decode(&bytes).unwrap();
        assert_eq!(composite.header.sequence, 5);
        if composite.header.mask_codec == Codec::Gray8 {
            assert_eq!(composite.planes.mask.len(), (WIDTH * HEIGHT) as usize);
            break;
        }
    }
}

#[tokio::test]
async fn scene_settings_and_placement_change_mid_session() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let hello = json!({"role": "viewer", "composite": {"image": "png"}});
    let (mut viewer, _) = Client::join(&server, hello).await;
    viewer.composite().await;
    viewer.credit().await;
    let changes = [
        json!({"type": "settings", "settings": {"max_bounces": 2}}),
        json!({"type": "play", "recording": "hall", "scene": "plain"}),
        json!({"type": "place", "object": "thing", "pixel": [4, 3]}),
        json!({"type": "turn", "object": "thing", "angle": 0.5}),
    ];
    for (id, mut change) in changes.into_iter().enumerate() {
        change["id"] = id.into();
        viewer.send(change).await;
        // The first frame of a recording arrives shortly after the change to it.
        while let Err(code) = viewer.answer(id as u64).await {
            assert_eq!((code.name(), id), ("object", 2));
            viewer.composite().await;
            viewer.credit().await;
            let again = json!({"type": "place", "id": 2, "object": "thing", "pixel": [4, 3]});
            viewer.send(again).await;
        }
    }
    let state = loop {
        match viewer.event().await {
            Event::Reply(Reply::State(state)) => break state,
            Event::Composite(_) => viewer.credit().await,
            _ => {}
        }
    };
    assert_eq!(state.source, Source::Recording("hall".to_owned()));
    assert_eq!(state.scene.as_deref(), Some("plain"));
    assert_eq!(state.settings["max_bounces"], 2);
    // Settings that are not given have their defaults.
    assert_eq!(state.settings["edge_samples"], 4);
    loop {
        let bytes = viewer.composite().await;
        viewer.credit().await;
        let image = pixels(Composite::decode(&bytes).unwrap().planes.image);
        if image.get_pixel(4, 3).0 == [0, 0, 255] {
            let shade = image.get_pixel(0, 0)[0];
            assert!((90..100).contains(&shade), "{shade}");
            break;
        }
    }
}

#[tokio::test]
async fn only_those_who_may_change_a_session() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    for (control, expected) in [("owner", Err("forbidden")), ("anyone", Ok(()))] {
        let hello = json!({"role": "producer", "control": control, "composite": null});
        let (mut producer, welcome) = Client::join(&server, hello).await;
        producer.send_bytes(frame(1, 1)).await;
        let hello = json!({"role": "viewer", "session": welcome.session});
        let (mut viewer, _) = Client::join(&server, hello).await;
        viewer.composite().await;
        viewer.credit().await;
        viewer
            .send(json!({"type": "turn", "id": 1, "object": "thing", "angle": 1}))
            .await;
        assert_eq!(viewer.answer(1).await.map_err(|c| c.name()), expected);
        // Only the producer may send frames, whoever else may change the scene.
        viewer.send_bytes(frame(7, 7)).await;
        assert_eq!(viewer.error().await.code.name(), "forbidden");
    }
}

#[tokio::test]
async fn uploads_become_assets() {
    let server = TestServer::start(Fake::default(), |c| {
        c.bounds.asset_bytes = 100;
        c.bounds.assets_bytes = 150;
    })
    .await;
    let (mut producer, _) = Client::producer(&server).await;
    let scene = json!({"type": "scene", "id": 1, "scene": {"mesh": "a.obj"}});
    producer.send(scene.clone()).await;
    assert_eq!(producer.answer(1).await.unwrap_err().name(), "scene");
    let announce = |upload: u32, name: &str, bytes: u64| json!({"type": "asset", "id": upload, "upload": upload, "name": name, "bytes": bytes});
    let chunk = |upload, offset, bytes: &[u8]| {
        AssetChunk {
            upload,
            offset,
            bytes,
        }
        .encode()
        .unwrap()
    };
    for (upload, name, bytes, code) in [
        (2, "../a.obj", 10, "asset"),
        (3, ".hidden", 10, "asset"),
        (4, "", 10, "asset"),
        (5, "a/b.obj", 10, "asset"),
        (6, "a.obj", 0, "asset"),
        (7, "a.obj", 101, "too_large"),
    ] {
        producer.send(announce(upload, name, bytes)).await;
        assert_eq!(
            producer.answer(upload.into()).await.unwrap_err().name(),
            code,
            "{name:?}"
        );
        producer.send_bytes(chunk(upload, 0, b"x")).await;
        assert_eq!(producer.error().await.code.name(), "asset", "{name:?}");
    }
    // Gaps and excess bytes end an upload, and its memory is free again.
    for (upload, offset, bytes) in [(10, 1, 10), (11, 0, 101)] {
        producer.send(announce(upload, "a.obj", 100)).await;
        producer
            .send_bytes(chunk(upload, offset, &vec![1; bytes]))
            .await;
        assert_eq!(
            producer.answer(upload.into()).await.unwrap_err().name(),
            "asset"
        );
    }
    producer.send(announce(20, "a.obj", 100)).await;
    producer.send(announce(21, "b.obj", 51)).await;
    assert_eq!(producer.answer(21).await.unwrap_err().name(), "too_large");
    producer.send_bytes(chunk(20, 0, &[1; 60])).await;
    producer.send_bytes(chunk(20, 60, &[2; 40])).await;
    assert_eq!(producer.answer(20).await, Ok(()));
    producer.send(scene).await;
    assert_eq!(producer.answer(1).await, Ok(()));
}

#[tokio::test]
async fn viewers_share_one_render_and_the_counts_are_told() {
    let fake = Fake::default();
    let rendered = std::sync::Arc::clone(&fake.rendered);
    let server = TestServer::start(fake, |_| {}).await;
    let (mut producer, welcome) = Client::producer(&server).await;
    let mut viewers = Vec::new();
    for _ in 0..4 {
        let hello = json!({"role": "viewer", "session": welcome.session});
        viewers.push(Client::join(&server, hello).await.0);
    }
    let mut seen = BTreeSet::new();
    for i in 0..20 {
        producer.send_bytes(frame(i, 9)).await;
        let bytes = producer.composite().await;
        producer.credit().await;
        seen.insert(Composite::decode(&bytes).unwrap().header.sequence);
        for viewer in &mut viewers {
            viewer.composite().await;
            viewer.credit().await;
        }
    }
    assert_eq!(seen.len(), 20);
    assert_eq!(rendered.load(std::sync::atomic::Ordering::Relaxed), 20);
    let stats = loop {
        if let Event::Reply(Reply::Stats(stats)) = producer.event().await
            && stats.frames_rendered == 20
        {
            break stats;
        }
    };
    assert_eq!(
        (stats.frames_received, stats.frames_dropped, stats.viewers),
        (20, 0, 5)
    );
    assert_eq!((stats.composites_sent, stats.composites_dropped), (20, 0));
    assert_eq!(server.metric("ghostlight_composites_sent_total").await, 100);
    assert_eq!(
        server
            .metric("ghostlight_stage_seconds_count{stage=\"shade\"}")
            .await,
        20
    );
}

#[tokio::test]
async fn plain_http_answers() {
    let server = TestServer::start(Fake::default(), |c| c.token = Some("secret".into())).await;
    let bearer = "Authorization: Bearer secret\r\n";
    for (path, headers, status, part) in [
        ("/healthz", "", 200, "ok"),
        ("/readyz", "", 200, "ready"),
        ("/version", "", 200, "ghostlight.v1"),
        ("/metrics", "", 401, "token"),
        ("/metrics", bearer, 200, "ghostlight_sessions 0"),
        ("/api/v1/recordings", bearer, 200, "\"room\""),
        ("/api/v1/scenes", bearer, 200, "\"invert\""),
        (
            "/api/v1/scenes",
            "Authorization: Bearer secrets\r\n",
            401,
            "token",
        ),
        ("/api/v1/sessions", bearer, 200, "[]"),
        ("/client/../Cargo.toml", "", 404, ""),
        ("/nothing", "", 404, ""),
        ("/ws", "", 400, ""),
    ] {
        let (got, body) = server.get(path, headers).await;
        assert_eq!(got, status, "{path} {headers}: {body}");
        assert!(body.contains(part), "{path}: {body}");
    }
}
