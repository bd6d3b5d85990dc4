//! JSON written by people: errors are one line that names the position and the expected value.

use std::fmt;

use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer};

/// Why a JSON text is invalid.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JsonError {
    /// The file, as the user named it.
    pub file: String,
    /// Path of the field, as in `objects[0].material`; empty for the whole text.
    pub path: String,
    /// What is wrong with it.
    pub message: String,
    /// Line, from 1; 0 if the position is meaningless.
    pub line: usize,
    /// Column, from 1.
    pub column: usize,
}

impl fmt::Display for JsonError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.file)?;
        if !self.path.is_empty() {
            write!(f, "{}: ", self.path)?;
        }
        f.write_str(&self.message)?;
        if self.line > 0 {
            write!(f, " (line {}, column {})", self.line, self.column)?;
        }
        Ok(())
    }
}

impl std::error::Error for JsonError {}

/// The `"$schema"` of a document: any text, which only editors use.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, JsonSchema)]
#[schemars(with = "String")]
pub struct SchemaLink;

impl<'de> Deserialize<'de> for SchemaLink {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer).map(|_| Self)
    }
}

/// Reads a file's bytes, in any encoding that [`crate::text`] knows; `file` is only for the
/// message.
pub fn from_bytes<T: DeserializeOwned>(bytes: &[u8], file: &str) -> Result<T, JsonError> {
    from_str(&crate::text::decode(bytes).text, file)
}

/// Reads `text`; `file` is only for the message.
pub fn from_str<T: DeserializeOwned>(text: &str, file: &str) -> Result<T, JsonError> {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    let value = serde_path_to_error::deserialize(&mut deserializer)
        .map_err(|error| describe(file, error.path().to_string(), error.inner()))?;
    deserializer
        .end()
        .map_err(|error| describe(file, String::new(), &error))?;
    Ok(value)
}

fn describe(file: &str, path: String, error: &serde_json::Error) -> JsonError {
    let text = error.to_string();
    // serde_json appends the position, which is reported separately here.
    let suffix = format!(" at line {} column {}", error.line(), error.column());
    let text = text.strip_suffix(&suffix).unwrap_or(&text);
    let mut path = if path == "." { String::new() } else { path };
    let message = if error.is_syntax() || error.is_eof() {
        format!("not JSON: {text}")
    } else if let Some((name, known)) = unknown(text, "unknown field ") {
        if path.rsplit('.').next() != Some(name) {
            if !path.is_empty() {
                path.push('.');
            }
            path.push_str(name);
        }
        with_nearest("unknown field", name, &known)
    } else if let Some((name, known)) = unknown(text, "unknown variant ") {
        with_nearest(&format!("unknown value {name:?}"), name, &known)
    } else {
        text.replace('`', "\"")
    };
    JsonError {
        file: file.to_owned(),
        path,
        message,
        line: error.line(),
        column: error.column(),
    }
}

/// Parses serde's message "unknown field `x`, expected one of `a`, `b`".
fn unknown<'a>(text: &'a str, prefix: &str) -> Option<(&'a str, Vec<&'a str>)> {
    let mut quoted = text.strip_prefix(prefix)?.split('`').skip(1).step_by(2);
    let name = quoted.next()?;
    Some((name, quoted.collect()))
}

fn with_nearest(what: &str, name: &str, known: &[&str]) -> String {
    match nearest(name, known.iter().copied()) {
        Some(meant) => format!("{what}, did you mean {meant:?}?"),
        None if known.is_empty() => what.to_owned(),
        None => format!("{what}, expected one of: {}", known.join(", ")),
    }
}

/// The known name that `name` is probably a misspelling of.
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    // Jaro-Winkler, 0..=1: 0.75 accepts swapped, missing and added letters in words of this length, and rejects words
    // that share only a letter or two (heuristic). A whole word of a longer name also counts as a match.
    let score = |candidate: &str| {
        let is_word = candidate.split('_').any(|word| word == name);
        strsim::jaro_winkler(name, candidate).max(if is_word { 0.9 } else { 0.0 })
    };
    known
        .into_iter()
        .map(|candidate| (score(candidate), candidate))
        .filter(|(score, _)| *score > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Outer {
        objects: Vec<Inner>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code, reason = "read through Debug only")]
    struct Inner {
        material: Option<Kind>,
        size: Option<f64>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Kind {
        Mirror,
        Glass,
    }

    fn message(text: &str) -> String {
        from_str::<Outer>(text, "scene.json")
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn errors_name_file_field_position_and_what_was_meant() {
        assert_eq!(
            message("{\"objects\": [\n  {\"materail\": \"glass\"}]}"),
            "scene.json: objects[0].materail: unknown field, did you mean \"material\"? (line 2, column 13)"
        );
        assert_eq!(
            message("{\"objects\": [{\"material\": \"mirrror\"}]}"),
            "scene.json: objects[0].material: unknown value \"mirrror\", did you mean \"mirror\"? (line 1, column 35)"
        );
        assert_eq!(
            message("{\"objects\": [{\"zzz\": 1}]}"),
            "scene.json: objects[0].zzz: unknown field, expected one of: material, size (line 1, column 19)"
        );
        assert_eq!(
            message("{\"objects\": [{\"size\": \"big\"}]}"),
            "scene.json: objects[0].size: invalid type: string \"big\", expected f64 (line 1, column 27)"
        );
        assert!(message("{}").starts_with("scene.json: missing field \"objects\""));
        assert!(message("{\"objects\": [").starts_with("scene.json: objects: not JSON: EOF"));
        assert!(message("").starts_with("scene.json: not JSON: EOF"));
        assert!(message("{\"objects\": []} x").contains("trailing characters"));
        assert!(message("{\"objects\": [{\"size\": 1e999}]}").contains("number out of range"));
        assert_eq!(
            from_str::<Outer>("{\"objects\": [{}]}", "f")
                .unwrap()
                .objects
                .len(),
            1
        );
    }

    #[test]
    fn bytes_are_read_in_any_encoding() {
        let text = "{\"objects\": [{\"size\": 2}]}";
        let utf16 = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let padded = [text.as_bytes(), &[0; 3]].concat();
        for bytes in [[b"\xEF\xBB\xBF", text.as_bytes()].concat(), utf16, padded] {
            assert_eq!(
                from_bytes::<Outer>(&bytes, "f").unwrap().objects[0].size,
                Some(2.0)
            );
        }
        let latin1 = from_bytes::<Outer>(b"{\"objects\": [{\"gr\xF6\": 1}]}", "f").unwrap_err();
        assert!(latin1.to_string().contains("objects[0].grö: unknown field"));
    }

    proptest! {
        #[test]
        fn arbitrary_text_gives_a_value_or_one_line(text in "\\PC*") {
            if let Err(error) = from_str::<Outer>(&text, "f.json") {
                prop_assert!(error.to_string().starts_with("f.json: "));
            }
        }
    }
}
