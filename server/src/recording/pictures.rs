//! Folders of pictures, paired by name.

use std::collections::BTreeMap;

use crate::camera::Pose;

use super::error::RecordingError;
use super::location::Location;
use super::text::MatrixPose;
use super::{Entry, NOMINAL_PERIOD_NS, OpenOptions};

/// Extensions of colour pictures.
pub(super) const COLOR: [&str; 9] = [
    "jpg", "jpeg", "png", "webp", "bmp", "ppm", "pgm", "tif", "tiff",
];
/// Extensions of depth pictures.
pub(super) const DEPTH: [&str; 7] = ["png", "pgm", "tif", "tiff", "npy", "exr", "pfm"];

/// The key of a frame: the number in its name, or the whole name if it has no number. Sorted by number.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Key {
    pub(super) number: Option<u64>,
    name: String,
}

impl Key {
    /// From a name without its extension and without the part before the number.
    pub(super) fn new(name: &str) -> Self {
        let digits = !name.is_empty() && name.bytes().all(|b| b.is_ascii_digit());
        match name.parse() {
            Ok(number) if digits => Self {
                number: Some(number),
                name: String::new(),
            },
            _ => Self {
                number: None,
                name: name.to_owned(),
            },
        }
    }
}

/// Files of a folder that have one of some extensions and a name that begins with `prefix`, by the rest of the name.
/// Hidden files are left out.
pub(super) fn list(
    dir: &Location,
    prefix: &str,
    extensions: &[&str],
) -> Result<BTreeMap<Key, Location>, RecordingError> {
    let files = dir.file_names()?.into_iter().filter_map(|name| {
        let (stem, extension) = name.rsplit_once('.')?;
        let rest = stem.strip_prefix(prefix)?;
        let known = extensions.contains(&extension.to_ascii_lowercase().as_str());
        (known && !name.starts_with('.')).then(|| (Key::new(rest), dir.join(&name)))
    });
    Ok(files.collect())
}

/// As [`list`], for pictures that all have the same word before their number (`image00001`, `rgb_1`), which is
/// detected.
pub(super) fn list_prefixed(
    dir: &Location,
    extensions: &[&str],
) -> Result<BTreeMap<Key, Location>, RecordingError> {
    let all = list(dir, "", extensions)?;
    let first = all.keys().find(|key| key.number.is_none());
    let Some(first) = first.map(|key| key.name.clone()) else {
        return Ok(all);
    };
    let digits = first.len() - first.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let prefixed = list(dir, &first[..first.len() - digits], extensions)?;
    let numbered = prefixed.keys().all(|key| key.number.is_some());
    Ok(if numbered && prefixed.len() == all.len() {
        prefixed
    } else {
        all
    })
}

/// The frames of a recording that are kept.
#[derive(Debug, Default)]
pub(super) struct Frames {
    pub(super) entries: Vec<Entry>,
    pub(super) pose_deviation: f64,
    /// Number of frames with colour and depth but without a pose.
    pub(super) without_pose: usize,
    n: usize,
    without_color: usize,
    without_depth: usize,
}

impl Frames {
    /// Adds a frame if it is complete, else counts it. If the caller requests a static camera, a lost pose is
    /// replaced by the camera at rest.
    pub(super) fn add(
        &mut self,
        color: Option<Location>,
        depth: Option<Location>,
        pose: Option<MatrixPose>,
        options: &OpenOptions,
        more: impl FnOnce(&mut Entry),
    ) {
        self.n += 1;
        let Some(color) = color.filter(|path| path.has_content()) else {
            self.without_color += 1;
            return;
        };
        let Some(depth) = depth.filter(|path| path.has_content()) else {
            self.without_depth += 1;
            return;
        };
        let pose = match pose {
            Some(matrix) => {
                self.pose_deviation = self.pose_deviation.max(matrix.deviation);
                matrix.pose
            }
            None if options.assume_static => Pose::IDENTITY,
            None => {
                self.without_pose += 1;
                return;
            }
        };
        let mut entry = Entry {
            color,
            depth,
            confidence: None,
            time_ns: 0,
            depth_lag_ns: 0,
            pose,
            focal: None,
        };
        more(&mut entry);
        self.entries.push(entry);
    }

    /// Pairs pictures by key.
    pub(super) fn pair(
        color: &BTreeMap<Key, Location>,
        depth: &BTreeMap<Key, Location>,
        mut pose: impl FnMut(&Key) -> Option<MatrixPose>,
        options: &OpenOptions,
    ) -> Self {
        let mut frames = Self::default();
        let first = color.keys().next().and_then(|key| key.number);
        for (i, (key, path)) in (0u64..).zip(color) {
            let steps = key.number.zip(first).map_or(i, |(n, first)| n - first);
            let steps = i64::try_from(steps).unwrap_or(i64::MAX);
            let depth = depth.get(key).cloned();
            frames.add(Some(path.clone()), depth, pose(key), options, |entry| {
                entry.time_ns = steps.saturating_mul(NOMINAL_PERIOD_NS);
            });
        }
        let alone = depth.keys().filter(|key| !color.contains_key(key)).count();
        frames.n += alone;
        frames.without_color += alone;
        frames
    }

    /// Adds notes on omitted frames; an error if no frame has a pose. `poses` describes the poses that were searched.
    pub(super) fn finish(
        &mut self,
        root: &Location,
        poses: &str,
        notes: &mut Vec<String>,
    ) -> Result<(), RecordingError> {
        if self.entries.is_empty() && self.without_pose > 0 {
            return Err(RecordingError::NoPoses {
                path: root.path().to_owned(),
                looked_for: poses.to_owned(),
            });
        }
        for (count, what) in [
            (self.without_color, "colour picture"),
            (self.without_depth, "depth picture"),
            (self.without_pose, "usable pose"),
        ] {
            if count > 0 {
                let n = self.n;
                notes.push(format!(
                    "{count} of {n} frames have no {what} and are left out."
                ));
            }
        }
        Ok(())
    }
}
