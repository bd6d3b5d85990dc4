//! Output files and folders of commands: they appear complete or not at all, and nothing is overwritten that the user
//! did not ask to replace.
//!
//! A [`Draft`] is written beside its destination and moved there when it is complete. A symbolic link is followed:
//! the file that it names is replaced, and the link is kept. A fifo or a character device is written to, never
//! replaced. A process that is ended by a signal removes its drafts ([`clean_up_on_signals`]); drafts of a process
//! that was killed are removed by the next one that writes into the same folder.

mod draft;
mod leftover;
mod signal;
mod stream;
mod target;
mod terminal;

pub use draft::{Draft, replace};
pub use signal::{clean_up_on_signals, end_signal};
pub use stream::Sink;
pub use target::Target;
pub use terminal::{StdoutError, print, tell};

use std::io;
use std::path::Path;

/// Writes a complete file, see [`Draft`].
pub fn write_file(destination: &Path, bytes: &[u8]) -> io::Result<()> {
    let draft = Draft::file(destination)?;
    draft.write(bytes)?;
    draft.commit()
}

#[cfg(test)]
mod tests;
