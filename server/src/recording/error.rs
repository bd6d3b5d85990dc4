//! Errors of recordings.

use std::path::{Path, PathBuf};

use crate::camera::CameraError;
use crate::codec::CodecError;

/// Why a recording, or one of its frames, could not be read. Every message names the file and, if known, the line or
/// field.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// A file or folder could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The path.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// A picture could not be decoded or encoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// An invalid text, number or size.
    #[error("{place}: {field}: expected {expected}, got {got}")]
    Field {
        /// File, and line if known.
        place: Place,
        /// Which field.
        field: String,
        /// The expected value.
        expected: String,
        /// The actual value.
        got: String,
    },
    /// Invalid intrinsics or an invalid pose.
    #[error("{place}: {source}")]
    Camera {
        /// File, and line if known.
        place: Place,
        /// The problem.
        source: CameraError,
    },
    /// No known layout was found.
    #[error("{}: expected a recording, found none of: {looked_for}", path.display())]
    UnknownLayout {
        /// The folder.
        path: PathBuf,
        /// The files that were searched.
        looked_for: String,
    },
    /// Colour and depth without camera poses.
    #[error(
        "{}: no camera poses: looked for {looked_for}; --trajectory FILE takes them from elsewhere, --static takes the camera as at rest", path.display()
    )]
    NoPoses {
        /// The folder.
        path: PathBuf,
        /// The names that were searched.
        looked_for: String,
    },
    /// A recording of a known layout without any usable frame.
    #[error("{}: {layout} recording without a usable frame: {reason}", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
        /// Layout name.
        layout: &'static str,
        /// Why frames were left out.
        reason: String,
    },
    /// An index beyond the number of frames.
    #[error("frame {index}: expected 0..{len}")]
    Index {
        /// The requested index.
        index: usize,
        /// Number of frames.
        len: usize,
    },
}

impl RecordingError {
    /// Whether the error concerns a single frame, and other frames may be valid.
    pub fn is_of_frame(&self) -> bool {
        match self {
            Self::Io { .. } | Self::Codec(_) | Self::Field { .. } | Self::Camera { .. } => true,
            Self::UnknownLayout { .. }
            | Self::NoPoses { .. }
            | Self::Empty { .. }
            | Self::Index { .. } => false,
        }
    }
}

/// A file, and a line in it if the error concerns one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// The file.
    pub path: PathBuf,
    /// Line, from 1.
    pub line: Option<usize>,
}

impl Place {
    pub(super) fn file(path: impl AsRef<Path>) -> Self {
        Self {
            path: path.as_ref().to_owned(),
            line: None,
        }
    }

    pub(super) fn line(path: &Path, line: usize) -> Self {
        Self {
            path: path.to_owned(),
            line: Some(line),
        }
    }

    pub(super) fn field(
        self,
        field: impl Into<String>,
        expected: impl Into<String>,
        got: impl Into<String>,
    ) -> RecordingError {
        RecordingError::Field {
            place: self,
            field: field.into(),
            expected: expected.into(),
            got: got.into(),
        }
    }

    pub(super) fn camera(self, source: CameraError) -> RecordingError {
        RecordingError::Camera {
            place: self,
            source,
        }
    }
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.path.display())?;
        self.line.map_or(Ok(()), |line| write!(f, " line {line}"))
    }
}
