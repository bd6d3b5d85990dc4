//! Runs the commands of README and book exactly as written, in a folder with the files that they use: the bundled
//! scenes, the first frames of the bundled recording (also as `my-recording`), a small mesh `chair.glb`, and a
//! certificate.
//!
//! Every line of an `sh` block is run, unless the line before the block is a comment `<!-- not run: REASON -->`.
//! A server runs until its block ends, at a free port; in later lines this port replaces the one in the text.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use tempfile::TempDir;

use crate::page::{Block, Page, root};

/// Frames of the copied recording.
const N_FRAMES: usize = 4;
/// Most blocks that may be marked as not run, so that this stays an exception.
const MOST_NOT_RUN: usize = 8;

#[test]
fn commands_of_the_readme_run() {
    run_all(&[Page::read("README.md")]);
}

#[test]
fn commands_of_the_book_run() {
    run_all(&Page::guides()[1..]);
}

#[test]
fn few_commands_are_not_run() {
    let mut reasons = Vec::new();
    for page in Page::guides() {
        let blocks = page.blocks();
        for block in blocks.iter().filter(|block| block.language == "sh") {
            if let Some(reason) = &block.not_run {
                assert!(reason.len() > 10, "{}: a reason is needed", block.at);
                reasons.push(format!("{}: {reason}", block.at));
            }
        }
    }
    assert!(reasons.len() <= MOST_NOT_RUN, "{}", reasons.join("\n"));
}

fn run_all(pages: &[Page]) {
    let mut n_commands = 0;
    for page in pages {
        let blocks = page.blocks();
        let blocks = blocks
            .iter()
            .filter(|block| block.language == "sh" && block.not_run.is_none());
        // One folder per page: blocks may use files written by earlier blocks of the page.
        let mut folder = None;
        for block in blocks {
            let folder = folder.get_or_insert_with(Folder::new);
            n_commands += folder.run(block);
        }
    }
    assert!(n_commands >= 5, "{n_commands}");
}

/// A running server; stopped when dropped.
struct Server {
    child: Child,
    /// Host and port.
    address: String,
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        let recordings = root().join("recordings").canonicalize().unwrap();
        std::fs::create_dir_all(folder.path("recordings")).unwrap();
        for name in ["meshes", "scenes", "settings"] {
            let link = folder.path("recordings").join(name);
            std::os::unix::fs::symlink(recordings.join(name), link).unwrap();
        }
        for to in ["recordings/desk", "my-recording"] {
            copy_frames(&recordings.join("desk"), &folder.path(to));
        }
        std::fs::write(folder.path("chair.glb"), tetrahedron_glb()).unwrap();
        let names = ["localhost".to_owned(), "127.0.0.1".to_owned()];
        let certificate = rcgen::generate_simple_self_signed(names).unwrap();
        std::fs::write(folder.path("cert.pem"), certificate.cert.pem()).unwrap();
        let key = certificate.signing_key.serialize_pem();
        std::fs::write(folder.path("key.pem"), key).unwrap();
        // Lets commands call the program by its name.
        std::fs::create_dir(folder.path("bin")).unwrap();
        let program = env!("CARGO_BIN_EXE_ghostlight-under-test");
        std::os::unix::fs::symlink(program, folder.path("bin/ghostlight")).unwrap();
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn shell(&self, line: &str) -> Command {
        let mut command = Command::new("sh");
        let path = std::env::var("PATH").unwrap_or_default();
        let path = format!("{}:{path}", self.path("bin").display());
        command.args(["-eu", "-c", line]).env("PATH", path);
        command.env("RUST_LOG", "warn").current_dir(self.0.path());
        command
    }

    /// Runs each line; returns the number of lines.
    fn run(&self, block: &Block) -> usize {
        let mut servers: Vec<Server> = Vec::new();
        let lines = block.text.lines().map(str::trim);
        let lines = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
        let mut n_lines = 0;
        for line in lines {
            n_lines += 1;
            // A comment begins after two blanks.
            let line = line.split_once("  #").map_or(line, |(line, _)| line).trim();
            let line = line.replace("cargo run --release -- ", "ghostlight ");
            assert!(
                line.starts_with("ghostlight "),
                "{}: {line}: only ghostlight is run here; mark the block as not run",
                block.at
            );
            let serves = line.starts_with("ghostlight serve")
                || (line.starts_with("ghostlight demo") && !line.contains("--out"));
            if serves {
                servers.push(self.serve(&line, &block.at));
                continue;
            }
            let line = servers.last().map_or_else(
                || line.clone(),
                |server| {
                    let line = line.replace("127.0.0.1:8080", &server.address);
                    line.replace("127.0.0.1:8443", &server.address)
                },
            );
            let output = self.shell(&line).output().unwrap();
            assert!(
                output.status.success(),
                "{}: {line}\n{}",
                block.at,
                String::from_utf8_lossy(&output.stderr)
            );
        }
        n_lines
    }

    /// Starts a server at a free port and waits until it listens.
    fn serve(&self, line: &str, at: &str) -> Server {
        let mut words: Vec<&str> = line.split_whitespace().collect();
        if let Some(i) = words.iter().position(|word| *word == "--listen") {
            words.drain(i..i + 2);
        }
        words.extend(["--listen", "127.0.0.1:0"]);
        // `exec` replaces the shell with the server, which can then be killed.
        let mut command = self.shell(&format!("exec {}", words.join(" ")));
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let stdout = BufReader::new(child.stdout.take().unwrap());
        let address = stdout.lines().find_map(|said| {
            let said = said.unwrap();
            let (_, rest) = said.split_once("://")?;
            let end = |c: char| c == '/' || c.is_whitespace();
            Some(rest.split(end).next()?.to_owned())
        });
        let Some(address) = address else {
            panic!("{at}: {line}: ended before it served");
        };
        Server { child, address }
    }
}

/// Copies the first frames of a recording in TUM's layout.
fn copy_frames(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for name in ["manifest.json", "groundtruth.txt"] {
        std::fs::copy(from.join(name), to.join(name)).unwrap();
    }
    for name in ["rgb", "depth"] {
        std::fs::create_dir(to.join(name)).unwrap();
        let list = format!("{name}.txt");
        let text = std::fs::read_to_string(from.join(&list)).unwrap();
        let frames = text.lines().filter(|line| !line.starts_with('#'));
        let frames: Vec<&str> = frames.take(N_FRAMES).collect();
        std::fs::write(to.join(&list), frames.join("\n")).unwrap();
        for frame in frames {
            let picture = frame.split_whitespace().nth(1).unwrap();
            std::fs::copy(from.join(picture), to.join(picture)).unwrap();
        }
    }
}

/// A tetrahedron as binary glTF.
fn tetrahedron_glb() -> Vec<u8> {
    let corners = [
        [0f32, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.5, 0.0, 1.0],
        [0.5, 1.0, 0.5],
    ];
    let faces = [[0u16, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]];
    let mut bytes: Vec<u8> = Vec::new();
    bytes.extend(corners.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
    bytes.extend(faces.as_flattened().iter().flat_map(|i| i.to_le_bytes()));
    let mut json = serde_json::json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "chair"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": bytes.len()}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
             "min": [0, 0, 0], "max": [1, 1, 1]},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"}],
    })
    .to_string()
    .into_bytes();
    // glTF chunks end at multiples of four bytes.
    while !json.len().is_multiple_of(4) {
        json.push(b' ');
    }
    let total = 12 + 8 + json.len() + 8 + bytes.len();
    let mut glb = Vec::with_capacity(total);
    glb.extend(b"glTF");
    glb.extend(2u32.to_le_bytes());
    glb.extend((total as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &bytes)] {
        glb.extend((chunk.len() as u32).to_le_bytes());
        glb.extend(kind);
        glb.extend(chunk);
    }
    glb
}
