//! Files that commands read, and values of their flags.

use std::path::Path;

use anyhow::Result;
use ghostlight::ghost::DepthPlanes;
use ghostlight::recording::{OpenOptions, Recording};
use ghostlight::render::{Aov, RenderSettings};
use ghostlight::scene::{PlacementFrame, Scene, SceneDocument};

/// The recording as a source of frames.
pub(crate) fn open_recording(path: &Path, options: &OpenOptions) -> Result<Recording> {
    Ok(Recording::open(path, options)?)
}

/// A scene placed in a recording, with notes about anything unusual. `pixel` placements refer to the recording's
/// first frame, whichever frames are replayed.
pub(crate) fn place_scene(
    document: &SceneDocument,
    folder: &Path,
    recording: &Recording,
    settings: &RenderSettings,
) -> Result<(Scene, Vec<String>)> {
    let first_frame = recording.frame(0)?;
    let surface = DepthPlanes::new(&first_frame.depth, &first_frame.intrinsics, &settings.ghost);
    let frame = PlacementFrame {
        frame: &first_frame,
        surface: &surface,
    };
    Ok(document.resolve(folder, &frame)?)
}

/// Parses the name of an [`Aov`].
pub(crate) fn aov(text: &str) -> Result<Aov, String> {
    let found = Aov::ALL.into_iter().find(|aov| aov.name() == text);
    found.ok_or_else(|| {
        let names = Aov::ALL.map(Aov::name).join(", ");
        format!("expected some of {names}, got {text:?}")
    })
}
