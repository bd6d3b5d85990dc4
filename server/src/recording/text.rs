//! Text files from outside: bounded size, bounded lines, numbers that say where they stand.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use crate::camera::{Intrinsics, Pose};
use crate::codec::read_file;
use crate::text::{self, Text};
use glam::DMat3;

use super::error::{Place, RecordingError};

/// Largest text file read, bytes: a day of poses at 100 Hz.
pub(super) const MAX_TEXT_BYTES: u64 = 64 << 20;
/// Longest line, bytes; the longest legitimate ones are a path or sixteen numbers.
const MAX_LINE_BYTES: usize = 8192;
/// Most entries of a folder or list that are looked at: nine hours at 30 Hz.
pub(super) const MAX_ENTRIES: usize = 1_000_000;
/// Longest excerpt of a file that an error repeats, characters.
const MAX_QUOTE: usize = 60;

/// A text file in memory.
#[derive(Debug)]
pub(super) struct TextFile {
    pub(super) path: PathBuf,
    text: Text<'static>,
}

/// One line, split at white space.
pub(super) struct Line<'a> {
    path: &'a Path,
    /// From 1.
    pub(super) number: usize,
    /// The words of the line.
    pub(super) words: Vec<&'a str>,
}

impl TextFile {
    pub(super) fn read(path: &Path) -> Result<Self, RecordingError> {
        Ok(Self::from_bytes(path, read_file(path, MAX_TEXT_BYTES)?))
    }

    pub(super) fn from_bytes(path: &Path, bytes: Vec<u8>) -> Self {
        let Text { text, encoding } = text::decode(&bytes);
        Self {
            path: path.to_owned(),
            text: Text {
                text: Cow::Owned(text.into_owned()),
                encoding,
            },
        }
    }

    pub(super) fn text(&self) -> &str {
        &self.text.text
    }

    /// The file that a word of the text names, relative to the folder that the text is about.
    pub(super) fn named(&self, word: &str) -> PathBuf {
        self.text.path(word)
    }

    /// Lines with content, without comments (`#`), at most [`MAX_ENTRIES`].
    pub(super) fn lines(&self) -> impl Iterator<Item = Result<Line<'_>, RecordingError>> {
        text::lines(self.text())
            .enumerate()
            .map(|(i, line)| (i + 1, line.trim().trim_start_matches('\u{feff}')))
            .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
            .enumerate()
            .map(|(n, (number, line))| {
                let place = || Place::line(&self.path, number);
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
                    path: &self.path,
                    number,
                    words: line.split_ascii_whitespace().collect(),
                })
            })
    }
}

impl<'a> Line<'a> {
    pub(super) fn place(&self) -> Place {
        Place::line(self.path, self.number)
    }

    /// Exactly `N` numbers.
    pub(super) fn numbers<const N: usize>(&self, field: &str) -> Result<[f64; N], RecordingError> {
        if self.words.len() != N {
            let got = format!("{} words", self.words.len());
            return Err(self.place().field(field, format!("{N} numbers"), got));
        }
        let mut out = [0.0; N];
        for (i, (slot, word)) in out.iter_mut().zip(&self.words).enumerate() {
            *slot = word.parse().map_err(|_| {
                self.place().field(
                    format!("{field}, number {}", i + 1),
                    "a number",
                    quote(word),
                )
            })?;
        }
        Ok(out)
    }

    /// The word at `index`, which must be there.
    pub(super) fn word(&self, index: usize, field: &str) -> Result<&'a str, RecordingError> {
        self.words.get(index).copied().ok_or_else(|| {
            let got = format!("{} words", self.words.len());
            self.place()
                .field(field, format!("a word at position {}", index + 1), got)
        })
    }
}

/// A piece of a hostile file, fit to be printed in one line.
pub(super) fn quote(text: &str) -> String {
    let short: String = text.chars().take(MAX_QUOTE).collect();
    let dots = if short.len() < text.len() { "…" } else { "" };
    format!("\"{}{dots}\"", short.escape_debug())
}

/// A time stamp in decimal seconds as nanoseconds, exact to the last digit (an f64 of Unix
/// time is good to a quarter of a microsecond only). Digits under a nanosecond are cut off.
pub(super) fn parse_time_ns(word: &str) -> Option<i64> {
    let (sign, digits) = match word.strip_prefix('-') {
        Some(rest) => (-1, rest),
        None => (1, word),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let plain = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
    if plain(whole) && plain(fraction) && !(whole.is_empty() && fraction.is_empty()) {
        let seconds: i64 = if whole.is_empty() {
            0
        } else {
            whole.parse().ok()?
        };
        let mut nanos = 0;
        for i in 0..9 {
            nanos = nanos * 10 + i64::from(fraction.as_bytes().get(i).map_or(0, |b| b - b'0'));
        }
        return seconds
            .checked_mul(1_000_000_000)?
            .checked_add(nanos)?
            .checked_mul(sign);
    }
    // Exponents, as numeric tools write them.
    let seconds: f64 = word.parse().ok()?;
    time_ns_from_secs(seconds)
}

/// Seconds as nanoseconds; nothing for NaN and anything beyond i64.
pub(super) fn time_ns_from_secs(seconds: f64) -> Option<i64> {
    let nanos = seconds * 1e9;
    // 2^63 is exactly representable; anything below it converts.
    (nanos.abs() < 9_223_372_036_854_775_808.0).then_some(nanos as i64)
}

/// A pose and how far its matrix was from a rotation before it was repaired.
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
    // Files hold this row exactly; 1e-6 allows for one printed with six digits.
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

/// Intrinsics from a row-major 3x3 matrix, checked to be a pinhole's.
pub(super) fn focal_from_matrix(
    m: &[[f64; 3]; 3],
    place: &Place,
) -> Result<[f64; 4], RecordingError> {
    let zeros = [m[0][1], m[1][0], m[2][0], m[2][1], m[2][2] - 1.0];
    if !zeros.iter().all(|z| z.abs() <= 1e-6) {
        return Err(place.clone().field(
            "intrinsics matrix",
            "fx 0 cx, 0 fy cy, 0 0 1",
            format!("{m:?}"),
        ));
    }
    check_focal([m[0][0], m[1][1], m[0][2], m[1][2]], place)
}

/// `fx fy cx cy` that a camera can have.
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
        let place = Place::line(&file.path, line);
        place.field(field, "a valid document", error.inner().to_string())
    })
}

/// File names in a folder, sorted as text; other kinds of entries and names that are no text
/// are left out.
pub(super) fn file_names(dir: &Path) -> Result<Vec<String>, RecordingError> {
    entry_names(dir, false)
}

/// Names of folders in a folder, sorted as text.
pub(super) fn folder_names(dir: &Path) -> Result<Vec<String>, RecordingError> {
    entry_names(dir, true)
}

fn entry_names(dir: &Path, folders: bool) -> Result<Vec<String>, RecordingError> {
    let io = |source| RecordingError::Io {
        path: dir.to_owned(),
        source,
    };
    let mut names = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(io)?.take(MAX_ENTRIES) {
        let entry = entry.map_err(io)?;
        // Follows links: recordings are often assembled from them. A dangling one is no entry.
        let is_folder = match entry.file_type().map_err(io)? {
            kind if kind.is_symlink() => match std::fs::metadata(entry.path()) {
                Ok(target) => target.is_dir(),
                Err(_) => continue,
            },
            kind => kind.is_dir(),
        };
        if is_folder == folders
            && let Ok(name) = entry.file_name().into_string()
        {
            names.push(name);
        }
    }
    names.sort_unstable();
    Ok(names)
}
