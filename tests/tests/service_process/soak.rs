//! Clients without a token attack a server without pause while one legitimate client is served: memory stays
//! flat, and the legitimate client gets its composites. `GHOSTLIGHT_SOAK` gives the seconds.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use ghostlight_proto::SUBPROTOCOL;
use serde_json::json;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;

use super::memory::resident;
use super::{Service, metrics_with, send, write_recording};

const TOKEN: &str = "a token nobody guesses";

/// Duration, unless `GHOSTLIGHT_SOAK` is set.
const DEFAULT_S: u64 = 12;

/// Number of hostile clients of each kind.
const EACH: usize = 12;

/// Longest connection of a hostile client before it connects again.
const STAY: Duration = Duration::from_millis(1500);

/// Behaviour of a hostile client.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Silent,
    HalfRequest,
    Garbage,
    SilentUpgrade,
    WrongToken,
    HalfHello,
    BadFrames,
}

const KINDS: [Kind; 7] = [
    Kind::Silent,
    Kind::HalfRequest,
    Kind::Garbage,
    Kind::SilentUpgrade,
    Kind::WrongToken,
    Kind::HalfHello,
    Kind::BadFrames,
];

/// One connection. The server may end it at any point.
async fn visit(kind: Kind, address: &str) -> Option<()> {
    let mut tcp = TcpStream::connect(address).await.ok()?;
    match kind {
        Kind::Silent => {}
        Kind::HalfRequest => tcp.write_all(b"GET / HTTP/1.1\r\nHost: ").await.ok()?,
        Kind::Garbage => tcp.write_all(&[0x9C; 4000]).await.ok()?,
        _ => {
            let url = format!("ws://{address}/ws").parse().ok()?;
            let request = ClientRequestBuilder::new(url).with_sub_protocol(SUBPROTOCOL);
            let (mut ws, _) = client_async(request, tcp).await.ok()?;
            if matches!(kind, Kind::WrongToken) {
                let hello =
                    json!({"type": "hello", "version": 1, "role": "producer", "token": "guess"});
                ws.send(Message::text(hello.to_string())).await.ok()?;
                while let Some(Ok(_)) = ws.next().await {}
                return Some(());
            }
            tcp = ws.into_inner();
            let bytes: &[u8] = match kind {
                // The header of a text message of 60,000 bytes, and one byte of its payload.
                Kind::HalfHello => &[0x81, 0xFE, 0xEA, 0x60, 0, 0, 0, 0, b'{'],
                Kind::BadFrames => &[0xFF; 64],
                _ => &[],
            };
            tcp.write_all(bytes).await.ok()?;
        }
    }
    tcp.readable().await.ok()?;
    Some(())
}

async fn stranger(kind: Kind, address: String, stop: Arc<AtomicBool>, visits: Arc<AtomicU64>) {
    while !stop.load(Ordering::Relaxed) {
        let _ = tokio::time::timeout(STAY, visit(kind, &address)).await;
        visits.fetch_add(1, Ordering::Relaxed);
        // Pauses so that the kernel's table of closed connections does not overflow.
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test]
async fn memory_is_flat_beside_hostile_strangers_and_the_owner_is_served() {
    if resident(std::process::id()).is_none() {
        println!("SKIPPED: /proc does not tell the memory of processes here");
        return;
    }
    let seconds = std::env::var("GHOSTLIGHT_SOAK").map_or(DEFAULT_S, |s| s.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let report = folder.path().join("report.json");
    let service = Service::start(&["--token", TOKEN, "--handshake", "1"]);
    let address = service.address();
    let owner = std::thread::spawn({
        let arguments = [
            recording.to_str().unwrap().to_owned(),
            "--url".to_owned(),
            service.url.clone(),
            "--token".to_owned(),
            TOKEN.to_owned(),
            "--seconds".to_owned(),
            (seconds + 2).to_string(),
            "--retries".to_owned(),
            "0".to_owned(),
            "--report".to_owned(),
            report.to_str().unwrap().to_owned(),
        ];
        move || send(&arguments.each_ref().map(String::as_str))
    });
    let (stop, visits) = (
        Arc::new(AtomicBool::new(false)),
        Arc::new(AtomicU64::new(0)),
    );
    let strangers: Vec<_> = KINDS
        .iter()
        .flat_map(|&kind| std::iter::repeat_n(kind, EACH))
        .map(|kind| {
            let (stop, visits) = (Arc::clone(&stop), Arc::clone(&visits));
            tokio::spawn(stranger(kind, address.clone(), stop, visits))
        })
        .collect();
    // Threads and allocator arenas exist after two seconds; from then on memory must not grow.
    tokio::time::sleep(Duration::from_secs(2)).await;
    let (end, mut seen) = (Instant::now() + Duration::from_secs(seconds), Vec::new());
    while Instant::now() < end {
        seen.push(resident(service.child.id()).unwrap());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    // Meanwhile the legitimate client connects several times.
    for _ in 0..5 {
        let (recording, url) = (recording.to_str().unwrap().to_owned(), service.url.clone());
        let sending = move || send(&[&recording, "--url", &url, "--token", TOKEN]);
        let (code, _, errors) = tokio::task::spawn_blocking(sending).await.unwrap();
        assert_eq!(code, Some(0), "the owner beside strangers: {errors}");
    }
    stop.store(true, Ordering::Relaxed);
    let (code, table, errors) = tokio::task::spawn_blocking(move || owner.join().unwrap())
        .await
        .unwrap();
    assert_eq!(code, Some(0), "the owner's session: {errors}");
    for stranger in strangers {
        stranger.await.unwrap();
    }
    let text = std::fs::read_to_string(&report).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let told = metrics_with(&address, &format!("Authorization: Bearer {TOKEN}\r\n"));
    let turned: Vec<&str> = told
        .lines()
        .filter(|l| l.starts_with("ghostlight_turned_away_total"))
        .collect();
    let mean = |part: &[u64]| part.iter().sum::<u64>() / part.len() as u64;
    let third = seen.len() / 3;
    let (first, last) = (mean(&seen[..third]), mean(&seen[seen.len() - third..]));
    let course: Vec<u64> = seen
        .chunks(seen.len().div_ceil(10))
        .map(|p| mean(p) >> 10)
        .collect();
    println!(
        "{seconds} s, {} visits; means of tenths {course:?} KiB; first third {} KiB, last {} KiB, most {} KiB\n{table}\n{}",
        visits.load(Ordering::Relaxed),
        first >> 10,
        last >> 10,
        seen.iter().max().unwrap() >> 10,
        turned.join("\n")
    );
    assert!(report["composites"].as_u64().unwrap() > 0, "{text}");
    assert_eq!(report["frames_lost"], 0, "{text}");
    assert!(visits.load(Ordering::Relaxed) > 100);
    assert!(
        last < first + first / 20 + (4 << 20),
        "grew from {first} to {last} bytes"
    );
}
