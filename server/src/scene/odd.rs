//! Counts the invalid items of a file that are left out, and describes them in notes.

/// Counts per kind, with a description of the first item of each kind.
#[derive(Debug, Default)]
pub(super) struct Odd(Vec<(&'static str, usize, String)>);

impl Odd {
    /// Counts an item of a kind; `first` describes it and is only called for the first item.
    pub(super) fn add(&mut self, kind: &'static str, first: impl FnOnce() -> String) {
        match self.0.iter_mut().find(|(known, ..)| *known == kind) {
            Some((_, n, _)) => *n += 1,
            None => self.0.push((kind, 1, first())),
        }
    }

    /// One sentence per kind.
    pub(super) fn into_notes(self) -> impl Iterator<Item = String> {
        self.0.into_iter().map(|(kind, n, first)| match n {
            1 => format!("1 {kind} ({first})"),
            n => format!("{n} {kind} (the first: {first})"),
        })
    }
}
