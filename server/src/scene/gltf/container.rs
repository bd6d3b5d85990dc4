//! Splits a file into JSON and buffers: the GLB container, or files beside the document.

use std::borrow::Cow;
use std::path::Path;

use super::super::LoadContext;
use super::super::error::MeshError;
use super::super::model::MAX_FILE_BYTES;
use super::format::Root;
use super::{extension, lenient, uri};
use crate::json;

/// A document and the bytes of each of its buffers.
pub(super) struct Opened<'a> {
    pub(super) root: Root,
    pub(super) buffers: Vec<Cow<'a, [u8]>>,
    /// Notes on unusual content.
    pub(super) notes: Vec<String>,
    /// Why the first unreadable buffer cannot be read.
    pub(super) first_problem: Option<MeshError>,
}

/// Splits a file into its document and buffers.
pub(super) fn open<'a>(
    context: &LoadContext,
    bytes: &'a [u8],
    name: &str,
    folder: &Path,
) -> Result<Opened<'a>, MeshError> {
    let mut notes = Vec::new();
    let (text, blob) = if bytes.starts_with(b"glTF") {
        split_glb(bytes, &mut notes).map_err(|(at, problem)| MeshError::at(name, at, problem))?
    } else {
        (bytes, None)
    };
    let root = parse(text, name, &mut notes)?;
    match root.version.split('.').next() {
        Some("2") => {}
        Some("") | None => notes.push("asset.version is missing: taken as 2.0".to_owned()),
        _ => {
            return Err(MeshError::at(
                name,
                "asset.version",
                format!(
                    "expected 2.x, got {:?}: convert it to glTF 2.0",
                    root.version
                ),
            ));
        }
    }
    extension::check_required(&root)
        .map_err(|problem| MeshError::at(name, "extensionsRequired", problem))?;
    notes.extend(root.issues());
    let mut first_problem = None;
    let mut buffers = Vec::with_capacity(root.buffers.len());
    for (i, buffer) in root.buffers.iter().enumerate() {
        let bytes = match (&buffer.uri, blob) {
            (Some(text), _) => uri::resolve(context, text, folder, MAX_FILE_BYTES).map(Cow::Owned),
            (None, Some(blob)) if i == 0 => Ok(Cow::Borrowed(blob)),
            (None, _) if buffer.is_fallback() => Ok(Cow::default()),
            (None, _) => Err("expected a uri or a binary chunk, got neither".to_owned()),
        };
        let bytes = bytes.unwrap_or_else(|problem| {
            notes.push(format!("buffers[{i}] left out: {problem}"));
            let at = format!("buffers[{i}]");
            first_problem.get_or_insert(MeshError::at(name, at, problem));
            Cow::default()
        });
        if !bytes.is_empty() && bytes.len() < buffer.byte_length {
            notes.push(format!(
                "buffers[{i}]: expected {} bytes, got {}: the rest is left out",
                buffer.byte_length,
                bytes.len()
            ));
        }
        buffers.push(bytes);
    }
    Ok(Opened {
        root,
        buffers,
        notes,
        first_problem,
    })
}

/// Parses the document; a byte order mark and padding are allowed.
fn parse(bytes: &[u8], name: &str, notes: &mut Vec<String>) -> Result<Root, MeshError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    // Padding: blanks by the specification, zeros by many exporters.
    let end = bytes
        .iter()
        .rposition(|b| !matches!(b, 0 | b' ' | b'\t' | b'\r' | b'\n'))
        .map_or(0, |last| last + 1);
    let bytes = &bytes[..end];
    if bytes.starts_with(b"\xFF\xFE") || bytes.starts_with(b"\xFE\xFF") {
        return Err(MeshError::new(
            name,
            "expected JSON in UTF-8, got UTF-16: save it as UTF-8",
        ));
    }
    let begins = bytes.iter().find(|b| !b.is_ascii_whitespace());
    if begins != Some(&b'{') {
        return Err(MeshError::new(
            name,
            "expected glTF (JSON or \"glTF\" binary), got something else",
        ));
    }
    let text = String::from_utf8_lossy(bytes);
    if matches!(text, Cow::Owned(_)) {
        notes.push("its text is not UTF-8: other characters are replaced".to_owned());
    }
    let mut parsed = json::from_str::<Root>(&text, name);
    if parsed.is_err()
        && let Some(mended) = lenient::mended(&text)
        && let Ok(root) = json::from_str(&mended, name)
    {
        notes.push("numbers that are no JSON (NaN, infinities) are taken as absent".to_owned());
        parsed = Ok(root);
    }
    parsed.map_err(|error| {
        let whole = error.to_string();
        let problem = whole.strip_prefix(&format!("{name}: ")).unwrap_or(&whole);
        MeshError::new(name, problem)
    })
}

type Chunks<'a> = (&'a [u8], Option<&'a [u8]>);

/// JSON and binary chunk of a GLB file (glTF 2.0, section 4).
///
/// Each chunk is found by the length of the one before it, because some writers count the header or padding wrongly
/// in the file's total length.
fn split_glb<'a>(bytes: &'a [u8], notes: &mut Vec<String>) -> Result<Chunks<'a>, (String, String)> {
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
    let length = word(8).unwrap_or_default() as usize;
    let cut = || {
        fail(
            8,
            format!(
                "expected a length within the file's {} bytes: it is cut short",
                bytes.len()
            ),
        )
    };
    let (mut json, mut blob) = (None, None);
    let mut at = 12;
    while json.is_none() || at < length.min(bytes.len()) || (blob.is_none() && at < bytes.len()) {
        let chunk = word(at).zip(word(at + 4)).and_then(|(n, kind)| {
            let start = at + 8;
            let chunk = bytes.get(start..start.checked_add(n as usize)?)?;
            Some((kind, chunk))
        });
        let Some((kind, chunk)) = chunk else {
            let is_whole = length <= bytes.len();
            let is_padding = at >= length || bytes.len() - at < 8;
            if json.is_some() && is_whole && is_padding {
                break;
            }
            if is_whole && at == bytes.len() {
                return fail(12, "expected a JSON chunk, got none".into());
            }
            return cut();
        };
        match kind {
            0x4E4F_534A if json.is_none() => json = Some(chunk),
            0x004E_4942 if blob.is_none() => blob = Some(chunk),
            // The specification requires unknown chunks to be ignored.
            _ => {}
        }
        at += 8 + chunk.len();
    }
    if length > bytes.len() {
        // All chunks are complete: only the total length is wrong.
        if blob.is_none() || at != bytes.len() {
            return cut();
        }
        notes.push(format!(
            "its header says {length} bytes, got {}",
            bytes.len()
        ));
    }
    match json {
        Some(json) => Ok((json, blob)),
        None => fail(12, "expected a JSON chunk, got none".into()),
    }
}
