//! Errors of a replay.

use std::io;
use std::path::{Path, PathBuf};

use crate::frame::BoxError;

/// Why a replay failed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// There are no frames to replay.
    #[error("the recording has no frames")]
    Empty,
    /// More frames were requested than the recording has.
    #[error("frames: expected A..B within 0..{n_frames}, got {start}..{end}")]
    Range {
        /// First requested frame.
        start: usize,
        /// One past the last requested frame.
        end: usize,
        /// Number of frames.
        n_frames: usize,
    },
    /// A frame could not be read.
    #[error("frame {index}: {source}")]
    Frame {
        /// Index of the frame.
        index: usize,
        /// Why.
        source: BoxError,
    },
    /// A frame could not be rendered.
    #[error("frame {index}: rendering: {source}")]
    Render {
        /// Index of the frame.
        index: usize,
        /// Why.
        source: BoxError,
    },
    /// A file or folder could not be written.
    #[error("{}: {source}", path.display())]
    Write {
        /// The path.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A folder with pictures that `replay` did not write.
    #[error(
        "{}: expected a new or empty folder, or one that replay wrote: {found} would be overwritten",
        path.display()
    )]
    Occupied {
        /// The folder.
        path: PathBuf,
        /// A file name in it that `replay` would overwrite.
        found: String,
    },
    /// A file name with the extension of a film or picture format that cannot be written.
    #[error("{}: expected a folder, or a film whose name ends in .mp4", path.display())]
    Format {
        /// The name.
        path: PathBuf,
    },
    /// AOVs were requested together with a film.
    #[error("aov: expected a folder to write into, got the film {}", path.display())]
    FilmAov {
        /// The film.
        path: PathBuf,
    },
    /// The film could not be encoded.
    #[error("{}: {source}", path.display())]
    Film {
        /// The film.
        path: PathBuf,
        /// Why.
        source: FilmError,
    },
    /// A picture could not be encoded.
    #[error("{}: {source}", path.display())]
    Picture {
        /// The picture.
        path: PathBuf,
        /// Why.
        source: crate::codec::CodecError,
    },
    /// The caller asked to stop.
    #[error("stopped before frame {index}; nothing was written")]
    Stopped {
        /// The first frame that was not rendered.
        index: usize,
    },
    /// A thread could not be started or failed.
    #[error("threads: {0}")]
    Threads(String),
}

pub(super) fn write_error(path: &Path, source: io::Error) -> ReplayError {
    ReplayError::Write {
        path: path.to_owned(),
        source,
    }
}

/// Why a film could not be written.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// A frame whose size differs from the first.
    #[error("film frames: expected {0}x{1} as the first, got {2}x{3}")]
    Size(u32, u32, u32, u32),
    /// Colour conversion failed.
    #[error("film colours: {0}")]
    Colour(String),
    /// The encoder failed.
    #[error("film encoder, {width}x{height}: {reason}")]
    Encoder {
        /// Picture width, pixels.
        width: u32,
        /// Picture height, pixels.
        height: u32,
        /// The encoder's error.
        reason: String,
    },
    /// The container could not be written.
    #[error("film container: {0}")]
    Container(String),
}
