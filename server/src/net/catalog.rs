//! The interface between sessions and the rest of the program: recordings to play and scenes to render. Tests
//! substitute their own.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use ghostlight_proto::WireError;
use ghostlight_proto::control::{ObjectInfo, SceneChoice, Stands};
use serde::Serialize;

use crate::frame::{ColorImage, FrameGeometry, FrameSource, RgbdFrame};
use crate::memory::Budget;
use crate::render::{Aov, Checkpoint, RenderSettings, Rendered};

/// A recording on offer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordingInfo {
    /// Name that `play` messages use.
    pub name: String,
    /// Frames.
    pub frames: usize,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Length, seconds.
    pub duration_s: f64,
}

/// A scene on offer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SceneInfo {
    /// Name that `scene` and `play` messages use.
    pub name: String,
}

/// Uploads of a session, by name.
pub type Assets = BTreeMap<String, Arc<Vec<u8>>>;

/// Recordings and renderers.
pub trait Catalog: Send + Sync + 'static {
    /// Recordings on offer, the default first.
    fn recordings(&self) -> Vec<RecordingInfo>;
    /// Scenes on offer, the default first.
    fn scenes(&self) -> Vec<SceneInfo>;
    /// A recording, for one session.
    fn open(&self, recording: &str) -> Result<Box<dyn FrameSource>, WireError>;
    /// A renderer with an empty scene, for one session; memory of its scenes is taken from `memory`.
    fn renderer(&self, memory: &Budget) -> Result<Box<dyn SceneRenderer>, WireError>;
    /// Threads that all renderers share.
    fn threads(&self) -> usize {
        1
    }
}

/// A received frame; its geometry and its colour picture may be decoded in parallel.
pub trait EncodedFrame: Sync {
    /// Depth registered to colour, camera and pose: everything but the picture.
    fn geometry(&self) -> Result<FrameGeometry, WireError>;
    /// The picture.
    fn color(&self) -> Result<ColorImage, WireError>;
    /// The whole frame: geometry and picture.
    fn whole(&self) -> Result<RgbdFrame, WireError> {
        let color = self.color()?;
        Ok(self.geometry()?.with_color(color))
    }
}

/// Why a frame has no composite.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unrendered {
    /// The scene cannot be rendered.
    #[error(transparent)]
    Scene(#[from] WireError),
    /// The frame's checkpoint cancelled it; the renderer's state is unchanged.
    #[error("cancelled")]
    Cancelled,
}

/// A scene that is to be loaded.
pub trait SceneLoad: Send {
    /// Name of the scene, if it has one.
    fn name(&self) -> Option<String>;

    /// The objects that can be placed and turned, without poses yet.
    fn objects(&self) -> Vec<ObjectInfo>;

    /// Settings that the scene's document carries.
    fn settings(&self) -> Option<RenderSettings> {
        None
    }

    /// Loads the scene, places it in a frame under the settings that it will be rendered with, and builds its
    /// renderer. May take long: call it on a separate thread. Returns soon after `stop` is set.
    fn run(
        self: Box<Self>,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        stop: &Arc<AtomicBool>,
    ) -> Result<Box<dyn SceneRenderer>, WireError>;
}

/// A scene and the renderer that holds it.
pub trait SceneRenderer: Send {
    /// Prepares to load another scene for the same session; fails if its name or document is invalid. The current
    /// scene stays until the load is done.
    fn begin_scene(
        &mut self,
        scene: &SceneChoice,
        assets: &Assets,
    ) -> Result<Box<dyn SceneLoad>, WireError>;

    /// Name of the scene, if it has one.
    fn scene_name(&self) -> Option<String>;

    /// The objects that can be placed and turned, with their poses.
    fn objects(&self) -> Vec<ObjectInfo>;

    /// Settings that the scene's document carries.
    fn scene_settings(&self) -> Option<RenderSettings> {
        None
    }

    /// Puts an object on the real surface seen at a pixel of a frame; `settings` are those that the frame is
    /// rendered with. If the pixel has no depth, the object is put at the nearest pixel that has, and a note for
    /// the user is returned. Reads no file.
    fn place(
        &mut self,
        object: &str,
        pixel: [f64; 2],
        frame: &RgbdFrame,
        settings: &RenderSettings,
    ) -> Result<Option<String>, WireError>;

    /// Puts an object back to a pose that [`SceneRenderer::objects`] returned.
    fn put_back(&mut self, object: &str, stands: &Stands) -> Result<(), WireError>;

    /// Turns an object about its vertical axis, radians.
    fn turn(&mut self, object: &str, angle: f64) -> Result<(), WireError>;

    /// Renders a frame. Returns early if `checkpoint` cancels it.
    fn render(
        &mut self,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<Rendered, Unrendered>;

    /// Decodes a frame and renders it. The outer error means that decoding failed and the renderer's state is
    /// unchanged; the inner one is as in [`SceneRenderer::render`].
    fn render_encoded(
        &mut self,
        encoded: &dyn EncodedFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<(RgbdFrame, Result<Rendered, Unrendered>), WireError> {
        let frame = encoded.whole()?;
        let rendered = self.render(&frame, settings, aovs, checkpoint);
        Ok((frame, rendered))
    }
}
