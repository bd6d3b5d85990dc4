//! The text files of a TUM recording: lists of time-stamped pictures, associations of both kinds, and time-stamped
//! poses, as written by the benchmark and similar tools: with commas, tabs, quotes, headings and additional columns,
//! on Windows and other systems. An unreadable line is left out.

use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};

use crate::camera::Pose;

use super::error::{Place, RecordingError};
use super::excerpt::quote;
use super::left_out::LeftOut;
use super::location::Location;
use super::text::{Line, TextFile, number};
use super::times::TimeUnit;

/// A listed picture.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Stamped {
    pub(super) time_ns: i64,
    pub(super) file: PathBuf,
}

/// The content of a file, and how much of it could not be read.
#[derive(Debug)]
pub(super) struct Parsed<T> {
    pub(super) items: Vec<T>,
    left: LeftOut,
    unit: TimeUnit,
}

impl<T> Parsed<T> {
    /// Notes the omitted lines, and a unit of time other than seconds.
    pub(super) fn describe(&self, name: &str, notes: &mut Vec<String>) {
        let n = self.items.len() + self.left.count();
        let what = format!("lines of {name} cannot be read and are left out");
        self.left.note(n, &what, notes);
        if self.unit != TimeUnit::SECONDS {
            notes.push(format!(
                "Time stamps of {name} are taken as {}.",
                self.unit.name()
            ));
        }
    }
}

/// `timestamp file` lines, sorted by time.
pub(super) fn parse_list(file: &TextFile) -> Parsed<Stamped> {
    let mut parsed = parse(file, |line, unit| {
        let name = match line.words.as_slice() {
            [] | [_] => line.word(1, "file name")?,
            // A word after a name is another column, unless the name contains blanks.
            [_, name, ..] if is_picture(name) => name,
            [stamp, ..] => {
                let rest = line.text.trim_start_matches(stamp).trim();
                if is_picture(rest) {
                    rest
                } else {
                    line.words[1]
                }
            }
        };
        Ok(Stamped {
            time_ns: time_of(line, 0, unit)?,
            file: path_inside(file, line, name)?,
        })
    });
    parsed.items.sort_by_key(|entry| entry.time_ns);
    parsed
}

/// `timestamp file timestamp file` lines, with colour and depth in either order and possibly other columns, sorted by
/// colour's time; also returns whether the names identified the depth file.
pub(super) fn parse_associations(file: &TextFile) -> (Parsed<[Stamped; 2]>, bool) {
    let mut named = true;
    let mut parsed = parse(file, |line, unit| {
        let names: Vec<usize> = (0..line.words.len())
            .filter(|&i| number(line.words[i]).is_none())
            .collect();
        let [a, b] = match names.as_slice() {
            &[a, b] if a > 0 => [a, b],
            _ => {
                let expected = "timestamp file timestamp file";
                return Err(line.place().field("line", expected, quote(line.text)));
            }
        };
        let picture = |i: usize, stamp: usize| {
            Ok::<_, RecordingError>(Stamped {
                time_ns: time_of(line, stamp, unit)?,
                file: path_inside(file, line, line.words[i])?,
            })
        };
        // Some lists have one stamp for both.
        let stamp_of_b = if b == a + 1 { a - 1 } else { b - 1 };
        let (first, second) = (picture(a, a - 1)?, picture(b, stamp_of_b)?);
        Ok(match (is_depth(&first.file), is_depth(&second.file)) {
            (true, false) => [second, first],
            (false, true) => [first, second],
            _ => {
                named = false;
                [first, second]
            }
        })
    });
    parsed.items.sort_by_key(|[color, _]| color.time_ns);
    (parsed, named)
}

/// `timestamp tx ty tz qx qy qz qw` lines, perhaps with more columns, sorted by time.
pub(super) fn parse_poses(file: &TextFile) -> Parsed<(i64, Pose)> {
    let mut parsed = parse(file, |line, unit| {
        let time_ns = time_of(line, 0, unit)?;
        let [_, tx, ty, tz, qx, qy, qz, qw] = line.first_numbers("pose")?;
        let pose = Pose::from_quaternion([qx, qy, qz, qw], [tx, ty, tz])
            .map_err(|e| line.place().camera(e))?;
        Ok((time_ns, pose))
    });
    parsed.items.sort_by_key(|(time_ns, _)| *time_ns);
    parsed
}

/// Whether a file has poses in the benchmark's format: its first line of numbers has eight or a few more numbers, not
/// the twelve or sixteen of a matrix.
pub(super) fn has_poses(file: &TextFile) -> bool {
    let rows = file.lines().filter_map(Result::ok).take(100);
    let lengths: Vec<usize> = rows
        .filter(|line| line.words.iter().all(|word| number(word).is_some()))
        .map(|line| line.words.len())
        .collect();
    lengths.first().is_some_and(|n| (8..=11).contains(n))
}

/// Reads every readable line; a heading before the first line is ignored.
fn parse<T>(
    file: &TextFile,
    mut item: impl FnMut(&Line, TimeUnit) -> Result<T, RecordingError>,
) -> Parsed<T> {
    let unit = TimeUnit::of_file(file);
    let mut parsed = Parsed {
        items: Vec::new(),
        left: LeftOut::default(),
        unit,
    };
    for (i, line) in file.lines().enumerate() {
        let (heading, found) = match line {
            Ok(line) => (
                i == 0 && line.words.iter().all(|word| is_label(word)),
                item(&line, unit),
            ),
            Err(error) => (false, Err(error)),
        };
        match found {
            Ok(found) => parsed.items.push(found),
            Err(_) if heading => {}
            Err(error) => parsed.left.add(format!("line {}", line_of(&error)), error),
        }
    }
    parsed
}

/// The line number of an error, 0 if it has none.
fn line_of(error: &RecordingError) -> usize {
    match error {
        RecordingError::Field { place, .. } | RecordingError::Camera { place, .. } => {
            place.line.unwrap_or(0)
        }
        _ => 0,
    }
}

/// Whether a word can be part of a heading: neither a number nor the name of a picture.
fn is_label(word: &str) -> bool {
    number(word).is_none() && !is_picture(word) && word.contains(|c: char| c.is_alphabetic())
}

fn is_picture(name: &str) -> bool {
    super::text::has_extension(
        name,
        &[
            "png", "jpg", "jpeg", "pgm", "ppm", "tif", "tiff", "npy", "exr", "bmp", "webp",
        ],
    )
}

/// Whether a path looks like that of a depth picture.
fn is_depth(path: &Path) -> bool {
    path.components().any(|part| {
        let part = part.as_os_str().to_string_lossy().to_ascii_lowercase();
        part.contains("depth") || part == "d"
    })
}

fn time_of(line: &Line, index: usize, unit: TimeUnit) -> Result<i64, RecordingError> {
    let word = line.word(index, "time stamp")?;
    unit.parse_ns(word)
        .ok_or_else(|| Place::field(line.place(), "time stamp", "seconds", quote(word)))
}

/// The file that a list names, which must be inside its folder. Lists from another machine or from Windows are
/// supported: backslashes, and the last two components of an absolute path.
fn path_inside(file: &TextFile, line: &Line, name: &str) -> Result<PathBuf, RecordingError> {
    let path = file.named(name);
    let inside = |path: &Path| {
        path.components()
            .all(|part| matches!(part, Component::Normal(_) | Component::CurDir))
    };
    let from_root =
        path.is_absolute() || name.get(1..3) == Some(":\\") || name.get(1..3) == Some(":/");
    if inside(&path) && !from_root && !path.as_os_str().is_empty() {
        return Ok(path);
    }
    let refused = || {
        let expected = "a path inside the recording's folder";
        line.place().field("file name", expected, quote(name))
    };
    if !from_root {
        return Err(refused());
    }
    let slashed = name.replace('\\', "/");
    let parts: Vec<&str> = slashed.split('/').filter(|part| !part.is_empty()).collect();
    let short = file.named(&parts[parts.len().saturating_sub(2)..].join("/"));
    let there = |root: Location| root.join(&short).is_file();
    if parts.len() > 2 && inside(&short) && file.location.parent().is_some_and(there) {
        Ok(short)
    } else {
        Err(refused())
    }
}

/// Finds listed files by their actual names on disk: backslashes are treated as slashes, and case is ignored.
#[derive(Debug, Default)]
pub(super) struct Finder {
    /// Contents of the folders that were read, by name in lower case.
    folders: HashMap<PathBuf, HashMap<String, PathBuf>>,
}

impl Finder {
    /// The actual path of a listed file in `root`.
    pub(super) fn find(&mut self, root: &Location, listed: &Path) -> Option<PathBuf> {
        if root.join(listed).is_file() {
            return Some(listed.to_owned());
        }
        let text = listed.to_str()?;
        let slashed = PathBuf::from(text.replace('\\', "/"));
        let inside = |part| matches!(part, Component::Normal(_) | Component::CurDir);
        if !slashed.components().all(inside) {
            return None;
        }
        if root.join(&slashed).is_file() {
            return Some(slashed);
        }
        let folder = root.join(slashed.parent()?);
        let name = slashed.file_name()?.to_str()?.to_lowercase();
        let names = self
            .folders
            .entry(folder.path().to_owned())
            .or_insert_with(|| {
                // An unreadable folder is treated as empty.
                let names = folder.file_names().unwrap_or_default();
                let lower = |name: String| (name.to_lowercase(), PathBuf::from(name));
                names.into_iter().map(lower).collect()
            });
        Some(slashed.parent()?.join(names.get(&name)?))
    }
}
