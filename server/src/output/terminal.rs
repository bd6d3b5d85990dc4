//! Text to people. `println!` panics when its reader has gone or the disk is full; this does not.

use std::fmt::Display;
use std::io::{self, Write as _};

/// Standard output takes no more.
#[derive(Debug, thiserror::Error)]
#[error("stdout: {0}")]
pub struct StdoutError(#[source] io::Error);

impl StdoutError {
    /// Whether its reader has left, as `head` does when it has seen enough: nothing to report.
    pub fn reader_left(&self) -> bool {
        self.0.kind() == io::ErrorKind::BrokenPipe
    }
}

/// Prints a text and a line break to standard output.
pub fn print(text: impl Display) -> Result<(), StdoutError> {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{text}")
        .and_then(|()| stdout.flush())
        .map_err(StdoutError)
}

/// Tells people a line on standard error; lost if nobody listens there.
pub fn tell(line: impl Display) {
    let _ = writeln!(io::stderr(), "{line}");
}
