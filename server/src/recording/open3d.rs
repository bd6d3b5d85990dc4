//! Open3D reconstruction system and the Redwood data sets (Choi, Zhou, Koltun 2015): pictures in
//! `color/` (or `image/`, `rgb/`) and `depth/`, a trajectory `.log` (per frame a line of
//! three integers and a 4x4 world from camera), a camera JSON. Depth is registered, 1000 units
//! per metre. The same folders without a trajectory are recordings without poses.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::camera::Pose;

use super::error::{Place, RecordingError};
use super::rig::{CameraFile, CameraModel, DepthRays, Rig, find_camera_file};
use super::text::{MatrixPose, TextFile, file_names, pose_from_matrix, quote};
use super::{Entry, Layout, Listing, NOMINAL_PERIOD_NS, OpenOptions};

pub(super) const LOOKED_FOR: &str = "color/, image/ or rgb/ with depth/ (Open3D)";

const UNITS_PER_METRE: f64 = 1000.0;
const COLOR_FOLDERS: [&str; 3] = ["color", "image", "rgb"];
const CAMERA_FILES: [&str; 7] = [
    "camera.json",
    "intrinsic.json",
    "intrinsics.json",
    "camera_intrinsic.json",
    "camera_intrinsics.json",
    "camera_primesense.json",
    "intrinsics.txt",
];
/// The reconstruction system writes into `scene/`.
const TRAJECTORIES: [&str; 2] = ["trajectory.log", "scene/trajectory.log"];
/// Open3D's `PinholeCameraIntrinsicParameters::PrimeSenseDefault`.
const PRIMESENSE: [f64; 4] = [525.0, 525.0, 319.5, 239.5];

/// A picture and the number in its name.
#[derive(Debug, Clone)]
struct Picture {
    number: Option<u64>,
    path: PathBuf,
}

pub(super) fn list(root: &Path, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    let folder = COLOR_FOLDERS
        .iter()
        .map(|name| root.join(name))
        .find(|dir| dir.is_dir());
    let (Some(color_dir), true) = (folder, root.join("depth").is_dir()) else {
        return Ok(None);
    };
    let mut notes = Vec::new();
    let CameraFile {
        camera,
        depth_units_per_metre,
    } = camera(root, options, &mut notes)?;
    let color = pictures(&color_dir, &["jpg", "jpeg", "png"])?;
    let depth = pictures(&root.join("depth"), &["png"])?;
    let pairs = pair(&color, &depth, root, &mut notes)?;
    let poses = match find_trajectory(root)? {
        Some(path) => Some(parse_log(&TextFile::read(&path)?)?),
        None if options.assume_static => {
            notes.push("No trajectory: the camera is taken to be at rest.".to_owned());
            None
        }
        None => {
            return Err(RecordingError::NoPoses {
                path: root.to_owned(),
                looked_for: format!(
                    "{} or another .log, groundtruth.txt with rgb.txt and depth.txt",
                    TRAJECTORIES.join(", ")
                ),
            });
        }
    };
    let mut entries = Vec::with_capacity(pairs.len());
    let (mut without_pose, mut pose_deviation) = (0, 0.0f64);
    for (c, d) in pairs {
        let pose = match &poses {
            None => Pose::IDENTITY,
            Some(poses) => match poses.get(&(c as u64)) {
                Some(matrix) => {
                    pose_deviation = pose_deviation.max(matrix.deviation);
                    matrix.pose
                }
                None => {
                    without_pose += 1;
                    continue;
                }
            },
        };
        entries.push(Entry {
            color: color[c].path.clone(),
            depth: depth[d].path.clone(),
            confidence: None,
            time_ns: (c as i64).saturating_mul(NOMINAL_PERIOD_NS),
            depth_lag_ns: 0,
            pose,
            focal: None,
        });
    }
    if without_pose > 0 {
        notes.push(format!(
            "{without_pose} frames have no pose in the trajectory and are left out."
        ));
    }
    Ok(Some(Listing {
        layout: if poses.is_some() {
            Layout::Open3d
        } else {
            Layout::NoPoses
        },
        entries,
        rig: Rig {
            color: camera,
            depth: DepthRays::Registered,
        },
        depth_units_per_metre: depth_units_per_metre.unwrap_or(UNITS_PER_METRE),
        stamped: false,
        pose_deviation: poses.is_some().then_some(pose_deviation),
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
    let [fx, fy, cx, cy] = PRIMESENSE;
    notes.push(format!(
        "No camera JSON in the folder: taking fx {fx} fy {fy} cx {cx} cy {cy} (Open3D's PrimeSense default)."
    ));
    Ok(CameraFile {
        camera: CameraModel::default_vga(PRIMESENSE, "Open3D's PrimeSense camera"),
        depth_units_per_metre: None,
    })
}

/// Pictures of a folder by the first number in their names, then by name, as Open3D orders them.
fn pictures(dir: &Path, extensions: &[&str]) -> Result<Vec<Picture>, RecordingError> {
    let mut list: Vec<(u64, String)> = file_names(dir)?
        .into_iter()
        .filter(|name| {
            let extension = name.rsplit_once('.').map(|(_, e)| e.to_ascii_lowercase());
            extension.is_some_and(|e| extensions.contains(&e.as_str()))
        })
        .map(|name| (first_number(&name).unwrap_or(u64::MAX), name))
        .collect();
    list.sort();
    let picture = |(_, name): (u64, String)| Picture {
        number: first_number(&name),
        path: dir.join(name),
    };
    Ok(list.into_iter().map(picture).collect())
}

fn first_number(name: &str) -> Option<u64> {
    let start = name.find(|c: char| c.is_ascii_digit())?;
    let digits = &name[start..];
    let end = digits
        .find(|c: char| !c.is_ascii_digit())
        .unwrap_or(digits.len());
    digits[..end].parse().ok()
}

/// Colour and depth belong together by the number in their names; if numbers say nothing (time
/// stamps that differ), by their order.
fn pair(
    color: &[Picture],
    depth: &[Picture],
    root: &Path,
    notes: &mut Vec<String>,
) -> Result<Vec<(usize, usize)>, RecordingError> {
    let numbered = |list: &[Picture]| {
        let map: HashMap<u64, usize> = list
            .iter()
            .enumerate()
            .filter_map(|(i, p)| Some((p.number?, i)))
            .collect();
        (map.len() == list.len()).then_some(map)
    };
    if let (Some(_), Some(depths)) = (numbered(color), numbered(depth)) {
        let pairs: Vec<_> = color
            .iter()
            .enumerate()
            .filter_map(|(c, picture)| Some((c, *depths.get(&picture.number?)?)))
            .collect();
        if !pairs.is_empty() {
            let (c, d) = (color.len() - pairs.len(), depth.len() - pairs.len());
            if c + d > 0 {
                notes.push(format!(
                    "{c} colour and {d} depth pictures have no counterpart and are left out."
                ));
            }
            return Ok(pairs);
        }
    }
    if color.len() != depth.len() {
        return Err(Place::file(root).field(
            "number of depth pictures",
            format!(
                "{} as of colour (their names do not say which belong together)",
                color.len()
            ),
            depth.len().to_string(),
        ));
    }
    if !color.is_empty() {
        notes.push("Colour and depth are paired by their order: their names do not say which belong together.".to_owned());
    }
    Ok((0..color.len()).map(|i| (i, i)).collect())
}

fn find_trajectory(root: &Path) -> Result<Option<PathBuf>, RecordingError> {
    if let Some(path) = TRAJECTORIES
        .iter()
        .map(|name| root.join(name))
        .find(|p| p.is_file())
    {
        return Ok(Some(path));
    }
    let logs: Vec<_> = file_names(root)?
        .into_iter()
        .filter(|name| name.ends_with(".log"))
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

/// Poses by the number of their frame. Entries number themselves by their first integer; if
/// these do not ascend, the order counts.
pub(super) fn parse_log(file: &TextFile) -> Result<HashMap<u64, MatrixPose>, RecordingError> {
    let mut entries: Vec<(u64, MatrixPose)> = Vec::new();
    let mut lines = file.lines();
    while let Some(header) = lines.next() {
        let header = header?;
        let word = header.word(0, "frame number")?;
        let number = word.parse().map_err(|_| {
            header
                .place()
                .field("frame number", "an integer >= 0", quote(word))
        })?;
        let mut rows = [[0.0; 4]; 4];
        for (i, row) in rows.iter_mut().enumerate() {
            let field = format!("pose row {}", i + 1);
            match lines.next() {
                Some(line) => *row = line?.numbers(&field)?,
                None => {
                    return Err(header
                        .place()
                        .field(field, "4 numbers", "the end of the file"));
                }
            }
        }
        entries.push((number, pose_from_matrix(&rows, &header.place())?));
    }
    let ascending = entries.is_sorted_by(|a, b| a.0 < b.0);
    let by_order = |(i, (_, pose))| (i as u64, pose);
    Ok(if ascending {
        entries.into_iter().collect()
    } else {
        entries.into_iter().enumerate().map(by_order).collect()
    })
}
