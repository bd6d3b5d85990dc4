//! Files that appear whole or not at all.

use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::film::Film;
use super::picture::{png_of, png_of_aov};
use super::{Rendered, ReplayError};
use crate::render::Aov;

/// Where composites go.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Output {
    /// A folder: `000000.png` for frame 0, and `<aov>/000000.png`.
    ///
    /// It is made if it is missing. One that replay wrote before has its frames and AOVs
    /// replaced once all are finished; other files in it are left alone. One that holds files
    /// of such names from elsewhere is refused.
    Folder(PathBuf),
    /// An MP4 film; replaces a file of that name.
    Film(PathBuf),
}

impl Output {
    /// A film if the name ends in `.mp4`, else a folder.
    pub fn from_path(path: PathBuf) -> Self {
        match path.extension() {
            Some(extension) if extension.eq_ignore_ascii_case("mp4") => Self::Film(path),
            _ => Self::Folder(path),
        }
    }
}

/// Marks a folder that replay wrote, so that the next one may replace its frames.
const MARKER: &str = ".ghostlight-replay";

/// Writes frames, from any thread.
pub(super) enum Writer {
    Folder(Partial),
    Film(Box<Mutex<Film>>),
}

impl Writer {
    pub(super) fn new(output: &Output, aovs: &[Aov]) -> Result<Self, ReplayError> {
        match output {
            Output::Folder(path) => {
                refuse_occupied(path)?;
                let folder = Partial::folder(path)?;
                let marker = folder.path.join(MARKER);
                fs::write(&marker, "").map_err(|error| folder.error(error))?;
                for aov in aovs {
                    let path = folder.path.join(aov.name());
                    fs::create_dir_all(path).map_err(|error| folder.error(error))?;
                }
                Ok(Self::Folder(folder))
            }
            Output::Film(path) => Ok(Self::Film(Box::new(Mutex::new(Film::new(path)?)))),
        }
    }

    /// How many threads may write: pictures in any order, a film one after the other.
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
                folder.picture(&name, png_of(&rendered.color))?;
                for (aov, image) in &rendered.aovs {
                    let name = format!("{}/{name}", aov.name());
                    folder.picture(&name, png_of_aov(image, width, height))?;
                }
                Ok(())
            }
        }
    }

    pub(super) fn finish(self) -> Result<(), ReplayError> {
        match self {
            Self::Folder(folder) => folder.commit_folder(),
            Self::Film(film) => film
                .into_inner()
                .unwrap_or_else(PoisonError::into_inner)
                .finish(),
        }
    }
}

/// A file or folder being made beside its destination; removed unless it is committed.
#[derive(Debug)]
pub(super) struct Partial {
    path: PathBuf,
    destination: PathBuf,
}

impl Partial {
    /// For a file, which exists, empty, from now on.
    pub(super) fn file(destination: &Path) -> Result<Self, ReplayError> {
        if destination.is_dir() {
            return Err(write_error(
                destination,
                io::Error::other("expected a file, got a folder"),
            ));
        }
        Self::new(destination, |path| fs::File::create_new(path).map(|_| ()))
    }

    /// For a folder, which exists, empty, from now on.
    fn folder(destination: &Path) -> Result<Self, ReplayError> {
        Self::new(destination, |path| fs::create_dir(path))
    }

    fn new(
        destination: &Path,
        make: impl Fn(&Path) -> io::Result<()>,
    ) -> Result<Self, ReplayError> {
        let fail = |error| write_error(destination, error);
        let whole = std::path::absolute(destination).map_err(fail)?;
        let name = match whole.file_name() {
            Some(name) => name.to_string_lossy().into_owned(),
            None => return Err(fail(io::Error::other("expected a name for the output"))),
        };
        // The nearest folder that exists: made folders would be left behind by an error.
        let parent = whole.ancestors().skip(1).find(|path| path.exists());
        let parent = parent.unwrap_or(Path::new("/"));
        let process = std::process::id();
        for attempt in 0..1000u32 {
            let path = parent.join(format!(".{name}.{process}-{attempt}.partial"));
            match make(&path) {
                Ok(()) => {
                    return Ok(Self {
                        path,
                        destination: destination.to_owned(),
                    });
                }
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(fail(error)),
            }
        }
        Err(fail(io::Error::from(io::ErrorKind::AlreadyExists)))
    }

    pub(super) fn destination(&self) -> &Path {
        &self.destination
    }

    /// Opens the file for writing.
    pub(super) fn create(&self) -> Result<fs::File, ReplayError> {
        fs::File::create(&self.path).map_err(|error| self.error(error))
    }

    pub(super) fn write(&self, bytes: &[u8]) -> Result<(), ReplayError> {
        let written = self.create()?.write_all(bytes);
        written.map_err(|error| self.error(error))
    }

    fn picture(
        &self,
        name: &str,
        png: Result<Vec<u8>, image::ImageError>,
    ) -> Result<(), ReplayError> {
        let destination = || self.destination.join(name);
        let png = png.map_err(|source| ReplayError::Picture {
            path: destination(),
            source,
        })?;
        fs::write(self.path.join(name), png).map_err(|error| write_error(&destination(), error))
    }

    /// Moves it to its destination, replacing a file there.
    pub(super) fn commit(self) -> Result<(), ReplayError> {
        self.make_parent()
            .and_then(|()| fs::rename(&self.path, &self.destination))
            .map_err(|error| self.error(error))
    }

    /// Moves a folder to its destination, or its files into a folder that is there.
    fn commit_folder(self) -> Result<(), ReplayError> {
        if !self.destination.exists() {
            return self.commit();
        }
        replace_frames(&self.path, &self.destination).map_err(|error| self.error(error))
    }

    fn make_parent(&self) -> io::Result<()> {
        match self.destination.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => fs::create_dir_all(parent),
            _ => Ok(()),
        }
    }

    fn error(&self, error: io::Error) -> ReplayError {
        write_error(&self.destination, error)
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        // Gone already if it was committed. Nothing can be done about a failure here.
        let _ = if self.path.is_dir() {
            fs::remove_dir_all(&self.path)
        } else {
            fs::remove_file(&self.path)
        };
    }
}

fn write_error(path: &Path, source: io::Error) -> ReplayError {
    ReplayError::Write {
        path: path.to_owned(),
        source,
    }
}

/// Refuses a folder with frames or AOVs that replay did not write.
fn refuse_occupied(path: &Path) -> Result<(), ReplayError> {
    let entries = match fs::read_dir(path) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(write_error(path, error)),
    };
    if path.join(MARKER).exists() {
        return Ok(());
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

/// Whether replay gives this name to a frame: six digits or more, `.png`.
fn is_frame(name: &str) -> bool {
    name.strip_suffix(".png")
        .is_some_and(|number| number.len() >= 6 && number.bytes().all(|b| b.is_ascii_digit()))
}

/// Replaces the frames of `into`, and those of its AOV folders, by those of `from`.
fn replace_frames(from: &Path, into: &Path) -> io::Result<()> {
    fs::rename(from.join(MARKER), into.join(MARKER))?;
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
                fs::rename(from.join(&name), into.join(&name))?;
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
