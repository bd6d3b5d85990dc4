//! Outputs overwrite no foreign files, and a run that ends early leaves no files behind.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::stage::{Stage, fail, ghostlight, succeed};

const REPLAY: [&str; 4] = ["replay", "recording", "--scene", "empty.json"];

fn with<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&REPLAY, more].concat()
}

fn start(folder: &Path, args: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_ghostlight-under-test"))
        .args(args)
        .current_dir(folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts")
}

fn drafts(folder: &Path) -> Vec<String> {
    let names = std::fs::read_dir(folder).expect("a folder lists");
    let name = |entry: std::io::Result<std::fs::DirEntry>| {
        let name = entry.expect("a folder lists").file_name();
        name.to_string_lossy().into_owned()
    };
    let names = names.map(name);
    names.filter(|name| name.contains("partial")).collect()
}

#[test]
fn films_and_reports_follow_links_and_frames_do() {
    use std::os::unix::fs::symlink;
    let stage = Stage::new();
    std::fs::create_dir_all(stage.path().join("disk/frames")).unwrap();
    std::fs::create_dir_all(stage.path().join("sub")).unwrap();
    for (name, to) in [
        ("sub/film.mp4", "../disk/film.mp4"),
        ("sub/r.json", "../disk/r.json"),
        ("sub/out", "../disk/frames"),
    ] {
        symlink(to, stage.path().join(name)).unwrap();
    }
    let film = ["--out", "sub/film.mp4", "--report", "sub/r.json", "--quiet"];
    succeed(stage.path(), &with(&film));
    succeed(stage.path(), &with(&["--out", "sub/out", "--quiet"]));
    // A frame in the folder is a link to a file elsewhere.
    let frame = stage.path().join("disk/frames/000001.png");
    let elsewhere = stage.path().join("disk/elsewhere.png");
    std::fs::rename(&frame, &elsewhere).unwrap();
    symlink(&elsewhere, &frame).unwrap();
    std::fs::write(&elsewhere, "old").unwrap();
    succeed(stage.path(), &with(&["--out", "sub/out", "--quiet"]));
    for name in [
        "disk/film.mp4",
        "disk/r.json",
        "disk/frames/000003.png",
        "disk/elsewhere.png",
    ] {
        assert!(
            std::fs::metadata(stage.path().join(name)).unwrap().len() > 100,
            "{name}"
        );
    }
    for name in [
        "sub/film.mp4",
        "sub/r.json",
        "sub/out",
        "disk/frames/000001.png",
    ] {
        let link = std::fs::symlink_metadata(stage.path().join(name)).unwrap();
        assert!(link.is_symlink(), "{name}");
    }
}

#[test]
fn a_report_goes_to_a_fifo_a_device_or_standard_output() {
    use std::os::unix::fs::FileTypeExt as _;
    let stage = Stage::new();
    let fifo = stage.path().join("p");
    assert!(
        Command::new("mkfifo")
            .arg(&fifo)
            .status()
            .unwrap()
            .success()
    );
    let reader = std::thread::spawn({
        let fifo = fifo.clone();
        move || std::fs::read_to_string(fifo).unwrap()
    });
    succeed(
        stage.path(),
        &with(&["--out", "a", "--report", "p", "--quiet"]),
    );
    let report: serde_json::Value = serde_json::from_str(&reader.join().unwrap()).unwrap();
    assert_eq!(report["summary"]["frames"], 4);
    let kind = |path: &Path| std::fs::symlink_metadata(path).unwrap().file_type();
    assert!(kind(&fifo).is_fifo());

    let said = succeed(
        stage.path(),
        &with(&["--out", "b", "--report", "/dev/stdout", "--quiet"]),
    );
    let report: serde_json::Value = serde_json::from_slice(&said.stdout).unwrap();
    assert_eq!(report["summary"]["frames"], 4);

    // Creating a device needs root; this uses a stand-in beside the outputs, never the system's own.
    let device = stage.path().join("nul");
    let mut mknod = Command::new("mknod");
    let mknod = mknod
        .arg(&device)
        .args(["c", "1", "3"])
        .stderr(Stdio::null());
    if mknod.status().is_ok_and(|status| status.success()) {
        succeed(
            stage.path(),
            &with(&["--out", "c", "--report", "nul", "--quiet"]),
        );
        assert!(kind(&device).is_char_device());
    } else {
        eprintln!("SKIPPED: a device cannot be made here");
    }
    let _socket = std::os::unix::net::UnixListener::bind(stage.path().join("s")).unwrap();
    let refused = ghostlight(
        stage.path(),
        &with(&["--out", "d", "--report", "s", "--quiet"]),
    );
    let told = String::from_utf8(refused.stderr).unwrap();
    assert_eq!(refused.status.code(), Some(2), "{told}");
    assert!(told.contains("s: expected a file, got a socket"), "{told}");
    assert!(!stage.path().join("d").exists());
}

#[test]
fn names_of_other_formats_are_refused() {
    let stage = Stage::new();
    for name in ["x.mkv", "x.GIF", "x.webm", "a.b.avi", "deep/x.mov", "x.png"] {
        let told = fail(stage.path(), &with(&["--out", name]));
        assert!(told.contains(".mp4") && told.contains(name), "{told}");
    }
    // An existing folder may have any name.
    std::fs::create_dir(stage.path().join("shots.gif")).unwrap();
    succeed(stage.path(), &with(&["--out", "shots.gif", "--quiet"]));
    assert!(stage.path().join("shots.gif/000003.png").is_file());
}

#[test]
fn signals_clean_up_and_leftovers_of_a_killed_run_go_with_the_next() {
    let stage = Stage::new();
    std::fs::create_dir(stage.path().join("out")).unwrap();
    let long = [
        "synth", "--quick", "--frames", "100000", "--quiet", "--out", "room",
    ];
    // Settings with which each frame takes minutes.
    stage.write(
        "slow.json",
        r#"{"edge_samples":64,"glossy_samples":64,"shadows":{"samples":256},
            "lens":{"radius_m":0.05,"samples":256}}"#,
    );
    let slow = [
        "replay",
        "recording",
        "--scene",
        "scene.json",
        "--settings",
        "slow.json",
    ];
    let slow = |out| [&slow[..], &["--out", out]].concat();
    let commands = [
        (long.to_vec(), "."),
        (slow("out/k.mp4"), "out"),
        (slow("out/k"), "out"),
    ];
    let begun = |place: &Path, child: &mut Child| {
        let until = Instant::now() + Duration::from_secs(60);
        while drafts(place).is_empty() {
            assert!(child.try_wait().unwrap().is_none() && Instant::now() < until);
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    for (command, place) in &commands {
        let place = stage.path().join(place);
        for (signal, code) in [("TERM", 143), ("HUP", 129), ("INT", 130)] {
            let mut child = start(stage.path(), command);
            begun(&place, &mut child);
            let pid = child.id().to_string();
            assert!(
                Command::new("kill")
                    .args([&format!("-{signal}"), &pid])
                    .status()
                    .unwrap()
                    .success()
            );
            let status = child.wait().unwrap();
            assert_eq!(status.code(), Some(code), "{command:?} {signal}");
            assert_eq!(drafts(&place), [""; 0], "{command:?} {signal}");
        }
    }
    for (command, place) in &commands {
        let place = stage.path().join(place);
        let mut child = start(stage.path(), command);
        begun(&place, &mut child);
        child.kill().unwrap();
        child.wait().unwrap();
    }
    succeed(stage.path(), &with(&["--out", "out/last", "--quiet"]));
    assert_eq!(drafts(&stage.path().join("out")), [""; 0]);
    succeed(stage.path(), &with(&["--out", "last", "--quiet"]));
    assert_eq!(drafts(stage.path()), [""; 0]);
    assert!(!stage.path().join("out/k").exists() && !stage.path().join("room").exists());
}

#[test]
fn a_reader_that_leaves_and_a_full_disk_end_a_command_quietly() {
    let stage = Stage::new();
    let shell = |line: &str| {
        let mut command = Command::new("sh");
        command.args(["-c", line]).current_dir(stage.path());
        command.env("G", env!("CARGO_BIN_EXE_ghostlight-under-test"));
        command.output().unwrap()
    };
    for line in [
        "$G inspect recording",
        "$G --help",
        "$G completions bash",
        "$G man",
    ] {
        let output = shell(&format!("({line}; echo $? > code) | true"));
        let told = String::from_utf8(output.stderr).unwrap();
        assert_eq!(told, "", "{line}");
        let code = std::fs::read_to_string(stage.path().join("code")).unwrap();
        assert_eq!(code.trim(), "0", "{line}");
    }
    // The device is written to, not replaced.
    if Path::new("/dev/full").exists() {
        let output = shell("$G inspect recording > /dev/full");
        let told = String::from_utf8(output.stderr).unwrap();
        assert_eq!(
            (told.lines().count(), output.status.code()),
            (1, Some(2)),
            "{told}"
        );
        assert!(told.starts_with("error: stdout: "), "{told}");
        let output = shell("$G inspect nothing 2> /dev/full");
        assert_eq!(output.status.code(), Some(2));
    }
    let output = shell("$G inspect nothing 2>&-");
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn completions_and_manual_pages_name_every_command() {
    let stage = Stage::new();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let said = succeed(stage.path(), &["completions", shell]).stdout;
        let said = String::from_utf8(said).unwrap();
        assert!(said.contains("replay") && said.contains("scene"), "{shell}");
    }
    succeed(stage.path(), &["man", "--out", "man"]);
    for page in ["ghostlight.1", "ghostlight-replay.1", "ghostlight-serve.1"] {
        let text = std::fs::read_to_string(stage.path().join("man").join(page)).unwrap();
        assert!(text.contains(".TH"), "{page}");
    }
}
