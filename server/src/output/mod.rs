//! What commands write: files and folders that appear whole or not at all, and destroy nothing
//! that they were not told to replace.
//!
//! A [`Draft`] is made beside its destination and moved there when it is complete. A symbolic
//! link is followed: the file that it names is replaced, the link stays. A fifo or a character
//! device is written to, never replaced. A run that a signal ends removes its drafts
//! ([`clean_up_on_signals`]); those of a run that was killed are removed by the next one that
//! writes into the same folder.

mod draft;
mod leftover;
mod signal;
mod stream;
mod target;
mod terminal;

pub use draft::{Draft, replace};
pub use signal::clean_up_on_signals;
pub use stream::Sink;
pub use target::Target;
pub use terminal::{StdoutError, print, tell};

use std::io;
use std::path::Path;

/// Writes a file whole: see [`Draft`].
pub fn write_file(destination: &Path, bytes: &[u8]) -> io::Result<()> {
    let draft = Draft::file(destination)?;
    draft.write(bytes)?;
    draft.commit()
}

#[cfg(test)]
mod tests;
