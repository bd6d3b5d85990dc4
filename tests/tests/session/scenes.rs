//! Scenes that take long to load. The load of the fake's [`SLOW`] takes until it is cancelled.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use ghostlight_proto::control::Reply;
use ghostlight_proto::{AssetChunk, Code, Composite};
use serde_json::json;

use super::client::{Client, Event, TestServer, frame, patient, pixels};
use super::fake::{Fake, SLOW};

/// A server, a producer that has received a frame of the scene "invert", and the count of cancelled loads.
/// `limit` is the time limit for loading a scene.
async fn shown(limit: Duration) -> (TestServer, Client, Arc<AtomicU64>) {
    let fake = Fake::default();
    let stopped = Arc::clone(&fake.stopped_loads);
    let server = TestServer::start(fake, |c| c.bounds.load = limit).await;
    let (mut producer, _) = Client::producer(&server).await;
    // Nothing is shown before the first scene is loaded.
    assert_eq!(shade(&mut producer, 1).await, 255 - 9);
    (server, producer, stopped)
}

const HOUR: Duration = Duration::from_secs(3600);

/// Sends a frame of shade 9; returns the shade of its composite.
async fn shade(producer: &mut Client, sequence: u64) -> u8 {
    producer.send_bytes(frame(sequence, 9)).await;
    loop {
        let bytes = producer.composite().await;
        producer.credit().await;
        let composite = Composite::decode(&bytes).unwrap();
        if composite.header.sequence == sequence {
            return pixels(composite.planes.image).get_pixel(3, 3).0[0];
        }
    }
}

async fn ask(producer: &mut Client, id: u64, scene: &str) {
    producer
        .send(json!({"type": "scene", "id": id, "scene": scene}))
        .await;
}

async fn until(what: &str, counter: &AtomicU64, n: u64) {
    patient(what, async {
        while counter.load(Ordering::Relaxed) < n {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    })
    .await;
}

#[tokio::test]
async fn the_old_scene_is_shown_and_answers_while_another_is_loaded() {
    let (server, mut producer, stopped) = shown(HOUR).await;
    ask(&mut producer, 5, SLOW).await;
    for sequence in 2..5 {
        assert_eq!(shade(&mut producer, sequence).await, 255 - 9);
    }
    // Later requests are answered earlier, and refer to the scene that is shown.
    producer
        .send(json!({"type": "settings", "id": 6, "settings": {"exposure": 1.0}}))
        .await;
    let settings = producer.answer(6).await;
    producer
        .send(json!({"type": "place", "id": 7, "object": "thing", "pixel": [3, 3]}))
        .await;
    assert_eq!(producer.answer(7).await, Ok(()));
    assert_ne!(shade(&mut producer, 6).await, 255 - 9);
    let _ = settings;
    assert_eq!(stopped.load(Ordering::Relaxed), 0);
    // When the owner leaves, the session ends and its load is cancelled.
    drop(producer);
    server.until_metric("ghostlight_sessions", |n| n == 0).await;
    until("the load to stop", &stopped, 1).await;
}

#[tokio::test]
async fn the_newest_scene_wins_and_each_request_has_its_answer() {
    let (_server, mut producer, stopped) = shown(HOUR).await;
    ask(&mut producer, 5, SLOW).await;
    ask(&mut producer, 6, SLOW).await;
    ask(&mut producer, 7, "plain").await;
    let mut answers = Vec::new();
    while answers.len() < 3 {
        match producer.event().await {
            Event::Reply(Reply::Done(done)) => answers.push((done.id.unwrap(), None)),
            Event::Reply(Reply::Error(e)) => {
                assert!(e.got.contains("newer one"), "{e:?}");
                answers.push((e.id.unwrap(), Some(e.code)));
            }
            Event::Reply(_) => {}
            Event::Composite(_) => producer.credit().await,
            Event::Closed(code, reason) => panic!("closed: {code} {reason}"),
        }
    }
    let superseded = Some(Code::Scene);
    assert_eq!(answers, [(5, superseded), (6, superseded), (7, None)]);
    assert_eq!(shade(&mut producer, 2).await, 9);
    // The second load never began; neither did the first if it was replaced before it got a thread.
    assert!(stopped.load(Ordering::Relaxed) <= 1);
}

#[tokio::test]
async fn a_scene_that_takes_too_long_is_one_error_and_the_old_one_stays() {
    let (_server, mut producer, stopped) = shown(Duration::from_millis(50)).await;
    ask(&mut producer, 5, SLOW).await;
    let error = producer.error().await;
    assert_eq!((error.id, error.code), (Some(5), Code::Scene));
    assert!(error.expected.contains("at most 0.05 s"), "{error:?}");
    assert_eq!(shade(&mut producer, 2).await, 255 - 9);
    until("the load to stop", &stopped, 1).await;
    ask(&mut producer, 6, "plain").await;
    assert_eq!(producer.answer(6).await, Ok(()));
    assert_eq!(shade(&mut producer, 3).await, 9);
}

#[tokio::test]
async fn uploads_are_bounded_in_number_and_in_memory() {
    let server = TestServer::start(Fake::default(), |c| {
        c.bounds.assets = 3;
        c.bounds.session_bytes = 1 << 20;
    })
    .await;
    let (mut producer, _) = Client::producer(&server).await;
    let announce = |upload: u32, name: String, bytes: u64| json!({"type": "asset", "id": upload, "upload": upload, "name": name, "bytes": bytes});
    for upload in 0..3 {
        let name = format!("{upload}.obj");
        producer.send(announce(upload, name, 1)).await;
        let chunk = AssetChunk {
            upload,
            offset: 0,
            bytes: b"v",
        };
        producer.send_bytes(chunk.encode().unwrap()).await;
        assert_eq!(producer.answer(upload.into()).await, Ok(()));
    }
    producer.send(announce(3, "3.obj".into(), 1)).await;
    assert_eq!(producer.answer(3).await, Err(Code::TooLarge));
    // Replacing an upload does not increase their number; all of them share the session's memory.
    producer.send(announce(4, "0.obj".into(), 2 << 20)).await;
    assert_eq!(producer.answer(4).await, Err(Code::TooLarge));
    producer.send(announce(5, "0.obj".into(), 1)).await;
    let chunk = AssetChunk {
        upload: 5,
        offset: 0,
        bytes: b"w",
    };
    producer.send_bytes(chunk.encode().unwrap()).await;
    assert_eq!(producer.answer(5).await, Ok(()));
}
