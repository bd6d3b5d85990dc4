//! Invalid items of a file: left out, counted, and described in notes.

/// Counts by kind, with the first of each kind in words.
#[derive(Debug, Default)]
pub(super) struct Odd(Vec<(&'static str, usize, String)>);

impl Odd {
    /// Counts an item of a kind; `first` describes it, and is called for the first only.
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
