//! What can go wrong in a replay.

use std::io;
use std::path::{Path, PathBuf};

use crate::frame::BoxError;

/// Why a replay failed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// Nothing to replay.
    #[error("the recording has no frames")]
    Empty,
    /// More frames asked for than there are.
    #[error("frames: expected A..B within 0..{n_frames}, got {start}..{end}")]
    Range {
        /// First frame asked for.
        start: usize,
        /// One past the last asked for.
        end: usize,
        /// Frames there are.
        n_frames: usize,
    },
    /// A frame could not be read.
    #[error("frame {index}: {source}")]
    Frame {
        /// Which frame.
        index: usize,
        /// Why.
        source: BoxError,
    },
    /// A frame could not be rendered.
    #[error("frame {index}: rendering: {source}")]
    Render {
        /// Which frame.
        index: usize,
        /// Why.
        source: BoxError,
    },
    /// A file or folder could not be written.
    #[error("{}: {source}", path.display())]
    Write {
        /// Which one.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A folder with pictures that replay did not write.
    #[error(
        "{}: expected a new or empty folder, or one that replay wrote: {found} would be overwritten",
        path.display()
    )]
    Occupied {
        /// The folder.
        path: PathBuf,
        /// A name in it that replay uses.
        found: String,
    },
    /// A file name of a film or picture format that is not written.
    #[error("{}: expected a folder, or a film whose name ends in .mp4", path.display())]
    Format {
        /// The name.
        path: PathBuf,
    },
    /// Extra images (AOVs) were asked for beside a film.
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

/// Why a film could not be made.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// A frame of another size than the first.
    #[error("film frames: expected {0}x{1} as the first, got {2}x{3}")]
    Size(u32, u32, u32, u32),
    /// Colour conversion failed.
    #[error("film colours: {0}")]
    Colour(String),
    /// The encoder refused.
    #[error("film encoder, {width}x{height}: {reason}")]
    Encoder {
        /// Picture width, pixels.
        width: u32,
        /// Picture height, pixels.
        height: u32,
        /// Its error.
        reason: String,
    },
    /// The container could not be written.
    #[error("film container: {0}")]
    Container(String),
}
