//! Errors of rendering.

use super::checkpoint::Cancelled;

/// Why a scene or frame could not be rendered.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// A GPU was requested.
    #[error("backend gpu: this build has no GPU backend; use auto or cpu")]
    NoGpu,
    /// Threads could not be started.
    #[error("render threads: {0}")]
    Threads(String),
    /// No acceleration structure could be built for a mesh.
    #[error("object {object:?}: {reason}")]
    Mesh {
        /// Object of the scene document.
        object: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The frame's [`Checkpoint`](super::Checkpoint) cancelled it.
    #[error("rendering was cancelled")]
    Cancelled,
}

impl From<Cancelled> for RenderError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}
