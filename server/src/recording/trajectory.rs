//! Trajectories in separate files, given by the caller or found in a folder.
//!
//! | line | is |
//! |---|---|
//! | 8 numbers | TUM: time (or frame number), tx ty tz qx qy qz qw |
//! | 12 or 16 | KITTI and others: a row-major 3x4 or 4x4 matrix |
//! | 13 or 17 | the same after a time or frame number |
//! | 7 | tx ty tz qx qy qz qw |
//! | 2 or 3, then four of 4 | Open3D `.log` |
//! | 4 | rows of 4x4 matrices, one after the other |
//!
//! All are world from camera. Poses are matched to pictures by time if both have times, else by number if both have
//! numbers, else by order.

use std::collections::HashMap;

use crate::camera::Pose;

use super::error::{Place, RecordingError};
use super::excerpt::MAX_ENTRIES;
use super::location::Location;
use super::poses::{Axes, matrix, numbers};
use super::text::{MatrixPose, TextFile};
use super::tum::pose_at;
use super::{Entry, OpenOptions};

/// Poses of a file in file order.
#[derive(Debug)]
pub(super) struct Trajectory {
    location: Location,
    /// Times in seconds or frame numbers, if the file has them; and poses, `None` if lost.
    poses: Vec<(Option<f64>, Option<MatrixPose>)>,
}

/// How poses were matched to pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rule {
    Time,
    Number,
    Order,
    /// Entry k belongs to the picture with number k, counted from this value.
    Index(u64),
}

impl Trajectory {
    pub(super) fn read(path: &Location) -> Result<Self, RecordingError> {
        Self::parse(&TextFile::read(path)?)
    }

    pub(super) fn parse(file: &TextFile) -> Result<Self, RecordingError> {
        let text = file.text();
        if text.trim_start().starts_with('{') {
            let expected = "a trajectory of numbers (TUM, .log, 12 or 16 numbers a line)";
            return Err(Place::file(file.path()).field("trajectory", expected, "a JSON document"));
        }
        let comment = |line: &str| ["#", "%", "//"].iter().any(|sign| line.starts_with(sign));
        let lines: Vec<Vec<f64>> = text
            .split(['\n', '\r'])
            .map(|line| line.trim_start_matches('\u{feff}').trim())
            .filter(|line| !line.is_empty() && !comment(line))
            .map(numbers)
            .filter(|line| !line.is_empty())
            .take(MAX_ENTRIES + 1)
            .collect();
        let place = || Place::file(file.path());
        if lines.len() > MAX_ENTRIES {
            let expected = format!("at most {MAX_ENTRIES} lines");
            return Err(place().field("length of the file", expected, "more"));
        }
        // A heading of words gives only NaN.
        let heading = lines
            .first()
            .is_some_and(|line| line.iter().all(|n| n.is_nan()));
        let lines = &lines[usize::from(heading)..];
        let poses = match lines.first().map(Vec::len) {
            Some(2 | 3) => log(lines),
            Some(4) => lines
                .chunks(4)
                .map(|rows| (None, matrix(&rows.concat(), Axes::OpenCv)))
                .collect(),
            Some(n @ (7 | 8 | 12 | 13 | 16 | 17)) => {
                lines.iter().map(|line| one_line(line, n)).collect()
            }
            Some(n) => {
                let expected = "7, 8, 12, 13, 16 or 17 numbers a line, 4x4 blocks or a .log";
                return Err(place().field("trajectory", expected, format!("{n} numbers")));
            }
            None => return Err(place().field("trajectory", "poses", "none")),
        };
        Ok(Self {
            location: file.location.clone(),
            poses,
        })
    }

    /// Assigns a pose to each picture. Pictures without a pose are left out and counted in a note.
    pub(super) fn apply(
        &self,
        entries: &mut Vec<Entry>,
        stamped: bool,
        options: &OpenOptions,
        notes: &mut Vec<String>,
    ) -> Result<f64, RecordingError> {
        let numbers: Option<Vec<u64>> = entries.iter().map(|e| picture_number(&e.color)).collect();
        let times = stamped.then(|| entries.iter().map(|e| e.time_ns).collect::<Vec<_>>());
        let Some((rule, found)) =
            self.find(entries.len(), numbers.as_deref(), times.as_deref(), options)
        else {
            return Err(Place::file(&self.location).field(
                "trajectory",
                format!(
                    "poses of these {} pictures, by time, number or order",
                    entries.len()
                ),
                format!("{} poses that do not fit", self.poses.len()),
            ));
        };
        let name = self.location.file_name();
        let how = match rule {
            Rule::Time => "by time".to_owned(),
            Rule::Number => "by the number in their names".to_owned(),
            Rule::Order => "by their order".to_owned(),
            Rule::Index(0) => "by the number in their names, counted from 0".to_owned(),
            Rule::Index(_) => "by the number in their names, counted from 1".to_owned(),
        };
        notes.push(format!("Pictures take the poses of {name} {how}."));
        let mut deviation = 0.0f64;
        let n = entries.len();
        let mut found = found.into_iter();
        entries.retain_mut(|entry| match found.next().flatten() {
            Some(matrix) => {
                deviation = deviation.max(matrix.deviation);
                entry.pose = matrix.pose;
                true
            }
            None => false,
        });
        if entries.len() < n {
            notes.push(format!(
                "{} of {n} frames have no usable pose in {name} and are left out.",
                n - entries.len()
            ));
        }
        Ok(deviation)
    }

    fn find(
        &self,
        n: usize,
        numbers: Option<&[u64]>,
        times: Option<&[i64]>,
        options: &OpenOptions,
    ) -> Option<(Rule, Vec<Option<MatrixPose>>)> {
        let keys: Option<Vec<f64>> = self.poses.iter().map(|(key, _)| *key).collect();
        if let (Some(keys), Some(times)) = (&keys, times) {
            let found = self.by_time(keys, times, options.max_time_gap_ns);
            if found.iter().any(Option::is_some) {
                return Some((Rule::Time, found));
            }
        }
        let by_order = || self.poses.iter().map(|(_, pose)| *pose).collect();
        let same_length = self.poses.len() == n;
        // Numbers that do not distinguish the pictures are ignored.
        let numbers = numbers.filter(|numbers| numbers.is_sorted_by(|a, b| a < b));
        let (Some(numbers), false) = (numbers, n == 0) else {
            return same_length.then(|| (Rule::Order, by_order()));
        };
        if let Some(keys) = keys {
            let whole = |key: f64| (0.0..9e15).contains(&key) && key.fract() == 0.0;
            if keys.iter().all(|&key| whole(key)) && keys.is_sorted_by(|a, b| a < b) {
                let poses = keys.iter().map(|&key| key as u64).zip(&self.poses);
                let map: HashMap<u64, Option<MatrixPose>> =
                    poses.map(|(key, (_, pose))| (key, *pose)).collect();
                let hits = numbers.iter().filter(|n| map.contains_key(n)).count();
                // Pictures counted from 1 with as many entries counted from 0 are matched by order.
                if hits == n || (hits * 2 >= n && !same_length) {
                    let found = numbers.iter().map(|n| map.get(n).copied().flatten());
                    return Some((Rule::Number, found.collect()));
                }
            }
        }
        if same_length {
            return Some((Rule::Order, by_order()));
        }
        let (first, last) = (numbers[0], numbers[n - 1]);
        let from = match self.poses.len() as u64 {
            count if last < count => 0,
            count if last == count && first > 0 => 1,
            _ => return None,
        };
        let pose = |number: &u64| self.poses[(number - from) as usize].1;
        Some((Rule::Index(from), numbers.iter().map(pose).collect()))
    }

    fn by_time(&self, keys: &[f64], times: &[i64], gap_ns: i64) -> Vec<Option<MatrixPose>> {
        let mut list: Vec<(i64, Pose)> = keys
            .iter()
            .zip(&self.poses)
            .filter_map(|(key, (_, pose))| Some(((key * 1e9) as i64, pose.as_ref()?.pose)))
            .collect();
        list.sort_by_key(|(time, _)| *time);
        let at = |&time: &i64| {
            let pose = pose_at(&list, time, gap_ns)?;
            Some(MatrixPose {
                pose,
                deviation: 0.0,
            })
        };
        times.iter().map(at).collect()
    }
}

/// A pose of `n` numbers on one line.
fn one_line(line: &[f64], n: usize) -> (Option<f64>, Option<MatrixPose>) {
    let keyed = n == 8 || n == 13 || n == 17;
    let key = keyed
        .then(|| line.first().copied().filter(|key| key.is_finite()))
        .flatten();
    if line.len() < n {
        return (key, None);
    }
    let values = &line[usize::from(keyed)..n];
    let pose = match *values {
        [tx, ty, tz, qx, qy, qz, qw] => Pose::from_quaternion([qx, qy, qz, qw], [tx, ty, tz])
            .ok()
            .map(|pose| MatrixPose {
                pose,
                deviation: 0.0,
            }),
        _ => matrix(values, Axes::OpenCv),
    };
    (key, pose)
}

/// Open3D: a line of integers, the first of which is the frame number, then four rows. Numbers that do not ascend are
/// ignored.
fn log(lines: &[Vec<f64>]) -> Vec<(Option<f64>, Option<MatrixPose>)> {
    let mut poses = Vec::new();
    let mut rest = lines;
    while let Some((header, after)) = rest.split_first() {
        // A lost matrix may be left out completely, so that the next header follows at once.
        let n_rows = after
            .iter()
            .take(4)
            .take_while(|row| row.len() == 4)
            .count();
        let (rows, next) = after.split_at(n_rows);
        let key = header.first().copied().filter(|key| key.is_finite());
        poses.push((key, matrix(&rows.concat(), Axes::OpenCv)));
        rest = next;
    }
    if !poses.is_sorted_by(|a, b| a.0 < b.0) {
        for (key, _) in &mut poses {
            *key = None;
        }
    }
    poses
}

/// The last number in a picture's name.
fn picture_number(picture: &Location) -> Option<u64> {
    let stem = picture.path().file_stem()?.to_str()?;
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let digits = &stem[..end];
    let start = digits
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |i| i + 1);
    digits[start..].parse().ok()
}
