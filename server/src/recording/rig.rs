//! The cameras of a recording: their intrinsics and the source of these, and the relation of depth to colour.

use std::path::Path;

use crate::camera::{Intrinsics, Pose};

use super::error::{Place, RecordingError};
use super::text::check_focal;

/// Largest relative difference of two aspect ratios that still count as the same camera at two resolutions. Rounding
/// a side to whole pixels explains half a pixel in 120 (the smallest depth sensors), which is 0.4 %; 4:3 and 16:9
/// differ by 33 %.
pub(super) const MAX_ASPECT_DIFFERENCE: f64 = 0.01;

/// Intrinsics, the image size they were calibrated at, and their source.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CameraModel {
    /// `fx fy cx cy`, pixels.
    pub(super) focal: [f64; 4],
    /// Width and height of the calibration; `None` means the size of the images.
    pub(super) size: Option<(u32, u32)>,
    /// Source, for messages.
    pub(super) origin: String,
}

/// The rays along which depth is measured.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum DepthRays {
    /// Rays of the colour camera, perhaps at another resolution.
    Registered,
    /// Rays of a separate camera.
    Own {
        /// Its intrinsics.
        camera: CameraModel,
        /// Transform from its axes to the colour camera's.
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
    /// From intrinsics given by the user.
    pub(super) fn given(focal: [f64; 4], root: impl AsRef<Path>) -> Result<Self, RecordingError> {
        Ok(Self {
            focal: check_focal(focal, &Place::file(root))?,
            size: None,
            origin: "given by the caller".to_owned(),
        })
    }

    /// From a known default for 640x480 images.
    pub(super) fn default_vga(focal: [f64; 4], name: &str) -> Self {
        Self {
            focal,
            size: Some((640, 480)),
            origin: format!("default: {name}"),
        }
    }

    /// The intrinsics for an image of this size; `image` is its file.
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

/// Whether two image sizes can belong to one camera at two resolutions.
pub(super) fn same_aspect(a: (u32, u32), b: (u32, u32)) -> bool {
    let cross = |p: u32, q: u32| f64::from(p) * f64::from(q);
    let (ab, ba) = (cross(a.0, b.1), cross(b.0, a.1));
    (ab - ba).abs() <= MAX_ASPECT_DIFFERENCE * ab.max(ba)
}

/// Checks that a depth scale is possible for 16-bit depth: 65535 units must be between a millimetre and 10 km, or no
/// depth would be valid.
pub(super) fn check_units(units_per_metre: f64, place: &Place) -> Result<(), RecordingError> {
    if (1.0..=1e8).contains(&units_per_metre) {
        return Ok(());
    }
    let got = units_per_metre.to_string();
    Err(place
        .clone()
        .field("depth units per metre", "1 to 1e8", got))
}
