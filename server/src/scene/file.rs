//! Reading files whose size nobody vouches for.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The whole of a regular file of at most `max_bytes`; else why not.
pub(crate) fn read(path: &Path, max_bytes: u64) -> Result<Vec<u8>, String> {
    let describe = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::NotFound => "no such file".to_owned(),
        _ => format!("cannot be read: {error}"),
    };
    // Asked before opening: opening a pipe would wait for a writer.
    let metadata = std::fs::metadata(path).map_err(describe)?;
    if !metadata.is_file() {
        return Err("expected a file, got a folder or device".to_owned());
    }
    let mut bytes = Vec::new();
    // One byte over the limit tells that there is more, even if the file grows meanwhile.
    File::open(path)
        .and_then(|file| file.take(max_bytes + 1).read_to_end(&mut bytes))
        .map_err(describe)?;
    if bytes.len() as u64 > max_bytes {
        return Err(format!("expected at most {max_bytes} bytes, got more"));
    }
    Ok(bytes)
}
