//! The cameras of a recording: whose intrinsics are known from where, and how depth relates to
//! colour.

use std::path::Path;

use serde::Deserialize;

use crate::camera::{Intrinsics, Pose};

use super::error::{Place, RecordingError};
use super::text::{TextFile, check_focal, focal_from_matrix, json_from_text};

/// How far two aspect ratios may differ and still be the same camera at two resolutions,
/// relative. Rounding a side to whole pixels explains half a pixel in 120 (the smallest depth
/// sensors), which is 0.4 %; 4:3 and 16:9 differ by 33 %.
pub(super) const MAX_ASPECT_DIFFERENCE: f64 = 0.01;

/// Intrinsics, the image size they were calibrated at, and where they come from.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CameraModel {
    /// `fx fy cx cy`, pixels.
    pub(super) focal: [f64; 4],
    /// Width and height they are for; nothing means the images' own.
    pub(super) size: Option<(u32, u32)>,
    /// In words, for people.
    pub(super) origin: String,
}

/// Which rays depth is measured along.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum DepthRays {
    /// Those of the colour camera, perhaps at another resolution.
    Registered,
    /// Those of a camera of its own.
    Own {
        /// Its intrinsics.
        camera: CameraModel,
        /// From its axes to the colour camera's.
        color_from_depth: Pose,
    },
}

/// Both cameras.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rig {
    pub(super) color: CameraModel,
    pub(super) depth: DepthRays,
}

impl CameraModel {
    /// Given by the user.
    pub(super) fn given(focal: [f64; 4], root: &Path) -> Result<Self, RecordingError> {
        Ok(Self {
            focal: check_focal(focal, &Place::file(root))?,
            size: None,
            origin: "given by the caller".to_owned(),
        })
    }

    /// A known default for 640x480 images.
    pub(super) fn default_vga(focal: [f64; 4], name: &str) -> Self {
        Self {
            focal,
            size: Some((640, 480)),
            origin: format!("default: {name}"),
        }
    }

    /// The intrinsics of an image of this size, `image` being the file it came from.
    pub(super) fn for_image(
        &self,
        width: u32,
        height: u32,
        image: &Path,
    ) -> Result<Intrinsics, RecordingError> {
        let [fx, fy, cx, cy] = self.focal;
        let place = || Place::file(image);
        match self.size {
            Some((w, h)) if (w, h) != (width, height) => {
                if !same_aspect((w, h), (width, height)) {
                    return Err(place().field(
                        "image size",
                        format!(
                            "{w}x{h} or its aspect ratio, which the intrinsics are for ({})",
                            self.origin
                        ),
                        format!("{width}x{height}"),
                    ));
                }
                Intrinsics::new(fx, fy, cx, cy, w, h).and_then(|k| k.scaled_to(width, height))
            }
            _ => Intrinsics::new(fx, fy, cx, cy, width, height),
        }
        .map_err(|e| place().camera(e))
    }
}

/// Whether two image sizes can be one camera at two resolutions.
pub(super) fn same_aspect(a: (u32, u32), b: (u32, u32)) -> bool {
    let cross = |p: u32, q: u32| f64::from(p) * f64::from(q);
    let (ab, ba) = (cross(a.0, b.1), cross(b.0, a.1));
    (ab - ba).abs() <= MAX_ASPECT_DIFFERENCE * ab.max(ba)
}

/// What a camera file says.
#[derive(Debug)]
pub(super) struct CameraFile {
    pub(super) camera: CameraModel,
    pub(super) depth_units_per_metre: Option<f64>,
}

/// The JSON forms in use; everything else in the document is for others.
#[derive(Deserialize)]
struct CameraJson {
    /// Ours: `{"intrinsics": {"fx", ...}}`.
    intrinsics: Option<FocalJson>,
    /// Open3D: column-major 3x3.
    intrinsic_matrix: Option<[f64; 9]>,
    width: Option<u32>,
    height: Option<u32>,
    depth_units_per_metre: Option<f64>,
    /// Open3D's recorder: units per metre.
    depth_scale: Option<f64>,
    /// Flat form.
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
}

#[derive(Deserialize)]
struct FocalJson {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    width: Option<u32>,
    height: Option<u32>,
}

/// The first of `names` that is a file in `dir`.
pub(super) fn find_camera_file(
    dir: &Path,
    names: &[&str],
) -> Result<Option<CameraFile>, RecordingError> {
    names
        .iter()
        .map(|name| dir.join(name))
        .find(|path| path.is_file())
        .map(|path| read_camera_file(&path))
        .transpose()
}

/// A camera file: JSON in one of the known forms, or text with four numbers or a 3x3 matrix.
pub(super) fn read_camera_file(path: &Path) -> Result<CameraFile, RecordingError> {
    parse_camera_file(&TextFile::read(path)?)
}

pub(super) fn parse_camera_file(file: &TextFile) -> Result<CameraFile, RecordingError> {
    let place = Place::file(&file.path);
    let origin = match file.path.file_name() {
        Some(name) => format!("from {}", name.to_string_lossy()),
        None => "from a file".to_owned(),
    };
    if !file.text().trim_start().starts_with('{') {
        let focal = text_focal(file)?;
        let camera = CameraModel {
            focal,
            size: None,
            origin,
        };
        return Ok(CameraFile {
            camera,
            depth_units_per_metre: None,
        });
    }
    let json: CameraJson = json_from_text(file)?;
    let (focal, width, height) = if let Some(k) = json.intrinsics {
        (
            check_focal([k.fx, k.fy, k.cx, k.cy], &place)?,
            k.width,
            k.height,
        )
    } else if let Some(m) = json.intrinsic_matrix {
        let rows = [[m[0], m[3], m[6]], [m[1], m[4], m[7]], [m[2], m[5], m[8]]];
        (focal_from_matrix(&rows, &place)?, json.width, json.height)
    } else if let (Some(fx), Some(fy), Some(cx), Some(cy)) = (json.fx, json.fy, json.cx, json.cy) {
        (
            check_focal([fx, fy, cx, cy], &place)?,
            json.width,
            json.height,
        )
    } else {
        return Err(place.field(
            "intrinsics",
            "\"intrinsics\", \"intrinsic_matrix\" or \"fx\", \"fy\", \"cx\", \"cy\"",
            "none of them",
        ));
    };
    let size = match (width, height) {
        (Some(w), Some(h)) => {
            Intrinsics::new(focal[0], focal[1], focal[2], focal[3], w, h)
                .map_err(|e| place.clone().camera(e))?;
            Some((w, h))
        }
        (None, None) => None,
        _ => return Err(place.field("width, height", "both or neither", "one of them")),
    };
    let units = json.depth_units_per_metre.or(json.depth_scale);
    if let Some(units) = units {
        check_units(units, &place)?;
    }
    Ok(CameraFile {
        camera: CameraModel {
            focal,
            size,
            origin,
        },
        depth_units_per_metre: units,
    })
}

/// A depth scale that 16-bit depth can have: 65535 units must span from a millimetre to
/// 10 km, or no depth would be valid.
pub(super) fn check_units(units_per_metre: f64, place: &Place) -> Result<(), RecordingError> {
    if (1.0..=1e8).contains(&units_per_metre) {
        return Ok(());
    }
    let got = units_per_metre.to_string();
    Err(place
        .clone()
        .field("depth units per metre", "1 to 1e8", got))
}

/// Four numbers on a line, or three lines of three.
fn text_focal(file: &TextFile) -> Result<[f64; 4], RecordingError> {
    let place = Place::file(&file.path);
    let lines = file.lines().take(5).collect::<Result<Vec<_>, _>>()?;
    match lines.as_slice() {
        [one] => check_focal(one.numbers("intrinsics fx fy cx cy")?, &one.place()),
        // Some tools write the matrix as 4x4 or end it with a row of their own.
        [a, b, c, ..] => {
            let rows = [
                a.numbers("intrinsics row 1")?,
                b.numbers("intrinsics row 2")?,
                c.numbers("intrinsics row 3")?,
            ];
            focal_from_matrix(&rows, &place)
        }
        other => Err(place.field(
            "intrinsics",
            "fx fy cx cy on one line or a 3x3 matrix",
            format!("{} lines", other.len()),
        )),
    }
}
