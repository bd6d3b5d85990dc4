//! One client requests as much as possible; another sends a camera's frames at the same time.
//!
//! A measurement, not a test: it prints the rate and latency of the ordinary client, alone and beside the
//! demanding one, and runs only with GHOSTLIGHT_MEASURE=1. GHOSTLIGHT_BINARY names the program to measure, a
//! release build, and GHOSTLIGHT_RECORDING a recording for the ordinary client; without them, those of this build
//! are used.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use serde_json::{Value, json};

use super::{Service, program};

/// Objects and lights of the demanding scene.
const CUBES: usize = 3000;
const LIGHTS: usize = 1000;

/// Every setting at its maximum.
fn most() -> Value {
    json!({
        "shadows": {"method": "naive", "samples": 256, "filter_radius_px": 4},
        "caustics": {"enabled": true, "photons": 4_000_000, "radius_m": 0.1},
        "ambient": {"samples": 256},
        "max_bounces": 8, "glossy_samples": 64, "edge_samples": 64, "edge_contrast": 0.0,
        "lod_error_px": 0.0, "budget_ms": 0.0,
        "lens": {"radius_m": 0.1, "samples": 256, "noise_threshold": 0.0},
        "bloom": {"enabled": true, "method": "gaussians", "levels": 8, "threshold": 0.0},
        "glare": {"enabled": true, "passes": 5, "samples": 16, "threshold": 0.0},
    })
}

/// Writes the scene of glass cubes and lights; returns its path.
fn write_cubes(folder: &Path) -> PathBuf {
    let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\nv 1 1 1\n";
    let faces = "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n";
    std::fs::write(folder.join("cube.obj"), format!("{corners}{faces}")).unwrap();
    let at = |i: usize, per_row: usize, from: f64, step: f64| from + (i % per_row) as f64 * step;
    let cube = |i: usize| {
        let place = [
            at(i, 20, -0.5, 0.05),
            at(i / 20, 15, -0.4, 0.055),
            at(i / 300, 10, 0.6, 0.1),
        ];
        json!({"mesh": "cube.obj", "material": {"preset": "glass"},
            "place": {"frame": "first_camera", "translation": place, "scale": 0.03}})
    };
    let light = |i: usize| {
        let position = [at(i, 40, -1.0, 0.05), -0.8, at(i / 40, 25, 0.2, 0.08)];
        json!({"type": "sphere", "frame": "first_camera", "position": position, "radius": 0.05,
            "intensity": [0.02, 0.02, 0.02]})
    };
    let scene = json!({"version": 1, "objects": (0..CUBES).map(cube).collect::<Vec<_>>(),
        "lights": (0..LIGHTS).map(light).collect::<Vec<_>>()});
    let path = folder.join("cubes.json");
    std::fs::write(&path, scene.to_string()).unwrap();
    path
}

/// Frames per second of the ordinary client, and median and 95th percentile of its latency from capture to
/// arrival, milliseconds.
fn good(program: &Path, url: &str, recording: &Path, folder: &Path, scene: &str) -> [f64; 3] {
    let report = folder.join("good.json");
    let done = Command::new(program)
        .args(["send", recording.to_str().unwrap(), "--url", url])
        .args(["--server-scene", scene, "--seconds", "20", "--report"])
        .arg(&report)
        .output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
    let report: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    let number = |value: &Value| value.as_f64().unwrap();
    let latency = &report["latency"];
    [&report["fps"], &latency["median_ms"], &latency["p95_ms"]].map(number)
}

#[test]
fn a_client_that_asks_for_everything_beside_a_good_one() {
    if std::env::var_os("GHOSTLIGHT_MEASURE").is_none() {
        eprintln!("SKIPPED: a measurement; set GHOSTLIGHT_MEASURE=1 to run it");
        return;
    }
    let program = program();
    let home = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let recording = std::env::var_os("GHOSTLIGHT_RECORDING");
    let recording = home.join(recording.unwrap_or_else(|| "recordings/desk".into()));
    let scene = home.join("recordings/scenes/teapot.json");
    let folder = tempfile::tempdir().unwrap();
    let cubes = write_cubes(folder.path());
    let settings = folder.path().join("most.json");
    std::fs::write(&settings, most().to_string()).unwrap();
    let service = Service::of(
        Command::new(&program)
            .args(["serve", "--listen", "127.0.0.1:0", "--scene"])
            .arg(&scene)
            .env("RUST_LOG", "error"),
    );
    let show = |what: &str, [fps, median, p95]: [f64; 3]| {
        println!("{what}: {fps:.1} fps, median {median:.1} ms, p95 {p95:.1} ms");
    };
    let run = || good(&program, &service.url, &recording, folder.path(), "teapot");
    show("alone", run());
    let mut bad = Command::new(&program)
        .args(["send", recording.to_str().unwrap(), "--url", &service.url])
        .args(["--rate", "max", "--seconds", "600", "--scene"])
        .arg(&cubes)
        .arg("--settings")
        .arg(&settings)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    // By then the demanding scene is loaded and its first frame is being rendered.
    std::thread::sleep(Duration::from_secs(8));
    show("beside one that asks for everything", run());
    bad.kill().unwrap();
    bad.wait().unwrap();
    show("after it left", run());
}
