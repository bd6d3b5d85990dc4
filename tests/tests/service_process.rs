//! The program itself as a service: started, sent to, asked by the clients of the guide, told
//! to stop.

#![allow(clippy::unwrap_used, reason = "a test: a panic is its verdict")]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use ghostlight::camera::Pose;
use ghostlight::codec::DepthUnits;
use ghostlight::frame::ColorImage;
use ghostlight::recording::{ColorFormat, TumWriter};
use glam::{DQuat, DVec3};

const PROGRAM: &str = env!("CARGO_BIN_EXE_ghostlight-under-test");

/// A wall 2 m away, seen twelve times at 30 Hz.
fn write_recording(folder: &Path) {
    let mut writer = TumWriter::create(folder, ColorFormat::Png).unwrap();
    for i in 0..12u8 {
        let color = ColorImage::filled(320, 240, [60 + i, 90, 120, 255]);
        let depth = DepthUnits {
            width: 320,
            height: 240,
            units: vec![10_000; 320 * 240],
        };
        let translation = DVec3::new(0.001 * f64::from(i), 0.0, 0.0);
        let pose = Pose {
            rotation: DQuat::IDENTITY,
            translation,
        };
        writer
            .push(
                &color,
                &depth,
                1_000_000_000 + i64::from(i) * 33_333_000,
                &pose,
            )
            .unwrap();
    }
    writer.finish().unwrap();
}

/// A pyramid on the wall, as a scene.
fn write_scene(folder: &Path) -> PathBuf {
    let mesh = "v -1 0 -1\nv 1 0 -1\nv 0 0 1\nv 0 1 0\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    std::fs::write(folder.join("pyramid.obj"), mesh).unwrap();
    let scene = r#"{"version":1,"objects":[{"name":"pyramid","mesh":"pyramid.obj",
        "place":{"pixel":[160,120],"size_m":0.4},"material":{"preset":"mirror"}}]}"#;
    let path = folder.join("pyramid.json");
    std::fs::write(&path, scene).unwrap();
    path
}

struct Service {
    child: Child,
    url: String,
}

impl Service {
    fn start(arguments: &[&str]) -> Self {
        let mut child = Command::new(PROGRAM)
            .args(["serve", "--listen", "127.0.0.1:0"])
            .args(arguments)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap())
            .read_line(&mut line)
            .unwrap();
        let address = line.trim().strip_prefix("listening on http://").unwrap();
        Self {
            url: format!("ws://{address}/ws"),
            child,
        }
    }

    fn terminate(&self) {
        let pid = self.child.id().to_string();
        assert!(
            Command::new("kill")
                .args(["-TERM", &pid])
                .status()
                .unwrap()
                .success()
        );
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn send(arguments: &[&str]) -> (Option<i32>, String, String) {
    let out = Command::new(PROGRAM)
        .arg("send")
        .args(arguments)
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (out.status.code(), text(out.stdout), text(out.stderr))
}

#[test]
fn send_reports_every_frame() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let scene = write_scene(folder.path());
    let service = Service::start(&[]);
    let report = folder.path().join("report.json");
    for rate in ["realtime", "max"] {
        let (code, table, errors) = send(&[
            recording.to_str().unwrap(),
            "--url",
            &service.url,
            "--rate",
            rate,
            "--scene",
            scene.to_str().unwrap(),
            "--report",
            report.to_str().unwrap(),
        ]);
        assert_eq!(code, Some(0), "{errors}");
        assert!(
            table.contains("latency") && table.contains("render"),
            "{table}"
        );
        let text = std::fs::read_to_string(&report).unwrap();
        let report: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(report["frames_sent"], 12, "{text}");
        assert_eq!(report["frames_refused"], 0, "{text}");
        // However busy the machine is: each frame came back, or was told to be dropped.
        assert_eq!(report["frames_lost"], 0, "{text}");
        let sum = |a: &str, b: &str| report[a].as_u64().unwrap() + report[b].as_u64().unwrap();
        let skipped = sum("frames_dropped", "composites_dropped");
        assert_eq!(
            report["composites"].as_u64().unwrap() + skipped,
            12,
            "{text}"
        );
        assert!(
            report["stages"]["primary"]["median_ms"].as_f64().unwrap() > 0.0,
            "{text}"
        );
    }
}

#[test]
fn send_says_in_one_line_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let recording = recording.to_str().unwrap();
    let service = Service::start(&["--token", "right"]);
    for (arguments, part) in [
        (vec!["/nowhere", "--url", &service.url], "/nowhere"),
        (
            vec![recording, "--url", "ws://127.0.0.1:1/ws"],
            "ws://127.0.0.1:1/ws",
        ),
        (vec![recording, "--url", &service.url], "token"),
        (
            vec![
                recording,
                "--url",
                &service.url,
                "--token",
                "right",
                "--server-scene",
                "x",
            ],
            "scene",
        ),
    ] {
        let (code, _, errors) = send(&arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {errors}");
        assert!(errors.contains(part), "{arguments:?}: {errors}");
        assert_eq!(errors.trim().lines().count(), 1, "{errors}");
    }
}

#[test]
fn serve_refuses_what_would_be_unsafe() {
    for (arguments, part) in [
        (vec!["--listen", "0.0.0.0:0"], "token"),
        (
            vec!["--listen", "127.0.0.1:0", "--recording", "/nowhere"],
            "/nowhere",
        ),
        (
            vec!["--listen", "127.0.0.1:0", "--scene", "/nowhere"],
            "/nowhere",
        ),
    ] {
        let out = Command::new(PROGRAM)
            .arg("serve")
            .args(&arguments)
            .output()
            .unwrap();
        let errors = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(2), "{arguments:?}: {errors}");
        assert!(errors.contains(part), "{errors}");
    }
}

#[cfg(unix)]
#[test]
fn sigterm_closes_with_a_reason_and_exits_0() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let mut service = Service::start(&["--recording", recording.to_str().unwrap()]);
    let url = service.url.clone();
    let sender = std::thread::spawn(move || {
        send(&[
            recording.to_str().unwrap(),
            "--url",
            &url,
            "--seconds",
            "600",
        ])
    });
    // Long enough under way that a frame is in flight, however slow the machine.
    let address = service
        .url
        .trim_start_matches("ws://")
        .trim_end_matches("/ws")
        .to_owned();
    while !metrics(&address).lines().any(|line| {
        let sent = line.strip_prefix("ghostlight_composites_sent_total ");
        sent.is_some_and(|n| n.parse::<u64>().unwrap() >= 5)
    }) {
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    service.terminate();
    assert_eq!(service.child.wait().unwrap().code(), Some(0));
    let (code, _, errors) = sender.join().unwrap();
    assert_eq!(code, Some(2));
    assert!(errors.contains("the server stops"), "{errors}");
}

fn metrics(address: &str) -> String {
    use std::io::{Read, Write};
    let mut stream = std::net::TcpStream::connect(address).unwrap();
    let request = format!("GET /metrics HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// Whether a client of the guide can run here; says so loudly if not, and fails if it must.
fn can_run(what: &str, probe: &mut Command) -> bool {
    let works = probe.output().is_ok_and(|out| out.status.success());
    if !works {
        println!("SKIPPED: {what} is not here");
        let required = std::env::var("GHOSTLIGHT_REQUIRE").unwrap_or_default();
        assert!(!required.contains("examples"), "{what} is required");
    }
    works
}

fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../proto/examples")
        .join(name)
}

#[test]
fn the_python_client_of_the_guide_runs() {
    let probe = ["-c", "import websockets, numpy"];
    if !can_run(
        "Python with websockets and numpy",
        Command::new("python3").args(probe),
    ) {
        return;
    }
    let service = Service::start(&["--token", "right"]);
    let folder = tempfile::tempdir().unwrap();
    let run = |token: &str| {
        let mut command = Command::new("python3");
        command
            .arg(example("minimal.py"))
            .args([&service.url, token]);
        command.current_dir(folder.path()).output().unwrap()
    };
    let out = run("right");
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(
        out.status.success(),
        "{}",
        String::from_utf8_lossy(&out.stderr)
    );
    assert_eq!(
        text.lines().filter(|l| l.starts_with("frame ")).count(),
        10,
        "{text}"
    );
    let picture = image::open(folder.path().join("composite.jpg"))
        .unwrap()
        .to_rgb8();
    assert_eq!(picture.dimensions(), (320, 240));
    assert!((i32::from(picture.get_pixel(9, 9)[0]) - 128).abs() <= 2);
    let out = run("wrong");
    assert!(!out.status.success());
    assert!(String::from_utf8_lossy(&out.stderr).contains("token"));
}

#[test]
fn the_javascript_client_of_the_guide_runs() {
    let probe = [
        "-e",
        "process.exit(typeof WebSocket === 'function' ? 0 : 1)",
    ];
    if !can_run("Node 22 or later", Command::new("node").args(probe)) {
        return;
    }
    let service = Service::start(&[]);
    let mut command = Command::new("node");
    let out = command
        .arg(example("minimal.mjs"))
        .arg(&service.url)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(
        out.status.success(),
        "{}",
        String::from_utf8_lossy(&out.stderr)
    );
    assert_eq!(
        text.lines().filter(|l| l.starts_with("frame ")).count(),
        10,
        "{text}"
    );
}
