//! Render settings written by people and clients: JSON, checked.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde_json::Value;

use crate::json::{self, JsonError};
use crate::output;
use crate::render::{RenderSettings, SettingsError};
use crate::text;

/// Largest settings file, bytes.
const MAX_BYTES: u64 = 1 << 20;

/// Current and former names of settings; former names are still accepted.
const RENAMED: [(&str, &str); 2] = [
    ("/lod_error_px", "/detail_px"),
    ("/lens/noise_threshold", "/lens/grain"),
];

/// Parsed settings, and notes for their author.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Parsed {
    /// The settings.
    pub settings: RenderSettings,
    /// One sentence for each setting with a former name.
    pub notes: Vec<String>,
}

/// Why render settings cannot be used. `name` is the file, or another name of the text.
#[derive(Debug, thiserror::Error)]
pub enum LoadSettingsError {
    /// The file cannot be read.
    #[error("{name}: {source}")]
    File {
        /// The file.
        name: String,
        /// The reason.
        source: std::io::Error,
    },
    /// The file is too large.
    #[error("{name}: expected at most {MAX_BYTES} bytes, got more")]
    TooLarge {
        /// The file.
        name: String,
    },
    /// The text is a list or a value.
    #[error("{name}: expected a JSON object, as in {{\"max_bounces\":3}}")]
    NotAnObject {
        /// The text's name.
        name: String,
    },
    /// Invalid JSON, or not render settings.
    #[error(transparent)]
    Json(#[from] JsonError),
    /// A setting is out of its range.
    #[error("{name}: {source}")]
    Range {
        /// The text's name.
        name: String,
        /// The setting, and its range.
        source: SettingsError,
    },
}

/// Reads and checks a file of settings; it may be a pipe.
pub fn load(path: &Path) -> Result<Parsed, LoadSettingsError> {
    let name = path.display().to_string();
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(MAX_BYTES + 1).read_to_end(&mut bytes));
    match read {
        Err(source) => Err(LoadSettingsError::File { name, source }),
        Ok(n) if n as u64 > MAX_BYTES => Err(LoadSettingsError::TooLarge { name }),
        Ok(_) => parse(&text::decode(&bytes).text, &name),
    }
}

/// The settings of a file that may be given on the command line; notes are printed to standard error.
pub fn load_given(path: Option<&Path>) -> Result<Option<RenderSettings>, LoadSettingsError> {
    let Some(path) = path else { return Ok(None) };
    let Parsed { settings, notes } = load(path)?;
    for note in notes {
        output::tell(format_args!("note: {note}"));
    }
    Ok(Some(settings))
}

/// Reads and checks the text of settings; errors name it `name`.
pub fn parse(text: &str, name: &str) -> Result<Parsed, LoadSettingsError> {
    let name = || name.to_owned();
    // serde would accept a list for a struct, with the fields in order.
    if !text.trim_start().starts_with('{') {
        return Err(LoadSettingsError::NotAnObject { name: name() });
    }
    let settings: RenderSettings = json::from_str(text, &name())?;
    match settings.validate() {
        Ok(()) => Ok(Parsed {
            settings,
            notes: former_names(&json::from_str(text, &name())?)
                .into_iter()
                .map(|note| format!("{}: {note}", name()))
                .collect(),
        }),
        Err(source) => Err(LoadSettingsError::Range {
            name: name(),
            source,
        }),
    }
}

/// One sentence for each setting with a former name.
pub(crate) fn former_names(settings: &Value) -> Vec<String> {
    let dotted = |pointer: &str| pointer.trim_start_matches('/').replace('/', ".");
    let used = RENAMED
        .iter()
        .filter(|(_, before)| settings.pointer(before).is_some());
    used.map(|(now, before)| format!("{} is now called {}", dotted(before), dotted(now)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn former_names_are_accepted_with_a_note() {
        let text = r#"{"detail_px": 2, "lens": {"grain": 0.5, "samples": 9}}"#;
        let Parsed { settings, notes } = parse(text, "s").unwrap();
        assert_eq!(settings.lod_error_px, 2.0);
        assert_eq!(settings.lens.noise_threshold, 0.5);
        assert_eq!(
            notes,
            [
                "s: detail_px is now called lod_error_px",
                "s: lens.grain is now called lens.noise_threshold"
            ]
        );
        let now = serde_json::to_string(&settings).unwrap();
        assert_eq!(
            parse(&now, "s").unwrap(),
            Parsed {
                settings,
                notes: vec![]
            }
        );
        let both = r#"{"detail_px": 2, "lod_error_px": 2}"#;
        let error = parse(both, "s").unwrap_err().to_string();
        assert!(error.contains("duplicate field"), "{error}");
    }

    #[test]
    fn settings_are_one_checked_object() {
        assert_eq!(
            parse(r#"{"max_bounces": 3}"#, "s")
                .unwrap()
                .settings
                .max_bounces,
            3
        );
        for (text, error) in [
            (
                "[3]",
                "s: expected a JSON object, as in {\"max_bounces\":3}",
            ),
            ("", "s: expected a JSON object, as in {\"max_bounces\":3}"),
            (
                r#"{"max_bounces": 9}"#,
                "s: max_bounces: expected 0 to 8, got 9",
            ),
            (
                r#"{"max_bonces": 3}"#,
                "s: max_bonces: unknown field, did you mean \"max_bounces\"? (line 1, column 13)",
            ),
        ] {
            assert_eq!(parse(text, "s").unwrap_err().to_string(), error);
        }
    }

    #[test]
    fn a_file_is_bounded_and_of_any_encoding() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("s.json");
        let error = load(&file).unwrap_err().to_string();
        assert!(error.contains("s.json: "), "{error}");
        let utf16 = r#"{"max_bounces": 2}"#.encode_utf16();
        std::fs::write(&file, utf16.flat_map(u16::to_le_bytes).collect::<Vec<_>>()).unwrap();
        assert_eq!(load(&file).unwrap().settings.max_bounces, 2);
        std::fs::write(&file, vec![b' '; MAX_BYTES as usize + 1]).unwrap();
        let error = load(&file).unwrap_err().to_string();
        assert!(error.contains("expected at most 1048576 bytes"), "{error}");
    }
}
