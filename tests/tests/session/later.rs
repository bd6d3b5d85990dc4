//! Changes and reports of clients after they have joined: planes, placements, their own times.

use ghostlight_proto::control::{Reply, Stands, State};
use ghostlight_proto::{Codec, Composite, CompositeHeader};
use serde_json::{Value, json};

use super::client::{Client, Event, TestServer, frame, pixels};
use super::fake::{Fake, HEIGHT, WIDTH};

/// Sends a frame and receives its composite; returns the header and the size of the message.
async fn next(client: &mut Client, number: u64) -> (CompositeHeader, usize) {
    client.send_bytes(frame(number, 9)).await;
    loop {
        let bytes = client.composite().await;
        client.credit().await;
        let header = Composite::decode(&bytes).unwrap().header;
        if header.sequence == number {
            return (header, bytes.len());
        }
    }
}

#[tokio::test]
async fn planes_come_and_go_on_demand() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let hello = json!({"role": "producer", "composite": {"image": "rgb8"}});
    let (mut producer, welcome) = Client::join(&server, hello).await;
    assert_eq!(welcome.revision, 3);
    let hello =
        json!({"role": "viewer", "session": welcome.session, "composite": {"image": "rgb8"}});
    let (mut other, _) = Client::join(&server, hello).await;
    let n = (WIDTH * HEIGHT) as usize;
    let (header, bare) = next(&mut producer, 1).await;
    assert_eq!(header.camera_codec, Codec::None);
    // Each change, the planes after it, and the number of bytes that they add.
    let cases = [
        (json!({"camera": "rgb8"}), "camera", 3 * n),
        (json!({"camera": "none", "mask": "gray8"}), "mask", n),
        (json!({"depth": "u16"}), "mask depth", 3 * n),
        (
            json!({"mask": "none", "depth": "none", "quality": 50}),
            "",
            0,
        ),
    ];
    for (i, (mut change, planes, more)) in cases.into_iter().enumerate() {
        let id = i as u64 + 10;
        change["type"] = "planes".into();
        change["id"] = id.into();
        producer.send(change).await;
        assert_eq!(producer.answer(id).await, Ok(()));
        // The newest composite is sent again, with the requested planes.
        let (header, bytes) = loop {
            let bytes = producer.composite().await;
            producer.credit().await;
            let header = Composite::decode(&bytes).unwrap().header;
            // A plane that the renderer has to produce may arrive one render later.
            let wanted = ["mask", "depth"].map(|p| planes.contains(p));
            let there = [header.mask_codec, header.depth_codec].map(|c| c != Codec::None);
            if wanted == there {
                break (header, bytes.len());
            }
        };
        assert_eq!(header.sequence, i as u64 + 1, "{planes}");
        assert_eq!(header.dropped_composites, 0, "{planes}");
        assert_eq!(bytes, bare + more, "{planes}");
        let (header, bytes) = next(&mut producer, i as u64 + 2).await;
        assert_eq!(header.camera_codec != Codec::None, planes == "camera");
        assert_eq!(bytes, bare + more, "{planes}: the next frame");
    }
    // The planes of other clients have not changed.
    other.composite().await;
    other.credit().await;
    let bytes = other.composite().await;
    assert_eq!(bytes.len(), bare);
}

#[tokio::test]
async fn planes_that_cannot_be_are_refused_and_nothing_changes() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let hello = json!({"role": "producer", "composite": null});
    let (mut silent, _) = Client::join(&server, hello).await;
    silent
        .send(json!({"type": "planes", "id": 1, "camera": "png"}))
        .await;
    assert_eq!(silent.answer(1).await.unwrap_err().name(), "forbidden");
    let (mut producer, _) = Client::producer(&server).await;
    for (change, code) in [
        (json!({"camera": "rvl"}), "codec"),
        (json!({"image": "none"}), "codec"),
        (json!({"quality": 101}), "malformed"),
        (json!({"camera": 3}), "malformed"),
    ] {
        let mut request: Value = change.clone();
        request["type"] = "planes".into();
        request["id"] = 5.into();
        producer.send(request).await;
        assert_eq!(
            producer.answer(5).await.unwrap_err().name(),
            code,
            "{change}"
        );
    }
    let (header, _) = next(&mut producer, 1).await;
    assert_eq!(
        (header.image_codec, header.camera_codec),
        (Codec::Png, Codec::None)
    );
}

#[tokio::test]
async fn who_asks_for_planes_again_and_again_does_not_keep_the_renderer_busy() {
    let fake = Fake::default();
    let rendered = std::sync::Arc::clone(&fake.rendered);
    let server = TestServer::start(fake, |_| {}).await;
    let (mut producer, welcome) = Client::producer(&server).await;
    next(&mut producer, 1).await;
    let hello = json!({"role": "viewer", "session": welcome.session});
    let (mut viewer, _) = Client::join(&server, hello).await;
    let start = std::time::Instant::now();
    for id in 0..300 {
        let mask = ["gray8", "none"][id as usize % 2];
        viewer
            .send(json!({"type": "planes", "id": id, "mask": mask}))
            .await;
        assert_eq!(viewer.answer(id).await, Ok(()));
    }
    // One render for the frame, and at most ten per second for the planes.
    let most = 3 + start.elapsed().as_millis() as u64 / 100;
    let n = rendered.load(std::sync::atomic::Ordering::Relaxed);
    assert!(n <= most, "{n} renders, expected at most {most}");
    next(&mut producer, 2).await;
}

/// The next state.
async fn state(client: &mut Client) -> State {
    loop {
        match client.event().await {
            Event::Reply(Reply::State(state)) => return state,
            Event::Composite(_) => client.credit().await,
            Event::Reply(Reply::Error(e)) => panic!("{e:?}"),
            _ => {}
        }
    }
}

#[tokio::test]
async fn an_object_is_put_back_where_a_state_had_it() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut producer, _) = Client::producer(&server).await;
    assert_eq!(state(&mut producer).await.objects[0].stands, None);
    next(&mut producer, 1).await;
    let mut stood: Option<Stands> = None;
    for change in [
        json!({"type": "place", "object": "thing", "pixel": [4, 3]}),
        json!({"type": "turn", "object": "thing", "angle": 0.5}),
    ] {
        producer.send(change).await;
        stood = state(&mut producer).await.objects[0].stands;
    }
    let stood = stood.unwrap();
    assert!((stood.turned - 0.5).abs() < 1e-12, "{stood:?}");
    // Another session, as after a restart, before any frame has arrived.
    let (mut again, _) = Client::producer(&server).await;
    state(&mut again).await;
    let request = json!({"type": "place", "id": 3, "object": "thing", "stands": stood});
    again.send(request).await;
    assert_eq!(again.answer(3).await, Ok(()));
    again.send_bytes(frame(1, 9)).await;
    let bytes = again.composite().await;
    let image = pixels(Composite::decode(&bytes).unwrap().planes.image);
    assert_eq!(image.get_pixel(4, 3).0, [0, 0, 255]);
    again
        .send(json!({"type": "place", "id": 4, "object": "cup", "stands": stood}))
        .await;
    assert_eq!(again.answer(4).await.unwrap_err().name(), "object");
}

#[tokio::test]
async fn times_that_clients_report_are_in_the_metrics() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut producer, _) = Client::producer(&server).await;
    let credits = "ghostlight_step_seconds_count{step=\"received_to_credit\"}";
    let latency = "ghostlight_client_seconds_count{step=\"received_to_drawn\"}";
    let draw = "ghostlight_client_seconds_count{step=\"arrived_to_drawn\"}";
    for (i, times) in [
        json!({}),
        json!({"latency_us": 40_000, "draw_us": 3000}),
        json!({"latency_us": 40_000}),
    ]
    .into_iter()
    .enumerate()
    {
        producer.send_bytes(frame(i as u64, 9)).await;
        producer.composite().await;
        let mut credit = times;
        credit["type"] = "credit".into();
        producer.send(credit.clone()).await;
        // Returning a credit that was not used gives no credit and reports no times.
        producer.send(credit).await;
    }
    server.until_metric(credits, |n| n == 3).await;
    assert_eq!(server.metric(latency).await, 2);
    assert_eq!(server.metric(draw).await, 1);
    let below = |bound| {
        format!("ghostlight_client_seconds_bucket{{step=\"received_to_drawn\",le=\"{bound}\"}}")
    };
    assert_eq!(server.metric(&below("0.033")).await, 0);
    assert_eq!(server.metric(&below("0.05")).await, 2);
}
