//! Errors of scenes and mesh files: one line each.

use crate::json::JsonError;
use crate::memory::OverBudget;

/// Why a mesh or texture file cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {}{problem}", at.as_ref().map(|at| format!("{at}: ")).unwrap_or_default())]
pub struct MeshError {
    /// The file.
    pub file: String,
    /// Position in the file: a line, a byte, or a path like `meshes[0].primitives[1]`.
    pub at: Option<String>,
    /// What is wrong there: the expected and the actual value.
    pub problem: String,
}

impl MeshError {
    /// An error about the file as a whole.
    pub fn new(file: &str, problem: impl Into<String>) -> Self {
        Self {
            file: file.to_owned(),
            at: None,
            problem: problem.into(),
        }
    }

    /// An error about one place in the file.
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
        /// The reason.
        source: LoadError,
    },
    /// More triangles than the limit on stored triangles.
    #[error("{file}: triangles: expected at most {max}, got {got}")]
    Triangles {
        /// The document.
        file: String,
        /// Most triangles allowed.
        max: usize,
        /// The number up to the mesh that exceeds the limit.
        got: usize,
    },
    /// A file that cannot be read.
    #[error("{file}: {reason}")]
    File {
        /// The file.
        file: String,
        /// The reason.
        reason: String,
    },
    /// A field whose value cannot be used.
    #[error("{file}: {path}: {problem}")]
    Field {
        /// The document.
        file: String,
        /// Path of the field, as in `objects[0].place.scale`.
        path: String,
        /// What is wrong: the expected and the actual value.
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
    /// A mesh file inspected on its own.
    #[error(transparent)]
    MeshFile(#[from] MeshError),
}
