//! Files and folders in the making.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::leftover::{self, draft_name, remove_path};
use super::stream::Sink;
use super::target::Target;

/// Names tried for one draft before giving up.
const MAX_ATTEMPTS: u32 = 1000;

/// Drafts of this process, so that a signal can remove them. Held while one is moved to its
/// destination: a signal comes before or after that, never in the middle.
static LIVE: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn live() -> MutexGuard<'static, Vec<PathBuf>> {
    LIVE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file or folder being made beside its destination; removed unless it is committed.
#[derive(Debug)]
pub struct Draft {
    destination: PathBuf,
    place: Place,
}

#[derive(Debug)]
enum Place {
    /// Made here, moved to the target.
    Beside {
        draft: PathBuf,
        target: PathBuf,
        /// Its lock says that the process lives; see [`leftover`].
        _lock: Option<File>,
    },
    /// Written to directly once all is ready.
    Stream(Target),
}

impl Draft {
    /// For a file. A draft of it exists, empty, from now on; a fifo or device is not touched yet.
    ///
    /// Fails where nothing can be written: a folder, a socket, a block device, a folder without
    /// permission.
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

    /// For a folder. A draft of it exists, empty, from now on.
    pub fn folder(destination: &Path) -> io::Result<Self> {
        Self::make_folder(destination, |path| fs::create_dir(path))
    }

    /// A folder that only this user can read; for what is removed again in the end.
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
        // The nearest folder that exists: made folders would be left behind by an error.
        let parent = target.ancestors().skip(1).find(|path| path.exists());
        let parent = parent.unwrap_or(Path::new("/"));
        if !parent.is_dir() {
            let told = format!("expected a folder at {}, got a file", parent.display());
            return Err(io::Error::other(told));
        }
        leftover::remove(parent);
        for attempt in 0..MAX_ATTEMPTS {
            let draft = parent.join(draft_name(name, attempt));
            // Known before it exists, so that a signal in between finds it.
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
                // Another process took it for a leftover in this very moment.
                leftover::Lock::Lost => forget(&draft),
            }
        }
        Err(io::Error::from(io::ErrorKind::AlreadyExists))
    }

    /// As it was asked for.
    pub fn destination(&self) -> &Path {
        &self.destination
    }

    /// Whether bytes go to a fifo, device or descriptor as they are written.
    pub fn is_stream(&self) -> bool {
        matches!(self.place, Place::Stream(_))
    }

    /// Where the draft lies; the destination itself for a stream.
    pub fn path(&self) -> &Path {
        match &self.place {
            Place::Beside { draft, .. } => draft,
            Place::Stream(_) => &self.destination,
        }
    }

    /// Opens the file for writing. A fifo waits for its reader.
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

    /// Moves it to its destination. A file there is replaced and its permissions are kept; an
    /// empty folder is replaced; a stream has its bytes already.
    pub fn commit(self) -> io::Result<()> {
        let Place::Beside { draft, target, .. } = &self.place else {
            return Ok(());
        };
        let _no_signal = live();
        make_parent(target)?;
        if draft.is_dir() && target.is_dir() {
            // Fails if it holds something, as it should.
            fs::remove_dir(target)?;
        }
        move_onto(draft, target)
    }

    /// Moves what the folder holds to the folder at the destination, which is there, by
    /// `merge(draft, destination)`. A signal waits until it is done.
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
            // Gone already if it was committed. Nothing can be done about a failure here.
            let _ = remove_path(draft);
            forget(draft);
        }
    }
}

fn forget(draft: &Path) {
    live().retain(|path| path != draft);
}

/// Removes every draft of this process and lets none be committed any more; for a process that
/// ends with this.
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
    // Never unlocked: whoever wants to commit waits for the end of the process.
    std::mem::forget(drafts);
}

fn make_parent(path: &Path) -> io::Result<()> {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => fs::create_dir_all(parent),
        _ => Ok(()),
    }
}

/// Renames a file or folder onto a target whose links were followed, keeping the permissions of
/// a file that it replaces. Where a rename is impossible (a file that is a mount point), the
/// bytes are copied.
pub(super) fn move_onto(from: &Path, target: &Path) -> io::Result<()> {
    if let (Ok(old), true) = (fs::metadata(target), from.is_file())
        && old.is_file()
    {
        // Not worth failing for: some file systems have no permissions.
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

/// Moves a finished file to `destination`, whose links are followed. Refuses a fifo, a device
/// or a folder there.
pub fn replace(from: &Path, destination: &Path) -> io::Result<()> {
    match Target::of(destination)? {
        Target::File(target) => move_onto(from, &target),
        Target::Folder(_) => Err(io::Error::other("expected a file, got a folder")),
        _ => Err(io::Error::other("expected a file, got a fifo or device")),
    }
}
