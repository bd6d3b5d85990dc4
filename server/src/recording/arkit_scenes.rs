//! ARKitScenes (Baruch et al. 2021): `lowres_wide/VIDEO_TIME.png`, `lowres_depth/VIDEO_TIME.png` in
//! millimetres, `confidence/` (0 low, 1 medium, 2 high), `lowres_wide_intrinsics/VIDEO_TIME.pincam`
//! (`width height fx fy cx cy`) and `lowres_wide.traj` (`time ax ay az tx ty tz`: axis-angle and
//! translation of camera from world, which is inverted here).
//!
//! Poses have a rate of 10 Hz, pictures of up to 60 Hz: each picture uses the pose interpolated to its time.

use std::collections::BTreeMap;

use glam::{DQuat, DVec3};

use crate::camera::Pose;

use super::error::RecordingError;
use super::layout::Layout;
use super::location::Location;
use super::pictures::{self, Frames, Key};
use super::poses::numbers;
use super::rig::{CameraModel, DepthRays, Rig};
use super::text::{MatrixPose, TextFile, check_focal};
use super::tum::pose_at;
use super::{Listing, OpenOptions, Place};

pub(super) const LAYOUT: Layout = Layout {
    name: "ARKitScenes",
    looked_for: "lowres_wide/ with lowres_depth/",
    list,
};

const UNITS_PER_METRE: f64 = 1000.0;

/// Largest gap between pictures and poses, nanoseconds: poses are sampled at 10 Hz, and [`pose_at`] allows five times
/// this gap between two poses.
const POSE_GAP_NS: i64 = 50_000_000;

/// Largest difference between the time stamps in the names of intrinsics files and of pictures, milliseconds.
const NAME_GAP_MS: i64 = 10;

fn list(root: &Location, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    let Some(dir) = find(root)? else {
        return Ok(None);
    };
    let color = timed(&dir.join("lowres_wide"), &pictures::COLOR)?;
    let depth = timed(&dir.join("lowres_depth"), &pictures::DEPTH)?;
    let optional = |name: &str, extensions: &[&str]| {
        let folder = dir.join(name);
        let list = folder.is_dir().then(|| timed(&folder, extensions));
        list.transpose().map(Option::unwrap_or_default)
    };
    let confidence = optional("confidence", &["png"])?;
    let cameras = optional("lowres_wide_intrinsics", &["pincam"])?;
    let mut notes = Vec::new();
    let poses = poses(&dir, &mut notes)?;
    let given = options
        .intrinsics
        .map(|focal| CameraModel::given(focal, root))
        .transpose()?;
    let mut frames = Frames::default();
    let mut model = given.clone();
    let mut without_camera = 0;
    for (&ms, color) in &color {
        let time_ns = ms.saturating_mul(1_000_000);
        let pose = pose_at(&poses, time_ns, POSE_GAP_NS).map(|pose| MatrixPose {
            pose,
            deviation: 0.0,
        });
        let camera = nearest(&cameras, ms).and_then(read_pincam);
        if given.is_none() && camera.is_none() {
            without_camera += 1;
        }
        let focal = camera.as_ref().map(|camera| camera.focal);
        if model.is_none() {
            model = camera;
        }
        let depth = nearest(&depth, ms).cloned();
        frames.add(Some(color.clone()), depth, pose, options, |entry| {
            entry.time_ns = time_ns;
            entry.focal = focal.filter(|_| given.is_none());
            entry.confidence = nearest(&confidence, ms).cloned();
        });
    }
    frames.finish(root, "lowres_wide.traj", &mut notes)?;
    if without_camera > 0 {
        notes.push(format!(
            "{without_camera} frames have no .pincam and take the first frame's intrinsics."
        ));
    }
    let Some(model) = model else {
        let place = Place::file(dir.join("lowres_wide_intrinsics"));
        return Err(place.field("intrinsics", "VIDEO_TIME.pincam files", "none"));
    };
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
        pose_deviation: None,
        notes,
    }))
}

/// The folder itself, or the folder `VIDEO_frames` in it.
fn find(root: &Location) -> Result<Option<Location>, RecordingError> {
    let has =
        |dir: &Location| dir.join("lowres_wide").is_dir() && dir.join("lowres_depth").is_dir();
    if has(root) {
        return Ok(Some(root.clone()));
    }
    let folders = root.folder_names()?.into_iter();
    Ok(folders.map(|name| root.join(name)).find(|dir| has(dir)))
}

/// Files by the time in their names, milliseconds.
fn timed(dir: &Location, extensions: &[&str]) -> Result<BTreeMap<i64, Location>, RecordingError> {
    let list: BTreeMap<Key, Location> = pictures::list(dir, "", extensions)?;
    let time = |path: &Location| {
        let stem = path.path().file_stem()?.to_str()?;
        let seconds: f64 = stem.rsplit('_').next()?.parse().ok()?;
        ((0.0..1e12).contains(&seconds)).then_some((seconds * 1e3).round() as i64)
    };
    let files = list.into_values();
    Ok(files
        .filter_map(|path| Some((time(&path)?, path)))
        .collect())
}

fn nearest(files: &BTreeMap<i64, Location>, ms: i64) -> Option<&Location> {
    let around = files.range(ms - NAME_GAP_MS..=ms + NAME_GAP_MS);
    around.min_by_key(|(t, _)| (*t - ms).abs()).map(|(_, p)| p)
}

fn read_pincam(path: &Location) -> Option<CameraModel> {
    let file = TextFile::read(path).ok()?;
    let &[w, h, fx, fy, cx, cy] = numbers(file.text()).first_chunk::<6>()?;
    let size = (w as u32, h as u32);
    Some(CameraModel {
        focal: check_focal([fx, fy, cx, cy], &Place::file(path)).ok()?,
        size: (size.0 > 0 && size.1 > 0).then_some(size),
        origin: "from each frame's .pincam".to_owned(),
    })
}

/// World from camera by time; lost poses are left out.
fn poses(dir: &Location, notes: &mut Vec<String>) -> Result<Vec<(i64, Pose)>, RecordingError> {
    let mut names = dir.file_names()?;
    names.retain(|name| name.ends_with(".traj"));
    let Some(name) = names.first() else {
        return Ok(Vec::new());
    };
    let file = TextFile::read(&dir.join(name))?;
    let lines: Vec<_> = file
        .text()
        .lines()
        .filter(|line| !line.trim().is_empty())
        .collect();
    let n = lines.len();
    let mut poses: Vec<(i64, Pose)> = lines.into_iter().filter_map(pose).collect();
    poses.sort_by_key(|(time, _)| *time);
    if poses.len() < n {
        let lost = n - poses.len();
        notes.push(format!(
            "{lost} of {n} lines of {name} have no pose and are left out."
        ));
    }
    Ok(poses)
}

fn pose(line: &str) -> Option<(i64, Pose)> {
    let &[time, ax, ay, az, tx, ty, tz] = numbers(line).first_chunk::<7>()?;
    let q = DQuat::from_scaled_axis(DVec3::new(ax, ay, az)).to_array();
    let camera_from_world = Pose::from_quaternion(q, [tx, ty, tz]).ok()?;
    let in_range = (0.0..9e9).contains(&time);
    in_range.then(|| ((time * 1e9) as i64, camera_from_world.inverse()))
}
