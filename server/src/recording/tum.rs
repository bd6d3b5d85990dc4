//! TUM RGB-D benchmark (Sturm et al. 2012): `rgb.txt` and `depth.txt` list
//! `timestamp file`, `groundtruth.txt` lists `timestamp tx ty tz qx qy qz qw`, world from
//! camera. Depth is registered, 5000 units per metre.
//!
//! Each colour frame takes the depth frame nearest in time (each depth frame serves one colour
//! frame only) and the pose interpolated to its own time.

use std::path::{Component, Path, PathBuf};

use crate::camera::Pose;

use super::error::{Place, RecordingError};
use super::rig::{CameraFile, CameraModel, DepthRays, Rig, find_camera_file};
use super::text::{Line, TextFile, parse_time_ns, quote};
use super::{Entry, Layout, Listing, NOMINAL_PERIOD_NS, OpenOptions};

pub(super) const LOOKED_FOR: &str = "rgb.txt with depth.txt (TUM RGB-D)";

const UNITS_PER_METRE: f64 = 5000.0;

/// Poses are interpolated over gaps up to this many times the largest colour-depth gap.
const POSE_GAP_FACTOR: i64 = 5;

/// A pose this near in time is the frame's own, whatever its neighbours: stamps are printed
/// with six digits.
const SAME_TIME_NS: i64 = 1_000;

/// Camera files in order of preference.
const CAMERA_FILES: [&str; 4] = [
    "manifest.json",
    "camera.json",
    "intrinsics.txt",
    // ETH3D's.
    "calibration.txt",
];

/// The benchmark's own calibrations and that of Bonn's dynamic data set, found by the folder's name.
const CALIBRATIONS: [(&str, [f64; 4]); 4] = [
    ("freiburg1", [517.3, 516.5, 318.6, 255.3]),
    ("freiburg2", [520.9, 521.0, 325.1, 249.7]),
    ("freiburg3", [535.4, 539.2, 320.1, 247.6]),
    (
        "rgbd_bonn",
        [542.822_841, 542.576_870, 315.593_520, 237.756_098],
    ),
];

/// What the benchmark recommends where nothing else is known.
const ROS_DEFAULT: [f64; 4] = [525.0, 525.0, 319.5, 239.5];

/// A listed picture.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Stamped {
    pub(super) time_ns: i64,
    pub(super) file: PathBuf,
}

pub(super) fn list(root: &Path, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    let [rgb_txt, depth_txt, poses_txt] =
        ["rgb.txt", "depth.txt", "groundtruth.txt"].map(|name| root.join(name));
    if !(rgb_txt.is_file() && depth_txt.is_file()) {
        return Ok(None);
    }
    let mut notes = Vec::new();
    let CameraFile {
        camera,
        depth_units_per_metre,
    } = camera(root, options, &mut notes)?;
    let color = present(
        root,
        parse_list(&TextFile::read(&rgb_txt)?)?,
        "rgb.txt",
        &mut notes,
    );
    let depth = present(
        root,
        parse_list(&TextFile::read(&depth_txt)?)?,
        "depth.txt",
        &mut notes,
    );
    let poses = if poses_txt.is_file() {
        Some(parse_poses(&TextFile::read(&poses_txt)?)?)
    } else if options.assume_static {
        notes.push("No groundtruth.txt: the camera is taken to be at rest.".to_owned());
        None
    } else {
        return Err(RecordingError::NoPoses {
            path: root.to_owned(),
            looked_for: "groundtruth.txt".to_owned(),
        });
    };

    let pairs = associate(&color, &depth, options.max_time_gap_ns);
    let unpaired = color.len() - pairs.len();
    if unpaired > 0 {
        notes.push(format!(
            "{unpaired} of {} colour frames have no depth frame within {:.0} ms and are left out.",
            color.len(),
            options.max_time_gap_ns as f64 * 1e-6
        ));
    }
    let mut entries = Vec::with_capacity(pairs.len());
    let mut without_pose = 0;
    for (c, d) in pairs {
        let (color, depth) = (&color[c], &depth[d]);
        let pose = match &poses {
            Some(poses) => pose_at(poses, color.time_ns, options.max_time_gap_ns),
            None => Some(Pose::IDENTITY),
        };
        let Some(pose) = pose else {
            without_pose += 1;
            continue;
        };
        entries.push(Entry {
            color: root.join(&color.file),
            depth: root.join(&depth.file),
            confidence: None,
            time_ns: color.time_ns,
            depth_lag_ns: depth.time_ns.saturating_sub(color.time_ns),
            pose,
            focal: None,
        });
    }
    if without_pose > 0 {
        notes.push(format!(
            "{without_pose} frames have no poses around them in groundtruth.txt and are left out."
        ));
    }
    Ok(Some(Listing {
        layout: Layout::Tum,
        entries,
        rig: Rig {
            color: camera,
            depth: DepthRays::Registered,
        },
        depth_units_per_metre: depth_units_per_metre.unwrap_or(UNITS_PER_METRE),
        stamped: true,
        pose_deviation: None,
        notes,
    }))
}

fn camera(
    root: &Path,
    options: &OpenOptions,
    notes: &mut Vec<String>,
) -> Result<CameraFile, RecordingError> {
    let found = find_camera_file(root, &CAMERA_FILES)?;
    if let Some(focal) = options.intrinsics {
        return Ok(CameraFile {
            camera: CameraModel::given(focal, root)?,
            depth_units_per_metre: found.and_then(|f| f.depth_units_per_metre),
        });
    }
    if let Some(found) = found {
        return Ok(found);
    }
    // A relative path such as "." has no name of its own.
    let folder = root.canonicalize().unwrap_or_else(|_| root.to_owned());
    let name = folder
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let known = CALIBRATIONS.iter().find(|(part, _)| name.contains(part));
    let (origin, focal) = match known {
        Some((part, focal)) => (format!("{part} calibration, by the folder's name"), *focal),
        None => ("ROS default of the TUM benchmark".to_owned(), ROS_DEFAULT),
    };
    let [fx, fy, cx, cy] = focal;
    notes.push(format!(
        "No intrinsics in the folder: taking fx {fx} fy {fy} cx {cx} cy {cy} ({origin})."
    ));
    Ok(CameraFile {
        camera: CameraModel::default_vga(focal, &origin),
        depth_units_per_metre: None,
    })
}

/// `timestamp file` lines, sorted by time.
pub(super) fn parse_list(file: &TextFile) -> Result<Vec<Stamped>, RecordingError> {
    let mut list = Vec::new();
    for line in file.lines() {
        let line = line?;
        let name = line.word(1, "file name")?;
        let path = Path::new(name);
        // A list must not lead out of its folder.
        if !path
            .components()
            .all(|part| matches!(part, Component::Normal(_) | Component::CurDir))
        {
            let expected = "a path inside the recording's folder";
            return Err(line.place().field("file name", expected, quote(name)));
        }
        list.push(Stamped {
            time_ns: time_of(&line)?,
            file: path.to_owned(),
        });
    }
    list.sort_by_key(|entry| entry.time_ns);
    Ok(list)
}

/// `timestamp tx ty tz qx qy qz qw` lines, sorted by time.
pub(super) fn parse_poses(file: &TextFile) -> Result<Vec<(i64, Pose)>, RecordingError> {
    let mut poses = Vec::new();
    for line in file.lines() {
        let line = line?;
        let time_ns = time_of(&line)?;
        let [_, tx, ty, tz, qx, qy, qz, qw] = line.numbers("pose")?;
        let pose = Pose::from_quaternion([qx, qy, qz, qw], [tx, ty, tz])
            .map_err(|e| line.place().camera(e))?;
        poses.push((time_ns, pose));
    }
    poses.sort_by_key(|(time_ns, _)| *time_ns);
    Ok(poses)
}

fn time_of(line: &Line) -> Result<i64, RecordingError> {
    let word = line.word(0, "time stamp")?;
    parse_time_ns(word)
        .ok_or_else(|| Place::field(line.place(), "time stamp", "seconds", quote(word)))
}

/// Leaves out, and counts, what is listed but not there.
fn present(root: &Path, list: Vec<Stamped>, name: &str, notes: &mut Vec<String>) -> Vec<Stamped> {
    let listed = list.len();
    let list: Vec<_> = list
        .into_iter()
        .filter(|e| root.join(&e.file).is_file())
        .collect();
    if list.len() < listed {
        let missing = listed - list.len();
        notes.push(format!(
            "{missing} of {listed} files listed in {name} are missing and left out."
        ));
    }
    list
}

/// Pairs (colour, depth) nearest in time within `max_gap_ns`; both lists sorted by time. A depth
/// frame goes to the nearest of the colour frames that want it, the earlier one on a tie.
pub(super) fn associate(
    color: &[Stamped],
    depth: &[Stamped],
    max_gap_ns: i64,
) -> Vec<(usize, usize)> {
    let gap = |c: usize, d: usize| color[c].time_ns.abs_diff(depth[d].time_ns);
    let mut taken_by: Vec<Option<usize>> = vec![None; depth.len()];
    for (c, picture) in color.iter().enumerate() {
        let after = depth.partition_point(|d| d.time_ns < picture.time_ns);
        let before = after.checked_sub(1);
        let nearest = before
            .into_iter()
            .chain((after < depth.len()).then_some(after));
        let Some(d) = nearest.min_by_key(|&d| gap(c, d)) else {
            continue;
        };
        let nearer = taken_by[d].is_none_or(|other| gap(c, d) < gap(other, d));
        if nearer && gap(c, d) <= max_gap_ns.unsigned_abs() {
            taken_by[d] = Some(c);
        }
    }
    let mut pairs: Vec<_> = taken_by
        .iter()
        .enumerate()
        .filter_map(|(d, c)| c.map(|c| (c, d)))
        .collect();
    pairs.sort_unstable();
    pairs
}

/// The pose at a time: that of the very moment, or between its two neighbours if these are near.
pub(super) fn pose_at(poses: &[(i64, Pose)], time_ns: i64, max_gap_ns: i64) -> Option<Pose> {
    let after = poses.partition_point(|(t, _)| *t < time_ns);
    let next = poses.get(after);
    let previous = after.checked_sub(1).and_then(|i| poses.get(i));
    let same = [next, previous]
        .into_iter()
        .flatten()
        .min_by_key(|(t, _)| t.abs_diff(time_ns))
        .filter(|(t, _)| t.abs_diff(time_ns) <= SAME_TIME_NS.unsigned_abs());
    if let Some((_, pose)) = same {
        return Some(*pose);
    }
    let ((t0, before), (t1, after)) = (previous?, next?);
    let span = t1.abs_diff(*t0);
    if span
        > max_gap_ns
            .saturating_mul(POSE_GAP_FACTOR)
            .unsigned_abs()
            .max(NOMINAL_PERIOD_NS.unsigned_abs())
    {
        return None;
    }
    Some(before.interpolate(after, time_ns.abs_diff(*t0) as f64 / span as f64))
}
