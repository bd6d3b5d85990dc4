//! Files that commands read, and values of their flags.

use std::path::Path;
use std::sync::LazyLock;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use ghostlight::frame::RgbdFrame;
use ghostlight::ghost::GhostSurface;
use ghostlight::json;
use ghostlight::recording::{OpenOptions, Recording};
use ghostlight::render::{Aov, RenderSettings};
use ghostlight::scene::{ResolveOptions, Scene, SceneDocument, Surface};
use ghostlight::text;
use glam::DVec3;

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
    let surface = Sensed::new(&first_frame, settings);
    let options = ResolveOptions {
        place_pixel: None,
        first_frame: &first_frame,
        surface: &surface,
    };
    Ok(document.resolve(folder, &options)?)
}

/// The real surface that a frame's depth shows.
struct Sensed(GhostSurface);

impl Sensed {
    fn new(frame: &RgbdFrame, settings: &RenderSettings) -> Self {
        let mut surface = GhostSurface::new();
        surface.rebuild(&frame.depth, &frame.intrinsics, &settings.ghost);
        Self(surface)
    }
}

impl Surface for Sensed {
    fn plane_at(&self, u: f32, v: f32, radius_px: f32) -> Option<(DVec3, DVec3)> {
        let plane = self.0.plane_at(u, v, radius_px.round() as u32);
        plane.map(|(point, normal)| (point.as_dvec3(), normal.as_dvec3()))
    }
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
