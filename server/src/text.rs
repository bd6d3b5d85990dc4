//! Text files from any source: byte order marks, UTF-16, Latin-1, any line ends, padding. Every reader of text
//! (lists, poses, JSON, OBJ, MTL, PLY headers) uses this module.
//!
//! No text is rejected: text that is not UTF-8 is decoded byte by byte as Latin-1. This is correct for numbers and
//! keywords in any encoding that extends ASCII, and names lose no information: their bytes can be recovered
//! ([`Text::path`]).

use std::borrow::Cow;
use std::path::PathBuf;

/// How a text was encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// UTF-8, which includes ASCII.
    Utf8,
    /// Unknown encoding, decoded as Latin-1.
    Bytes,
    /// UTF-16, least significant byte first (Windows PowerShell's `>` writes it).
    Utf16Le,
    /// UTF-16, most significant byte first.
    Utf16Be,
}

impl Encoding {
    /// Name, for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Utf8 => "UTF-8",
            Self::Bytes => "bytes that are not UTF-8, read as Latin-1",
            Self::Utf16Le | Self::Utf16Be => "UTF-16",
        }
    }
}

/// A decoded text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Text<'a> {
    /// Text without byte order mark and padding.
    pub text: Cow<'a, str>,
    /// Original encoding.
    pub encoding: Encoding,
}

impl Text<'_> {
    /// The file that a word of this text names. If the text was not UTF-8, its original bytes are used, because file
    /// systems store names as bytes.
    pub fn path(&self, word: &str) -> PathBuf {
        match self.encoding {
            Encoding::Bytes => match latin1_bytes(word) {
                Some(bytes) => path_from_bytes(&bytes),
                None => PathBuf::from(word),
            },
            _ => PathBuf::from(word),
        }
    }
}

/// Decodes a text in any of the known encodings; never fails. Takes up to twice the memory of the bytes.
pub fn decode(bytes: &[u8]) -> Text<'_> {
    let (encoding, cleaned) = cleaned(bytes);
    let text = |text| Text { text, encoding };
    match cleaned {
        // Converted from UTF-16, so it is already UTF-8.
        Cow::Owned(bytes) => match String::from_utf8(bytes) {
            Ok(decoded) => text(Cow::Owned(decoded)),
            Err(error) => text(Cow::Owned(latin1(error.as_bytes()))),
        },
        Cow::Borrowed(bytes) => match std::str::from_utf8(bytes) {
            Ok(decoded) => text(Cow::Borrowed(decoded)),
            Err(_) => Text {
                text: Cow::Owned(latin1(bytes)),
                encoding: Encoding::Bytes,
            },
        },
    }
}

/// For formats that are read as bytes (OBJ, MTL): removes the byte order mark and the padding at the end, and
/// converts UTF-16 to UTF-8; everything else is unchanged, including names in unknown encodings.
pub fn clean(bytes: &[u8]) -> Cow<'_, [u8]> {
    cleaned(bytes).1
}

fn cleaned(bytes: &[u8]) -> (Encoding, Cow<'_, [u8]>) {
    let utf16 = |rest: &[u8], encoding: Encoding| {
        let units = rest.as_chunks::<2>().0.iter().map(|&pair| match encoding {
            Encoding::Utf16Be => u16::from_be_bytes(pair),
            _ => u16::from_le_bytes(pair),
        });
        let text: String = char::decode_utf16(units)
            .map(|unit| unit.unwrap_or(char::REPLACEMENT_CHARACTER))
            .collect();
        let mut bytes = text.into_bytes();
        bytes.truncate(unpadded(&bytes).len());
        (encoding, Cow::Owned(bytes))
    };
    match bytes {
        [0xEF, 0xBB, 0xBF, rest @ ..] => (Encoding::Utf8, Cow::Borrowed(unpadded(rest))),
        [0xFF, 0xFE, rest @ ..] => utf16(rest, Encoding::Utf16Le),
        [0xFE, 0xFF, rest @ ..] => utf16(rest, Encoding::Utf16Be),
        _ => match unmarked_utf16(bytes) {
            Some(encoding) => utf16(bytes, encoding),
            None => (Encoding::Utf8, Cow::Borrowed(unpadded(bytes))),
        },
    }
}

/// UTF-16 without a byte order mark, recognised by the zero bytes of its ASCII part: other texts have zeros only as
/// padding at the end.
fn unmarked_utf16(bytes: &[u8]) -> Option<Encoding> {
    // More than the longest keyword or number at the start of a file.
    const LOOKED_AT: usize = 64;
    let pairs = bytes.get(..bytes.len().min(LOOKED_AT))?.as_chunks::<2>().0;
    let zeros = |i: usize| pairs.iter().filter(|pair| pair[i] == 0).count();
    let (even, odd) = (zeros(0), zeros(1));
    let most = |n: usize| n > 0 && 4 * n >= 3 * pairs.len();
    match (even, odd) {
        (0, odd) if most(odd) && pairs.len() > 1 => Some(Encoding::Utf16Le),
        (even, 0) if most(even) && pairs.len() > 1 => Some(Encoding::Utf16Be),
        _ => None,
    }
}

/// Without zeros and the DOS end-of-file character at the end.
fn unpadded(bytes: &[u8]) -> &[u8] {
    let end = bytes
        .iter()
        .rposition(|b| !matches!(b, 0 | 0x1A))
        .map_or(0, |last| last + 1);
    &bytes[..end]
}

fn latin1(bytes: &[u8]) -> String {
    bytes.iter().map(|&b| char::from(b)).collect()
}

fn latin1_bytes(text: &str) -> Option<Vec<u8>> {
    text.chars().map(|c| u8::try_from(c).ok()).collect()
}

/// A file name in any encoding: on Unix a name is bytes; on other systems, bytes that are not UTF-8 are decoded as
/// Latin-1.
pub fn path_from_bytes(bytes: &[u8]) -> PathBuf {
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        PathBuf::from(std::ffi::OsStr::from_bytes(bytes))
    }
    #[cfg(not(unix))]
    {
        match std::str::from_utf8(bytes) {
            Ok(name) => PathBuf::from(name),
            Err(_) => PathBuf::from(latin1(bytes)),
        }
    }
}

/// Lines that end with LF, CR LF or a single CR (old Macintosh); without their line ends.
pub fn lines(text: &str) -> impl Iterator<Item = &str> {
    let mut rest = Some(text).filter(|text| !text.is_empty());
    std::iter::from_fn(move || {
        let text = rest?;
        let (line, after) = match text.find(['\n', '\r']) {
            None => (text, ""),
            Some(at) => {
                let end = if text[at..].starts_with("\r\n") { 2 } else { 1 };
                (&text[..at], &text[at + end..])
            }
        };
        rest = Some(after).filter(|after| !after.is_empty());
        Some(line)
    })
}

/// As [`lines`], for bytes.
pub fn byte_lines(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = Some(bytes).filter(|bytes| !bytes.is_empty());
    std::iter::from_fn(move || {
        let bytes = rest?;
        let (line, after) = match bytes.iter().position(|b| matches!(b, b'\n' | b'\r')) {
            None => (bytes, &[][..]),
            Some(at) => {
                let end = if bytes[at..].starts_with(b"\r\n") {
                    2
                } else {
                    1
                };
                (&bytes[..at], &bytes[at + end..])
            }
        };
        rest = Some(after).filter(|after| !after.is_empty());
        Some(line)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn utf16(text: &str, mark: bool, little: bool) -> Vec<u8> {
        let units = mark
            .then_some(0xFEFF)
            .into_iter()
            .chain(text.encode_utf16());
        let pair = |unit: u16| {
            if little {
                unit.to_le_bytes()
            } else {
                unit.to_be_bytes()
            }
        };
        units.flat_map(pair).collect()
    }

    #[test]
    fn marks_padding_and_utf16_are_taken_off() {
        let text = "1.0 rgb/ä.png\r\n";
        let mut marked = b"\xEF\xBB\xBF".to_vec();
        marked.extend(text.as_bytes());
        let padded = [text.as_bytes(), &[0x1A, 0, 0, 0]].concat();
        for (bytes, encoding) in [
            (text.as_bytes().to_vec(), Encoding::Utf8),
            (marked, Encoding::Utf8),
            (padded, Encoding::Utf8),
            (utf16(text, true, true), Encoding::Utf16Le),
            (utf16(text, true, false), Encoding::Utf16Be),
            (utf16(text, false, true), Encoding::Utf16Le),
            (utf16(text, false, false), Encoding::Utf16Be),
            (utf16(&format!("{text}\0\0"), true, true), Encoding::Utf16Le),
        ] {
            let decoded = decode(&bytes);
            assert_eq!((&*decoded.text, decoded.encoding), (text, encoding));
            assert_eq!(&*clean(&bytes), text.as_bytes());
            assert_eq!(decoded.path("ä.png"), PathBuf::from("ä.png"));
        }
        // A zeroed disk block, a single code unit, half a code unit at the end.
        assert_eq!(decode(&[0; 512]).text, "");
        assert_eq!(decode(b"1\0").text, "1");
        assert_eq!(decode(b"\xFF\xFE1\x002").text, "1");
        assert_eq!(decode(b"\xFF\xFE\x00\xD8").text, "\u{FFFD}");
        assert_eq!(decode(b"").text, "");
    }

    #[test]
    fn other_bytes_are_kept_for_names() {
        let bytes = b"# Gr\xF6\xDFe\n1.0 rgb/\xC0.png";
        let decoded = decode(bytes);
        assert_eq!(decoded.encoding, Encoding::Bytes);
        assert_eq!(&*decoded.text, "# Größe\n1.0 rgb/À.png");
        assert_eq!(decoded.path("rgb/À.png"), path_from_bytes(b"rgb/\xC0.png"));
        assert_eq!(&*clean(bytes), bytes);
    }

    #[test]
    fn lines_end_in_any_way() {
        for end in ["\n", "\r\n", "\r"] {
            let text = ["a", "", "b c", "d"].join(end);
            let expected = ["a", "", "b c", "d"];
            assert!(lines(&text).eq(expected), "{end:?}");
            assert!(lines(&format!("{text}{end}")).eq(expected), "{end:?}");
            assert!(byte_lines(text.as_bytes()).eq(expected.map(str::as_bytes)));
        }
        assert_eq!(lines("").count(), 0);
        assert!(lines("a\r\rb\n\rc").eq(["a", "", "b", "", "c"]));
    }

    proptest! {
        #[test]
        fn any_bytes_are_some_text(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let decoded = decode(&bytes);
            let cleaned = clean(&bytes);
            prop_assert!(decoded.text.len() <= 2 * bytes.len());
            prop_assert_eq!(lines(&decoded.text).count() > 0, !decoded.text.is_empty());
            if decoded.encoding == Encoding::Bytes {
                prop_assert_eq!(decoded.path(&decoded.text), path_from_bytes(&cleaned));
            }
        }

        #[test]
        fn utf16_comes_back(text in "[a-z0-9 .\n]{0,5}[a-z0-9äπ語 .\n]{2,40}x", little: bool) {
            let bytes = utf16(&text, true, little);
            prop_assert_eq!(&*decode(&bytes).text, &text);
        }
    }
}
