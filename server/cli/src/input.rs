//! Files that commands read, and values of their flags.

use std::path::Path;
use std::sync::LazyLock;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use ghostlight::ghost::DepthPlanes;
use ghostlight::json;
use ghostlight::recording::{OpenOptions, Recording};
use ghostlight::render::{Aov, RenderSettings};
use ghostlight::scene::{PlacementFrame, Scene, SceneDocument};
use ghostlight::text;

/// The recording as a source of frames.
pub(crate) fn open_recording(path: &Path, options: &OpenOptions) -> Result<Recording> {
    Ok(Recording::open(path, options)?)
}

/// A scene placed into a recording, and what was odd about it. `pixel` placements refer to the
/// recording's first frame, whichever frames are replayed.
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

/// Settings of a JSON file, checked.
pub(crate) fn load_settings(path: Option<&Path>) -> Result<Option<RenderSettings>> {
    let Some(path) = path else {
        return Ok(None);
    };
    let file = path.display().to_string();
    let bytes = std::fs::read(path).with_context(|| file.clone())?;
    let text = text::decode(&bytes).text;
    // serde would take a list for a struct whose fields come in order.
    if !text.trim_start().starts_with('{') {
        bail!("{file}: expected a JSON object, as in {{\"max_bounces\":3}}");
    }
    let settings: RenderSettings = json::from_str(&text, &file)?;
    settings.validate().with_context(|| file.clone())?;
    Ok(Some(settings))
}

/// Nanoseconds since the first call.
pub(crate) fn clock() -> u64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    // 580 years fit.
    START.elapsed().as_nanos() as u64
}

/// The name of an [`Aov`].
pub(crate) fn aov(text: &str) -> Result<Aov, String> {
    let found = Aov::ALL.into_iter().find(|aov| aov.name() == text);
    found.ok_or_else(|| {
        let names = Aov::ALL.map(Aov::name).join(", ");
        format!("expected some of {names}, got {text:?}")
    })
}
