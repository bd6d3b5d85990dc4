//! What can be wrong with a scene or a mesh file: one line each.

use crate::json::JsonError;
use crate::memory::OverBudget;

/// Why a mesh or texture file cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {}{problem}", at.as_ref().map(|at| format!("{at}: ")).unwrap_or_default())]
pub struct MeshError {
    /// The file.
    pub file: String,
    /// Where in it: a line, a byte, or a path like `meshes[0].primitives[1]`.
    pub at: Option<String>,
    /// What is wrong there: expected and got.
    pub problem: String,
}

impl MeshError {
    /// About the file as a whole.
    pub fn new(file: &str, problem: impl Into<String>) -> Self {
        Self {
            file: file.to_owned(),
            at: None,
            problem: problem.into(),
        }
    }

    /// About one place in it.
    pub fn at(file: &str, at: impl Into<String>, problem: impl Into<String>) -> Self {
        Self {
            file: file.to_owned(),
            at: Some(at.into()),
            problem: problem.into(),
        }
    }
}

/// Why loading was stopped, independent of the files' content.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LoadError {
    /// The load was cancelled.
    #[error("loading was cancelled")]
    Cancelled,
    /// It needs more memory than its budget has left.
    #[error(transparent)]
    Memory(#[from] OverBudget),
}

/// Why a scene cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The document is invalid JSON, or has another structure.
    #[error(transparent)]
    Json(#[from] JsonError),
    /// Loading was stopped.
    #[error("{file}: {source}")]
    Load {
        /// The document.
        file: String,
        /// Why.
        source: LoadError,
    },
    /// More triangles than may be stored.
    #[error("{file}: triangles: expected at most {max}, got {got}")]
    Triangles {
        /// The document.
        file: String,
        /// Most of them.
        max: usize,
        /// The number up to the mesh that exceeds the limit.
        got: usize,
    },
    /// A file that cannot be read.
    #[error("{file}: {reason}")]
    File {
        /// The file.
        file: String,
        /// Why not.
        reason: String,
    },
    /// A field whose value cannot be used.
    #[error("{file}: {path}: {problem}")]
    Field {
        /// The document.
        file: String,
        /// Path of the field, as in `objects[0].place.scale`.
        path: String,
        /// What is wrong: expected and got.
        problem: String,
    },
    /// A mesh file named by the document that cannot be used.
    #[error("{file}: {path}: {source}")]
    Mesh {
        /// The document.
        file: String,
        /// Path of the field that names the mesh.
        path: String,
        /// What is wrong with it.
        source: MeshError,
    },
    /// A mesh file looked at on its own.
    #[error(transparent)]
    MeshFile(#[from] MeshError),
}
