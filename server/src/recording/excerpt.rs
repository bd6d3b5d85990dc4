//! Limits on what is read and quoted from hostile folders and files: number of entries, length of a text.

/// Most entries of a folder or list: nine hours at 30 Hz.
pub(super) const MAX_ENTRIES: usize = 1_000_000;

/// Longest excerpt of a file in an error, characters.
const MAX_QUOTE: usize = 60;

/// A part of an untrusted text, formatted to be printed in one line, in quotes.
pub(super) fn quote(text: &str) -> String {
    format!("\"{}\"", printable(text))
}

/// [`quote`] without its quotes.
pub(super) fn printable(text: &str) -> String {
    let short: String = text.chars().take(MAX_QUOTE).collect();
    let dots = if short.len() < text.len() { "…" } else { "" };
    format!("{}{dots}", short.escape_debug())
}
