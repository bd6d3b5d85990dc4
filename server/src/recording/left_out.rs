//! Counts items that were left out, and describes them in one note: some names, and the reason of the first.

use std::fmt::Display;

/// Most items that a note names.
const MAX_NAMED: usize = 5;

/// Parts of a recording that were left out for one kind of reason.
#[derive(Debug, Default)]
pub(super) struct LeftOut {
    count: usize,
    named: Vec<String>,
    /// Reason of the first item.
    reason: Option<String>,
}

impl LeftOut {
    /// Counts an item; `reason` is one line.
    pub(super) fn add(&mut self, name: impl Display, reason: impl Display) {
        self.count += 1;
        if self.named.len() < MAX_NAMED {
            self.named.push(name.to_string());
        }
        self.reason.get_or_insert_with(|| reason.to_string());
    }

    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Adds the note "2 of 60 `what`: a, b (reason of the first)"; no note if nothing was left out. `what` names the
    /// problem and says that the items are left out.
    pub(super) fn note(&self, of: usize, what: &str, into: &mut Vec<String>) {
        if self.count == 0 {
            return;
        }
        let mut names = self.named.join(", ");
        if self.count > self.named.len() {
            names += &format!(" and {} more", self.count - self.named.len());
        }
        let reason = self.reason.as_deref().unwrap_or_default();
        into.push(format!(
            "{} of {of} {what}: {names} ({reason}).",
            self.count
        ));
    }
}

/// The name of a file, formatted for a note.
pub(super) fn name_of(path: impl AsRef<std::path::Path>) -> String {
    let path = path.as_ref();
    let name = path.file_name().unwrap_or(path.as_os_str());
    super::excerpt::printable(&name.to_string_lossy())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_are_named_all_are_counted() {
        let mut notes = Vec::new();
        let mut left = LeftOut::default();
        left.note(9, "x", &mut notes);
        assert!(notes.is_empty());
        for i in 0..7 {
            left.add(i, format!("reason {i}"));
        }
        left.note(9, "pictures are left out", &mut notes);
        assert_eq!(
            notes,
            ["7 of 9 pictures are left out: 0, 1, 2, 3, 4 and 2 more (reason 0)."]
        );
    }
}
