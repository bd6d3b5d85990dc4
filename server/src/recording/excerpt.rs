//! What is repeated of hostile folders and files: how many entries, how much of a text.

/// Most entries of a folder or list that are looked at: nine hours at 30 Hz.
pub(super) const MAX_ENTRIES: usize = 1_000_000;

/// Longest excerpt of a file that an error repeats, characters.
const MAX_QUOTE: usize = 60;

/// A piece of a hostile file, fit to be printed in one line.
pub(super) fn quote(text: &str) -> String {
    format!("\"{}\"", printable(text))
}

/// [`quote`] without its quotes.
pub(super) fn printable(text: &str) -> String {
    let short: String = text.chars().take(MAX_QUOTE).collect();
    let dots = if short.len() < text.len() { "…" } else { "" };
    format!("{}{dots}", short.escape_debug())
}
