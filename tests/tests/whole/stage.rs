//! Runs the program as its users do, on recordings that the program rendered itself.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use tempfile::TempDir;

/// Runs `ghostlight` with these arguments in a folder.
pub(crate) fn ghostlight(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ghostlight-under-test"))
        .args(args)
        .current_dir(folder)
        .output()
        .expect("the program starts")
}

/// Runs it; panics with its output unless it succeeds.
pub(crate) fn succeed(folder: &Path, args: &[&str]) -> Output {
    let output = ghostlight(folder, args);
    assert!(
        output.status.success(),
        "ghostlight {}: {}\n{}",
        args.join(" "),
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    output
}

/// Runs it on bad input: expects exit code 2, a single line on stderr, which is returned, and no file written in
/// `folder`.
pub(crate) fn fail(folder: &Path, args: &[&str]) -> String {
    let before = contents(folder);
    let output = ghostlight(folder, args);
    let told = String::from_utf8(output.stderr).expect("errors are text");
    let what = args.join(" ");
    assert_eq!(output.status.code(), Some(2), "ghostlight {what}: {told}");
    assert!(output.stdout.is_empty(), "ghostlight {what} said something");
    assert_eq!(told.lines().count(), 1, "ghostlight {what}: {told}");
    assert!(told.starts_with("error: "), "ghostlight {what}: {told}");
    let changed = contents(folder) != before;
    assert!(!changed, "ghostlight {what} left something behind");
    told
}

/// Every file and folder below `folder`, by its relative path.
pub(crate) fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(&next).expect("a folder lists") {
            let path = entry.expect("a folder lists").path();
            let name = path.strip_prefix(folder).expect("inside").to_owned();
            if path.is_dir() {
                found.insert(name, Vec::new());
                folders.push(path);
            } else {
                found.insert(name, std::fs::read(&path).expect("a file reads"));
            }
        }
    }
    found
}

/// A folder with a small recording of four frames, `recording`, and two scenes: `scene.json`, a mirror cube on
/// the surface in the middle of the picture, and `empty.json`.
pub(crate) struct Stage {
    /// Removed when this is dropped.
    folder: TempDir,
}

impl Stage {
    /// Copies a recording that is rendered only once.
    pub(crate) fn new() -> Self {
        static RECORDING: OnceLock<TempDir> = OnceLock::new();
        let made = RECORDING.get_or_init(|| {
            let folder = tempfile::tempdir().expect("a folder");
            let size = ["--size", "161x121", "--frames", "4", "--samples", "1"];
            let args = [
                &["synth", "--quick", "--quiet", "--out", "recording"],
                &size[..],
            ];
            succeed(folder.path(), &args.concat());
            folder
        });
        let stage = Self {
            folder: tempfile::tempdir().expect("a folder"),
        };
        for (name, bytes) in contents(made.path()) {
            let path = stage.path().join(name);
            let parent = path.parent().expect("inside a folder");
            std::fs::create_dir_all(parent).expect("a folder");
            if !bytes.is_empty() {
                std::fs::write(path, bytes).expect("a file");
            }
        }
        stage.write("cube.obj", CUBE);
        stage.write("empty.json", r#"{"version":1,"objects":[]}"#);
        stage.write(
            "scene.json",
            r#"{"version":1,
                "objects":[{"name":"cube","mesh":"cube.obj","place":{"frame":"pixel","pixel":[80,70],"scale":0.15},
                            "material":{"preset":"mirror"}}],
                "lights":[{"type":"sphere","position":[0,-1.5,1],"frame":"first_camera","radius":0.1,"intensity":[20,20,20]}]}"#,
        );
        stage
    }

    pub(crate) fn path(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path().join(name), text).expect("a file");
    }

    /// The report of a replay with additional arguments.
    pub(crate) fn report(&self, args: &[&str]) -> serde_json::Value {
        let replay = ["replay", "recording", "--quiet", "--report", "report.json"];
        succeed(self.path(), &[&replay, args].concat());
        let text = std::fs::read(self.path().join("report.json")).expect("a report");
        serde_json::from_slice(&text).expect("JSON")
    }
}

/// The hash of every frame in a report.
pub(crate) fn hashes(report: &serde_json::Value) -> Vec<String> {
    let frames = report["frames"].as_array().expect("frames");
    let hash = |frame: &serde_json::Value| frame["hash"].as_str().expect("a hash").to_owned();
    frames.iter().map(hash).collect()
}

const CUBE: &str =
    "v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1
f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
