//! Tests `send`: a recording over the network, and the report about it.

use std::path::Path;
use std::process::{Command, Stdio};

use super::{PROGRAM, Service, send, until_sent, write_recording, write_scene};

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
        // However busy the machine is, each frame comes back or is reported as dropped.
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

fn read_report(path: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// A server on a given port.
fn serve_at(address: &str) -> Service {
    Service::of(
        Command::new(PROGRAM)
            .args(["serve", "--listen", address])
            .env("RUST_LOG", "warn"),
    )
}

#[test]
fn a_server_that_comes_back_is_sent_to_again() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let scene = write_scene(folder.path());
    let report = folder.path().join("report.json");
    let service = Service::start(&[]);
    let (address, url) = (service.address(), service.url.clone());
    let mut child = Command::new(PROGRAM)
        .args(["send", recording.to_str().unwrap(), "--url", &url])
        .args(["--seconds", "600", "--retries", "30"])
        .args(["--scene", scene.to_str().unwrap()])
        .args(["--report", report.to_str().unwrap()])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    until_sent(&address, 3);
    // Killed, as in a crash: no close reason is sent.
    drop(service);
    let service = serve_at(&address);
    until_sent(&address, 3);
    drop(service);
    let _service = serve_at(&address);
    until_sent(&address, 3);
    let pid = child.id().to_string();
    let killed = Command::new("kill").args(["-TERM", &pid]).status().unwrap();
    assert!(killed.success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let report = read_report(&report);
    assert_eq!(report["reconnects"], 2, "{report}");
    assert!(report["composites"].as_u64().unwrap() >= 9, "{report}");
    assert_eq!(report["ended"], "stopped by a signal", "{report}");
    let errors = report["errors"].to_string();
    assert!(errors.contains("no connection"), "{errors}");
}

#[test]
fn a_report_is_written_however_the_run_ends() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let report = folder.path().join("report.json");
    let (file, recording) = (report.to_str().unwrap(), recording.to_str().unwrap());
    let service = Service::start(&[]);
    let (address, url) = (service.address(), service.url.clone());
    let (code, _, errors) = std::thread::scope(|scope| {
        let sending = scope.spawn(|| {
            send(&[
                recording,
                "--url",
                &url,
                "--seconds",
                "600",
                "--retries",
                "2",
                "--report",
                file,
            ])
        });
        until_sent(&address, 3);
        drop(service);
        sending.join().unwrap()
    });
    assert_eq!(code, Some(2), "{errors}");
    assert!(errors.contains("2 tries later"), "{errors}");
    let written = read_report(&report);
    assert!(written["composites"].as_u64().unwrap() >= 1, "{written}");
    assert!(written["ended"].as_str().is_some(), "{written}");
    // No server at all: reported at once, also in the report file.
    let (code, table, _) = send(&[recording, "--url", &url, "--report", file]);
    assert_eq!((code, table.as_str()), (Some(2), ""));
    assert_eq!(read_report(&report)["frames_sent"], 0);
}
