//! Resolves URIs: embedded data, or a file in the document's folder. Exporters write paths of their own system, so
//! every interpretation is tried until a file is found.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use super::super::{LoadContext, mtl};

/// Most entries of a folder that are searched for a name with different case.
const MAX_ENTRIES: usize = 10_000;

/// Most characters of a URI in messages.
const SHOWN: usize = 80;

/// The bytes that a URI refers to.
pub(super) fn resolve(
    context: &LoadContext,
    uri: &str,
    folder: &Path,
    max_bytes: u64,
) -> Result<Vec<u8>, String> {
    let uri = uri.trim();
    let is_data = uri
        .get(..5)
        .is_some_and(|s| s.eq_ignore_ascii_case("data:"));
    if is_data {
        context.unpack(uri.len() as u64)?;
        return decode_data(&uri[5..]);
    }
    let path = find(uri, folder)?;
    context
        .read(&folder.join(&path), max_bytes)
        .map_err(|reason| format!("uri: {}: {reason}", path.display()))
}

/// Decodes the part after `data:` (RFC 2397): media type and parameters, a comma, the data.
fn decode_data(text: &str) -> Result<Vec<u8>, String> {
    let (kind, data) = text
        .split_once(',')
        .ok_or("uri: expected data after a comma, got none")?;
    let is_base64 = kind
        .rsplit(';')
        .next()
        .is_some_and(|last| last.trim().eq_ignore_ascii_case("base64"));
    if !is_base64 {
        return match kind.split_once(";base") {
            Some(_) => Err(format!("uri: expected base64 data, got {kind:?}")),
            None => Ok(decode_percent(data)),
        };
    }
    let data = match data.contains('%') {
        true => Cow::Owned(String::from_utf8_lossy(&decode_percent(data)).into_owned()),
        false => Cow::Borrowed(data),
    };
    decode_base64(&data).ok_or_else(|| "uri: expected base64 data, got other characters".to_owned())
}

/// Finds the file named by a URI in `folder`.
fn find(uri: &str, folder: &Path) -> Result<PathBuf, String> {
    let mut shown: String = uri.chars().take(SHOWN).collect();
    if shown.len() < uri.len() {
        shown.push_str("...");
    }
    let decoded = String::from_utf8(decode_percent(uri)).unwrap_or_else(|_| uri.to_owned());
    let mut candidates = vec![decoded.clone(), uri.to_owned()];
    for text in [&decoded, uri] {
        candidates.push(text.replace('\\', "/"));
    }
    // A query or fragment, from the path of a web server.
    let end = decoded.find(['?', '#']).unwrap_or(decoded.len());
    candidates.push(decoded[..end].replace('\\', "/"));
    let slashed = decoded.replace('\\', "/");
    // An absolute path of the exporting machine: the file may be in the folder.
    let is_absolute = slashed.starts_with('/')
        || slashed.get(1..3) == Some(":/")
        || slashed
            .get(..7)
            .is_some_and(|s| s.eq_ignore_ascii_case("file://"));
    if is_absolute {
        candidates.extend(slashed.rsplit('/').next().map(str::to_owned));
    } else if decoded.contains("://") {
        return Err(format!(
            "uri: expected a file in the same folder, got {shown:?}"
        ));
    }
    let mut refused = None;
    let mut inside = Vec::new();
    for candidate in candidates {
        // Windows treats a backslash as a slash, so neither interpretation may leave the folder.
        let slashed = candidate.replace('\\', "/");
        match mtl::inside(&slashed).and_then(|_| mtl::inside(&candidate)) {
            Ok(path) => inside.push(path.to_owned()),
            Err(problem) => {
                refused.get_or_insert(problem);
            }
        }
    }
    // A backslash may hide a path that leaves the folder: if one interpretation leaves it, all are rejected.
    if let Some(problem) = refused.filter(|_| !is_absolute) {
        return Err(problem);
    }
    let is_there = |path: &PathBuf| folder.join(path).is_file();
    if let Some(path) = inside.iter().find(|path| is_there(path)) {
        return Ok(path.clone());
    }
    inside
        .iter()
        .find_map(|path| in_other_letters(folder, path))
        .or_else(|| inside.into_iter().next())
        .ok_or_else(|| format!("uri: expected a path, got {shown:?}"))
}

/// Finds a file whose name differs only in case, because Windows ignores case.
fn in_other_letters(folder: &Path, path: &Path) -> Option<PathBuf> {
    let folder = match folder.as_os_str().is_empty() {
        true => Path::new("."),
        false => folder,
    };
    let mut found = PathBuf::new();
    for component in path.components() {
        let wanted = component.as_os_str();
        if folder.join(&found).join(wanted).exists() {
            found.push(wanted);
            continue;
        }
        let name = std::fs::read_dir(folder.join(&found))
            .ok()?
            .take(MAX_ENTRIES)
            .filter_map(|entry| Some(entry.ok()?.file_name()))
            .filter(|name| name.eq_ignore_ascii_case(wanted))
            .min()?;
        found.push(name);
    }
    folder.join(&found).is_file().then_some(found)
}

/// Decodes `%20` to a blank; a per cent sign without two hexadecimal digits is kept.
fn decode_percent(text: &str) -> Vec<u8> {
    let bytes = text.as_bytes();
    let digit = |at: usize| (*bytes.get(at)? as char).to_digit(16);
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        match (bytes[at], digit(at + 1), digit(at + 2)) {
            (b'%', Some(high), Some(low)) => {
                out.push((high * 16 + low) as u8);
                at += 3;
            }
            (byte, ..) => {
                out.push(byte);
                at += 1;
            }
        }
    }
    out
}

/// Decodes Base64 (RFC 4648) in both alphabets, with or without padding and line breaks.
fn decode_base64(text: &str) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 2);
    let (mut bits, mut n_bits) = (0u32, 0);
    let mut ended = false;
    for byte in text.bytes() {
        let value = match byte {
            b' ' | b'\t' | b'\r' | b'\n' => continue,
            b'=' => {
                ended = true;
                continue;
            }
            _ if ended => return None,
            b'A'..=b'Z' => byte - b'A',
            b'a'..=b'z' => byte - b'a' + 26,
            b'0'..=b'9' => byte - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        n_bits += 6;
        if n_bits >= 8 {
            n_bits -= 8;
            out.push((bits >> n_bits) as u8);
            bits &= (1 << n_bits) - 1;
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn uris_are_decoded_and_kept_inside() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a b.bin"), b"xyz").unwrap();
        let context = LoadContext::default();
        let read = |uri: &str| resolve(&context, uri, folder.path(), 100);
        assert_eq!(read("a%20b.bin").unwrap(), b"xyz");
        assert_eq!(
            read("data:application/octet-stream;base64,SGk+/w==").unwrap(),
            b"Hi>\xff"
        );
        for bad in [
            "../a b.bin",
            "..\\a b.bin",
            "x\\..\\..\\a b.bin",
            "%2e%2e/a",
            "/etc/passwd",
            "file:///etc/passwd",
            "C:\\Windows\\win.ini",
            "http://x/y",
            "data:;base65,plain",
            "data:;base64,!!",
            "data:;base64",
            "none.bin",
            "%zz",
            "",
        ] {
            assert!(read(bad).is_err(), "{bad}");
        }
        assert!(
            resolve(&context, "a b.bin", folder.path(), 2)
                .unwrap_err()
                .contains("at most 2 bytes")
        );
    }

    #[test]
    fn paths_as_other_systems_write_them() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("Textures")).unwrap();
        std::fs::write(at("Textures/Wood.PNG"), b"wood").unwrap();
        std::fs::write(at("50% grey.png"), b"grey").unwrap();
        std::fs::write(at("a#1.png"), b"hash").unwrap();
        for (uri, expected) in [
            ("Textures/Wood.PNG", "wood"),
            ("Textures\\Wood.PNG", "wood"),
            ("textures%5Cwood.png", "wood"),
            (".\\Textures\\wood.png", "wood"),
            ("./Textures/Wood.PNG?v=3", "wood"),
            ("50% grey.png", "grey"),
            ("50%25%20grey.png", "grey"),
            ("C:\\Users\\me\\50% grey.png", "grey"),
            ("file:///home/me/50%25%20grey.png", "grey"),
            ("/home/me/a%231.png", "hash"),
            (" a#1.png\n", "hash"),
        ] {
            let bytes = resolve(&LoadContext::default(), uri, folder.path(), 100);
            assert_eq!(bytes, Ok(expected.as_bytes().to_vec()), "{uri}");
        }
    }

    #[test]
    fn data_of_every_form() {
        for uri in [
            "data:;base64,SGk+/w==",
            "data:;base64,SGk-_w",
            "DATA:image/png;charset=x;BASE64,SGk-\r\n  _w = =",
            "data:application/gltf-buffer;base64,SGk%2B%2Fw%3D%3D",
            "data:application/octet-stream,Hi>%FF",
        ] {
            let bytes = resolve(&LoadContext::default(), uri, Path::new(""), 9);
            assert_eq!(bytes.unwrap(), b"Hi>\xff", "{uri}");
        }
    }

    proptest! {
        #[test]
        fn no_uri_leaves_the_folder(uri in "[a%./\\\\:2eE5cC?#]{0,24}") {
            let folder = tempfile::tempdir().unwrap();
            if let Ok(path) = find(&uri, folder.path()) {
                prop_assert!(mtl::inside(&path.to_string_lossy()).is_ok(), "{uri}: {path:?}");
                prop_assert!(!path.to_string_lossy().replace('\\', "/").split('/').any(|part| part == ".."));
            }
        }
    }
}
