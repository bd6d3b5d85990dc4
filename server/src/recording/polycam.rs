//! Polycam's raw data (iPhone and iPad LiDAR): `keyframes/images/ID.jpg`, `keyframes/depth/ID.png` in millimetres,
//! `keyframes/cameras/ID.json` (intrinsics and an ARKit pose as `t_00` to `t_23`), `keyframes/confidence/ID.png`.
//! `corrected_images/` and `corrected_cameras/` are preferred: Polycam writes them after it has optimised the poses.
//!
//! ARKit's camera looks along -z with y up. Depth is registered at a lower resolution.

use serde::Deserialize;

use super::error::RecordingError;
use super::layout::Layout;
use super::location::Location;
use super::pictures::{self, Frames};
use super::poses::{Axes, matrix};
use super::rig::{CameraModel, DepthRays, Rig};
use super::text::{TextFile, check_focal, json_from_text};
use super::{Listing, OpenOptions, Place};

pub(super) const LAYOUT: Layout = Layout {
    name: "Polycam raw data",
    looked_for: "keyframes/ with images/, depth/ and cameras/",
    list,
};

const UNITS_PER_METRE: f64 = 1000.0;

#[derive(Deserialize)]
struct Camera {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    width: Option<f64>,
    height: Option<f64>,
    /// In microseconds; some versions have it only in the name.
    timestamp: Option<f64>,
    t_00: f64,
    t_01: f64,
    t_02: f64,
    t_03: f64,
    t_10: f64,
    t_11: f64,
    t_12: f64,
    t_13: f64,
    t_20: f64,
    t_21: f64,
    t_22: f64,
    t_23: f64,
}

fn list(root: &Location, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    let dir = [root.join("keyframes"), root.clone()]
        .into_iter()
        .find(|dir| dir.join("depth").is_dir() && dir.join("cameras").is_dir());
    let Some(dir) = dir else {
        return Ok(None);
    };
    let corrected = ["corrected_images", "corrected_cameras"].map(|name| dir.join(name));
    let is_corrected = corrected.iter().all(|dir| dir.is_dir());
    let [images, cameras] = if is_corrected {
        corrected
    } else {
        ["images", "cameras"].map(|name| dir.join(name))
    };
    if !images.is_dir() {
        return Ok(None);
    }
    let color = pictures::list(&images, "", &pictures::COLOR)?;
    let depth = pictures::list(&dir.join("depth"), "", &pictures::DEPTH)?;
    let cameras = pictures::list(&cameras, "", &["json"])?;
    let confidence_dir = dir.join("confidence");
    let confidence = match confidence_dir.is_dir() {
        true => pictures::list(&confidence_dir, "", &["png"])?,
        false => Default::default(),
    };
    let mut notes = Vec::new();
    let given = options
        .intrinsics
        .map(|focal| CameraModel::given(focal, root))
        .transpose()?;
    let mut model = given.clone();
    let mut frames = Frames::default();
    let mut bad_cameras = 0;
    for (key, path) in &color {
        let info = cameras.get(key).and_then(read);
        if info.is_none() && cameras.contains_key(key) {
            bad_cameras += 1;
        }
        let pose = info.as_ref().and_then(|(camera, _)| pose(camera));
        let own = info.as_ref().map(|(_, model)| model.clone());
        let focal = own.as_ref().map(|model| model.focal);
        if model.is_none() {
            model = own;
        }
        // Names are microseconds since the device was started.
        let us = info
            .as_ref()
            .and_then(|(camera, _)| camera.timestamp)
            .map(|t| t as i64)
            .or_else(|| i64::try_from(key.number?).ok());
        frames.add(
            Some(path.clone()),
            depth.get(key).cloned(),
            pose,
            options,
            |entry| {
                entry.time_ns = us.unwrap_or(0).saturating_mul(1000);
                entry.focal = focal.filter(|_| given.is_none());
                entry.confidence = confidence.get(key).cloned();
            },
        );
    }
    frames.finish(root, "keyframes/cameras/ID.json", &mut notes)?;
    if bad_cameras > 0 {
        notes.push(format!("{bad_cameras} camera files are damaged."));
    }
    frames.entries.sort_by_key(|entry| entry.time_ns);
    let Some(model) = model else {
        let place = Place::file(dir.join("cameras"));
        return Err(place.field("intrinsics", "ID.json files with fx, fy, cx, cy", "none"));
    };
    if !is_corrected {
        notes.push(
            "No corrected_cameras/: the poses are those of the tracker, which drift.".to_owned(),
        );
    }
    Ok(Some(Listing {
        layout: LAYOUT.name,
        entries: frames.entries,
        rig: Rig {
            color: model,
            depth: DepthRays::Registered,
        },
        depth_units_per_metre: UNITS_PER_METRE,
        stamped: true,
        poses_of_depth: false,
        pose_deviation: Some(frames.pose_deviation),
        notes,
    }))
}

fn read(path: &Location) -> Option<(Camera, CameraModel)> {
    let camera: Camera = json_from_text(&TextFile::read(path).ok()?).ok()?;
    let k = [camera.fx, camera.fy, camera.cx, camera.cy];
    let side = |s: Option<f64>| s.map(|s| s.round() as u32).filter(|&s| s > 0);
    let model = CameraModel {
        focal: check_focal(k, &Place::file(path)).ok()?,
        size: side(camera.width).zip(side(camera.height)),
        origin: "from each frame's JSON".to_owned(),
    };
    Some((camera, model))
}

fn pose(c: &Camera) -> Option<super::text::MatrixPose> {
    let rows = [
        c.t_00, c.t_01, c.t_02, c.t_03, c.t_10, c.t_11, c.t_12, c.t_13, c.t_20, c.t_21, c.t_22,
        c.t_23,
    ];
    matrix(&rows, Axes::OpenGl)
}
