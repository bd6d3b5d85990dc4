//! Prints text for people. `println!` panics if its reader has exited or the disk is full; these functions do not.

use std::fmt::Display;
use std::io::{self, Write as _};

/// Standard output cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("stdout: {0}")]
pub struct StdoutError(#[source] io::Error);

impl StdoutError {
    /// Whether its reader has exited, as `head` does after enough lines: not an error to report.
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

/// Prints a line to standard error; errors are ignored.
pub fn tell(line: impl Display) {
    let _ = writeln!(io::stderr(), "{line}");
}
