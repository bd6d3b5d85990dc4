//! Writes to destinations that are not replaced: fifos, character devices, inherited descriptors.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

/// A destination that bytes are written to directly.
#[derive(Debug)]
pub enum Sink {
    /// A draft, a fifo or a device.
    File(File),
    /// Standard output.
    Stdout,
    /// Standard error.
    Stderr,
}

impl Sink {
    /// Opens a fifo or character device; waits for a fifo's reader.
    pub(super) fn stream(path: &Path) -> io::Result<Self> {
        // Neither created nor truncated, because it exists and is not a regular file.
        Ok(Self::File(OpenOptions::new().write(true).open(path)?))
    }

    /// Opens an inherited descriptor for appending, so that earlier output is kept.
    pub(super) fn descriptor(number: u32) -> io::Result<Self> {
        match number {
            1 => Ok(Self::Stdout),
            2 => Ok(Self::Stderr),
            n => {
                let path = format!("/dev/fd/{n}");
                Ok(Self::File(OpenOptions::new().append(true).open(path)?))
            }
        }
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.write(bytes),
            Self::Stdout => io::stdout().write(bytes),
            Self::Stderr => io::stderr().write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::File(file) => file.flush(),
            Self::Stdout => io::stdout().flush(),
            Self::Stderr => io::stderr().flush(),
        }
    }
}
