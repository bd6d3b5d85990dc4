//! `ghostlight replay` from the outside: its output, and that it is the same every time.

use crate::stage::{Stage, contents, hashes, succeed};

#[test]
fn hashes_are_the_same_for_any_number_of_threads_and_every_run() {
    let stage = Stage::new();
    let first = hashes(&stage.report(&["--scene", "scene.json", "--out", "a", "--threads", "1"]));
    assert_eq!(first.len(), 4);
    // Four different views of a moving camera.
    assert!((1..4).all(|i| first[i] != first[0]), "{first:?}");
    for threads in ["1", "2", "5"] {
        let args = ["--scene", "scene.json", "--out", "a", "--threads", threads];
        assert_eq!(hashes(&stage.report(&args)), first, "{threads} threads");
    }
    // A run without a report writes the same pictures.
    let before = contents(&stage.path().join("a"));
    let args = ["replay", "recording", "--scene", "scene.json", "--out", "b"];
    succeed(stage.path(), &args);
    assert!(contents(&stage.path().join("b")) == before);
}

#[test]
fn the_report_is_as_promised_and_its_hashes_are_of_the_pictures() {
    let stage = Stage::new();
    let args = ["--scene", "scene.json", "--out", "out", "--frames", "1..3"];
    let report = stage.report(&args);
    assert_eq!(report["summary"]["frames"], 2);
    for key in ["median_ms", "p95_ms", "fps"] {
        assert!(report["summary"][key].is_number(), "{key}");
    }
    for (i, frame) in report["frames"].as_array().unwrap().iter().enumerate() {
        assert_eq!(frame["index"], i + 1);
        assert!(frame["total_ms"].is_number());
        let stages = frame["stages_ms"].as_object().unwrap();
        for stage in ghostlight::render::Stage::ALL {
            assert!(stages[stage.name()].is_number(), "{}", stage.name());
        }
        assert!(stages["read"].as_f64().unwrap() > 0.0 && stages["write"].as_f64().unwrap() > 0.0);
        let picture = stage.path().join(format!("out/{:06}.png", i + 1));
        let picture = image::open(picture).unwrap().to_rgba8();
        assert_eq!(picture.dimensions(), (161, 121));
        let hash = twox_hash::XxHash3_128::oneshot(picture.as_raw());
        assert_eq!(frame["hash"], format!("{hash:032x}"));
    }
    let pictures = contents(&stage.path().join("out"));
    let pictures = pictures
        .keys()
        .filter(|name| name.extension().is_some_and(|e| e == "png"));
    assert_eq!(pictures.count(), 2);
}

#[test]
fn an_empty_scene_gives_back_the_cameras_pictures_bit_for_bit() {
    let stage = Stage::new();
    stage.report(&["--scene", "empty.json", "--out", "out"]);
    let recording = ghostlight::recording::Recording::open(
        &stage.path().join("recording"),
        &ghostlight::recording::OpenOptions::default(),
    )
    .unwrap();
    for i in 0..4 {
        let picture = image::open(stage.path().join(format!("out/{i:06}.png"))).unwrap();
        let frame = recording.frame(i).unwrap();
        assert!(
            picture.to_rgba8().as_raw().as_slice() == frame.color.bytes(),
            "frame {i}"
        );
    }
}

#[test]
fn replaying_again_into_a_folder_replaces_its_frames() {
    let stage = Stage::new();
    let args = [
        "replay",
        "recording",
        "--scene",
        "empty.json",
        "--out",
        "deep/out",
    ];
    succeed(stage.path(), &args);
    stage.write("deep/out/notes.txt", "mine");
    succeed(stage.path(), &[&args[..], &["--frames", "2.."]].concat());
    let names: Vec<String> = contents(&stage.path().join("deep/out"))
        .keys()
        .map(|name| name.display().to_string())
        .collect();
    assert_eq!(
        names,
        [
            ".ghostlight-replay",
            "000002.png",
            "000003.png",
            "notes.txt"
        ]
    );
}

#[test]
fn a_film_of_an_odd_size_comes_out_and_nothing_is_printed_when_quiet() {
    let stage = Stage::new();
    let args = [
        "replay",
        "recording",
        "--scene",
        "empty.json",
        "--out",
        "film.mp4",
        "--quiet",
    ];
    let output = succeed(stage.path(), &args);
    assert!(output.stdout.is_empty() && output.stderr.is_empty());
    let film = std::fs::read(stage.path().join("film.mp4")).unwrap();
    assert_eq!(&film[4..8], b"ftyp");
    let loud = succeed(stage.path(), &args[..6]);
    let said = String::from_utf8(loud.stdout).unwrap();
    assert!(said.starts_with("4 frames in film.mp4; "), "{said}");
}

#[test]
fn inspect_tells_a_recording_from_a_scene_from_a_mesh() {
    let stage = Stage::new();
    let says = |path: &str| {
        let output = succeed(stage.path(), &["inspect", path]);
        String::from_utf8(output.stdout).unwrap()
    };
    assert!(says("recording").contains("TUM"));
    assert!(says("scene.json").contains("cube"));
    assert!(says("cube.obj").contains("12 triangles"));
}

#[test]
fn every_command_explains_itself_with_examples() {
    let folder = tempfile::tempdir().unwrap();
    for command in ["", "demo", "replay", "synth", "inspect"] {
        let args: Vec<&str> = [command, "--help"]
            .into_iter()
            .filter(|a| !a.is_empty())
            .collect();
        let output = succeed(folder.path(), &args);
        let help = String::from_utf8(output.stdout).unwrap();
        assert!(
            help.contains("Usage: ") && help.contains("Examples:"),
            "{help}"
        );
        assert!(help.contains(&format!("  ghostlight {command}")), "{help}");
    }
    let version = succeed(folder.path(), &["--version"]).stdout;
    assert_eq!(
        version,
        format!("ghostlight {}\n", env!("CARGO_PKG_VERSION")).as_bytes()
    );
}
