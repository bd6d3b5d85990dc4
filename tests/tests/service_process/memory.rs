//! Measures a server's memory while hostile clients try to increase it.

use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use ghostlight_proto::{Codec, Frame, FrameHeader, Intrinsics, Pose, SUBPROTOCOL};
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

use super::{Service, send, write_recording};

type Socket = WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>;

/// Most memory that the server may use, bytes.
const MOST: u64 = 400 << 20;

/// How long the memory is watched after all clients have connected.
const WATCH: Duration = Duration::from_secs(9);

/// Resident memory of a process, bytes; `None` if the system does not report it.
pub(crate) fn resident(pid: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib << 10)
}

/// Connects and says hello; does not read the welcome.
async fn join(url: &str, hello: Value) -> Socket {
    let request = ClientRequestBuilder::new(url.parse().unwrap()).with_sub_protocol(SUBPROTOCOL);
    let (mut socket, _) = connect_async(request).await.unwrap();
    socket.send(Message::text(hello.to_string())).await.unwrap();
    socket
}

fn producer() -> Value {
    json!({"type": "hello", "version": 1, "role": "producer"})
}

/// An uncompressed VGA frame, 1.5 MB.
fn frame() -> Vec<u8> {
    let camera = Intrinsics {
        width: 640,
        height: 480,
        fx: 525.0,
        fy: 525.0,
        cx: 319.5,
        cy: 239.5,
    };
    let n = camera.n_pixels();
    let header = FrameHeader {
        sequence: 0,
        capture_ns: 0,
        pose: Pose::IDENTITY,
        color: camera,
        depth: camera,
        color_from_depth: Pose::IDENTITY,
        metres_per_unit: 0.001,
        color_codec: Codec::Rgb8,
        depth_codec: Codec::U16,
        max_depth_m: 0.0,
    };
    let (color, depth) = (vec![90; 3 * n], vec![5; 2 * n]);
    let frame = Frame {
        header,
        color: &color,
        depth: &depth,
    };
    frame.encode().unwrap()
}

/// Sends frames as fast as they are accepted; reads composites but never acknowledges them.
async fn flood_frames(url: String) {
    let (mut sink, mut stream) = join(&url, producer()).await.split();
    let frame = frame();
    let reading = async { while let Some(Ok(_)) = stream.next().await {} };
    let writing = async { while sink.send(Message::binary(frame.clone())).await.is_ok() {} };
    tokio::join!(reading, writing);
}

/// Sends invalid messages as fast as they are accepted, and never reads the answers.
async fn flood_errors(url: String) {
    let mut socket = join(&url, producer()).await;
    while socket.send(Message::text("{}")).await.is_ok() {}
}

/// Connects, sends half of a message, and disconnects.
async fn vanish(url: String) {
    loop {
        let socket = join(
            &url,
            json!({"type": "hello", "version": 1, "role": "viewer"}),
        )
        .await;
        if let MaybeTlsStream::Plain(mut tcp) = socket.into_inner() {
            // The header of a masked binary message of 1 MiB, and a few bytes of its payload.
            let mut begun = vec![0x82, 0xFF, 0, 0, 0, 0, 0, 0x10, 0, 0, 1, 2, 3, 4];
            begun.resize(4000, 0x55);
            tokio::io::AsyncWriteExt::write_all(&mut tcp, &begun)
                .await
                .unwrap();
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

#[tokio::test]
async fn memory_stays_bounded_and_flat_whatever_clients_do() {
    if resident(std::process::id()).is_none() {
        println!("SKIPPED: /proc does not tell the memory of processes here");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let recording = recording.to_str().unwrap().to_owned();
    let service = Service::start(&["--recording", &recording]);
    let url = service.url.clone();
    let good = std::thread::spawn({
        let (url, seconds) = (url.clone(), (WATCH.as_secs() + 3).to_string());
        move || send(&[&recording, "--url", &url, "--seconds", &seconds])
    });
    // Requests every plane, uncompressed, with the maximum of credits, and never reads.
    let hello = json!({"type": "hello", "version": 1, "role": "viewer", "credits": 8, "composite":
        {"image": "rgba8", "camera": "rgba8", "mask": "gray8", "depth": "u16"}});
    let _silent = join(&url, hello).await;
    let others = [
        tokio::spawn(flood_frames(url.clone())),
        tokio::spawn(flood_errors(url.clone())),
        tokio::spawn(vanish(url)),
    ];
    // Threads, allocator arenas and scenes exist after two seconds; from then on memory must not grow.
    tokio::time::sleep(Duration::from_secs(2)).await;
    let (end, mut seen) = (Instant::now() + WATCH, Vec::new());
    while Instant::now() < end {
        seen.push(resident(service.child.id()).unwrap());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    for other in &others[..2] {
        assert!(!other.is_finished(), "a flood ended before its time");
    }
    for other in others {
        other.abort();
    }
    let (code, table, errors) = tokio::task::spawn_blocking(move || good.join().unwrap())
        .await
        .unwrap();
    assert_eq!(code, Some(0), "the good session: {errors}");
    let mean = |part: &[u64]| part.iter().sum::<u64>() / part.len() as u64;
    let third = seen.len() / 3;
    let (first, last) = (mean(&seen[..third]), mean(&seen[seen.len() - third..]));
    let most = seen.iter().copied().max().unwrap();
    let mib = |bytes: u64| bytes >> 20;
    println!(
        "first third {} MiB, last {} MiB, most {} MiB\n{table}",
        mib(first),
        mib(last),
        mib(most)
    );
    assert!(most < MOST, "{} MiB at most", mib(most));
    // The number of unfinished messages varies, so a difference of a few of them is noise.
    assert!(
        last < first + first / 10 + (16 << 20),
        "grew from {} to {} MiB",
        mib(first),
        mib(last)
    );
}
