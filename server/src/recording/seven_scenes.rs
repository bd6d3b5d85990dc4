//! Microsoft 7-Scenes (Shotton et al. 2013): `frame-000000.color.png` (or `.jpg`), `.depth.png` in millimetres and
//! `.pose.txt`, a 4x4 world-from-camera matrix; sequences are in folders `seq-01`, ..., the intrinsics may be one
//! level up.
//!
//! The data set was recorded with a Kinect v1 without registration: its 585-pixel intrinsics and its poses belong to
//! the *depth* camera, and colour is from another camera beside it. Depth is therefore warped into colour, and poses
//! are converted to the colour camera.

use std::collections::HashMap;

use glam::{DQuat, DVec3};

use crate::camera::Pose;

use super::camera_file::find_camera_file;
use super::error::{Place, RecordingError};
use super::layout::Layout;
use super::left_out::LeftOut;
use super::location::Location;
use super::rig::{CameraModel, DepthRays, Rig};
use super::text::{MatrixPose, TextFile, pose_from_matrix};
use super::{Entry, Listing, NOMINAL_PERIOD_NS, OpenOptions};

pub(super) const LAYOUT: Layout = Layout {
    name: "7-Scenes",
    looked_for: "frame-000000.depth.png or folders seq-01",
    list,
};

const UNITS_PER_METRE: f64 = 1000.0;

/// The data set's nominal depth camera.
const KINECT_DEPTH: [f64; 4] = [585.0, 585.0, 320.0, 240.0];

/// Intrinsics within this relative difference of the nominal ones mean the unregistered Kinect: a registered
/// recording of another tool in this layout has those of the colour camera (525 pixels, 10 % less).
const KINECT_FOCAL_TOLERANCE: f64 = 0.02;

/// The colour camera of a Kinect v1, measured on the data set's own pictures: fx, fy, cx, cy and the baseline along x
/// were fitted so that depth jumps coincide with colour edges (225,000 jumps of 60 RedKitchen frames), and rounded.
/// Fits to all frames, to even and to odd frames, at two blur widths and from either sign of the baseline, give 526.4
/// to 527.6, 528.9 to 530.2, 320.6 to 322.0, 238.8 to 238.9 and -24.8 to -29.5 mm; this is near the nominal 525
/// pixels and 25 mm. The other two baselines and distortion were not fitted. With them free the score at the narrow
/// blur gains 1 %, but at the wide one two of the fits diverged to baselines that no Kinect has (50 mm down, 58 mm
/// forward) with 8 to 11 % more. One scene, one sensor: another Kinect may differ.
const KINECT_COLOR: [f64; 4] = [527.0, 529.5, 321.3, 238.8];

/// Position of the depth camera in the colour camera's axes, metres; see [`KINECT_COLOR`]. The rotation between the
/// two is too small to be distinguished from the principal point.
const KINECT_BASELINE_M: [f64; 3] = [-0.027, 0.0, 0.0];

/// The names of a frame's files, and its number.
struct Names {
    number: u64,
    depth: String,
    color: Option<String>,
    pose: Option<String>,
}

fn list(root: &Location, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    let mut notes = Vec::new();
    let Some((dir, names)) = find_frames(root, &mut notes)? else {
        return Ok(None);
    };
    let rig = rig(&dir, options, &mut notes)?;
    let color_from_depth = match &rig.depth {
        DepthRays::Own {
            color_from_depth, ..
        } => *color_from_depth,
        DepthRays::Registered => Pose::IDENTITY,
    };
    let depth_from_color = color_from_depth.inverse();
    let first = names.first().map_or(0, |n| n.number);
    let mut entries = Vec::with_capacity(names.len());
    let mut pose_deviation = 0.0f64;
    let (mut without_color, mut without_pose, mut lost) = (0, 0, LeftOut::default());
    // The camera is at rest only if no frame has a pose: among frames with poses, a missing one is lost.
    let at_rest = options.assume_static && names.iter().all(|frame| frame.pose.is_none());
    for frame in &names {
        let Some(color) = &frame.color else {
            without_color += 1;
            continue;
        };
        let pose = match &frame.pose {
            None if at_rest => Pose::IDENTITY,
            None => {
                without_pose += 1;
                continue;
            }
            Some(name) => match TextFile::read(&dir.join(name)).and_then(|f| parse_pose(&f)) {
                Ok(MatrixPose { pose, deviation }) => {
                    pose_deviation = pose_deviation.max(deviation);
                    pose
                }
                Err(error) => {
                    lost.add(name, error);
                    continue;
                }
            },
        };
        let steps = i64::try_from(frame.number - first).unwrap_or(i64::MAX);
        entries.push(Entry {
            color: dir.join(color),
            depth: dir.join(&frame.depth),
            confidence: None,
            time_ns: steps.saturating_mul(NOMINAL_PERIOD_NS),
            depth_lag_ns: 0,
            pose: pose.then(&depth_from_color),
            focal: None,
        });
    }
    if without_color > 0 {
        notes.push(format!(
            "{without_color} depth frames have no colour and are left out."
        ));
    }
    if without_pose == names.len() - without_color && without_pose > 0 {
        return Err(RecordingError::NoPoses {
            path: dir.path().to_owned(),
            looked_for: "frame-*.pose.txt".to_owned(),
        });
    }
    if without_pose > 0 {
        notes.push(format!(
            "{without_pose} frames have no pose file and are left out."
        ));
    }
    lost.note(
        names.len(),
        "frames have lost their pose and are left out",
        &mut notes,
    );
    Ok(Some(Listing {
        layout: LAYOUT.name,
        entries,
        rig,
        depth_units_per_metre: UNITS_PER_METRE,
        stamped: false,
        poses_of_depth: true,
        pose_deviation: Some(pose_deviation),
        notes,
    }))
}

/// The frames of a folder, or of its first sequence.
fn find_frames(
    root: &Location,
    notes: &mut Vec<String>,
) -> Result<Option<(Location, Vec<Names>)>, RecordingError> {
    let names = frames_in(root)?;
    if !names.is_empty() {
        return Ok(Some((root.clone(), names)));
    }
    let is_sequence = |name: &String| {
        name.strip_prefix("seq-")
            .is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
    };
    let sequences: Vec<_> = root
        .folder_names()?
        .into_iter()
        .filter(is_sequence)
        .collect();
    let Some(first) = sequences.first() else {
        return Ok(None);
    };
    if sequences.len() > 1 {
        notes.push(format!(
            "{} sequences here ({}): reading {first}; give its folder to read another.",
            sequences.len(),
            sequences.join(", ")
        ));
    }
    let dir = root.join(first);
    let names = frames_in(&dir)?;
    Ok(Some((dir, names)))
}

fn frames_in(dir: &Location) -> Result<Vec<Names>, RecordingError> {
    let files = dir.file_names()?;
    // Names are compared without regard to case: cameras and Windows write `.JPG`.
    let by_lower: HashMap<String, &String> = files
        .iter()
        .map(|name| (name.to_ascii_lowercase(), name))
        .collect();
    let find = |name: String| by_lower.get(&name).map(|name| (*name).clone());
    let mut frames: Vec<Names> = by_lower
        .iter()
        .filter_map(|(lower, file)| {
            let stem = lower.strip_suffix(".depth.png")?;
            let digits = stem.strip_prefix("frame-")?;
            let number = digits
                .bytes()
                .all(|b| b.is_ascii_digit())
                .then(|| digits.parse().ok())??;
            Some(Names {
                number,
                depth: (*file).clone(),
                color: ["jpg", "png", "jpeg"]
                    .into_iter()
                    .find_map(|end| find(format!("{stem}.color.{end}"))),
                pose: find(format!("{stem}.pose.txt")),
            })
        })
        .collect();
    frames.sort_by_key(|frame| frame.number);
    Ok(frames)
}

fn rig(
    dir: &Location,
    options: &OpenOptions,
    notes: &mut Vec<String>,
) -> Result<Rig, RecordingError> {
    const FILE: [&str; 1] = ["camera-intrinsics.txt"];
    let mut found = find_camera_file(dir, &FILE)?;
    // A folder of sequences has one calibration for all of them.
    if found.is_none()
        && let Some(parent) = dir.absolute().parent()
        && parent.join(FILE[0]).is_file()
    {
        found = find_camera_file(&parent, &FILE)?;
    }
    if let Some(file) = &found {
        notes.extend(file.notes.iter().cloned());
    }
    let given = options
        .intrinsics
        .map(|focal| CameraModel::given(focal, dir))
        .transpose()?;
    let depth = match found {
        Some(file) if !is_kinect(&file.camera) => {
            let color = given.unwrap_or(file.camera);
            return Ok(Rig {
                color,
                depth: DepthRays::Registered,
            });
        }
        Some(file) => file.camera,
        None => {
            notes.push("No camera-intrinsics.txt: taking 7-Scenes' Kinect v1 depth camera (fx 585 fy 585 cx 320 cy 240).".to_owned());
            CameraModel::default_vga(KINECT_DEPTH, "Kinect v1 depth camera")
        }
    };
    let [fx, fy, cx, cy] = KINECT_COLOR;
    let [bx, by, bz] = KINECT_BASELINE_M.map(|m| m * 1e3);
    notes.push(match &given {
        None => format!(
            "Depth is not registered here: warping it into a Kinect v1 colour camera (fx {fx} fy {fy} cx {cx} cy {cy}, depth camera at {bx:.1} {by:.1} {bz:.1} mm from it)."
        ),
        Some(_) => format!(
            "Depth is not registered here: warping it into the given colour camera, depth camera at {bx:.1} {by:.1} {bz:.1} mm from it (Kinect v1)."
        ),
    });
    Ok(Rig {
        color: given
            .unwrap_or_else(|| CameraModel::default_vga(KINECT_COLOR, "Kinect v1 colour camera")),
        depth: DepthRays::Own {
            camera: depth,
            color_from_depth: kinect_color_from_depth(),
        },
    })
}

fn kinect_color_from_depth() -> Pose {
    Pose {
        rotation: DQuat::IDENTITY,
        translation: DVec3::from_array(KINECT_BASELINE_M),
    }
}

fn is_kinect(camera: &CameraModel) -> bool {
    let near = |a: f64, b: f64| (a / b - 1.0).abs() <= KINECT_FOCAL_TOLERANCE;
    near(camera.focal[0], KINECT_DEPTH[0]) && near(camera.focal[1], KINECT_DEPTH[1])
}

/// A matrix of four lines with four numbers each.
pub(super) fn parse_pose(file: &TextFile) -> Result<MatrixPose, RecordingError> {
    let place = Place::file(file.path());
    let lines = file.lines().take(5).collect::<Result<Vec<_>, _>>()?;
    let last = [0.0, 0.0, 0.0, 1.0];
    let rows = match lines.as_slice() {
        [a, b, c, d] => [
            a.numbers("pose row 1")?,
            b.numbers("pose row 2")?,
            c.numbers("pose row 3")?,
            d.numbers("pose row 4")?,
        ],
        // Without the constant last row.
        [a, b, c] => [
            a.numbers("pose row 1")?,
            b.numbers("pose row 2")?,
            c.numbers("pose row 3")?,
            last,
        ],
        // All numbers in one line.
        [one] if one.words.len() == 16 => {
            let m: [f64; 16] = one.numbers("pose")?;
            [0, 4, 8, 12].map(|at| [m[at], m[at + 1], m[at + 2], m[at + 3]])
        }
        lines => {
            let got = format!("{} lines", lines.len());
            return Err(place.field("pose", "4 lines of 4 numbers", got));
        }
    };
    pose_from_matrix(&rows, &place)
}
