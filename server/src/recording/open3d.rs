//! The Open3D reconstruction system and the Redwood data sets (Choi, Zhou, Koltun 2015): pictures in `color/` (or
//! `image/`, `rgb/`) and `depth/`, a trajectory `.log` (per frame a line of three integers and a 4x4
//! world-from-camera matrix), a camera JSON. Depth is registered, 1000 units per metre. The same folders without a
//! trajectory are recordings without poses.

use std::collections::HashMap;

use crate::camera::Pose;

use super::camera_file::{CameraFile, find_camera_file};
use super::error::{Place, RecordingError};
use super::excerpt::quote;
use super::layout::Layout;
use super::left_out::{LeftOut, name_of};
use super::location::Location;
use super::numbers::{Rule, keys, matched, natural_order};
use super::pictures::{COLOR, DEPTH};
use super::rig::{CameraModel, DepthRays, Rig};
use super::text::{Line, MatrixPose, TextFile, has_extension, pose_from_matrix};
use super::{Entry, Listing, NOMINAL_PERIOD_NS, OpenOptions};

pub(super) const LAYOUT: Layout = Layout {
    name: "Open3D",
    looked_for: "color/, image/ or rgb/ with depth/",
    list,
};

/// Name of [`LAYOUT`] for recordings without a trajectory.
pub(super) const WITHOUT_POSES: &str = "RGB-D without poses";

const UNITS_PER_METRE: f64 = 1000.0;
const COLOR_FOLDERS: [&str; 3] = ["color", "image", "rgb"];
/// The reconstruction system writes to `scene/`.
const TRAJECTORIES: [&str; 2] = ["trajectory.log", "scene/trajectory.log"];
/// Open3D's `PinholeCameraIntrinsicParameters::PrimeSenseDefault`.
const PRIMESENSE: [f64; 4] = [525.0, 525.0, 319.5, 239.5];

/// Pictures of a folder, in order.
#[derive(Debug)]
pub(super) struct Pictures {
    pub(super) paths: Vec<Location>,
    /// The numbers that distinguish their names, if there are any.
    pub(super) keys: Option<Vec<Vec<u64>>>,
}

fn list(root: &Location, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    let folder = COLOR_FOLDERS
        .iter()
        .map(|name| root.join(name))
        .find(|dir| dir.is_dir());
    let (Some(color_dir), true) = (folder, root.join("depth").is_dir()) else {
        return Ok(None);
    };
    let mut notes = Vec::new();
    let (camera, depth_units_per_metre) = camera(root, options, &mut notes)?;
    let color = pictures(&color_dir, &COLOR)?;
    let depth = pictures(&root.join("depth"), &DEPTH)?;
    let pairs = pair(&color, &depth, root, &mut notes)?;
    let poses = match find_trajectory(root)? {
        Some(path) => {
            let (poses, stray) = parse_log(&TextFile::read(&path)?);
            let what = "lines of the trajectory belong to no entry and are left out";
            stray.note(5 * poses.len() + stray.count(), what, &mut notes);
            Some((poses, path))
        }
        None if options.assume_static => {
            notes.push("No trajectory: the camera is taken to be at rest.".to_owned());
            None
        }
        None => {
            return Err(RecordingError::NoPoses {
                path: root.path().to_owned(),
                looked_for: format!(
                    "{} or another .log, groundtruth.txt with rgb.txt and depth.txt",
                    TRAJECTORIES.join(", ")
                ),
            });
        }
    };
    let matched = poses
        .as_ref()
        .map(|(poses, path)| match_poses(&color, &pairs, poses, path, &mut notes));
    let mut entries = Vec::with_capacity(pairs.len());
    let (mut without_pose, mut lost) = (0, LeftOut::default());
    let mut pose_deviation = 0.0f64;
    for (i, &(c, d)) in pairs.iter().enumerate() {
        let entry = match (&poses, &matched) {
            (Some((poses, _)), Some(matched)) => match matched[i] {
                Some(place) => Some(&poses[place]),
                None => {
                    without_pose += 1;
                    continue;
                }
            },
            _ => None,
        };
        let pose = match entry.map(|entry| &entry.pose) {
            None => Pose::IDENTITY,
            Some(Ok(matrix)) => {
                pose_deviation = pose_deviation.max(matrix.deviation);
                matrix.pose
            }
            Some(Err(error)) => {
                lost.add(name_of(&color.paths[c]), error);
                continue;
            }
        };
        entries.push(Entry {
            color: color.paths[c].clone(),
            depth: depth.paths[d].clone(),
            confidence: None,
            time_ns: (c as i64).saturating_mul(NOMINAL_PERIOD_NS),
            depth_lag_ns: 0,
            pose,
            focal: None,
        });
    }
    lost.note(
        pairs.len(),
        "frames have lost their pose and are left out",
        &mut notes,
    );
    if without_pose > 0 {
        notes.push(format!(
            "{without_pose} frames have no pose in the trajectory and are left out."
        ));
    }
    Ok(Some(Listing {
        layout: if poses.is_some() {
            LAYOUT.name
        } else {
            WITHOUT_POSES
        },
        entries,
        rig: Rig {
            color: camera,
            depth: DepthRays::Registered,
        },
        depth_units_per_metre: depth_units_per_metre.unwrap_or(UNITS_PER_METRE),
        stamped: false,
        poses_of_depth: false,
        pose_deviation: poses.is_some().then_some(pose_deviation),
        notes,
    }))
}

/// The trajectory entry of each pair of pictures: by number if both sides have numbers, else by order. A note always
/// names the rule, because nothing else would reveal a wrong match.
fn match_poses(
    color: &Pictures,
    pairs: &[(usize, usize)],
    poses: &[LogEntry],
    path: &Location,
    notes: &mut Vec<String>,
) -> Vec<Option<usize>> {
    let log = name_of(path);
    let numbers: Option<Vec<Vec<u64>>> = poses
        .iter()
        .map(|entry| Some(vec![entry.number?]))
        .collect();
    // Numbers that do not ascend are ignored; some tools write zeros.
    let numbers = numbers.filter(|numbers| numbers.is_sorted_by(|a, b| a < b));
    // Entries belong to colour pictures, even those without depth, unless there are as many entries as pairs.
    let pictures: Vec<usize> = if poses.len() == pairs.len() {
        pairs.iter().map(|&(c, _)| c).collect()
    } else {
        (0..color.paths.len()).collect()
    };
    let n = [pictures.len(), poses.len()];
    let counted: Option<Vec<Vec<u64>>> = color
        .keys
        .as_ref()
        .filter(|keys| keys.iter().all(|key| key.len() == 1))
        .map(|keys| pictures.iter().map(|&c| keys[c].clone()).collect());
    let entry_of: HashMap<usize, usize> = match matched(counted.as_deref(), numbers.as_deref(), n) {
        Some((matched, rule)) => {
            notes.push(format!(
                "Pictures take their poses from {log} {}.",
                rule.name()
            ));
            let found = pictures.iter().zip(matched);
            found.filter_map(|(&c, entry)| Some((c, entry?))).collect()
        }
        // By order, as far as both lists go, as in Open3D.
        None => {
            notes.push(format!(
                "Warning: pictures take their poses from {log} by order, but it has {} entries for {} pictures: poses may be of other frames.",
                n[1], n[0]
            ));
            pictures.iter().copied().zip(0..n[1]).collect()
        }
    };
    pairs
        .iter()
        .map(|(c, _)| entry_of.get(c).copied())
        .collect()
}

/// The colour camera, and depth units per metre if the camera file has them.
fn camera(
    root: &Location,
    options: &OpenOptions,
    notes: &mut Vec<String>,
) -> Result<(CameraModel, Option<f64>), RecordingError> {
    let found = find_camera_file(root, &[]);
    if let Some(focal) = options.intrinsics {
        // Given intrinsics replace those of the file, even if the file cannot be read.
        let units = found.ok().flatten().and_then(|f| f.depth_units_per_metre);
        return Ok((CameraModel::given(focal, root)?, units));
    }
    if let Some(found) = found? {
        let CameraFile {
            camera,
            depth_units_per_metre,
            notes: of_file,
        } = found;
        notes.extend(of_file);
        return Ok((camera, depth_units_per_metre));
    }
    let [fx, fy, cx, cy] = PRIMESENSE;
    notes.push(format!(
        "No camera JSON in the folder: taking fx {fx} fy {fy} cx {cx} cy {cy} (Open3D's PrimeSense default)."
    ));
    let camera = CameraModel::default_vga(PRIMESENSE, "Open3D's PrimeSense camera");
    Ok((camera, None))
}

/// Pictures of a folder by their number, else in natural order.
pub(super) fn pictures(dir: &Location, extensions: &[&str]) -> Result<Pictures, RecordingError> {
    let mut names: Vec<String> = dir
        .file_names()?
        .into_iter()
        .filter(|name| has_extension(name, extensions))
        .collect();
    names.sort_by(|a, b| natural_order(a, b));
    let as_text: Vec<&str> = names.iter().map(String::as_str).collect();
    let keys = keys(&as_text);
    let paths = names.iter().map(|name| dir.join(name));
    let Some(keys) = keys else {
        return Ok(Pictures {
            paths: paths.collect(),
            keys: None,
        });
    };
    let mut list: Vec<(Vec<u64>, Location)> = keys.into_iter().zip(paths).collect();
    list.sort_by(|(a, _), (b, _)| a.cmp(b));
    let (keys, paths) = list.into_iter().unzip();
    Ok(Pictures {
        paths,
        keys: Some(keys),
    })
}

/// Pairs colour and depth by the number in their names or, if the numbers cannot be matched (different time stamps),
/// by order.
pub(super) fn pair(
    color: &Pictures,
    depth: &Pictures,
    root: &Location,
    notes: &mut Vec<String>,
) -> Result<Vec<(usize, usize)>, RecordingError> {
    let n = [color.paths.len(), depth.paths.len()];
    let Some((pairs, rule)) = matched(color.keys.as_deref(), depth.keys.as_deref(), n) else {
        return Err(Place::file(root).field(
            "number of depth pictures",
            format!(
                "{} as of colour (their names do not say which belong together)",
                n[0]
            ),
            n[1].to_string(),
        ));
    };
    let pairs: Vec<_> = pairs
        .into_iter()
        .enumerate()
        .filter_map(|(c, d)| Some((c, d?)))
        .collect();
    let (c, d) = (n[0] - pairs.len(), n[1] - pairs.len());
    if c + d > 0 {
        notes.push(format!(
            "{c} colour and {d} depth pictures have no counterpart and are left out."
        ));
    }
    if rule != Rule::Number && !pairs.is_empty() {
        notes.push(format!(
            "Colour and depth are paired {}: their names do not have the same numbers.",
            rule.name()
        ));
    }
    Ok(pairs)
}

fn find_trajectory(root: &Location) -> Result<Option<Location>, RecordingError> {
    if let Some(path) = TRAJECTORIES
        .iter()
        .map(|name| root.join(name))
        .find(|p| p.is_file())
    {
        return Ok(Some(path));
    }
    let logs: Vec<_> = root
        .file_names()?
        .into_iter()
        .filter(|name| has_extension(name, &["log"]))
        .collect();
    match logs.as_slice() {
        [] => Ok(None),
        [one] => Ok(Some(root.join(one))),
        several => Err(Place::file(root).field(
            "trajectory",
            "one .log, or one of several called trajectory.log",
            several.join(", "),
        )),
    }
}

/// An entry of a trajectory; a lost pose keeps its position and number.
#[derive(Debug)]
pub(super) struct LogEntry {
    /// Its first integer, if any.
    pub(super) number: Option<u64>,
    pub(super) pose: Result<MatrixPose, RecordingError>,
}

/// Entries of a trajectory: a line of integers, of which the first is the entry's number, and four lines of a matrix.
/// Files of only matrices are supported too. Lines that belong to no entry are left out.
pub(super) fn parse_log(file: &TextFile) -> (Vec<LogEntry>, LeftOut) {
    let mut entries: Vec<LogEntry> = Vec::new();
    let mut stray = LeftOut::default();
    let mut lines = file.lines().peekable();
    let headed = match lines.peek() {
        Some(Ok(first)) => first.words.len() != 4,
        _ => true,
    };
    while let Some(first) = lines.peek() {
        let place = match first {
            Ok(line) => line.place(),
            Err(_) => Place::file(file.path()),
        };
        let mut number = None;
        if headed {
            let header = match lines.next() {
                Some(Ok(header)) => header,
                Some(Err(error)) => {
                    stray.add("one", error);
                    continue;
                }
                None => break,
            };
            number = header
                .words
                .first()
                .and_then(|word| word.parse::<f64>().ok())
                .filter(|n| n.fract() == 0.0 && (0.0..1e15).contains(n))
                .map(|n| n as u64);
            if header.words.len() == 4 {
                // A matrix row without a header: its entry is unknown.
                let reason = format!("a row without its entry, {}", quote(header.text));
                stray.add(format!("line {}", header.number), reason);
                while lines.next_if(is_row).is_some() {}
                continue;
            }
        }
        let mut rows = Vec::with_capacity(4);
        while rows.len() < 4
            && let Some(line) = lines.next_if(is_row)
        {
            let field = format!("pose row {}", rows.len() + 1);
            rows.push(line.and_then(|line| line.numbers(&field)));
        }
        if rows.is_empty() && !headed {
            // Neither a row nor a header: skipped.
            match lines.next() {
                Some(Ok(line)) => stray.add(format!("line {}", line.number), quote(line.text)),
                Some(Err(error)) => stray.add("one", error),
                None => {}
            }
            continue;
        }
        let cut = entries.last().is_some_and(|entry| entry.pose.is_err());
        if rows.is_empty() && cut && lines.peek().is_none() {
            // The incomplete row of a file that was cut, not an entry.
            break;
        }
        let n_rows = rows.len();
        let pose = rows
            .into_iter()
            .collect::<Result<Vec<[f64; 4]>, _>>()
            .and_then(|rows| match rows.as_slice() {
                [a, b, c, d] => pose_from_matrix(&[*a, *b, *c, *d], &place),
                _ => {
                    let got = format!("{n_rows} rows");
                    Err(place.field("pose", "4 rows of 4 numbers", got))
                }
            });
        entries.push(LogEntry { number, pose });
    }
    (entries, stray)
}

/// Whether a line can be a matrix row. Unreadable lines are treated as headers.
fn is_row(line: &Result<Line<'_>, RecordingError>) -> bool {
    line.as_ref().is_ok_and(|line| line.words.len() == 4)
}
