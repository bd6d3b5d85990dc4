//! nerfstudio's `transforms.json` with `depth_file_path`: a 4x4 world-from-camera matrix per frame with OpenGL axes
//! (y up, looking along -z); intrinsics for all frames or per frame; depth in millimetres unless
//! `depth_unit_scale_factor` (metres per unit) says otherwise.

use std::path::{Component, Path};

use serde::Deserialize;

use super::error::RecordingError;
use super::excerpt::MAX_ENTRIES;
use super::layout::Layout;
use super::location::Location;
use super::pictures::Frames;
use super::poses::{Axes, matrix};
use super::rig::{CameraModel, DepthRays, Rig, check_units};
use super::text::{TextFile, check_focal, json_from_text};
use super::{Listing, NOMINAL_PERIOD_NS, OpenOptions, Place};

pub(super) const LAYOUT: Layout = Layout {
    name: "nerfstudio",
    looked_for: "transforms.json with depth_file_path",
    list,
};

const METRES_PER_UNIT: f64 = 0.001;

#[derive(Deserialize)]
struct Transforms {
    #[serde(flatten)]
    camera: Camera,
    depth_unit_scale_factor: Option<f64>,
    #[serde(default)]
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: Option<String>,
    depth_file_path: Option<String>,
    /// Parsed by hand, so that an invalid matrix is a lost pose instead of an invalid file.
    transform_matrix: Option<serde_json::Value>,
    #[serde(flatten)]
    camera: Camera,
}

#[derive(Deserialize)]
struct Camera {
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    camera_angle_x: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

impl Camera {
    fn size(&self) -> Option<(u32, u32)> {
        let side = |s: Option<f64>| s.map(|s| s.round() as u32).filter(|&s| s > 0);
        side(self.w).zip(side(self.h))
    }

    /// `fx fy cx cy`; missing values are derived from the size.
    fn focal(&self) -> Option<[f64; 4]> {
        let (w, h) = (self.w, self.h);
        let from_angle = || Some(0.5 * w? / (0.5 * self.camera_angle_x?).tan());
        let fx = self.fl_x.or_else(from_angle)?;
        let middle = |side: Option<f64>| side.map(|s| (s - 1.0) / 2.0);
        Some([
            fx,
            self.fl_y.unwrap_or(fx),
            self.cx.or(middle(w))?,
            self.cy.or(middle(h))?,
        ])
    }

    fn is_distorted(&self) -> bool {
        let terms = [self.k1, self.k2, self.k3, self.p1, self.p2];
        terms.into_iter().flatten().any(|k| k.abs() > 1e-3)
    }
}

fn list(root: &Location, options: &OpenOptions) -> Result<Option<Listing>, RecordingError> {
    let path = root.join("transforms.json");
    if !path.is_file() {
        return Ok(None);
    }
    let place = Place::file(&path);
    let json: Transforms = json_from_text(&TextFile::read(&path)?)?;
    if !json.frames.iter().any(|f| f.depth_file_path.is_some()) {
        return Err(place.field(
            "frames",
            "a depth_file_path in each (ns-process-data with depth, or another export)",
            "none: pictures without depth",
        ));
    }
    if json.frames.len() > MAX_ENTRIES {
        let got = json.frames.len().to_string();
        return Err(place.field("frames", format!("at most {MAX_ENTRIES}"), got));
    }
    let mut notes = Vec::new();
    let metres_per_unit = json.depth_unit_scale_factor.unwrap_or(METRES_PER_UNIT);
    let units = 1.0 / metres_per_unit;
    check_units(units, &place)?;
    let given = options
        .intrinsics
        .map(|focal| CameraModel::given(focal, root))
        .transpose()?;
    let shared = json.camera.focal();
    let mut frames = Frames::default();
    let mut outside = 0;
    for (i, frame) in (0i64..).zip(&json.frames) {
        let inside = |name: &Option<String>| name.as_ref().map(|name| file_in(root, name));
        let (color, depth) = (inside(&frame.file_path), inside(&frame.depth_file_path));
        outside += usize::from(
            [&color, &depth]
                .into_iter()
                .any(|p| matches!(p, Some(None))),
        );
        let pose = frame.transform_matrix.as_ref().and_then(|value| {
            let rows = value.as_array()?;
            let numbers: Vec<f64> = rows
                .iter()
                .filter_map(|row| row.as_array())
                .flatten()
                .map(|n| n.as_f64().unwrap_or(f64::NAN))
                .collect();
            matrix(&numbers, Axes::OpenGl)
        });
        let own = frame.camera.focal();
        let focal = match own {
            Some(own) if given.is_none() => Some(check_focal(own, &place)?),
            _ => None,
        };
        frames.add(color.flatten(), depth.flatten(), pose, options, |entry| {
            entry.time_ns = i.saturating_mul(NOMINAL_PERIOD_NS);
            entry.focal = focal;
        });
    }
    frames.finish(root, "transform_matrix in transforms.json", &mut notes)?;
    if outside > 0 {
        notes.push(format!(
            "{outside} frames name files outside the folder and are left out."
        ));
    }
    let cameras = json.frames.iter().map(|f| &f.camera);
    if cameras.chain([&json.camera]).any(Camera::is_distorted) {
        notes.push("Lens distortion in transforms.json is left out: undistort the pictures for exact edges.".to_owned());
    }
    let first = json.frames.iter().find(|f| f.depth_file_path.is_some());
    let size = json
        .camera
        .size()
        .or_else(|| first.and_then(|f| f.camera.size()));
    let focal = shared.or_else(|| frames.entries.first().and_then(|e| e.focal));
    let color = match (given, focal) {
        (Some(given), _) => given,
        (None, Some(focal)) => CameraModel {
            focal: check_focal(focal, &place)?,
            size,
            origin: "from transforms.json".to_owned(),
        },
        (None, None) => {
            return Err(place.field("fl_x, cx, cy (or camera_angle_x, w, h)", "numbers", "none"));
        }
    };
    Ok(Some(Listing {
        layout: LAYOUT.name,
        entries: frames.entries,
        rig: Rig {
            color,
            depth: DepthRays::Registered,
        },
        depth_units_per_metre: units,
        stamped: false,
        poses_of_depth: false,
        pose_deviation: Some(frames.pose_deviation),
        notes,
    }))
}

/// A file named by the document, if it is in the folder. Names written on Windows have backslashes.
fn file_in(root: &Location, name: &str) -> Option<Location> {
    let name = name.replace('\\', "/");
    let path = Path::new(&name);
    let plain = |part: Component| matches!(part, Component::Normal(_) | Component::CurDir);
    path.components().all(plain).then(|| root.join(path))
}
