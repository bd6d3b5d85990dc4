//! The cameras of a recording: whose intrinsics are known from where, and how depth relates to
//! colour.

use std::path::Path;

use crate::camera::{Intrinsics, Pose};

use super::error::{Place, RecordingError};
use super::text::check_focal;

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
    /// In words, for messages.
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
    pub(super) fn given(focal: [f64; 4], root: impl AsRef<Path>) -> Result<Self, RecordingError> {
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
        image: impl AsRef<Path>,
    ) -> Result<Intrinsics, RecordingError> {
        let [fx, fy, cx, cy] = self.focal;
        let place = || Place::file(&image);
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
