//! Removal of drafts of processes that were killed.
//!
//! A draft is named `.NAME.ghostlight-PID-N.partial` and locked (`flock`) while its process is alive; the system
//! releases the lock when the process ends for any reason. So a draft whose lock can be acquired is a leftover, even
//! if another process now has the same PID.

use std::ffi::OsStr;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::Path;

const MARK: &str = ".ghostlight-";
const SUFFIX: &str = ".partial";

/// The name of a draft of `name` by this process.
pub(super) fn draft_name(name: &OsStr, attempt: u32) -> String {
    let name = name.to_string_lossy();
    // File systems allow names of 255 bytes, which must include the other parts.
    let short: String = name.chars().take(50).collect();
    format!(".{short}{MARK}{}-{attempt}{SUFFIX}", std::process::id())
}

/// Whether a name has the form of a draft's name.
fn is_draft(name: &str) -> bool {
    let Some(rest) = name.strip_prefix('.').and_then(|x| x.strip_suffix(SUFFIX)) else {
        return false;
    };
    let Some((_, numbers)) = rest.rsplit_once(MARK) else {
        return false;
    };
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    numbers
        .split_once('-')
        .is_some_and(|(pid, attempt)| digits(pid) && digits(attempt))
}

/// Result of the attempt to lock a new draft.
pub(super) enum Lock {
    /// Locked, or created on a system without locks, where other processes never remove it.
    Held(Option<File>),
    /// Another process is removing it.
    Lost,
}

/// Locks a new draft.
pub(super) fn lock(draft: &Path) -> Lock {
    let Ok(file) = File::open(draft) else {
        return match draft.exists() {
            true => Lock::Held(None),
            false => Lock::Lost,
        };
    };
    match file.try_lock() {
        Ok(()) if draft.exists() => Lock::Held(Some(file)),
        Ok(()) | Err(TryLockError::WouldBlock) => Lock::Lost,
        Err(TryLockError::Error(_)) => Lock::Held(None),
    }
}

/// Removes the drafts in `folder` that no process has locked. Failures are ignored: the drafts may belong to another
/// user.
pub(super) fn remove(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        if !entry.file_name().to_str().is_some_and(is_draft) {
            continue;
        }
        let path = entry.path();
        // A link with such a name is not a draft, and opening a fifo would wait.
        let ours = entry.file_type().is_ok_and(|t| t.is_file() || t.is_dir());
        let Some(file) = ours.then(|| File::open(&path).ok()).flatten() else {
            continue;
        };
        if file.try_lock().is_ok() {
            let _ = remove_path(&path);
        }
    }
}

/// Removes a file or folder; succeeds if it does not exist.
pub(super) fn remove_path(path: &Path) -> io::Result<()> {
    let removed = match fs::symlink_metadata(path) {
        Ok(metadata) if metadata.is_dir() => fs::remove_dir_all(path),
        Ok(_) => fs::remove_file(path),
        Err(error) => Err(error),
    };
    match removed {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_drafts_are_taken_for_drafts() {
        let name = draft_name(OsStr::new("film.mp4"), 3);
        assert!(is_draft(&name), "{name}");
        assert!(is_draft(&draft_name(OsStr::new(&"x".repeat(300)), 0)));
        for other in [
            "film.mp4",
            ".film.mp4.partial",
            ".film.mp4.ghostlight-.partial",
            ".film.mp4.ghostlight-12.partial",
            ".film.mp4.ghostlight-12-x.partial",
            "film.mp4.ghostlight-12-0.partial",
            ".film.mp4.ghostlight-12-0.partial.bak",
        ] {
            assert!(!is_draft(other), "{other}");
        }
    }
}
