//! Resolves an output path: a regular file or folder, or a target that must not be replaced.

use std::fs::{self, FileType, Metadata};
use std::io;
use std::path::{Path, PathBuf};

/// Most links followed before a chain counts as a loop; the limit of Linux.
const MAX_LINKS: usize = 40;

/// The kind of a destination, after following symbolic links.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// A regular file at this path, or a path that does not exist.
    File(PathBuf),
    /// A folder at this path.
    Folder(PathBuf),
    /// A fifo or character device: bytes are written into it.
    Stream(PathBuf),
    /// A descriptor that this process inherited, as in `/dev/stdout` or `/dev/fd/3`.
    Descriptor(u32),
}

impl Target {
    /// Follows the links of `path`. Fails for targets that can neither be replaced nor written to: block devices,
    /// sockets, loops of links.
    pub fn of(path: &Path) -> io::Result<Self> {
        let mut path = std::path::absolute(path)?;
        for _ in 0..MAX_LINKS {
            if let Some(descriptor) = descriptor(&path) {
                return Ok(Self::Descriptor(descriptor));
            }
            let metadata = match fs::symlink_metadata(&path) {
                Ok(metadata) => metadata,
                Err(error) if error.kind() == io::ErrorKind::NotFound => {
                    return Ok(Self::File(path));
                }
                Err(error) => return Err(error),
            };
            if !metadata.is_symlink() {
                return Self::from_metadata(path, &metadata);
            }
            let link = fs::read_link(&path)?;
            let parent = path.parent().unwrap_or(Path::new("/"));
            // `join` keeps an absolute link unchanged.
            path = std::path::absolute(parent.join(link))?;
        }
        Err(io::Error::other("expected a file, got a loop of links"))
    }

    fn from_metadata(path: PathBuf, metadata: &Metadata) -> io::Result<Self> {
        let kind = metadata.file_type();
        if kind.is_file() {
            return Ok(Self::File(path));
        }
        if kind.is_dir() {
            return Ok(Self::Folder(path));
        }
        match special(kind) {
            Special::Stream => Ok(Self::Stream(path)),
            Special::Other(name) => Err(io::Error::other(format!("expected a file, got {name}"))),
        }
    }
}

enum Special {
    Stream,
    Other(&'static str),
}

#[cfg(unix)]
fn special(kind: FileType) -> Special {
    use std::os::unix::fs::FileTypeExt as _;
    if kind.is_fifo() || kind.is_char_device() {
        Special::Stream
    } else if kind.is_block_device() {
        Special::Other("a block device")
    } else if kind.is_socket() {
        Special::Other("a socket")
    } else {
        Special::Other("something else")
    }
}

#[cfg(not(unix))]
fn special(_: FileType) -> Special {
    Special::Other("something else")
}

/// The number in `/dev/fd/N`, `/proc/self/fd/N` or `/proc/PID/fd/N` of this process. The target of such a link is not
/// replaced: the descriptor itself is written to.
fn descriptor(path: &Path) -> Option<u32> {
    let number = path.file_name()?.to_str()?.parse().ok()?;
    let folder = path.parent()?.to_str()?;
    let own = format!("/proc/{}/fd", std::process::id());
    ["/dev/fd", "/proc/self/fd", "/proc/thread-self/fd", &own]
        .contains(&folder)
        .then_some(number)
}
