//! Tests the program as a service: starting it, sending to it, the example clients of the guide, stopping it.

#![allow(clippy::unwrap_used, reason = "a test: a panic is its verdict")]

mod examples;
mod fair;
mod listening;
mod memory;
mod scenes;
mod sending;
mod soak;
mod tls;

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use ghostlight::camera::Pose;
use ghostlight::codec::DepthUnits;
use ghostlight::frame::ColorImage;
use ghostlight::recording::{ColorFormat, TumWriter};
use glam::{DQuat, DVec3};

const PROGRAM: &str = env!("CARGO_BIN_EXE_ghostlight-under-test");

/// The program of this build, or the one that `GHOSTLIGHT_BINARY` names, to measure a release build.
fn program() -> PathBuf {
    std::env::var_os("GHOSTLIGHT_BINARY").map_or_else(|| PROGRAM.into(), PathBuf::from)
}

/// Writes a recording of a wall 2 m away: twelve frames at 30 Hz.
fn write_recording(folder: &Path) {
    write_recording_of(folder, &vec![10_000; 320 * 240]);
}

/// The same with the given depth in every frame.
fn write_recording_of(folder: &Path, units: &[u16]) {
    let mut writer = TumWriter::create(folder, ColorFormat::Png).unwrap();
    for i in 0..12u8 {
        let color = ColorImage::filled(320, 240, [60 + i, 90, 120, 255]);
        let depth = DepthUnits {
            width: 320,
            height: 240,
            units: units.to_vec(),
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

/// Writes a scene with a pyramid on the wall.
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
        let mut command = Command::new(program());
        Self::of(
            command
                .args(["serve", "--listen", "127.0.0.1:0"])
                .args(arguments)
                .env("RUST_LOG", "warn"),
        )
    }

    fn of(command: &mut Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap())
            .read_line(&mut line)
            .unwrap();
        // `http` becomes `ws`, and `https` becomes `wss`.
        let address = line.trim().strip_prefix("listening on http").unwrap();
        Self {
            url: format!("ws{address}/ws"),
            child,
        }
    }

    /// Host and port.
    fn address(&self) -> String {
        let (_, rest) = self.url.split_once("://").unwrap();
        rest.trim_end_matches("/ws").to_owned()
    }

    /// Ends the service; returns its output on a piped stderr.
    fn log(mut self) -> String {
        let mut text = String::new();
        self.child.kill().unwrap();
        let stderr = self.child.stderr.as_mut().unwrap();
        std::io::Read::read_to_string(stderr, &mut text).unwrap();
        text
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

/// Arguments that `serve` refuses: the exit code is 2, and one line contains `part`.
fn refused(arguments: &[&str], part: &str) {
    let out = Command::new(PROGRAM)
        .arg("serve")
        .args(arguments)
        .output()
        .unwrap();
    let errors = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(2), "{arguments:?}: {errors}");
    assert!(errors.contains(part), "{arguments:?}: {errors}");
    assert_eq!(errors.trim().lines().count(), 1, "{errors}");
}

fn send(arguments: &[&str]) -> (Option<i32>, String, String) {
    let out = Command::new(program())
        .arg("send")
        .args(arguments)
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (out.status.code(), text(out.stdout), text(out.stderr))
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
        refused(&arguments, part);
    }
}

#[test]
fn log_lines_are_as_many_as_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let said = |level: &str| {
        let mut command = Command::new(PROGRAM);
        command.args(["serve", "--listen", "127.0.0.1:0"]);
        match level {
            "" => command.env_remove("RUST_LOG"),
            level => command.env("RUST_LOG", level),
        };
        let service = Service::of(command.stderr(Stdio::piped()));
        let (code, _, errors) = send(&[recording.to_str().unwrap(), "--url", &service.url]);
        assert_eq!(code, Some(0), "{errors}");
        service.log()
    };
    let lines = said("");
    // Logs connections and sessions, and nothing per frame.
    assert!(
        lines.contains("joined") && lines.contains("left"),
        "{lines}"
    );
    assert!(lines.lines().count() < 12, "{lines}");
    assert!(!lines.contains('\u{1b}'), "no colours in a file: {lines}");
    assert_eq!(said("warn"), "");
    let out = Command::new(PROGRAM)
        .args(["serve", "--listen", "127.0.0.1:0"])
        .env("RUST_LOG", "net=loud")
        .output()
        .unwrap();
    let errors = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(2), "{errors}");
    assert!(errors.contains("RUST_LOG"), "{errors}");
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
            "--retries",
            "0",
        ])
    });
    // After five composites a frame is in flight, however slow the machine is.
    until_sent(&service.address(), 5);
    service.terminate();
    assert_eq!(service.child.wait().unwrap().code(), Some(0));
    let (code, _, errors) = sender.join().unwrap();
    assert_eq!(code, Some(2));
    assert!(errors.contains("the server stops"), "{errors}");
}

/// Waits until a server without a token has sent `n` composites.
fn until_sent(address: &str, n: u64) {
    let sent = |line: &str| -> Option<u64> {
        let n = line.strip_prefix("ghostlight_composites_sent_total ")?;
        Some(n.parse().unwrap())
    };
    while metrics(address).lines().find_map(sent).unwrap() < n {
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
}

fn metrics(address: &str) -> String {
    metrics_with(address, "")
}

fn metrics_with(address: &str, headers: &str) -> String {
    use std::io::{Read, Write};
    let mut stream = std::net::TcpStream::connect(address).unwrap();
    let request =
        format!("GET /metrics HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n{headers}\r\n");
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}
