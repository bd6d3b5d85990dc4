//! TUM RGB-D benchmark (Sturm et al. 2012): `rgb.txt` and `depth.txt` list `timestamp file`, `groundtruth.txt` lists
//! `timestamp tx ty tz qx qy qz qw`, world from camera. Depth is registered, 5000 units per metre. If the two lists
//! are missing, a list of associations (`timestamp rgb timestamp depth`) is used.
//!
//! Each colour frame uses the depth frame nearest in time (each depth frame belongs to only one colour frame) and the
//! pose interpolated to its own time.

use crate::camera::Pose;

use super::camera_file::find_camera_file;
use super::error::RecordingError;
use super::layout::Layout;
use super::location::Location;
use super::rig::{CameraModel, DepthRays, Rig};
use super::text::TextFile;
use super::tum_lists::{Finder, Stamped, has_poses, parse_associations, parse_list, parse_poses};
use super::{Entry, Listing, NOMINAL_PERIOD_NS, OpenOptions};

pub(super) const LAYOUT: Layout = Layout {
    name: "TUM RGB-D",
    looked_for: "rgb.txt with depth.txt, or associations.txt",
    list,
};

const UNITS_PER_METRE: f64 = 5000.0;

/// Poses are interpolated over gaps up to this many times the largest colour-depth gap.
const POSE_GAP_FACTOR: i64 = 5;

/// A pose within this time counts as the frame's own, without interpolation: stamps are printed with six digits.
const SAME_TIME_NS: i64 = 1_000;

/// The calibrations of the benchmark and of Bonn's dynamic data set, selected by the folder's name.
const CALIBRATIONS: [(&str, [f64; 4]); 4] = [
    ("freiburg1", [517.3, 516.5, 318.6, 255.3]),
    ("freiburg2", [520.9, 521.0, 325.1, 249.7]),
    ("freiburg3", [535.4, 539.2, 320.1, 247.6]),
    (
        "rgbd_bonn",
        [542.822_841, 542.576_870, 315.593_520, 237.756_098],
    ),
];

/// The benchmark's recommendation if nothing else is known.
const ROS_DEFAULT: [f64; 4] = [525.0, 525.0, 319.5, 239.5];

/// Names of pose files in the benchmark's format, in order of preference; any case.
const POSE_FILES: [&str; 9] = [
    "groundtruth.txt",
    "gt.txt",
    "trajectory.txt",
    "traj.txt",
    "poses.txt",
    "pose.txt",
    "cameratrajectory.txt",
    "keyframetrajectory.txt",
    "estimated_trajectory.txt",
];

fn list(root: &Location, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    let files = root.file_names()?;
    let mut notes = Vec::new();
    let Some(pairs) = pairs(root, &files, options, &mut notes)? else {
        return Ok(None);
    };
    let (camera, depth_units_per_metre) = camera(root, options, &mut notes)?;
    let poses_file = find_poses(root, &files);
    let poses = match &poses_file {
        Some((name, file)) => {
            let parsed = parse_poses(file);
            parsed.describe(name, &mut notes);
            if name != POSE_FILES[0] {
                notes.push(format!("No {}: poses are those of {name}.", POSE_FILES[0]));
            }
            Some(parsed.items)
        }
        None if options.assume_static => {
            notes.push("No groundtruth.txt: the camera is taken to be at rest.".to_owned());
            None
        }
        None => {
            return Err(RecordingError::NoPoses {
                path: root.path().to_owned(),
                looked_for: format!("{} (timestamp tx ty tz qx qy qz qw)", POSE_FILES.join(", ")),
            });
        }
    };
    let mut entries = Vec::with_capacity(pairs.len());
    let mut without_pose = 0;
    for [color, depth] in pairs {
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
        let name = poses_file.map_or_else(String::new, |(name, _)| name);
        notes.push(format!(
            "{without_pose} frames have no poses around them in {name} and are left out."
        ));
    }
    Ok(Some(Listing {
        layout: LAYOUT.name,
        entries,
        rig: Rig {
            color: camera,
            depth: DepthRays::Registered,
        },
        depth_units_per_metre: depth_units_per_metre.unwrap_or(UNITS_PER_METRE),
        stamped: true,
        poses_of_depth: false,
        pose_deviation: None,
        notes,
    }))
}

/// Pairs of colour and depth, sorted by colour's time: from the two lists, or from a list of associations; `None` if
/// there is neither.
fn pairs(
    root: &Location,
    files: &[String],
    options: &OpenOptions,
    notes: &mut Vec<String>,
) -> Result<Option<Vec<[Stamped; 2]>>, RecordingError> {
    let mut finder = Finder::default();
    let named = |wanted: &str| files.iter().find(|name| name.eq_ignore_ascii_case(wanted));
    let mut listed = |name: &String, notes: &mut Vec<String>| {
        let parsed = parse_list(&TextFile::read(&root.join(name))?);
        parsed.describe(name, notes);
        Ok::<_, RecordingError>(present(root, parsed.items, name, &mut finder, notes))
    };
    if let (Some(rgb_txt), Some(depth_txt)) = (named("rgb.txt"), named("depth.txt")) {
        let color = listed(rgb_txt, notes)?;
        let depth = listed(depth_txt, notes)?;
        let pairs = associate(&color, &depth, options.max_time_gap_ns);
        let unpaired = color.len() - pairs.len();
        if unpaired > 0 {
            notes.push(format!(
                "{unpaired} of {} colour frames have no depth frame within {:.0} ms and are left out.",
                color.len(),
                options.max_time_gap_ns as f64 * 1e-6
            ));
        }
        let pair = |(c, d): (usize, usize)| [color[c].clone(), depth[d].clone()];
        return Ok(Some(pairs.into_iter().map(pair).collect()));
    }
    let is_association = |name: &&String| {
        let lower = name.to_ascii_lowercase();
        lower.ends_with(".txt") && lower.contains("assoc")
    };
    let associations: Vec<&String> = files.iter().filter(is_association).collect();
    let Some(name) = associations.first() else {
        return Ok(None);
    };
    let (parsed, named) = parse_associations(&TextFile::read(&root.join(name))?);
    parsed.describe(name, notes);
    notes.push(format!("Colour and depth are paired as {name} says."));
    if associations.len() > 1 {
        let names: Vec<&str> = associations.iter().map(|name| name.as_str()).collect();
        notes.push(format!("The first of {} is read.", names.join(", ")));
    }
    if !named && !parsed.items.is_empty() {
        notes.push(format!(
            "Names in {name} do not say which picture is depth: the first is read as colour."
        ));
    }
    let n = parsed.items.len();
    let pairs: Vec<[Stamped; 2]> = parsed
        .items
        .into_iter()
        .filter_map(|[color, depth]| {
            let mut there = |picture: Stamped| {
                let file = finder.find(root, &picture.file)?;
                Some(Stamped { file, ..picture })
            };
            Some([there(color)?, there(depth)?])
        })
        .collect();
    if pairs.len() < n {
        let missing = n - pairs.len();
        notes.push(format!(
            "{missing} of {n} pairs listed in {name} have files that are missing and are left out."
        ));
    }
    Ok(Some(pairs))
}

/// The pose file and its name. Files with these names but poses in other formats are skipped.
fn find_poses(root: &Location, files: &[String]) -> Option<(String, TextFile)> {
    let mut named = POSE_FILES.iter().filter_map(|wanted| {
        let name = files
            .iter()
            .find(|name| name.eq_ignore_ascii_case(wanted))?;
        Some((*wanted, name))
    });
    named.find_map(|(wanted, name)| {
        let file = TextFile::read(&root.join(name)).ok()?;
        // The benchmark's own file name always counts as poses, even if all are lost or the file is cut.
        (wanted == POSE_FILES[0] || has_poses(&file)).then(|| (name.clone(), file))
    })
}

/// The colour camera, and depth units per metre if the camera file has them.
fn camera(
    root: &Location,
    options: &OpenOptions,
    notes: &mut Vec<String>,
) -> Result<(CameraModel, Option<f64>), RecordingError> {
    let found = find_camera_file(root, &["manifest.json"]);
    if let Some(focal) = options.intrinsics {
        // Given intrinsics replace those of the file, even if the file cannot be read.
        let units = found.ok().flatten().and_then(|f| f.depth_units_per_metre);
        return Ok((CameraModel::given(focal, root)?, units));
    }
    if let Some(found) = found? {
        notes.extend(found.notes);
        return Ok((found.camera, found.depth_units_per_metre));
    }
    // A relative path such as "." has no name of its own.
    let name = root.absolute().file_name();
    let known = CALIBRATIONS.iter().find(|(part, _)| name.contains(part));
    let (origin, focal) = match known {
        Some((part, focal)) => (format!("{part} calibration, by the folder's name"), *focal),
        None => ("ROS default of the TUM benchmark".to_owned(), ROS_DEFAULT),
    };
    let [fx, fy, cx, cy] = focal;
    notes.push(format!(
        "No intrinsics in the folder: taking fx {fx} fy {fy} cx {cx} cy {cy} ({origin})."
    ));
    Ok((CameraModel::default_vga(focal, &origin), None))
}

/// Leaves out, and counts, listed files that do not exist.
fn present(
    root: &Location,
    list: Vec<Stamped>,
    name: &str,
    finder: &mut Finder,
    notes: &mut Vec<String>,
) -> Vec<Stamped> {
    let listed = list.len();
    let there = |picture: Stamped| {
        let file = finder.find(root, &picture.file)?;
        Some(Stamped { file, ..picture })
    };
    let list: Vec<_> = list.into_iter().filter_map(there).collect();
    if list.len() < listed {
        let missing = listed - list.len();
        notes.push(format!(
            "{missing} of {listed} files listed in {name} are missing and left out."
        ));
    }
    list
}

/// Pairs (colour, depth) nearest in time within `max_gap_ns`; both lists are sorted by time. A depth frame goes to
/// the nearest of the colour frames for which it is the nearest, the earlier one on a tie.
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

/// The pose at a time: an exact match, or interpolated between its neighbours if these are close enough.
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
