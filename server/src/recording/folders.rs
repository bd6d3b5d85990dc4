//! Folders of colour and depth with poses beside them, under common names:
//!
//! - ScanNet's export (Dai et al. 2017): `color/N.jpg`, `depth/N.png` (1000 units per metre),
//!   `pose/N.txt` (4x4, world from camera; `-inf` where tracking was lost) and
//!   `intrinsic/intrinsic_color.txt`, `intrinsic_depth.txt`. Depth has a resolution and intrinsics
//!   of its own and is warped into colour.
//! - Any other `color/` (`image/`, `rgb/`, `images/`) and `depth/` with a folder of pose files, or
//!   with a trajectory in the folder (`traj.txt`, `poses.txt`, ...) or one folder deeper.
//! - ICL-NUIM (Handa et al. 2014): a trajectory `*.gt.freiburg`, 5000 units per metre. Its y axes
//!   point up (the negative fy of its calibration), which is undone here.

use std::collections::BTreeMap;

use glam::{DQuat, DVec3};

use crate::camera::Pose;

use super::camera_file::{find_camera_file, read_camera_file};
use super::error::RecordingError;
use super::layout::Layout;
use super::location::Location;
use super::pictures::{self, Frames, Key};
use super::poses::read_matrix;
use super::rig::{CameraModel, DepthRays, Rig};
use super::trajectory::Trajectory;
use super::{Listing, OpenOptions};

pub(super) const LAYOUT: Layout = Layout {
    name: "colour and depth folders with poses",
    looked_for: "color/ and depth/ with pose/ or a trajectory (ScanNet and others)",
    list,
};

pub(super) const ICL_NUIM: Layout = Layout {
    name: "ICL-NUIM",
    looked_for: "*.gt.freiburg with rgb/ and depth/",
    list: list_icl,
};

/// Name of [`LAYOUT`] for recordings with a separate depth camera and pose files.
const SCANNET: &str = "ScanNet export";

const COLOR_FOLDERS: [&str; 8] = [
    "color",
    "colour",
    "image",
    "images",
    "rgb",
    "imgs",
    "colors",
    "rgb_images",
];
const DEPTH_FOLDERS: [&str; 4] = ["depth", "depths", "depth_images", "depth_raw"];
const POSE_FOLDERS: [&str; 7] = [
    "pose",
    "poses",
    "camera_pose",
    "camera_poses",
    "cam_pose",
    "extrinsics",
    "c2w",
];
const TRAJECTORIES: [&str; 8] = [
    "traj.txt",
    "traj_w_c.txt",
    "trajectory.txt",
    "poses.txt",
    "pose.txt",
    "camera_poses.txt",
    "camera_trajectory.txt",
    "CameraTrajectory.txt",
];
/// Additional names of camera files.
const COLOR_CAMERA: [&str; 3] = [
    "intrinsic/intrinsic_color.txt",
    "intrinsics/intrinsic_color.txt",
    "intrinsic_color.txt",
];
const DEPTH_CAMERA: [&str; 3] = [
    "intrinsic/intrinsic_depth.txt",
    "intrinsics/intrinsic_depth.txt",
    "intrinsic_depth.txt",
];

const UNITS_PER_METRE: f64 = 1000.0;
/// Open3D's `PinholeCameraIntrinsicParameters::PrimeSenseDefault`.
const PRIMESENSE: [f64; 4] = [525.0, 525.0, 319.5, 239.5];

/// ICL-NUIM's calibration, with y pointing down.
const ICL_CAMERA: [f64; 4] = [481.2, 480.0, 319.5, 239.5];
const ICL_UNITS_PER_METRE: f64 = 5000.0;

/// The size of ScanNet's colour camera: exports with smaller pictures keep the intrinsics of this size.
const SCANNET_COLOR: (u32, u32) = (1296, 968);

/// Source of the poses.
enum Poses {
    Files(BTreeMap<Key, Location>, String),
    Trajectory(Location),
    Icl(Location),
}

/// ICL-NUIM, whose folders also contain lists like TUM's.
fn list_icl(root: &Location, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    let icl = root
        .file_names()?
        .into_iter()
        .find(|name| name.ends_with(".gt.freiburg"));
    match icl {
        Some(name) => list_with(root, Poses::Icl(root.join(name)), options),
        None => Ok(None),
    }
}

fn list(root: &Location, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    match find_poses(root)? {
        Some(poses) => list_with(root, poses, options),
        None => Ok(None),
    }
}

fn list_with(
    root: &Location,
    poses: Poses,
    options: &OpenOptions,
) -> Result<Option<Listing>, RecordingError> {
    let folder = |names: &[&str]| names.iter().map(|n| root.join(n)).find(|dir| dir.is_dir());
    let (Some(color_dir), Some(depth_dir)) = (folder(&COLOR_FOLDERS), folder(&DEPTH_FOLDERS))
    else {
        return Ok(None);
    };
    let color = pictures::list_prefixed(&color_dir, &pictures::COLOR)?;
    let depth = pictures::list_prefixed(&depth_dir, &pictures::DEPTH)?;
    let mut notes = Vec::new();
    let icl = matches!(poses, Poses::Icl(_));
    let (rig, units) = rig(root, color.values().next(), icl, options, &mut notes)?;
    let (mut frames, looked_for) = match &poses {
        Poses::Files(files, name) => {
            let pose = |key: &Key| read_matrix(files.get(key)?);
            let frames = Frames::pair(&color, &depth, pose, options);
            (frames, format!("{name}/N.txt"))
        }
        Poses::Trajectory(path) | Poses::Icl(path) => {
            let rest = OpenOptions {
                assume_static: true,
                ..options.clone()
            };
            let mut frames = Frames::pair(&color, &depth, |_| None, &rest);
            // A trajectory given by the caller replaces this one.
            if options.trajectory.is_none() {
                let trajectory = Trajectory::read(path)?;
                let entries = &mut frames.entries;
                frames.pose_deviation = trajectory.apply(entries, false, options, &mut notes)?;
            }
            (frames, path.path().display().to_string())
        }
    };
    if icl {
        for entry in &mut frames.entries {
            entry.pose = with_y_down(&entry.pose);
        }
    }
    frames.finish(root, &looked_for, &mut notes)?;
    let layout = match (&poses, &rig.depth) {
        (Poses::Icl(_), _) => ICL_NUIM.name,
        (Poses::Files(..), DepthRays::Own { .. }) => SCANNET,
        _ => LAYOUT.name,
    };
    Ok(Some(Listing {
        layout,
        entries: frames.entries,
        rig,
        depth_units_per_metre: units,
        stamped: false,
        poses_of_depth: false,
        pose_deviation: Some(frames.pose_deviation),
        notes,
    }))
}

fn find_poses(root: &Location) -> Result<Option<Poses>, RecordingError> {
    for name in POSE_FOLDERS {
        let dir = root.join(name);
        if dir.is_dir() {
            let files = pictures::list_prefixed(&dir, &["txt", "pose", "matrix", "dat"])?;
            if !files.is_empty() {
                return Ok(Some(Poses::Files(files, name.to_owned())));
            }
        }
    }
    // A log beside the pictures belongs to Open3D's layout, which has its own rules.
    let has_log = root.file_names()?.iter().any(|name| name.ends_with(".log"));
    if has_log || root.join("scene/trajectory.log").is_file() {
        return Ok(None);
    }
    let named = TRAJECTORIES.iter().map(|name| root.join(name));
    if let Some(path) = named.into_iter().find(|path| path.is_file()) {
        return Ok(Some(Poses::Trajectory(path)));
    }
    // One folder deeper: any log, or a trajectory with a usual name.
    for folder in root.folder_names()? {
        let dir = root.join(folder);
        let mut logs = dir.file_names()?;
        logs.retain(|name| name.ends_with(".log") || TRAJECTORIES.contains(&name.as_str()));
        if let [one] = logs.as_slice() {
            return Ok(Some(Poses::Trajectory(dir.join(one))));
        }
    }
    Ok(None)
}

fn rig(
    root: &Location,
    first: Option<&Location>,
    icl: bool,
    options: &OpenOptions,
    notes: &mut Vec<String>,
) -> Result<(Rig, f64), RecordingError> {
    let default_units = if icl {
        ICL_UNITS_PER_METRE
    } else {
        UNITS_PER_METRE
    };
    let found = find_camera_file(root, &COLOR_CAMERA);
    let found = match options.intrinsics {
        // Given intrinsics replace those of the file, even if the file cannot be read.
        Some(_) => found.unwrap_or_default(),
        None => found?,
    };
    let units = found.as_ref().and_then(|file| file.depth_units_per_metre);
    let mut color = match (options.intrinsics, found) {
        (Some(focal), _) => CameraModel::given(focal, root)?,
        (None, Some(file)) => {
            notes.extend(file.notes);
            file.camera
        }
        (None, None) if icl => CameraModel::default_vga(ICL_CAMERA, "ICL-NUIM's camera"),
        (None, None) => {
            let [fx, fy, cx, cy] = PRIMESENSE;
            notes.push(format!(
                "No intrinsics in the folder: taking fx {fx} fy {fy} cx {cx} cy {cy} (Open3D's PrimeSense default)."
            ));
            CameraModel::default_vga(PRIMESENSE, "Open3D's PrimeSense camera")
        }
    };
    let own = DEPTH_CAMERA.iter().map(|name| root.join(name));
    let own = own.into_iter().find(|path| path.is_file());
    let depth = match own {
        None => DepthRays::Registered,
        Some(path) => {
            if options.intrinsics.is_none() {
                fit_scannet(&mut color, first, notes);
            }
            DepthRays::Own {
                camera: read_camera_file(&path)?.camera,
                color_from_depth: Pose::IDENTITY,
            }
        }
    };
    Ok((Rig { color, depth }, units.unwrap_or(default_units)))
}

/// Exports that scale the pictures keep the intrinsics of the camera's full size.
fn fit_scannet(color: &mut CameraModel, first: Option<&Location>, notes: &mut Vec<String>) {
    let [_, _, cx, cy] = color.focal;
    let near = |c: f64, side: u32| (2.0 * c / f64::from(side) - 1.0).abs() < 0.1;
    let calibrated = near(cx, SCANNET_COLOR.0) && near(cy, SCANNET_COLOR.1);
    // A picture that does not decode is reported when it is read.
    let Some(image) = first.and_then(|path| path.color().ok()) else {
        return;
    };
    if calibrated && !near(cx, image.width) && color.size.is_none() {
        color.size = Some(SCANNET_COLOR);
        let (w, h) = SCANNET_COLOR;
        notes.push(format!(
            "Colour is {}x{}, its intrinsics are for {w}x{h}: scaled.",
            image.width, image.height
        ));
    }
}

/// The same motion with the y axes of world and camera pointing down.
fn with_y_down(pose: &Pose) -> Pose {
    let (q, t) = (pose.rotation, pose.translation);
    Pose {
        rotation: DQuat::from_xyzw(-q.x, q.y, -q.z, q.w),
        translation: DVec3::new(t.x, -t.y, t.z),
    }
}
