//! Writes composites as pictures in a folder or as a film.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::Rendered;
use super::error::{ReplayError, write_error};
use super::film::Film;
use super::picture::{png_of, png_of_aov};
use crate::codec::CodecError;
use crate::output::{Draft, Target, replace};
use crate::render::Aov;

/// Destination of composites.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Output {
    /// A folder: `000000.png` for frame 0, and `<aov>/000000.png`.
    ///
    /// It is created if it is missing. If an earlier replay wrote it, its frames and AOVs are replaced after the
    /// last frame; other files in it stay. A folder with files of such names from elsewhere is refused.
    Folder(PathBuf),
    /// An MP4 film; an existing file is replaced.
    Film(PathBuf),
}

impl Output {
    /// A film if the name ends in `.mp4`, otherwise a folder.
    ///
    /// A name with the extension of another film or picture format is refused, unless it is an existing folder:
    /// creating a folder called `film.mkv` is most likely a mistake.
    pub fn from_path(path: PathBuf) -> Result<Self, ReplayError> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("mp4") => Ok(Self::Film(path)),
            Some(other) if OTHER_FORMATS.contains(&other) && !path.is_dir() => {
                Err(ReplayError::Format { path })
            }
            _ => Ok(Self::Folder(path)),
        }
    }
}

/// Extensions of film and picture formats that cannot be written.
const OTHER_FORMATS: &[&str] = &[
    "3gp", "apng", "avi", "avif", "bmp", "exr", "flv", "gif", "h264", "h265", "hevc", "jpeg",
    "jpg", "m2ts", "m4v", "mkv", "mov", "mpeg", "mpg", "mxf", "ogg", "ogv", "png", "tif", "tiff",
    "ts", "vob", "webm", "webp", "wmv", "y4m", "yuv",
];

/// Marks a folder written by `replay`, so that a later replay may replace its frames.
const MARKER: &str = ".ghostlight-replay";

/// Writes frames, from any thread.
pub(super) enum Writer {
    Folder(Draft),
    Film(Box<Mutex<Film>>),
}

impl Writer {
    pub(super) fn new(output: &Output, aovs: &[Aov]) -> Result<Self, ReplayError> {
        match output {
            Output::Folder(path) => {
                refuse_occupied(path)?;
                let fail = |error| write_error(path, error);
                let folder = Draft::folder(path).map_err(fail)?;
                fs::write(folder.path().join(MARKER), "").map_err(fail)?;
                for aov in aovs {
                    fs::create_dir_all(folder.path().join(aov.name())).map_err(fail)?;
                }
                Ok(Self::Folder(folder))
            }
            Output::Film(path) => Ok(Self::Film(Box::new(Mutex::new(Film::new(path)?)))),
        }
    }

    /// Number of threads that may write: pictures in any order, films in order on one thread.
    pub(super) fn n_threads(&self) -> usize {
        match self {
            Self::Folder(_) => 2,
            Self::Film(_) => 1,
        }
    }

    pub(super) fn write(
        &self,
        index: usize,
        time_ns: i64,
        rendered: &Rendered,
    ) -> Result<(), ReplayError> {
        match self {
            Self::Film(film) => film
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .write(time_ns, rendered),
            Self::Folder(folder) => {
                let (width, height) = (rendered.color.width, rendered.color.height);
                let name = format!("{index:06}.png");
                write_picture(folder, &name, png_of(&rendered.color))?;
                for (aov, image) in &rendered.aovs {
                    let name = format!("{}/{name}", aov.name());
                    write_picture(folder, &name, png_of_aov(image, width, height))?;
                }
                Ok(())
            }
        }
    }

    pub(super) fn finish(self) -> Result<(), ReplayError> {
        match self {
            Self::Folder(folder) => finish_folder(folder),
            Self::Film(film) => film
                .into_inner()
                .unwrap_or_else(PoisonError::into_inner)
                .finish(),
        }
    }
}

fn write_picture(
    folder: &Draft,
    name: &str,
    png: Result<Vec<u8>, CodecError>,
) -> Result<(), ReplayError> {
    let destination = || folder.destination().join(name);
    let png = png.map_err(|source| ReplayError::Picture {
        path: destination(),
        source,
    })?;
    fs::write(folder.path().join(name), png).map_err(|error| write_error(&destination(), error))
}

/// Moves a folder to its destination, or its files into an existing folder.
fn finish_folder(folder: Draft) -> Result<(), ReplayError> {
    let destination = folder.destination().to_owned();
    let moved = if destination.is_dir() {
        folder.merge(replace_frames)
    } else {
        folder.commit()
    };
    moved.map_err(|error| write_error(&destination, error))
}

/// Refuses a folder with frames or AOVs that `replay` did not write.
fn refuse_occupied(path: &Path) -> Result<(), ReplayError> {
    let entries = match fs::read_dir(path) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(write_error(path, error)),
    };
    if path.join(MARKER).exists() {
        return refuse_unusual(path);
    }
    for entry in entries {
        let name = entry.map_err(|error| write_error(path, error))?.file_name();
        let name = name.to_string_lossy();
        if is_frame(&name) || Aov::ALL.iter().any(|aov| aov.name() == name) {
            return Err(ReplayError::Occupied {
                path: path.to_owned(),
                found: name.into_owned(),
            });
        }
    }
    Ok(())
}

/// Refuses an existing folder, fifo or device with the name of a frame, before rendering starts.
fn refuse_unusual(path: &Path) -> Result<(), ReplayError> {
    for aov in std::iter::once("").chain(Aov::ALL.iter().map(|aov| aov.name())) {
        let folder = path.join(aov);
        if !folder.is_dir() {
            continue;
        }
        let fail = |error| write_error(&folder, error);
        for name in frames_in(&folder).map_err(fail)? {
            let file = folder.join(name);
            match Target::of(&file).map_err(|error| write_error(&file, error))? {
                Target::File(_) => {}
                _ => return Err(write_error(&file, io::Error::other("expected a file"))),
            }
        }
    }
    Ok(())
}

/// Whether a name is that of a frame: six digits or more, `.png`.
fn is_frame(name: &str) -> bool {
    name.strip_suffix(".png")
        .is_some_and(|number| number.len() >= 6 && number.bytes().all(|b| b.is_ascii_digit()))
}

/// Replaces the frames of `into`, and those of its AOV folders, with those of `from`.
fn replace_frames(from: &Path, into: &Path) -> io::Result<()> {
    replace(&from.join(MARKER), &into.join(MARKER))?;
    let folders = std::iter::once("").chain(Aov::ALL.iter().map(|aov| aov.name()));
    for folder in folders {
        let (from, into) = (from.join(folder), into.join(folder));
        if into.is_dir() {
            for name in frames_in(&into)? {
                if !from.join(&name).exists() {
                    fs::remove_file(into.join(&name))?;
                }
            }
        }
        if from.is_dir() {
            fs::create_dir_all(&into)?;
            for name in frames_in(&from)? {
                replace(&from.join(&name), &into.join(&name))?;
            }
        } else if into.is_dir() && fs::read_dir(&into)?.next().is_none() {
            fs::remove_dir(&into)?;
        }
    }
    Ok(())
}

fn frames_in(folder: &Path) -> io::Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder)? {
        let name = entry?.file_name().to_string_lossy().into_owned();
        if is_frame(&name) {
            names.push(name);
        }
    }
    Ok(names)
}
