//! `send`: a recording over the network, and what it says of it.

use super::{Service, send, write_recording, write_scene};

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
