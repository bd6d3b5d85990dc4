//! Replica as rendered by iMAP and NICE-SLAM: `results/frame000000.jpg`, `results/depth000000.png` and `traj.txt` (a
//! row-major 4x4 world-from-camera matrix per line). `cam_params.json` in the folder or the one above has size,
//! intrinsics and 6553.5 units per metre.

use serde::Deserialize;

use super::error::RecordingError;
use super::layout::Layout;
use super::location::Location;
use super::pictures::{self, Frames};
use super::rig::{CameraModel, DepthRays, Rig, check_units};
use super::text::{TextFile, check_focal, json_from_text};
use super::trajectory::Trajectory;
use super::{Listing, OpenOptions, Place};

pub(super) const LAYOUT: Layout = Layout {
    name: "Replica",
    looked_for: "results/frame000000.jpg with traj.txt",
    list,
};

const UNITS_PER_METRE: f64 = 6553.5;
/// NICE-SLAM's camera, for 1200x680.
const FOCAL_PX: f64 = 600.0;
const WIDTH: f64 = 1200.0;

#[derive(Deserialize)]
struct Params {
    camera: Camera,
}

#[derive(Deserialize)]
struct Camera {
    w: f64,
    h: f64,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    scale: Option<f64>,
}

fn list(root: &Location, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    let dir = root.join("results");
    let trajectory = root.join("traj.txt");
    if !dir.is_dir() {
        return Ok(None);
    }
    let color = pictures::list(&dir, "frame", &pictures::COLOR)?;
    let depth = pictures::list(&dir, "depth", &pictures::DEPTH)?;
    if color.is_empty() || depth.is_empty() {
        return Ok(None);
    }
    let mut notes = Vec::new();
    let (camera, units) = camera(root, color.values().next(), options, &mut notes)?;
    let has_trajectory = trajectory.is_file() && options.trajectory.is_none();
    let rest = OpenOptions {
        assume_static: options.assume_static || has_trajectory,
        ..options.clone()
    };
    let mut frames = Frames::pair(&color, &depth, |_| None, &rest);
    if has_trajectory {
        let trajectory = Trajectory::read(&trajectory)?;
        let entries = &mut frames.entries;
        frames.pose_deviation = trajectory.apply(entries, false, options, &mut notes)?;
    }
    frames.finish(root, "traj.txt", &mut notes)?;
    Ok(Some(Listing {
        layout: LAYOUT.name,
        entries: frames.entries,
        rig: Rig {
            color: camera,
            depth: DepthRays::Registered,
        },
        depth_units_per_metre: units,
        stamped: false,
        poses_of_depth: false,
        pose_deviation: Some(frames.pose_deviation),
        notes,
    }))
}

fn camera(
    root: &Location,
    first: Option<&Location>,
    options: &OpenOptions,
    notes: &mut Vec<String>,
) -> Result<(CameraModel, f64), RecordingError> {
    let real = root.absolute();
    let file = [Some(real.clone()), real.parent()]
        .into_iter()
        .flatten()
        .map(|dir| dir.join("cam_params.json"))
        .find(|path| path.is_file());
    let mut units = UNITS_PER_METRE;
    let mut found = None;
    if let Some(path) = file {
        let place = Place::file(&path);
        let Params { camera: c } = json_from_text(&TextFile::read(&path)?)?;
        if let Some(scale) = c.scale {
            check_units(scale, &place)?;
            units = scale;
        }
        let focal = check_focal([c.fx, c.fy, c.cx, c.cy], &place)?;
        // The cast saturates: sizes out of range match no picture.
        let size = (c.w.round() as u32, c.h.round() as u32);
        found = Some(CameraModel {
            focal,
            size: (size.0 > 0 && size.1 > 0).then_some(size),
            origin: "from cam_params.json".to_owned(),
        });
    }
    if let Some(focal) = options.intrinsics {
        return Ok((CameraModel::given(focal, root)?, units));
    }
    if let Some(found) = found {
        return Ok((found, units));
    }
    // Without the file only the field of view is known; a picture that cannot be decoded is reported when it is read.
    let size = first
        .and_then(|path| path.color().ok())
        .map_or((1200, 680), |image| (image.width, image.height));
    let (w, h) = (f64::from(size.0), f64::from(size.1));
    let f = FOCAL_PX / WIDTH * w;
    let focal = [f, f, (w - 1.0) / 2.0, (h - 1.0) / 2.0];
    notes.push(format!(
        "No cam_params.json: taking fx {f} fy {f}, the principal point in the middle (NICE-SLAM's Replica camera) and {UNITS_PER_METRE} depth units per metre."
    ));
    let model = CameraModel {
        focal,
        size: Some(size),
        origin: "default: NICE-SLAM's Replica camera".to_owned(),
    };
    Ok((model, units))
}
