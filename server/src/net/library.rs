//! The recordings and scenes that a server offers, from files.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use ghostlight_proto::{Code, WireError};

use super::catalog::{Catalog, RecordingInfo, SceneInfo, SceneRenderer};
use super::config::ServeConfig;
use super::session_scene::{OfferedScene, SessionScene, Shared};
use crate::clock::render_clock;
use crate::frame::FrameSource;
use crate::memory::Budget;
use crate::recording::{OpenOptions, Recording, RecordingError};
use crate::render::Engine;
use crate::scene::SceneDocument;

/// An open recording on offer.
struct Offered {
    info: RecordingInfo,
    recording: Arc<Recording>,
}

/// Recordings and scenes found in files.
pub struct Library {
    recordings: Vec<Offered>,
    /// Name and source of each scene.
    scenes: Arc<[(String, OfferedScene)]>,
    engine: Engine,
    max_triangles: usize,
}

impl Library {
    /// Logs the backend and what is on offer.
    pub fn describe(&self) {
        tracing::info!(
            "rendering on {} ({} threads)",
            self.engine.backend().name(),
            self.engine.threads()
        );
        for Offered { info, .. } in &self.recordings {
            tracing::info!(
                "recording {}: {} frames, {}x{}, {:.1} s",
                info.name,
                info.frames,
                info.width,
                info.height,
                info.duration_s
            );
        }
        let scenes: Vec<&str> = self.scenes.iter().map(|(name, _)| name.as_str()).collect();
        match scenes.as_slice() {
            [] => tracing::info!(
                "no scenes: pictures are passed through unchanged until a client sends one"
            ),
            [first, ..] => tracing::info!("scenes: {}; {first} is shown first", scenes.join(", ")),
        }
        if self.recordings.is_empty() {
            tracing::info!("no recordings: waiting for frames, as from ghostlight send");
        }
    }

    /// Opens the recordings and scenes of the configuration. A path to a single one must be valid; in
    /// a folder, everything that is valid is offered.
    pub fn open(config: &ServeConfig) -> Result<Self> {
        let mut recordings = Vec::new();
        let open = &config.open;
        if open.trajectory.is_some() && config.recordings.len() != 1 {
            bail!(
                "--trajectory: expected one --recording, got {}",
                config.recordings.len()
            );
        }
        for path in &config.recordings {
            open_recordings(path, open, &mut recordings)?;
        }
        let mut scenes: Vec<(String, OfferedScene)> = Vec::new();
        if let Some((name, document)) = &config.first_scene {
            let document = OfferedScene::Flags(Arc::new(document.clone()));
            scenes.push((name.clone(), document));
        }
        for path in &config.scenes {
            for file in scene_files(path)? {
                let name = stem(&file);
                let known = scenes.iter().find(|(known, _)| *known == name);
                match known {
                    None => scenes.push((name, OfferedScene::File(file))),
                    // The folder of scenes often contains the first scene again.
                    Some((_, OfferedScene::File(first))) if same_file(first, &file) => {}
                    Some(_) => tracing::warn!(
                        "left out scene {}: one named {name} is offered already",
                        file.display()
                    ),
                }
            }
        }
        Ok(Self {
            recordings,
            scenes: scenes.into(),
            engine: Engine::new(config.backend, config.threads, render_clock)?,
            max_triangles: config.bounds.triangles,
        })
    }
}

/// A recording, or the recordings in a folder.
fn open_recordings(path: &Path, open: &OpenOptions, into: &mut Vec<Offered>) -> Result<()> {
    let whole = match Recording::open(path, open) {
        Ok(recording) => {
            offer(path, recording, into);
            return Ok(());
        }
        // This is a recording, so the folders in it are not recordings.
        Err(error @ RecordingError::NoPoses { .. }) => return Err(error.into()),
        // A trajectory file belongs to one recording.
        Err(error) if open.trajectory.is_some() => return Err(error.into()),
        Err(error) => error,
    };
    let before = into.len();
    for entry in sorted_entries(path)? {
        if !Recording::is_container(&entry) {
            continue;
        }
        match Recording::open(&entry, open) {
            Ok(recording) => offer(&entry, recording, into),
            Err(error) => left_out(&entry, &error),
        }
    }
    if into.len() == before {
        return Err(anyhow::Error::new(whole).context(format!(
            "{}: expected a recording, or a folder of recordings",
            path.display()
        )));
    }
    Ok(())
}

fn offer(path: &Path, recording: Recording, into: &mut Vec<Offered>) {
    let name = stem(path);
    if into.iter().any(|o| o.info.name == name) {
        tracing::warn!(
            "left out recording {}: one named {name} is offered already",
            path.display()
        );
        return;
    }
    let times_ns = recording.times_ns();
    let length = match (times_ns.first(), times_ns.last()) {
        (Some(first), Some(last)) => last.saturating_sub(*first),
        _ => 0,
    };
    let k = recording.intrinsics();
    into.push(Offered {
        info: RecordingInfo {
            name,
            frames: recording.len(),
            width: k.width,
            height: k.height,
            duration_s: length as f64 * 1e-9,
        },
        recording: Arc::new(recording),
    });
}

/// Logs why a file is not offered; most errors begin with the path.
fn left_out(path: &Path, error: &dyn std::fmt::Display) {
    let (path, error) = (path.display().to_string(), error.to_string());
    let reason = error.strip_prefix(&path).map_or(error.as_str(), |rest| {
        rest.trim_start_matches([':', ' ', '/'])
    });
    tracing::info!("left out {path}: {reason}");
}

fn same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// A scene document or mesh, or the documents in a folder.
fn scene_files(path: &Path) -> Result<Vec<PathBuf>> {
    if path.is_file() {
        SceneDocument::load(path)?;
        return Ok(vec![path.to_owned()]);
    }
    let mut files = Vec::new();
    for entry in sorted_entries(path)? {
        if entry.extension().is_some_and(|e| e == "json") {
            match SceneDocument::load(&entry) {
                Ok(_) => files.push(entry),
                Err(error) => left_out(&entry, &error),
            }
        }
    }
    if files.is_empty() {
        bail!(
            "{}: expected a scene document, a mesh, or a folder of documents (*.json), got none",
            path.display()
        );
    }
    Ok(files)
}

fn sorted_entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let context = || folder.display().to_string();
    let entries: std::io::Result<Vec<_>> = std::fs::read_dir(folder)
        .with_context(context)?
        .map(|entry| entry.map(|e| e.path()))
        .collect();
    let mut entries = entries.with_context(context)?;
    entries.sort();
    Ok(entries)
}

fn stem(path: &Path) -> String {
    path.file_stem()
        .unwrap_or(path.as_os_str())
        .to_string_lossy()
        .into_owned()
}

impl Catalog for Library {
    fn threads(&self) -> usize {
        self.engine.threads()
    }

    fn recordings(&self) -> Vec<RecordingInfo> {
        self.recordings.iter().map(|o| o.info.clone()).collect()
    }

    fn scenes(&self) -> Vec<SceneInfo> {
        let names = self.scenes.iter().map(|(name, _)| name.clone());
        names.map(|name| SceneInfo { name }).collect()
    }

    fn open(&self, recording: &str) -> Result<Box<dyn FrameSource>, WireError> {
        match self.recordings.iter().find(|o| o.info.name == recording) {
            Some(offered) => Ok(Box::new(Arc::clone(&offered.recording))),
            None => Err(WireError::new(
                Code::NotFound,
                "recording",
                "one of /api/v1/recordings",
                recording,
            )),
        }
    }

    fn renderer(&self, memory: &Budget) -> Result<Box<dyn SceneRenderer>, WireError> {
        Ok(Box::new(SessionScene::new(Shared {
            scenes: Arc::clone(&self.scenes),
            engine: self.engine.clone(),
            max_triangles: self.max_triangles,
            memory: memory.clone(),
            uploads: Arc::default(),
        })?))
    }
}
