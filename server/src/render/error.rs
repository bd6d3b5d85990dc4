//! Why nothing is rendered.

use super::checkpoint::Cancelled;

/// Why a scene or frame cannot be rendered.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// A GPU was asked for.
    #[error("backend gpu: this build has no GPU backend; use auto or cpu")]
    NoGpu,
    /// Threads could not be started.
    #[error("render threads: {0}")]
    Threads(String),
    /// A mesh that no acceleration structure could be built for.
    #[error("object {object:?}: {reason}")]
    Mesh {
        /// Object of the scene document.
        object: String,
        /// What is wrong.
        reason: String,
    },
    /// The frame's [`Checkpoint`](super::Checkpoint) gave it up.
    #[error("rendering was cancelled")]
    Cancelled,
}

impl From<Cancelled> for RenderError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}
