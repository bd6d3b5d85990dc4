//! Writes a report's folder: its files appear when all are finished, or not at all.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use ghostlight::output::{Draft, replace};

/// Marks a folder written by `compare` and lists its files, so that the next run may replace them.
const MARKER: &str = ".ghostlight-compare";

/// A folder that is writable, as far as can be checked before writing.
#[derive(Debug)]
pub struct Output {
    destination: PathBuf,
}

impl Output {
    /// Checks the destination: a new folder, one that `compare` wrote before, or one without files with the names
    /// of a report's files.
    pub fn new(destination: &Path) -> Result<Self> {
        let told = || destination.display().to_string();
        let whole = std::path::absolute(destination).with_context(told)?;
        if whole.exists() && !whole.is_dir() {
            bail!("{}: expected a folder, got a file", destination.display());
        }
        if whole.is_dir() && !whole.join(MARKER).exists() {
            for name in ["index.html", "compare.json"] {
                if whole.join(name).exists() {
                    bail!(
                        "{}: holds {name}, which compare did not write and which would be overwritten; \
                         give another folder",
                        destination.display()
                    );
                }
            }
        }
        // Creates the folder as a test and removes it again: an interrupted run leaves no folder behind.
        Draft::folder(&whole).with_context(told)?;
        Ok(Self { destination: whole })
    }

    /// Writes all files. In an existing folder, files of the last report that are not part of this one are
    /// removed; other files stay.
    pub fn write(self, files: &[(String, Vec<u8>)]) -> Result<()> {
        self.commit(files)
            .with_context(|| self.destination.display().to_string())
    }

    fn commit(&self, files: &[(String, Vec<u8>)]) -> Result<()> {
        let draft = Draft::folder(&self.destination)?;
        for (name, bytes) in files {
            fs::write(draft.path().join(name), bytes)?;
        }
        let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
        fs::write(draft.path().join(MARKER), names.join("\n"))?;
        let last = fs::read_to_string(self.destination.join(MARKER)).unwrap_or_default();
        draft.merge(|draft, destination| {
            fs::create_dir_all(destination)?;
            for name in names.iter().copied().chain([MARKER]) {
                replace(&draft.join(name), &destination.join(name))?;
            }
            Ok(())
        })?;
        for stale in last.lines().filter(|name| !names.contains(name)) {
            // The marker may have been edited: it must not refer to files outside of the folder.
            if stale.ends_with(".csv") && !stale.contains(['/', '\\']) {
                let _ = fs::remove_file(self.destination.join(stale));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(name: &str, text: &str) -> (String, Vec<u8>) {
        (name.to_owned(), text.as_bytes().to_vec())
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_second_report_replaces_the_first_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("a/b");
        let first = [
            file("index.html", "1"),
            file("x.csv", "1"),
            file("y.csv", "1"),
        ];
        Output::new(&out).unwrap().write(&first).unwrap();
        assert_eq!(names(&out), [MARKER, "index.html", "x.csv", "y.csv"]);
        fs::write(out.join("notes.txt"), "mine").unwrap();
        fs::write(out.join("mine.csv"), "mine").unwrap();
        let second = [file("index.html", "2"), file("x.csv", "2")];
        Output::new(&out).unwrap().write(&second).unwrap();
        assert_eq!(
            names(&out),
            [MARKER, "index.html", "mine.csv", "notes.txt", "x.csv"]
        );
        assert_eq!(fs::read_to_string(out.join("x.csv")).unwrap(), "2");
        assert_eq!(names(folder.path()), ["a"]);
    }

    #[test]
    fn what_compare_did_not_write_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("index.html"), "mine").unwrap();
        let error = Output::new(folder.path()).unwrap_err().to_string();
        assert!(error.contains("index.html"), "{error}");
        let file = folder.path().join("index.html");
        let error = Output::new(&file).unwrap_err().to_string();
        assert!(error.contains("expected a folder"), "{error}");
        // A report that is never written leaves no folder behind.
        drop(Output::new(&folder.path().join("new")).unwrap());
        assert_eq!(names(folder.path()), ["index.html"]);
    }
}
