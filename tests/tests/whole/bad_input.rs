//! Bad input gives one clear line that names the file and the field, exit code 2, and no files.

use crate::stage::{Stage, fail, succeed};

/// Runs `replay recording --scene scene.json --out out` with `changes` to the arguments (flag, value); the error
/// must contain every string of `named`.
#[track_caller]
fn refuse(stage: &Stage, changes: &[(&str, &str)], named: &[&str]) {
    let mut args = vec![("--scene", "scene.json"), ("--out", "out")];
    let mut recording = "recording";
    for &(flag, value) in changes {
        if flag == "RECORDING" {
            recording = value;
            continue;
        }
        args.retain(|(known, _)| *known != flag);
        args.push((flag, value));
    }
    let mut line = vec!["replay".to_owned(), recording.to_owned()];
    line.extend(args.iter().map(|(flag, value)| format!("{flag}={value}")));
    let line: Vec<&str> = line.iter().map(String::as_str).collect();
    let told = fail(stage.path(), &line);
    for name in named {
        assert!(told.contains(name), "{told}: does not name {name}");
    }
}

#[test]
fn flags() {
    let stage = Stage::new();
    for (flag, value, named) in [
        ("--frames", "3..3", "A < B"),
        ("--frames", "x..2", "A..B"),
        ("--frames", "0..5", "0..4"),
        ("--frames", "4..", "0..4"),
        (
            "--aov",
            "mask,foo",
            "mask, depth, normal, shadow, ambient, real, mixed",
        ),
        ("--backend", "gpu", "no GPU backend"),
        ("--backend", "vulkan", "cpu"),
        ("--intrinsics", "0,500,80,60", "fx"),
        ("--intrinsics", "500,-500,80,60", "fy"),
        ("--intrinsics", "500,500,80", "four numbers"),
        ("--intrinsics", "500,500,NaN,60", "four numbers"),
        ("--depth-scale", "0", "over 0"),
        ("--depth-scale", "inf", "a number"),
        ("--place", "5", "U,V"),
        ("--threads", "-1", "-1"),
        ("--threads", "100000", "1024"),
    ] {
        refuse(
            &stage,
            &[(flag, value)],
            &[flag.trim_start_matches('-'), named],
        );
    }
    refuse(
        &stage,
        &[("--aov", "mask"), ("--out", "film.mp4")],
        &["aov", "film.mp4"],
    );
    let told = fail(
        stage.path(),
        &["replay", "recording", "--scne", "a", "--out", "b"],
    );
    assert!(told.contains("--scene"), "{told}");
    let told = fail(stage.path(), &["replay", "recording"]);
    assert!(told.contains("--scene") && told.contains("--out"), "{told}");
}

#[test]
fn settings() {
    let stage = Stage::new();
    for (text, named) in [
        ("", &["settings.json"][..]),
        ("{", &["settings.json"]),
        ("[]", &["settings.json"]),
        ("\u{0}\u{1}", &["settings.json"]),
        (r#"{"max_bounce":3}"#, &["max_bounce", "max_bounces"]),
        (
            r#"{"bloom":{"treshold":3}}"#,
            &["bloom", "treshold", "threshold"],
        ),
        (r#"{"shadows":{"method":"sof"}}"#, &["shadows", "sof"]),
        (r#"{"max_bounces":9}"#, &["max_bounces", "0 to 8", "9"]),
        (r#"{"max_bounces":-1}"#, &["max_bounces", "-1"]),
        (r#"{"max_bounces":"3"}"#, &["max_bounces"]),
        (r#"{"bloom":{"levels":0}}"#, &["bloom.levels", "1 to 8"]),
        (r#"{"bloom":{"threshold":-1}}"#, &["bloom.threshold", "-1"]),
        (
            r#"{"glare":{"attenuation":1}}"#,
            &["glare.attenuation", "0.85 to 0.95"],
        ),
        (
            r#"{"shadows":{"samples":4}}"#,
            &["shadows.samples", "5 to 256"],
        ),
        (
            r#"{"ghost":{"edge_relative":0}}"#,
            &["ghost.edge_relative", "0.001 to 1"],
        ),
    ] {
        stage.write("settings.json", text);
        let named = [named, &["settings.json"]].concat();
        refuse(&stage, &[("--settings", "settings.json")], &named);
    }
    refuse(&stage, &[("--settings", "none.json")], &["none.json"]);
    refuse(&stage, &[("--settings", "recording")], &["recording"]);
}

#[test]
fn scenes_and_meshes() {
    let stage = Stage::new();
    refuse(&stage, &[("--scene", "none.json")], &["none.json"]);
    refuse(&stage, &[("--scene", "recording")], &["recording"]);
    for (text, named) in [
        ("", &[][..]),
        ("{}", &["version"]),
        (r#"{"version":2}"#, &["version", "2"]),
        (r#"{"version":1,"objekts":[]}"#, &["objekts", "objects"]),
        (
            r#"{"version":1,"objects":[{"name":"a","mesh":"none.obj"}]}"#,
            &["none.obj"],
        ),
        (
            r#"{"version":1,"objects":[{"name":"a","mesh":"bad.obj"}]}"#,
            &["bad.obj"],
        ),
        (
            r#"{"version":1,"objects":[{"name":"a","mesh":"cube.obj","place":{"frame":"pixel","pixel":[9999,5]}}]}"#,
            &["pixel"],
        ),
    ] {
        stage.write("scene.json", text);
        stage.write("bad.obj", "v 0 0 0\nv 1 0 0\nf 1 2 99\n");
        refuse(&stage, &[], &[named, &["scene.json"]].concat());
    }
}

#[test]
fn recordings() {
    let stage = Stage::new();
    refuse(&stage, &[("RECORDING", "none")], &["none"]);
    refuse(&stage, &[("RECORDING", "scene.json")], &["scene.json"]);
    std::fs::create_dir(stage.path().join("nothing")).unwrap();
    refuse(&stage, &[("RECORDING", "nothing")], &["nothing"]);

    // One bad picture does not refuse the others: its frame is left out, with a note.
    let third = |list: &str| {
        let text = std::fs::read_to_string(stage.path().join("recording").join(list)).unwrap();
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        let line = lines.clone().nth(2).unwrap();
        line.split_whitespace().nth(1).unwrap().to_owned()
    };
    let (color, depth) = (third("rgb.txt"), third("depth.txt"));
    let replay = ["replay", "recording", "--scene=scene.json", "--out=out"];
    for name in [&color, &depth] {
        let path = stage.path().join("recording").join(name);
        let whole = std::fs::read(&path).unwrap();
        for bytes in [&whole[..whole.len() / 3], b"no picture at all", b""] {
            std::fs::write(&path, bytes).unwrap();
            let output = succeed(stage.path(), &replay);
            let told = String::from_utf8(output.stderr).unwrap();
            assert!(
                told.contains("1 of 4 frames") && told.contains(name.as_str()),
                "{told}"
            );
            assert!(stage.path().join("out/000002.png").exists());
            assert!(!stage.path().join("out/000003.png").exists());
        }
        std::fs::write(&path, whole).unwrap();
    }
    // Damage that is found only when the pixels are decoded: the frame keeps its number.
    let path = stage.path().join("recording").join(&depth);
    let whole = std::fs::read(&path).unwrap();
    let mut damaged = whole.clone();
    let middle = damaged.len() / 2;
    damaged[middle..middle + 16].fill(0xAA);
    std::fs::write(&path, damaged).unwrap();
    let told = String::from_utf8(succeed(stage.path(), &replay).stderr).unwrap();
    assert!(
        told.contains("Frame 2 is left out") && told.contains(depth.as_str()),
        "{told}"
    );
    assert!(!stage.path().join("out/000002.png").exists());
    assert!(stage.path().join("out/000003.png").exists());
    let report = stage.report(&["--scene=scene.json", "--out=film.mp4"]);
    assert_eq!(report["left_out"][0]["index"], 2);
    assert_eq!(report["frames"].as_array().unwrap().len(), 3);
    std::fs::write(&path, whole).unwrap();
    for name in ["out", "film.mp4", "report.json"] {
        let path = stage.path().join(name);
        if path.is_dir() {
            std::fs::remove_dir_all(path).unwrap();
        } else {
            std::fs::remove_file(path).unwrap();
        }
    }
    // If every picture is bad, there is one error.
    for entry in std::fs::read_dir(stage.path().join("recording/depth")).unwrap() {
        std::fs::write(entry.unwrap().path(), "").unwrap();
    }
    refuse(&stage, &[], &["4 of 4 frames", "empty file"]);
    let stage = Stage::new();

    // Bad poses.
    let path = stage.path().join("recording/groundtruth.txt");
    let text = std::fs::read_to_string(&path).unwrap();
    for (field, value) in [(1, "nan"), (7, "9.0"), (4, "x")] {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        for line in lines.iter_mut().filter(|line| !line.starts_with('#')) {
            let mut fields: Vec<&str> = line.split_whitespace().collect();
            fields[field] = value;
            *line = fields.join(" ");
        }
        std::fs::write(&path, lines.join("\n")).unwrap();
        refuse(&stage, &[], &["groundtruth.txt"]);
    }
}

#[test]
fn outputs_that_cannot_be_written() {
    let stage = Stage::new();
    stage.write("file", "in the way");
    refuse(&stage, &[("--out", "file")], &["file"]);
    refuse(&stage, &[("--out", "file/out")], &["file"]);
    refuse(&stage, &[("--report", "recording")], &["recording"]);
    // The recording has a folder `depth`, which is also the name of an AOV folder.
    refuse(
        &stage,
        &[("--out", "recording")],
        &["recording", "depth", "overwritten"],
    );
    std::fs::create_dir(stage.path().join("folder.mp4")).unwrap();
    refuse(&stage, &[("--out", "folder.mp4")], &["folder.mp4"]);
}
