//! What can be wrong with a recording.

use std::path::{Path, PathBuf};

use crate::camera::CameraError;
use crate::codec::CodecError;

/// Why a recording, or one frame of it, could not be read. Every message names the file and,
/// where there is one, the line or field.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// A file or folder could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A picture could not be decoded or encoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// A text, number or size that is not what it must be.
    #[error("{place}: {field}: expected {expected}, got {got}")]
    Field {
        /// File, and line if there is one.
        place: Place,
        /// Which field.
        field: String,
        /// What it must be.
        expected: String,
        /// What it is.
        got: String,
    },
    /// Intrinsics or a pose that no camera has.
    #[error("{place}: {source}")]
    Camera {
        /// File, and line if there is one.
        place: Place,
        /// What is wrong with it.
        source: CameraError,
    },
    /// Nothing known was found.
    #[error("{}: expected a recording, found none of: {looked_for}", path.display())]
    UnknownLayout {
        /// Which folder.
        path: PathBuf,
        /// What was looked for.
        looked_for: String,
    },
    /// Colour and depth without camera poses.
    #[error(
        "{}: no camera poses: looked for {looked_for}; --trajectory FILE takes them from elsewhere, --static takes the camera as at rest", path.display()
    )]
    NoPoses {
        /// Which folder.
        path: PathBuf,
        /// Names looked for.
        looked_for: String,
    },
    /// A recording of a known layout without one usable frame.
    #[error("{}: {layout} recording without a usable frame: {reason}", path.display())]
    Empty {
        /// Which folder.
        path: PathBuf,
        /// Layout name.
        layout: &'static str,
        /// What became of the frames.
        reason: String,
    },
    /// A frame that is not there.
    #[error("frame {index}: expected 0..{len}")]
    Index {
        /// The frame asked for.
        index: usize,
        /// Number of frames.
        len: usize,
    },
}

impl RecordingError {
    /// Whether a single frame is to blame, and the others may be as good as ever.
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

/// A file, and a line of it if one is to blame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// Which file.
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
