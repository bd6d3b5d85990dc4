//! From bytes to JSON and buffers: the GLB container, data URIs, files beside the document.

use std::borrow::Cow;
use std::path::Path;

use super::super::error::MeshError;
use super::super::model::MAX_FILE_BYTES;
use super::super::{LoadContext, mtl};
use super::format::Root;
use crate::json;

/// Extensions that are read.
pub(super) const UNDERSTOOD: &[&str] = &[
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_transmission",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// A parsed document and the bytes of each of its buffers.
type Opened<'a> = (Root, Vec<Cow<'a, [u8]>>);

/// Takes a file apart.
pub(super) fn open<'a>(
    context: &LoadContext,
    bytes: &'a [u8],
    name: &str,
    folder: &Path,
) -> Result<Opened<'a>, MeshError> {
    let (text, blob) = if bytes.starts_with(b"glTF") {
        split_glb(bytes).map_err(|(at, problem)| MeshError::at(name, at, problem))?
    } else {
        (bytes, None)
    };
    let text = std::str::from_utf8(text).map_err(|_| {
        MeshError::new(
            name,
            "expected glTF (JSON or \"glTF\" binary), got something else",
        )
    })?;
    let root: Root = json::from_str(text, name).map_err(|error| {
        let whole = error.to_string();
        let problem = whole.strip_prefix(&format!("{name}: ")).unwrap_or(&whole);
        MeshError::new(name, problem)
    })?;
    if root.asset.version.split('.').next() != Some("2") {
        return Err(MeshError::at(
            name,
            "asset.version",
            format!("expected 2.x, got {:?}", root.asset.version),
        ));
    }
    for extension in &root.extensions_required {
        if !UNDERSTOOD.contains(&extension.as_str()) && !is_only_looks(extension) {
            return Err(MeshError::at(
                name,
                "extensionsRequired",
                match extension.as_str() {
                    "KHR_draco_mesh_compression" => {
                        "Draco compression (KHR_draco_mesh_compression) is not supported: export without it".to_owned()
                    }
                    other => format!("{other} is not supported: export without it"),
                },
            ));
        }
    }
    let buffers = root
        .buffers
        .iter()
        .enumerate()
        .map(|(i, buffer)| {
            let fail = |problem: String| MeshError::at(name, format!("buffers[{i}]"), problem);
            let bytes = match (&buffer.uri, blob) {
                (Some(uri), _) => {
                    resolve_uri(context, uri, folder, MAX_FILE_BYTES).map_err(fail)?
                }
                (None, Some(blob)) if i == 0 => Cow::Borrowed(blob),
                (None, _) => {
                    return Err(fail("expected a uri or a binary chunk, got neither".into()));
                }
            };
            if bytes.len() < buffer.byte_length {
                return Err(fail(format!(
                    "expected {} bytes, got {}",
                    buffer.byte_length,
                    bytes.len()
                )));
            }
            Ok(bytes)
        })
        .collect::<Result<_, _>>()?;
    Ok((root, buffers))
}

/// Whether leaving the extension out changes how a surface looks, not where it is.
fn is_only_looks(extension: &str) -> bool {
    extension.starts_with("KHR_materials_") || extension == "KHR_lights_punctual"
}

type Chunks<'a> = (&'a [u8], Option<&'a [u8]>);

/// JSON and binary chunk of a GLB file (glTF 2.0, section 4).
fn split_glb(bytes: &[u8]) -> Result<Chunks<'_>, (String, String)> {
    let word = |at: usize| {
        let end = at.checked_add(4)?;
        let four: [u8; 4] = bytes.get(at..end)?.try_into().ok()?;
        Some(u32::from_le_bytes(four))
    };
    let fail = |at: usize, problem: String| Err((format!("byte {at}"), problem));
    match word(4) {
        Some(2) => {}
        Some(other) => return fail(4, format!("expected glTF version 2, got {other}")),
        None => return fail(4, "expected a version, got the end of the file".into()),
    }
    let Some(length) = word(8).filter(|&n| n as usize <= bytes.len()) else {
        return fail(
            8,
            format!(
                "expected a length within the file's {} bytes: it is cut short",
                bytes.len()
            ),
        );
    };
    let (mut json, mut blob) = (None, None);
    let mut at = 12;
    while at < length as usize {
        let (Some(n), Some(kind)) = (word(at), word(at + 4)) else {
            return fail(at, "expected a chunk, got the end of the file".into());
        };
        let start = at + 8;
        let Some(chunk) = start
            .checked_add(n as usize)
            .and_then(|end| bytes.get(start..end))
        else {
            return fail(
                at,
                format!("expected a chunk of {n} bytes, got the end of the file"),
            );
        };
        match kind {
            0x4E4F_534A if json.is_none() => json = Some(chunk),
            0x004E_4942 if blob.is_none() => blob = Some(chunk),
            // Unknown chunks are to be ignored.
            _ => {}
        }
        at = start + chunk.len();
    }
    match json {
        Some(json) => Ok((json, blob)),
        None => fail(12, "expected a JSON chunk, got none".into()),
    }
}

/// The bytes that a URI stands for: data in base64, or a file inside `folder`.
pub(super) fn resolve_uri<'a>(
    context: &LoadContext,
    uri: &str,
    folder: &Path,
    max_bytes: u64,
) -> Result<Cow<'a, [u8]>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, base64) = data
            .split_once(";base64,")
            .ok_or("uri: expected base64 data, got another encoding")?;
        return decode_base64(base64)
            .map(Cow::Owned)
            .ok_or_else(|| "uri: expected base64 data, got other characters".to_owned());
    }
    let path = decode_percent(uri).ok_or_else(|| format!("uri: expected a path, got {uri:?}"))?;
    if path.contains("://") {
        return Err(format!(
            "uri: expected a file in the same folder, got {path:?}"
        ));
    }
    let path = mtl::inside(&path)?;
    context
        .read(&folder.join(path), max_bytes)
        .map(Cow::Owned)
        .map_err(|reason| format!("uri: {}: {reason}", path.display()))
}

fn decode_percent(text: &str) -> Option<String> {
    let mut out = Vec::with_capacity(text.len());
    let mut bytes = text.bytes();
    while let Some(byte) = bytes.next() {
        if byte != b'%' {
            out.push(byte);
            continue;
        }
        let digit = |b: u8| (b as char).to_digit(16);
        let (high, low) = (digit(bytes.next()?)?, digit(bytes.next()?)?);
        out.push((high * 16 + low) as u8);
    }
    String::from_utf8(out).ok()
}

/// RFC 4648, with or without padding.
fn decode_base64(text: &str) -> Option<Vec<u8>> {
    let text = text.trim_end_matches('=');
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 2);
    let (mut bits, mut n_bits) = (0u32, 0);
    for byte in text.bytes() {
        let value = match byte {
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

    #[test]
    fn uris_are_decoded_and_kept_inside() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a b.bin"), b"xyz").unwrap();
        let context = LoadContext::default();
        let read = |uri: &str| resolve_uri(&context, uri, folder.path(), 100);
        assert_eq!(&*read("a%20b.bin").unwrap(), b"xyz");
        assert_eq!(
            &*read("data:application/octet-stream;base64,SGk+/w==").unwrap(),
            b"Hi>\xff"
        );
        for bad in [
            "../a b.bin",
            "%2e%2e/a",
            "/etc/passwd",
            "file:///etc/passwd",
            "http://x/y",
            "data:,plain",
            "data:;base64,!!",
            "none.bin",
            "%zz",
            "",
        ] {
            assert!(read(bad).is_err(), "{bad}");
        }
        assert!(
            resolve_uri(&context, "a b.bin", folder.path(), 2)
                .unwrap_err()
                .contains("at most 2 bytes")
        );
    }
}
