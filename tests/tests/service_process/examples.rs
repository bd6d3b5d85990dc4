//! Runs the example clients of the protocol guide as they are.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use super::Service;

/// Reports that an example client cannot run on this machine; fails if it must run.
fn skip(why: &str) {
    println!("SKIPPED: {why}");
    let required = std::env::var("GHOSTLIGHT_REQUIRE").unwrap_or_default();
    assert!(!required.contains("examples"), "required, but: {why}");
}

fn succeeds(command: &mut Command) -> bool {
    command.output().is_ok_and(|out| out.status.success())
}

/// A Python with the packages that the guide names: the machine's, or a virtual environment filled by pip and
/// kept between runs.
fn python() -> Result<PathBuf, String> {
    let has_packages =
        |python: &Path| succeeds(Command::new(python).args(["-c", "import websockets, numpy"]));
    let own = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python");
    let candidates = [PathBuf::from("python3"), own.join("bin/python")];
    if let Some(found) = candidates.iter().find(|python| has_packages(python)) {
        return Ok(found.clone());
    }
    let mut venv = Command::new("python3");
    if !succeeds(venv.args(["-m", "venv"]).arg(&own)) {
        return Err("Python 3 with venv is not here".to_owned());
    }
    let out = Command::new(&candidates[1])
        .args(["-m", "pip", "install", "--quiet", "websockets", "numpy"])
        .output()
        .map_err(|e| e.to_string())?;
    match has_packages(&candidates[1]) {
        true => Ok(candidates[1].clone()),
        false => Err(format!(
            "pip could not install websockets and numpy: {}",
            String::from_utf8_lossy(&out.stderr)
        )),
    }
}

fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../proto/examples")
        .join(name)
}

/// Checks what an example client prints after success.
fn has_ten_frames(out: &Output) {
    let errors = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{errors}");
    let text = String::from_utf8_lossy(&out.stdout);
    let frames = text.lines().filter(|l| l.starts_with("frame ")).count();
    assert_eq!(frames, 10, "{text}");
}

#[test]
fn the_python_client_of_the_guide_runs() {
    let python = match python() {
        Ok(python) => python,
        Err(why) => return skip(&why),
    };
    let service = Service::start(&["--token", "right"]);
    let folder = tempfile::tempdir().unwrap();
    let run = |token: &str| {
        let mut command = Command::new(&python);
        command
            .arg(example("minimal.py"))
            .args([&service.url, token]);
        command.current_dir(folder.path()).output().unwrap()
    };
    let out = run("right");
    has_ten_frames(&out);
    let picture = image::open(folder.path().join("composite.jpg"))
        .unwrap()
        .to_rgb8();
    assert_eq!(picture.dimensions(), (320, 240));
    assert!((i32::from(picture.get_pixel(9, 9)[0]) - 128).abs() <= 2);
    let out = run("wrong");
    assert!(!out.status.success());
    let errors = String::from_utf8_lossy(&out.stderr);
    assert!(errors.contains("token"), "{errors}");
}

#[test]
fn the_javascript_client_of_the_guide_runs() {
    // Node 22 has WebSocket, Node 20 only with a flag.
    let flags: [&[&str]; 2] = [&[], &["--experimental-websocket"]];
    let probe = "process.exit(typeof WebSocket === 'function' ? 0 : 1)";
    let works = |flags: &&&[&str]| succeeds(Command::new("node").args(**flags).args(["-e", probe]));
    let Some(flags) = flags.iter().find(works) else {
        return skip("Node 20 or later is not here");
    };
    let service = Service::start(&[]);
    let mut command = Command::new("node");
    let out = command
        .args(*flags)
        .arg(example("minimal.mjs"))
        .arg(&service.url)
        .output()
        .unwrap();
    has_ten_frames(&out);
}
