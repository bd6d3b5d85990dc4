//! Files and folders that are being written.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::leftover::{self, draft_name, remove_path};
use super::stream::Sink;
use super::target::Target;

/// Most names tried for one draft.
const MAX_ATTEMPTS: u32 = 1000;

/// Drafts of this process, so that a signal can remove them. The lock is held while a draft is moved to its
/// destination, so a signal is handled before or after the move, never during it.
static LIVE: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn live() -> MutexGuard<'static, Vec<PathBuf>> {
    LIVE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file or folder being written beside its destination; removed unless it is committed.
#[derive(Debug)]
pub struct Draft {
    destination: PathBuf,
    place: Place,
}

#[derive(Debug)]
enum Place {
    /// Written beside the target, and moved there on commit.
    Beside {
        draft: PathBuf,
        target: PathBuf,
        /// The lock shows that the process is alive; see [`leftover`].
        _lock: Option<File>,
    },
    /// Written directly to the target.
    Stream(Target),
}

impl Draft {
    /// A draft of a file. An empty draft is created at once; a fifo or device is not opened yet.
    ///
    /// Fails if nothing can be written: a folder, a socket, a block device, a folder without permission.
    pub fn file(destination: &Path) -> io::Result<Self> {
        match Target::of(destination)? {
            Target::File(target) => {
                Self::beside(destination, target, |path| File::create_new(path).map(drop))
            }
            Target::Folder(_) => Err(io::Error::other("expected a file, got a folder")),
            stream => Ok(Self {
                destination: destination.to_owned(),
                place: Place::Stream(stream),
            }),
        }
    }

    /// A draft of a folder. An empty draft is created at once.
    pub fn folder(destination: &Path) -> io::Result<Self> {
        Self::make_folder(destination, |path| fs::create_dir(path))
    }

    /// A draft of a folder that only this user can read, for temporary folders.
    pub fn private_folder(destination: &Path) -> io::Result<Self> {
        Self::make_folder(destination, |path| {
            let mut builder = fs::DirBuilder::new();
            #[cfg(unix)]
            std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
            builder.create(path)
        })
    }

    fn make_folder(destination: &Path, make: impl Fn(&Path) -> io::Result<()>) -> io::Result<Self> {
        match Target::of(destination)? {
            Target::Folder(target) => Self::beside(destination, target, make),
            Target::File(target) if fs::symlink_metadata(&target).is_err() => {
                Self::beside(destination, target, make)
            }
            Target::File(_) => Err(io::Error::other("expected a folder, got a file")),
            _ => Err(io::Error::other("expected a folder, got a fifo or device")),
        }
    }

    fn beside(
        destination: &Path,
        target: PathBuf,
        make: impl Fn(&Path) -> io::Result<()>,
    ) -> io::Result<Self> {
        let name = target
            .file_name()
            .ok_or_else(|| io::Error::other("expected a name for the output"))?;
        // Created in the nearest existing folder: new parent folders would remain after an error.
        let parent = target.ancestors().skip(1).find(|path| path.exists());
        let parent = parent.unwrap_or(Path::new("/"));
        if !parent.is_dir() {
            let told = format!("expected a folder at {}, got a file", parent.display());
            return Err(io::Error::other(told));
        }
        leftover::remove(parent);
        for attempt in 0..MAX_ATTEMPTS {
            let draft = parent.join(draft_name(name, attempt));
            // Registered before it is created, so that a signal in between removes it.
            live().push(draft.clone());
            let made = make(&draft);
            if let Err(error) = made {
                forget(&draft);
                if error.kind() == io::ErrorKind::AlreadyExists {
                    continue;
                }
                return Err(error);
            }
            match leftover::lock(&draft) {
                leftover::Lock::Held(lock) => {
                    return Ok(Self {
                        destination: destination.to_owned(),
                        place: Place::Beside {
                            draft,
                            target,
                            _lock: lock,
                        },
                    });
                }
                // Another process just removed it as a leftover.
                leftover::Lock::Lost => forget(&draft),
            }
        }
        Err(io::Error::from(io::ErrorKind::AlreadyExists))
    }

    /// The destination as given by the caller.
    pub fn destination(&self) -> &Path {
        &self.destination
    }

    /// Whether the bytes are written directly to a fifo, device or descriptor.
    pub fn is_stream(&self) -> bool {
        matches!(self.place, Place::Stream(_))
    }

    /// Path of the draft; the destination itself for a stream.
    pub fn path(&self) -> &Path {
        match &self.place {
            Place::Beside { draft, .. } => draft,
            Place::Stream(_) => &self.destination,
        }
    }

    /// Opens the file for writing. Opening a fifo waits for its reader.
    pub fn create(&self) -> io::Result<Sink> {
        match &self.place {
            Place::Beside { draft, .. } => Ok(Sink::File(File::create(draft)?)),
            Place::Stream(Target::Descriptor(number)) => Sink::descriptor(*number),
            Place::Stream(_) => Sink::stream(&self.destination),
        }
    }

    /// Writes the whole file.
    pub fn write(&self, bytes: &[u8]) -> io::Result<()> {
        let mut sink = self.create()?;
        sink.write_all(bytes)?;
        sink.flush()
    }

    /// Moves the draft to its destination. An existing file there is replaced and its permissions are kept; an empty
    /// folder is replaced; a stream has received its bytes already.
    pub fn commit(self) -> io::Result<()> {
        let Place::Beside { draft, target, .. } = &self.place else {
            return Ok(());
        };
        let _no_signal = live();
        make_parent(target)?;
        if draft.is_dir() && target.is_dir() {
            // Fails if the folder is not empty, as intended.
            fs::remove_dir(target)?;
        }
        move_onto(draft, target)
    }

    /// Moves the folder's content into the existing folder at the destination, by `merge(draft, destination)`.
    /// Signals are handled after it is done.
    pub fn merge(self, merge: impl FnOnce(&Path, &Path) -> io::Result<()>) -> io::Result<()> {
        let Place::Beside { draft, target, .. } = &self.place else {
            return Ok(());
        };
        let _no_signal = live();
        merge(draft, target)
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        if let Place::Beside { draft, .. } = &self.place {
            // Already moved if it was committed. A failure here cannot be handled.
            let _ = remove_path(draft);
            forget(draft);
        }
    }
}

fn forget(draft: &Path) {
    live().retain(|path| path != draft);
}

/// Removes every draft of this process and prevents further commits; for a process that is about to exit.
pub(super) fn remove_all() {
    let mut drafts = live();
    for draft in drafts.drain(..) {
        // Another thread may still be writing files into a folder.
        for _ in 0..50 {
            if remove_path(&draft).is_ok() {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    }
    // Never unlocked: threads that want to commit wait until the process exits.
    std::mem::forget(drafts);
}

fn make_parent(path: &Path) -> io::Result<()> {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => fs::create_dir_all(parent),
        _ => Ok(()),
    }
}

/// Renames a file or folder to a target whose links were already followed, and keeps the permissions of a replaced
/// file. If renaming is impossible (a file that is a mount point), the bytes are copied.
pub(super) fn move_onto(from: &Path, target: &Path) -> io::Result<()> {
    if let (Ok(old), true) = (fs::metadata(target), from.is_file())
        && old.is_file()
    {
        // An error is ignored: some file systems have no permissions.
        let _ = fs::set_permissions(from, old.permissions());
    }
    match fs::rename(from, target) {
        Err(error)
            if from.is_file()
                && matches!(
                    error.kind(),
                    io::ErrorKind::ResourceBusy | io::ErrorKind::CrossesDevices
                ) =>
        {
            fs::copy(from, target)?;
            fs::remove_file(from)
        }
        other => other,
    }
}

/// Moves a finished file to `destination`, whose links are followed. Fails if the destination is a fifo, a device or
/// a folder.
pub fn replace(from: &Path, destination: &Path) -> io::Result<()> {
    match Target::of(destination)? {
        Target::File(target) => move_onto(from, &target),
        Target::Folder(_) => Err(io::Error::other("expected a file, got a folder")),
        _ => Err(io::Error::other("expected a file, got a fifo or device")),
    }
}
