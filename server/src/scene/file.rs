//! Reads files of untrusted size.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Reads a regular file of at most `max_bytes`; the error says why it cannot be read.
pub(crate) fn read(path: &Path, max_bytes: u64) -> Result<Vec<u8>, String> {
    read_within(path, max_bytes, |_| Ok(()))
}

/// As [`read`]; `reserve` is called with the file's size before its bytes are read.
pub(crate) fn read_within(
    path: &Path,
    max_bytes: u64,
    reserve: impl FnOnce(u64) -> Result<(), String>,
) -> Result<Vec<u8>, String> {
    let describe = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::NotFound => "no such file".to_owned(),
        _ => format!("cannot be read: {error}"),
    };
    // Checked before opening, because opening a pipe would wait for a writer.
    let metadata = std::fs::metadata(path).map_err(describe)?;
    if !metadata.is_file() {
        return Err("expected a file, got a folder or device".to_owned());
    }
    let too_large = || Err(format!("expected at most {max_bytes} bytes, got more"));
    let size = metadata.len();
    if size > max_bytes {
        return too_large();
    }
    reserve(size)?;
    let mut bytes = Vec::with_capacity(size as usize);
    // One byte more than its size, to detect a file that has grown.
    File::open(path)
        .and_then(|file| file.take(size + 1).read_to_end(&mut bytes))
        .map_err(describe)?;
    if bytes.len() as u64 > size.max(1) && bytes.len() as u64 > max_bytes {
        return too_large();
    }
    Ok(bytes)
}
