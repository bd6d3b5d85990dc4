//! Uploads as files, for the scene loaders.
//!
//! A process keeps its uploads in one folder under the system's temporary folder that only its user can read.
//! While it runs, it holds a lock on a file in that folder. A process that is killed leaves its folder behind,
//! unlocked, and the next process removes it.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use tempfile::TempDir;

use super::catalog::Assets;

/// Prefix of the folder names.
const PREFIX: &str = "ghostlight-uploads-";

/// The file whose lock shows that the process is alive.
const LOCK: &str = "lock";

/// The folder of a process.
#[derive(Debug)]
struct Home {
    // Declared before the lock, so that the folder is removed before the lock is released.
    folder: TempDir,
    _lock: File,
}

/// The process's folder, while any session has uploads in it.
static HOME: Mutex<Weak<Home>> = Mutex::new(Weak::new());

impl Home {
    /// Returns the process's folder. Creates it if there is none, and then also removes folders of killed
    /// processes.
    fn get() -> io::Result<Arc<Self>> {
        let mut home = HOME.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(home) = home.upgrade() {
            return Ok(home);
        }
        let new = Arc::new(Self::new_in(&std::env::temp_dir())?);
        *home = Arc::downgrade(&new);
        Ok(new)
    }

    fn new_in(folder: &Path) -> io::Result<Self> {
        remove_left_behind_in(folder);
        let folder = private_folder(PREFIX, folder)?;
        // Renamed only once it is locked, so that the folder never looks left behind.
        let unlocked = folder.path().join("lock.new");
        let lock = File::create_new(&unlocked)?;
        lock.lock()?;
        std::fs::rename(unlocked, folder.path().join(LOCK))?;
        Ok(Self {
            folder,
            _lock: lock,
        })
    }
}

/// Creates a folder that only this user can read, from the moment it exists.
fn private_folder(prefix: &str, within: &Path) -> io::Result<TempDir> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(prefix);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o700));
    }
    builder.tempdir_in(within)
}

/// Removes this process's folder although sessions may still use it, because the process ends.
pub(super) fn remove_own() {
    let home = HOME.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(home) = home.upgrade() {
        // If this fails, the next process removes it.
        let _ = std::fs::remove_dir_all(home.folder.path());
    }
}

/// Removes upload folders that killed processes of this user left behind.
pub(super) fn remove_left_behind() {
    remove_left_behind_in(&std::env::temp_dir());
}

fn remove_left_behind_in(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let ours = entry.file_name().to_string_lossy().starts_with(PREFIX);
        if ours && is_left_behind(&entry.path()) {
            // Fails for folders of other users, which stay.
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}

/// Whether a folder is one of this user's whose process is gone.
fn is_left_behind(folder: &Path) -> bool {
    // Metadata of the entry itself: links are not followed.
    let Ok(metadata) = folder.symlink_metadata() else {
        return false;
    };
    if !metadata.is_dir() || !is_own(&metadata) {
        return false;
    }
    let path = folder.join(LOCK);
    match path.symlink_metadata() {
        Ok(lock) if lock.is_file() => File::open(&path)
            .is_ok_and(|file| !matches!(file.try_lock(), Err(TryLockError::WouldBlock))),
        Ok(_) => false,
        // Either the process was killed between creating the folder and the lock, or it is creating them now.
        Err(_) => metadata
            .modified()
            .ok()
            .and_then(|time| time.elapsed().ok())
            .is_some_and(|age| age.as_secs() > 60),
    }
}

#[cfg(unix)]
fn is_own(metadata: &std::fs::Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    // The temporary folder may contain many folders of other users.
    std::fs::metadata("/proc/self").is_ok_and(|process| process.uid() == metadata.uid())
}

#[cfg(not(unix))]
fn is_own(_: &std::fs::Metadata) -> bool {
    true
}

/// A session's uploads as files; removed when it is dropped.
#[derive(Debug)]
pub(super) struct UploadFolder {
    // Declared first, so that it is removed before the home folder.
    folder: TempDir,
    _home: Arc<Home>,
    written: Mutex<BTreeMap<String, Arc<Vec<u8>>>>,
}

impl UploadFolder {
    /// An empty folder.
    pub(super) fn new() -> io::Result<Self> {
        let home = Home::get()?;
        let folder = private_folder("session-", home.folder.path())?;
        Ok(Self {
            folder,
            _home: home,
            written: Mutex::default(),
        })
    }

    /// Brings the files up to date and returns their folder.
    pub(super) fn write(&self, assets: &Assets) -> io::Result<PathBuf> {
        let mut written = self.written.lock().unwrap_or_else(PoisonError::into_inner);
        for (name, content) in assets {
            let same = written.get(name).is_some_and(|w| Arc::ptr_eq(w, content));
            if !same {
                // The name was checked when the upload was announced: a plain file name.
                std::fs::write(self.folder.path().join(name), content.as_slice())?;
                written.insert(name.clone(), Arc::clone(content));
            }
        }
        Ok(self.folder.path().to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uploads_are_for_this_user_only_and_gone_with_the_session() {
        let content = Arc::new(b"v 0 0 0".to_vec());
        let assets = Assets::from([("a.obj".to_owned(), Arc::clone(&content))]);
        let uploads = UploadFolder::new().unwrap();
        let folder = uploads.write(&assets).unwrap();
        assert_eq!(std::fs::read(folder.join("a.obj")).unwrap(), *content);
        let home = folder.parent().unwrap().to_owned();
        #[cfg(unix)]
        for folder in [&folder, &home] {
            use std::os::unix::fs::PermissionsExt;
            let mode = folder.metadata().unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o700, "{}", folder.display());
        }
        // Another process that starts does not remove it, because this process is alive.
        assert!(!is_left_behind(&home));
        drop(uploads);
        assert!(!folder.exists());
    }

    #[test]
    fn what_a_killed_process_left_is_removed_and_nothing_else() {
        let root = tempfile::tempdir().unwrap();
        let path = |name: &str| root.path().join(name);
        let living = Home::new_in(root.path()).unwrap();
        // As after a kill: the folder exists, and nobody holds its lock.
        let left = path("ghostlight-uploads-left");
        std::fs::create_dir_all(left.join("session-x")).unwrap();
        std::fs::write(left.join("session-x/a.obj"), "v").unwrap();
        std::fs::write(left.join(LOCK), "").unwrap();
        // A folder being created, a user's file, and another program's folder.
        std::fs::create_dir(path("ghostlight-uploads-new")).unwrap();
        std::fs::write(path("ghostlight-uploads-file"), "").unwrap();
        std::fs::create_dir(path("other")).unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink(path("other"), path("ghostlight-uploads-link")).unwrap();
        remove_left_behind_in(root.path());
        assert!(!left.exists());
        assert!(living.folder.path().exists());
        for stays in ["ghostlight-uploads-new", "ghostlight-uploads-file", "other"] {
            assert!(path(stays).exists(), "{stays}");
        }
        #[cfg(unix)]
        assert!(path("ghostlight-uploads-link").symlink_metadata().is_ok());
        let folder = living.folder.path().to_owned();
        drop(living);
        assert!(!folder.exists());
    }
}
