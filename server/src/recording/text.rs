//! Text files from outside: bounded size, bounded lines, and errors with line numbers.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use crate::camera::{Intrinsics, Pose};
use crate::text::{self, Text};
use glam::DMat3;

use super::error::{Place, RecordingError};
use super::excerpt::{MAX_ENTRIES, quote};
use super::location::Location;

/// Largest text file, bytes: a day of poses at 100 Hz.
pub(super) const MAX_TEXT_BYTES: u64 = 64 << 20;
/// Longest line, bytes; the longest legitimate ones are a path or sixteen numbers.
const MAX_LINE_BYTES: usize = 8192;

/// A text file in memory.
#[derive(Debug)]
pub(super) struct TextFile {
    pub(super) location: Location,
    text: Text<'static>,
}

/// One line, split into words.
pub(super) struct Line<'a> {
    path: &'a Path,
    /// From 1.
    pub(super) number: usize,
    /// The whole line, trimmed.
    pub(super) text: &'a str,
    /// The words of the line, without quotes.
    pub(super) words: Vec<&'a str>,
}

impl TextFile {
    pub(super) fn read(location: &Location) -> Result<Self, RecordingError> {
        let bytes = location.read(MAX_TEXT_BYTES)?;
        Ok(Self::from_bytes(location.clone(), bytes))
    }

    pub(super) fn from_bytes(location: impl Into<Location>, bytes: Vec<u8>) -> Self {
        let Text { text, encoding } = text::decode(&bytes);
        Self {
            location: location.into(),
            text: Text {
                text: Cow::Owned(text.into_owned()),
                encoding,
            },
        }
    }

    /// Path, for messages.
    pub(super) fn path(&self) -> &Path {
        self.location.path()
    }

    pub(super) fn text(&self) -> &str {
        &self.text.text
    }

    /// The file that a word of the text names, relative to the folder of the recording.
    pub(super) fn named(&self, word: &str) -> PathBuf {
        self.text.path(word)
    }

    /// Lines with content, without comments; after [`MAX_ENTRIES`] lines an error ends the iteration. Other errors
    /// concern only their line.
    pub(super) fn lines(&self) -> impl Iterator<Item = Result<Line<'_>, RecordingError>> {
        text::lines(self.text())
            .enumerate()
            .map(|(i, line)| (i + 1, line.trim().trim_start_matches('\u{feff}')))
            .filter(|(_, line)| !line.is_empty() && !is_comment(line))
            .take(MAX_ENTRIES + 1)
            .enumerate()
            .map(|(n, (number, line))| {
                let place = || Place::line(self.path(), number);
                if n >= MAX_ENTRIES {
                    let expected = format!("at most {MAX_ENTRIES} lines");
                    return Err(place().field("length of the file", expected, "more"));
                }
                if line.len() > MAX_LINE_BYTES {
                    let expected = format!("at most {MAX_LINE_BYTES} bytes");
                    return Err(place().field(
                        "length of the line",
                        expected,
                        line.len().to_string(),
                    ));
                }
                Ok(Line {
                    path: self.path(),
                    number,
                    text: line,
                    words: words(line),
                })
            })
    }
}

/// Comment markers in the files of various tools.
fn is_comment(line: &str) -> bool {
    ["#", "%", "//", "!"]
        .iter()
        .any(|sign| line.starts_with(sign))
}

/// Splits a line at white space, and at semicolons or commas if these are separators: a comma inside a word of a line
/// with other separators is a decimal point or part of a name. Quotes keep a word together.
fn words(line: &str) -> Vec<&str> {
    let blank = |c: char| c.is_whitespace() || c == '\0';
    let semicolons = line.contains(';');
    let commas = !semicolons && {
        let mut parts = line.split(blank).filter(|part| !part.is_empty());
        let several = line.trim().contains(blank);
        !several || parts.any(|part| part.starts_with(',') || part.ends_with(','))
    };
    let separates = |c: char| blank(c) || c == ';' || (commas && c == ',');
    let mut words = Vec::new();
    let mut rest = line;
    loop {
        rest = rest.trim_start_matches(separates);
        let Some(first) = rest.chars().next() else {
            return words;
        };
        let quoted = ['"', '\''].contains(&first);
        let close = quoted.then(|| rest[1..].find(first)).flatten();
        match close {
            Some(length) => {
                words.push(&rest[1..=length]);
                rest = &rest[length + 2..];
            }
            None => {
                let end = rest.find(separates).unwrap_or(rest.len());
                words.push(&rest[..end]);
                rest = &rest[end..];
            }
        }
    }
}

/// Parses a number as programs in any language print it: Windows notations for NaN and infinity, a decimal comma, and
/// surrounding brackets are supported.
pub(super) fn number(word: &str) -> Option<f64> {
    let word = word.trim_matches(['[', ']', '(', ')', '{', '}']);
    if let Ok(number) = word.parse() {
        return Some(number);
    }
    let lower = word.trim_start_matches(['-', '+']).to_ascii_lowercase();
    if ["1.#", "nan", "1.$"]
        .iter()
        .any(|sign| lower.starts_with(sign))
    {
        return Some(f64::NAN);
    }
    word.replacen(',', ".", 1).parse().ok()
}

impl<'a> Line<'a> {
    pub(super) fn place(&self) -> Place {
        Place::line(self.path, self.number)
    }

    /// Exactly `N` numbers.
    pub(super) fn numbers<const N: usize>(&self, field: &str) -> Result<[f64; N], RecordingError> {
        if self.words.len() > N {
            let got = format!("{} words", self.words.len());
            return Err(self.place().field(field, format!("{N} numbers"), got));
        }
        self.first_numbers(field)
    }

    /// `N` numbers; further numbers are ignored.
    pub(super) fn first_numbers<const N: usize>(
        &self,
        field: &str,
    ) -> Result<[f64; N], RecordingError> {
        if self.words.len() < N {
            let got = format!("{} words", self.words.len());
            return Err(self.place().field(field, format!("{N} numbers"), got));
        }
        let mut out = [0.0; N];
        for (i, (slot, word)) in out.iter_mut().zip(&self.words).enumerate() {
            *slot = number(word).ok_or_else(|| {
                self.place().field(
                    format!("{field}, number {}", i + 1),
                    "a number",
                    quote(word),
                )
            })?;
        }
        Ok(out)
    }

    /// The word at `index`, which must exist.
    pub(super) fn word(&self, index: usize, field: &str) -> Result<&'a str, RecordingError> {
        self.words.get(index).copied().ok_or_else(|| {
            let got = format!("{} words", self.words.len());
            self.place()
                .field(field, format!("a word at position {}", index + 1), got)
        })
    }
}

/// A pose, and the deviation of its matrix from a rotation before it was corrected.
#[derive(Debug, Clone, Copy)]
pub(super) struct MatrixPose {
    pub(super) pose: Pose,
    pub(super) deviation: f64,
}

/// A homogeneous 4x4 matrix as a pose.
pub(super) fn pose_from_matrix(
    m: &[[f64; 4]; 4],
    place: &Place,
) -> Result<MatrixPose, RecordingError> {
    let rows = [0, 1, 2].map(|r| [m[r][0], m[r][1], m[r][2]]);
    let translation = [m[0][3], m[1][3], m[2][3]];
    let pose = Pose::from_rows(rows, translation).map_err(|e| place.clone().camera(e))?;
    let last = [0.0, 0.0, 0.0, 1.0];
    // Files contain this row exactly; 1e-6 allows for printing with six digits.
    if !m[3].iter().zip(last).all(|(a, b)| (a - b).abs() <= 1e-6) {
        return Err(place
            .clone()
            .field("pose, row 4", "0 0 0 1", format!("{:?}", m[3])));
    }
    let r = DMat3::from_cols_array_2d(&rows);
    let residual = r.transpose() * r - DMat3::IDENTITY;
    let deviation = residual
        .to_cols_array()
        .iter()
        .fold(0.0f64, |a, b| a.max(b.abs()));
    Ok(MatrixPose { pose, deviation })
}

/// Checks `fx fy cx cy`.
pub(super) fn check_focal(k: [f64; 4], place: &Place) -> Result<[f64; 4], RecordingError> {
    Intrinsics::new(k[0], k[1], k[2], k[3], 1, 1)
        .map(|_| k)
        .map_err(|e| place.clone().camera(e))
}

/// A JSON document; errors name the field.
pub(super) fn json_from_text<T: serde::de::DeserializeOwned>(
    file: &TextFile,
) -> Result<T, RecordingError> {
    let mut json = serde_json::Deserializer::from_str(file.text());
    serde_path_to_error::deserialize(&mut json).map_err(|error| {
        let line = error.inner().line();
        let field = error.path().to_string();
        let place = Place::line(file.path(), line);
        place.field(field, "a valid document", error.inner().to_string())
    })
}

/// Whether a name has one of some extensions, given in lower case.
pub(super) fn has_extension(name: &str, extensions: &[&str]) -> bool {
    let extension = name.rsplit_once('.').map(|(_, e)| e.to_ascii_lowercase());
    extension.is_some_and(|e| extensions.contains(&e.as_str()))
}
