//! A zip archive as a tree of folders. Nothing is unpacked to disk: members (stored or deflated) are read into memory
//! one at a time, with the same limits as files.
//!
//! Names are untrusted: members whose name leads out of the archive, is absolute, or is extremely long or deep are
//! left out, and so are links and hidden files.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Component, Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use zip::ZipArchive;
use zip::read::ZipFile;
use zip::result::ZipError;

use crate::codec::CodecError;

use super::error::{Place, RecordingError};
use super::excerpt::MAX_ENTRIES;

/// Longest name of a member, bytes, and most folders above it: far more than any recording has. Every member creates
/// all folders above it, so these limits bound the memory of the tree.
const MAX_NAME_BYTES: usize = 1024;
const MAX_FOLDERS: usize = 32;
/// Folder that macOS adds for its own use.
const MACOS_FOLDER: &str = "__MACOSX";

type Reader = BufReader<File>;

/// An open archive.
pub(super) struct Archive {
    path: PathBuf,
    /// A single reader for all members: decoding pictures takes longer than the lock is held.
    zip: Mutex<ZipArchive<Reader>>,
    /// By the path from the root, with slashes; the root is "".
    folders: HashMap<String, Folder>,
}

#[derive(Debug, Default)]
struct Folder {
    files: BTreeMap<String, Member>,
    folders: BTreeSet<String>,
}

#[derive(Debug, Clone, Copy)]
struct Member {
    index: usize,
    /// Uncompressed size, as declared in the archive's directory.
    bytes: u64,
}

impl fmt::Debug for Archive {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Archive").field(&self.path).finish()
    }
}

impl Archive {
    /// Reads the directory of a zip archive.
    pub(super) fn open(path: &Path) -> Result<Self, RecordingError> {
        let failed = |source| RecordingError::Io {
            path: path.to_owned(),
            source,
        };
        let bad = |got: String| Place::file(path).field("recording", "a whole zip archive", got);
        let file = BufReader::new(File::open(path).map_err(failed)?);
        let mut zip = ZipArchive::new(file).map_err(|error| match error {
            ZipError::Io(source) if source.kind() != io::ErrorKind::UnexpectedEof => failed(source),
            other => bad(format!("one that cannot be read ({other})")),
        })?;
        if zip.len() > MAX_ENTRIES {
            let got = format!("{} members (at most {MAX_ENTRIES} are read)", zip.len());
            return Err(bad(got));
        }
        let mut folders = HashMap::from([(String::new(), Folder::default())]);
        for index in 0..zip.len() {
            let Ok(member) = zip.by_index_raw(index) else {
                continue;
            };
            let (Ok(name), false) = (member.name(), member.is_symlink()) else {
                continue;
            };
            // Some programs on Windows use backslashes as separators.
            let name = name.replace('\\', "/");
            let is_folder = name.ends_with('/');
            if let Some(parts) = parts(&name) {
                let bytes = member.size();
                insert(
                    &mut folders,
                    &parts,
                    (!is_folder).then_some(Member { index, bytes }),
                );
            }
        }
        Ok(Self {
            path: path.to_owned(),
            zip: Mutex::new(zip),
            folders,
        })
    }

    /// Path of the archive itself.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    fn folder(&self, inside: &Path) -> Option<&Folder> {
        self.folders.get(&key(inside)?)
    }

    fn member(&self, inside: &Path) -> Option<Member> {
        let name = inside.file_name()?.to_str()?;
        let folder = self.folder(inside.parent()?)?;
        folder.files.get(name).copied()
    }

    pub(super) fn has_folder(&self, inside: &Path) -> bool {
        self.folder(inside).is_some()
    }

    /// Size of a file in bytes; `None` if there is no such file.
    pub(super) fn size(&self, inside: &Path) -> Option<u64> {
        self.member(inside).map(|member| member.bytes)
    }

    /// Names of the files in a folder, sorted; empty if the folder does not exist.
    pub(super) fn file_names(&self, inside: &Path) -> Vec<String> {
        let folder = self.folder(inside);
        folder.map_or(Vec::new(), |f| f.files.keys().cloned().collect())
    }

    /// Names of the folders in a folder, sorted; empty if the folder does not exist.
    pub(super) fn folder_names(&self, inside: &Path) -> Vec<String> {
        let folder = self.folder(inside);
        folder.map_or(Vec::new(), |f| f.folders.iter().cloned().collect())
    }

    /// Reads a whole file of at most `max_bytes`.
    pub(super) fn read(&self, inside: &Path, max_bytes: u64) -> Result<Vec<u8>, CodecError> {
        // A declared size is not trusted for allocation beyond this; larger buffers grow while reading.
        const MAX_TRUSTED_BYTES: u64 = 16 << 20;
        let file = || self.path.join(inside).display().to_string();
        let io = |source| CodecError::Io {
            file: file(),
            source,
        };
        let too_large = |got| CodecError::TooLarge {
            file: file(),
            field: "file size in bytes",
            limit: max_bytes,
            got,
        };
        let missing = || io(io::ErrorKind::NotFound.into());
        let member = self.member(inside).ok_or_else(missing)?;
        if member.bytes > max_bytes {
            return Err(too_large(member.bytes));
        }
        let mut zip = self.reader();
        let reader = open(&mut zip, member).map_err(io)?;
        let mut bytes = Vec::with_capacity(member.bytes.min(MAX_TRUSTED_BYTES) as usize);
        // One byte beyond the limit reveals a member that is larger than declared. Reading to the end also verifies
        // the checksum.
        reader
            .take(max_bytes + 1)
            .read_to_end(&mut bytes)
            .map_err(io)?;
        if bytes.len() as u64 > max_bytes {
            return Err(too_large(bytes.len() as u64));
        }
        Ok(bytes)
    }

    /// The first `n` bytes of a file, or all if it is shorter.
    pub(super) fn head(&self, inside: &Path, n: u64) -> io::Result<Vec<u8>> {
        let member = self.member(inside).ok_or(io::ErrorKind::NotFound)?;
        let mut zip = self.reader();
        let mut head = Vec::new();
        open(&mut zip, member)?.take(n).read_to_end(&mut head)?;
        Ok(head)
    }

    fn reader(&self) -> MutexGuard<'_, ZipArchive<Reader>> {
        // After a panic elsewhere only the reader's position may differ, and every read sets it.
        self.zip.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The reader of a member; the error says whether it is encrypted or uses an unsupported compression.
fn open(zip: &mut ZipArchive<Reader>, member: Member) -> io::Result<ZipFile<'_, Reader>> {
    zip.by_index(member.index).map_err(|error| match error {
        ZipError::Io(error) => error,
        other => io::Error::new(io::ErrorKind::InvalidData, other),
    })
}

/// The path components of a member's name; `None` for a member that is left out.
fn parts(name: &str) -> Option<Vec<&str>> {
    let is_drive = name.get(1..2) == Some(":");
    if name.len() > MAX_NAME_BYTES || name.starts_with('/') || is_drive || name.contains('\0') {
        return None;
    }
    let parts = name
        .split('/')
        .filter(|part| !part.is_empty() && *part != ".");
    let parts: Vec<&str> = parts.collect();
    let unwanted = |part: &&str| part.starts_with('.') || *part == MACOS_FOLDER;
    // This also excludes "..", because it begins with a dot.
    (!parts.is_empty() && parts.len() <= MAX_FOLDERS + 1 && !parts.iter().any(unwanted))
        .then_some(parts)
}

/// Adds a file, or a folder if `member` is `None`, and the folders above it.
fn insert(folders: &mut HashMap<String, Folder>, parts: &[&str], member: Option<Member>) {
    let n_folders = parts.len() - usize::from(member.is_some());
    let mut at = String::new();
    for part in &parts[..n_folders] {
        let parent = folders.entry(at.clone()).or_default();
        parent.folders.insert((*part).to_owned());
        if !at.is_empty() {
            at.push('/');
        }
        at += part;
        folders.entry(at.clone()).or_default();
    }
    if let (Some(member), Some(name)) = (member, parts.last()) {
        let folder = folders.entry(at).or_default();
        folder.files.insert((*name).to_owned(), member);
    }
}

/// A relative path as a key of the tree; `None` if it leads out of the archive or is not UTF-8.
fn key(inside: &Path) -> Option<String> {
    let mut parts = Vec::new();
    for part in inside.components() {
        match part {
            Component::Normal(part) => parts.push(part.to_str()?),
            Component::CurDir => {}
            Component::ParentDir | Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    Some(parts.join("/"))
}
