//! Location of a file or folder of a recording: on disk, or inside an archive. Layouts treat both the same way, so a
//! zipped recording is read like the folder.

use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::codec::{self, CodecError, DepthMap, GrayImage, MAX_IMAGE_FILE_BYTES};
use crate::frame::ColorImage;

use super::archive::Archive;
use super::error::RecordingError;
use super::excerpt::{MAX_ENTRIES, printable};

/// A file or folder, which need not exist.
#[derive(Debug, Clone)]
pub(super) struct Location {
    /// Path on disk; inside an archive, the archive's path followed by the path within the archive.
    path: PathBuf,
    /// The archive that contains it; `None` on disk.
    archive: Option<Arc<Archive>>,
}

impl From<&Path> for Location {
    fn from(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            archive: None,
        }
    }
}

impl AsRef<Path> for Location {
    fn as_ref(&self) -> &Path {
        &self.path
    }
}

impl Location {
    /// The root of a zip archive.
    pub(super) fn zip(path: &Path) -> Result<Self, RecordingError> {
        Ok(Self {
            path: path.to_owned(),
            archive: Some(Arc::new(Archive::open(path)?)),
        })
    }

    /// Path for messages and names; it can only be opened if the location is on disk.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The path on disk, unless the location is in an archive.
    pub(super) fn on_disk(&self) -> Option<&Path> {
        self.archive.is_none().then_some(&*self.path)
    }

    /// The last component of the path, as text.
    pub(super) fn file_name(&self) -> String {
        let name = self.path.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    /// A location inside this folder, by relative path.
    pub(super) fn join(&self, inside: impl AsRef<Path>) -> Self {
        Self {
            path: self.path.join(inside),
            archive: self.archive.clone(),
        }
    }

    /// The folder that contains this; `None` for the root of a disk or archive.
    pub(super) fn parent(&self) -> Option<Self> {
        let is_root = |archive: &Arc<Archive>| archive.path() == self.path;
        if self.archive.as_ref().is_some_and(is_root) {
            return None;
        }
        Some(Self {
            path: self.path.parent()?.to_owned(),
            archive: self.archive.clone(),
        })
    }

    /// On disk, the absolute path without links, because a relative path such as "." has no name and no parent.
    pub(super) fn absolute(&self) -> Self {
        let path = self.on_disk().and_then(|path| path.canonicalize().ok());
        match path {
            Some(path) => Self::from(path.as_path()),
            None => self.clone(),
        }
    }

    /// The archive that contains this, and the path within the archive.
    fn packed(&self) -> Option<(&Archive, &Path)> {
        let archive = self.archive.as_deref()?;
        let inside = self.path.strip_prefix(archive.path());
        // A path outside the archive is never looked up on disk.
        Some((archive, inside.unwrap_or(Path::new(".."))))
    }

    pub(super) fn is_dir(&self) -> bool {
        match self.packed() {
            Some((archive, inside)) => archive.has_folder(inside),
            None => self.path.is_dir(),
        }
    }

    pub(super) fn is_file(&self) -> bool {
        match self.packed() {
            Some((archive, inside)) => archive.size(inside).is_some(),
            None => self.path.is_file(),
        }
    }

    /// Whether it is a file that is not empty.
    pub(super) fn has_content(&self) -> bool {
        match self.packed() {
            Some((archive, inside)) => archive.size(inside).is_some_and(|bytes| bytes > 0),
            None => std::fs::metadata(&self.path).is_ok_and(|m| m.is_file() && m.len() > 0),
        }
    }

    /// Reads a whole file of at most `max_bytes`.
    pub(super) fn read(&self, max_bytes: u64) -> Result<Vec<u8>, CodecError> {
        match self.packed() {
            Some((archive, inside)) => archive.read(inside, max_bytes),
            None => codec::read_file(&self.path, max_bytes),
        }
    }

    /// The first `n` bytes of a file, or all if it is shorter.
    pub(super) fn head(&self, n: u64) -> io::Result<Vec<u8>> {
        if let Some((archive, inside)) = self.packed() {
            return archive.head(inside, n);
        }
        // Checked before opening, because opening a pipe would wait for its writer.
        if !std::fs::metadata(&self.path)?.is_file() {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        let mut head = Vec::new();
        std::fs::File::open(&self.path)?
            .take(n)
            .read_to_end(&mut head)?;
        Ok(head)
    }

    /// Reads and decodes a colour image.
    pub(super) fn color(&self) -> Result<ColorImage, CodecError> {
        codec::decode_color(&self.read(MAX_IMAGE_FILE_BYTES)?, &self.name_in_errors())
    }

    /// Reads and decodes a depth image.
    pub(super) fn depth(&self) -> Result<DepthMap, CodecError> {
        codec::decode_depth_map(&self.read(MAX_IMAGE_FILE_BYTES)?, &self.name_in_errors())
    }

    /// Reads and decodes an 8-bit image of one channel.
    pub(super) fn gray8(&self) -> Result<GrayImage, CodecError> {
        codec::decode_gray8(&self.read(MAX_IMAGE_FILE_BYTES)?, &self.name_in_errors())
    }

    fn name_in_errors(&self) -> String {
        self.path.display().to_string()
    }

    /// Names of the files in a folder, sorted as text. Hidden files are left out (macOS adds a `._` file to every
    /// file on foreign disks), and so are names that are not UTF-8 and other kinds of entries.
    pub(super) fn file_names(&self) -> Result<Vec<String>, RecordingError> {
        match self.packed() {
            Some((archive, inside)) => Ok(archive.file_names(inside)),
            None => names_on_disk(&self.path, false),
        }
    }

    /// Names of the folders in a folder, sorted as text.
    pub(super) fn folder_names(&self) -> Result<Vec<String>, RecordingError> {
        match self.packed() {
            Some((archive, inside)) => Ok(archive.folder_names(inside)),
            None => names_on_disk(&self.path, true),
        }
    }

    /// Names in a folder that [`Self::file_names`] leaves out because they are not UTF-8, as readable as possible,
    /// sorted. Names in an archive are always UTF-8.
    pub(super) fn unreadable_names(&self) -> Vec<String> {
        let Some(dir) = self.on_disk() else {
            return Vec::new();
        };
        let entries = std::fs::read_dir(dir).into_iter().flatten();
        let entries = entries.take(MAX_ENTRIES).flatten();
        let mut names: Vec<String> = entries
            .filter_map(|entry| entry.file_name().into_string().err())
            .map(|name| printable(&name.to_string_lossy()))
            .collect();
        names.sort_unstable();
        names
    }
}

fn names_on_disk(dir: &Path, folders: bool) -> Result<Vec<String>, RecordingError> {
    let io = |source| RecordingError::Io {
        path: dir.to_owned(),
        source,
    };
    let mut names = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(io)?.take(MAX_ENTRIES) {
        let entry = entry.map_err(io)?;
        // Follows links, because recordings are often assembled from links. A dangling link is ignored.
        let is_folder = match entry.file_type().map_err(io)? {
            kind if kind.is_symlink() => match std::fs::metadata(entry.path()) {
                Ok(target) => target.is_dir(),
                Err(_) => continue,
            },
            kind => kind.is_dir(),
        };
        if is_folder == folders
            && let Ok(name) = entry.file_name().into_string()
            && !name.starts_with('.')
        {
            names.push(name);
        }
    }
    names.sort_unstable();
    Ok(names)
}
