//! Raw export of the 3D Scanner App (iPhone and iPad LiDAR): `frame_00000.json` per depth frame
//! with intrinsics for the colour image and an ARKit pose, `depth_00000.png` in millimetres,
//! `conf_00000.png` (0 low, 1 medium, 2 high), and `frame_00000.jpg` for some of them.
//!
//! ARKit's camera looks along -z with y up: poses are multiplied on the right by diag(1, -1, -1, 1). Depth is
//! registered at a lower resolution.

use serde::Deserialize;
use std::collections::BTreeMap;

use super::camera_file::focal_from_matrix;
use super::error::{Place, RecordingError};
use super::layout::Layout;
use super::left_out::LeftOut;
use super::location::Location;
use super::rig::{CameraModel, DepthRays, Rig};
use super::text::{MatrixPose, TextFile, json_from_text, pose_from_matrix};
use super::times::time_ns_from_secs;
use super::{Entry, Listing, OpenOptions};

pub(super) const LAYOUT: Layout = Layout {
    name: "3D Scanner App",
    looked_for: "frame_00000.json with depth_00000.png",
    list,
};

const UNITS_PER_METRE: f64 = 1000.0;

/// The used fields of a frame's JSON.
#[derive(Deserialize)]
struct FrameJson {
    /// Seconds.
    time: f64,
    /// Row-major 3x3, for the colour image.
    intrinsics: [f64; 9],
    /// Row-major 4x4, ARKit's world from camera.
    #[serde(rename = "cameraPoseARFrame")]
    pose: [f64; 16],
}

/// A frame's JSON, checked and converted to the project's axes.
#[derive(Debug)]
pub(super) struct FrameInfo {
    pub(super) time_ns: i64,
    pub(super) focal: [f64; 4],
    pub(super) matrix: MatrixPose,
}

fn list(root: &Location, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    let files = root.file_names()?;
    // Names are compared without regard to case.
    let by_lower: BTreeMap<String, &String> = files
        .iter()
        .map(|name| (name.to_ascii_lowercase(), name))
        .collect();
    let there = |name: String| by_lower.get(&name).map(|name| root.join(name));
    let frames: Vec<(&str, &String)> = by_lower
        .iter()
        .filter_map(|(lower, name)| {
            let number = lower.strip_prefix("frame_")?.strip_suffix(".json")?;
            Some((number, *name))
        })
        .filter(|(number, _)| !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit()))
        .collect();
    if !(frames.iter()).any(|(n, _)| there(format!("depth_{n}.png")).is_some()) {
        return Ok(None);
    }
    let (mut without_color, mut without_depth, mut without_confidence) = (0, 0, 0);
    let mut entries = Vec::new();
    let mut pose_deviation = 0.0f64;
    let given = options
        .intrinsics
        .map(|focal| CameraModel::given(focal, root))
        .transpose()?;
    let mut lost = LeftOut::default();
    for (number, json) in &frames {
        let color = ["jpg", "jpeg", "png"]
            .into_iter()
            .find_map(|end| there(format!("frame_{number}.{end}")));
        let Some(depth) = there(format!("depth_{number}.png")) else {
            without_depth += 1;
            continue;
        };
        let Some(color) = color else {
            without_color += 1;
            continue;
        };
        let info = match TextFile::read(&root.join(json)).and_then(|file| parse_frame(&file)) {
            Ok(info) => info,
            Err(error) => {
                lost.add(json, error);
                continue;
            }
        };
        let confidence = there(format!("conf_{number}.png"));
        without_confidence += usize::from(confidence.is_none());
        pose_deviation = pose_deviation.max(info.matrix.deviation);
        entries.push(Entry {
            color,
            depth,
            confidence,
            time_ns: info.time_ns,
            depth_lag_ns: 0,
            pose: info.matrix.pose,
            focal: given.is_none().then_some(info.focal),
        });
    }
    entries.sort_by_key(|entry| entry.time_ns);
    let mut notes = Vec::new();
    let n = frames.len();
    for (count, what) in [
        (without_color, "colour picture"),
        (without_depth, "depth picture"),
    ] {
        if count > 0 {
            notes.push(format!(
                "{count} of {n} frames have no {what} and are left out."
            ));
        }
    }
    lost.note(
        n,
        "frames have lost their pose or intrinsics and are left out",
        &mut notes,
    );
    if without_confidence > 0 {
        notes.push(format!(
            "{without_confidence} frames have no confidence map: all their depth is kept."
        ));
    }
    let camera = given.unwrap_or_else(|| CameraModel {
        // Each frame has its own intrinsics; these represent all of them.
        focal: entries
            .first()
            .and_then(|e| e.focal)
            .unwrap_or([1.0, 1.0, 0.0, 0.0]),
        size: None,
        origin: "from each frame's JSON".to_owned(),
    });
    Ok(Some(Listing {
        layout: LAYOUT.name,
        entries,
        rig: Rig {
            color: camera,
            depth: DepthRays::Registered,
        },
        depth_units_per_metre: UNITS_PER_METRE,
        stamped: true,
        poses_of_depth: false,
        pose_deviation: Some(pose_deviation),
        notes,
    }))
}

pub(super) fn parse_frame(file: &TextFile) -> Result<FrameInfo, RecordingError> {
    let place = Place::file(file.path());
    let json: FrameJson = json_from_text(file)?;
    let k = &json.intrinsics;
    let focal = focal_from_matrix(
        &[[k[0], k[1], k[2]], [k[3], k[4], k[5]], [k[6], k[7], k[8]]],
        &place,
        // A small skew is not reported for each frame.
        &mut Vec::new(),
    )?;
    // Multiplying by diag(1, -1, -1, 1) on the right negates the second and third columns.
    let row = |r: usize| {
        let m = &json.pose[4 * r..4 * r + 4];
        [m[0], -m[1], -m[2], m[3]]
    };
    let matrix = pose_from_matrix(&[row(0), row(1), row(2), row(3)], &place)?;
    let time_ns = time_ns_from_secs(json.time)
        .ok_or_else(|| place.field("time", "seconds", json.time.to_string()))?;
    Ok(FrameInfo {
        time_ns,
        focal,
        matrix,
    })
}
