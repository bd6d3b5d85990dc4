//! Frames that take too long, and sessions that end while a frame is rendered. A frame of the fake renderer with
//! [`ENDLESS`] ends only when it is cancelled.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use ghostlight_proto::control::{ErrorReport, Reply, Stats};
use ghostlight_proto::{Composite, Frame};
use serde_json::{Value, json};

use super::client::{Client, Event, TestServer, frame, patient};
use super::fake::{ENDLESS, Fake};

const HOUR: Duration = Duration::from_secs(3600);

fn settings(id: u64, glossy_samples: u32) -> Value {
    json!({"type": "settings", "id": id, "settings": {"glossy_samples": glossy_samples}})
}

async fn until(what: &str, counter: &AtomicU64, n: u64) {
    patient(what, async {
        while counter.load(Ordering::Relaxed) < n {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    })
    .await;
}

/// A server without a deadline, and a producer whose endless frame is being rendered.
async fn busy() -> (TestServer, Client, Arc<AtomicU64>, Arc<AtomicU64>) {
    let fake = Fake::default();
    let (endless, given_up) = (Arc::clone(&fake.endless), Arc::clone(&fake.given_up));
    let server = TestServer::start(fake, |c| c.bounds.frame = HOUR).await;
    let (mut producer, _) = Client::producer(&server).await;
    producer.send(settings(1, ENDLESS)).await;
    assert_eq!(producer.answer(1).await, Ok(()));
    producer.send_bytes(frame(1, 9)).await;
    until("the frame to begin", &endless, 1).await;
    (server, producer, endless, given_up)
}

#[tokio::test]
async fn a_session_ends_with_its_owner_whatever_it_renders_and_has_queued() {
    for says_bye in [false, true] {
        let (server, mut producer, _, given_up) = busy().await;
        producer.send_bytes(frame(2, 9)).await;
        producer.send_bytes(frame(3, 9)).await;
        if says_bye {
            producer
                .send(json!({"type": "bye", "reason": "done"}))
                .await;
        }
        drop(producer);
        server.until_metric("ghostlight_sessions", |n| n == 0).await;
        // Frames that waited were not begun.
        assert_eq!(given_up.load(Ordering::Relaxed), 1);
    }
}

#[tokio::test]
async fn requests_that_wait_do_not_keep_a_session_alive() {
    let (server, mut producer, ..) = busy().await;
    for id in 0..40 {
        producer.send(settings(id, ENDLESS)).await;
    }
    drop(producer);
    server.until_metric("ghostlight_sessions", |n| n == 0).await;
}

#[tokio::test]
async fn a_frame_that_runs_long_is_given_up_for_new_settings_and_rendered_with_them() {
    let (server, mut producer, endless, given_up) = busy().await;
    producer.send(settings(2, ENDLESS)).await;
    until("the frame to begin again", &endless, 2).await;
    assert_eq!(given_up.load(Ordering::Relaxed), 1);
    producer.send(settings(3, 8)).await;
    let bytes = producer.composite().await;
    assert_eq!(Composite::decode(&bytes).unwrap().header.sequence, 1);
    assert_eq!(given_up.load(Ordering::Relaxed), 2);
    assert_eq!(server.metric("ghostlight_frames_rendered_total").await, 1);
    assert_eq!(server.metric("ghostlight_frames_dropped_total").await, 0);
}

#[tokio::test]
async fn a_server_that_stops_does_not_wait_for_a_frame_without_end() {
    let (mut server, mut producer, ..) = busy().await;
    server.stop();
    let (code, reason) = producer.close().await;
    assert_eq!((code, reason.as_str()), (1001, "the server stops"));
    server.ended().await;
}

#[tokio::test]
async fn a_producer_is_told_which_frame_took_too_long_and_goes_on() {
    let server = TestServer::start(Fake::default(), |c| {
        c.bounds.frame = Duration::from_millis(200);
    })
    .await;
    let (mut producer, _) = Client::producer(&server).await;
    producer.send_bytes(frame(1, 9)).await;
    producer.composite().await;
    producer.credit().await;
    producer.send(settings(1, ENDLESS)).await;
    assert_eq!(producer.answer(1).await, Ok(()));
    for sequence in [2, 3] {
        producer.send_bytes(frame(sequence, 9)).await;
        let error = loop {
            let error = producer.error().await;
            // The last frame, rendered again with the new settings, is too slow as well.
            if error.sequence.is_some() {
                break error;
            }
            assert_eq!(error.code.name(), "too_slow");
        };
        assert_eq!(error.sequence, Some(sequence));
        assert_eq!((error.code.name(), error.fatal), ("too_slow", false));
        assert!(error.expected.contains("0.2 s"), "{error:?}");
    }
    producer.send(settings(2, 8)).await;
    assert_eq!(producer.answer(2).await, Ok(()));
    producer.send_bytes(frame(4, 9)).await;
    loop {
        let bytes = producer.composite().await;
        producer.credit().await;
        if Composite::decode(&bytes).unwrap().header.sequence == 4 {
            break;
        }
    }
}

/// A recording has no sender: its owner is told once, and keeps the last good picture.
#[tokio::test]
async fn the_owner_of_a_recording_is_told_once_that_frames_take_too_long() {
    let fake = Fake::default();
    let given_up = Arc::clone(&fake.given_up);
    let server = TestServer::start(fake, |c| {
        c.bounds.frame = Duration::from_millis(100);
    })
    .await;
    let (mut viewer, _) = Client::join(&server, json!({"role": "viewer"})).await;
    viewer.composite().await;
    viewer.credit().await;
    for round in 0..2 {
        let before = given_up.load(Ordering::Relaxed);
        viewer.send(settings(1, ENDLESS)).await;
        until("frames to be given up", &given_up, before + 3).await;
        viewer.send(settings(2, 8)).await;
        let mut errors: Vec<ErrorReport> = Vec::new();
        let mut done = 0;
        // Reads up to a composite after the last answer.
        loop {
            match viewer.event().await {
                Event::Reply(Reply::Error(error)) => errors.push(error),
                Event::Reply(Reply::Done(_)) => done += 1,
                Event::Composite(_) => {
                    viewer.credit().await;
                    if done == 2 {
                        break;
                    }
                }
                Event::Reply(_) => {}
                Event::Closed(code, reason) => panic!("closed: {code} {reason}"),
            }
        }
        let codes: Vec<_> = errors.iter().map(|e| (e.code.name(), e.fatal)).collect();
        assert_eq!(codes, [("too_slow", false)], "round {round}");
    }
}

/// The first stats that satisfy `fit`; composites before them are acknowledged.
async fn stats_that(client: &mut Client, fit: impl Fn(&Stats) -> bool) -> Stats {
    loop {
        match client.event().await {
            Event::Reply(Reply::Stats(stats)) if fit(&stats) => return stats,
            Event::Reply(Reply::Error(error)) => panic!("{error:?}"),
            Event::Reply(_) => {}
            Event::Composite(_) => client.credit().await,
            Event::Closed(code, reason) => panic!("closed: {code} {reason}"),
        }
    }
}

/// Without a budget, it is 0.85 of the source's period; a given budget, including 0, is kept.
#[tokio::test]
async fn frames_of_a_recording_keep_its_rate_unless_asked_otherwise() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut viewer, _) = Client::join(&server, json!({"role": "viewer"})).await;
    let stats = stats_that(&mut viewer, |stats| !stats.lowered.is_empty()).await;
    assert_eq!(stats.source_period_us, Some(20_000));
    assert_eq!(stats.lowered, ["budget_ms none -> 17.0"]);
    for (limit, lowered) in [
        (json!(0), vec![]),
        (json!(40), vec!["budget_ms none -> 40.0"]),
        (json!(null), vec!["budget_ms none -> 17.0"]),
    ] {
        let settings = json!({"type": "settings", "settings": {"budget_ms": limit}});
        viewer.send(settings).await;
        stats_that(&mut viewer, |stats| stats.lowered == lowered).await;
    }
}

#[tokio::test]
async fn frames_of_a_producer_keep_the_rate_of_their_capture_times() {
    let server = TestServer::start(Fake::default(), |_| {}).await;
    let (mut producer, _) = Client::producer(&server).await;
    for sequence in 0..10 {
        let message = frame(sequence, 9);
        let mut plain = Frame::decode(&message).unwrap();
        // Captured at 25 Hz, however fast they are sent.
        plain.header.capture_ns = 40_000_000 * sequence as i64;
        producer.send_bytes(plain.encode().unwrap()).await;
        producer.composite().await;
        producer.credit().await;
    }
    let stats = stats_that(&mut producer, |stats| !stats.lowered.is_empty()).await;
    assert_eq!(stats.source_period_us, Some(40_000));
    assert_eq!(stats.lowered, ["budget_ms none -> 34.0"]);
}
