//! Depth images as files: 16-bit grey PNG and the other forms in which depth is written.
//!
//! | form | samples |
//! |---|---|
//! | PNG | 16-bit grey, with or without alpha or a transparent value |
//! | PGM (P5, P2) | 8 or 16 bits |
//! | TIFF | u8, u16, u32, i16, i32, f16, f32, f64, one channel |
//! | NPY | the same, both byte orders, C and Fortran order |
//! | PFM, EXR | float |
//!
//! **Units.** Integers count the recording's depth units (5000 a metre in TUM, 1000 elsewhere).
//! Floats are metres, unless nine of ten of the values over zero are over 100, which no depth
//! camera measures in metres: then they are millimetres. A pixel that is transparent is not
//! measured, unless all are.

use std::path::Path;

use image::{DynamicImage, ImageFormat};

use super::{
    CodecError, DepthUnits, MAX_IMAGE_FILE_BYTES, check_size, decode, exr, kind_of, malformed,
    netpbm, npy, read_file, tiff,
};
use crate::frame::DepthImage;

/// What every form is expected to be, in errors.
pub(super) const EXPECTED: &str =
    "a depth image of one channel (16-bit PNG, PGM, TIFF, NPY, PFM or EXR)";

/// Floats over this are no metres, see the module's documentation.
const MOST_METRES: f32 = 100.0;

/// A depth image as stored.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMap {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` samples, rows from the top.
    pub samples: DepthSamples,
}

/// Samples of a [`DepthMap`].
#[derive(Debug, Clone, PartialEq)]
pub enum DepthSamples {
    /// Sensor units; 0 and 65535 are no measurements.
    Units(Vec<u16>),
    /// Sensor units beyond 16 bits; 0 is no measurement.
    WideUnits(Vec<f32>),
    /// Metres.
    Metres(Vec<f32>),
    /// Millimetres, as floats.
    Millimetres(Vec<f32>),
}

impl DepthMap {
    /// Depth units per metre of these samples; `layout` says what integers count.
    pub fn units_per_metre(&self, layout: f64) -> f64 {
        match self.samples {
            DepthSamples::Units(_) | DepthSamples::WideUnits(_) => layout,
            DepthSamples::Metres(_) => 1.0,
            DepthSamples::Millimetres(_) => 1000.0,
        }
    }

    /// In metres; depth beyond `max_m` is no measurement.
    pub fn to_image(&self, units_per_metre: f64, max_m: f32) -> DepthImage {
        let (width, height) = (self.width, self.height);
        match &self.samples {
            DepthSamples::Units(units) => {
                DepthImage::from_units(width, height, units, units_per_metre, max_m)
            }
            DepthSamples::WideUnits(values)
            | DepthSamples::Metres(values)
            | DepthSamples::Millimetres(values) => {
                let metres = values.iter().map(|&value| {
                    let z = (f64::from(value) / units_per_metre) as f32;
                    if z <= max_m { z } else { DepthImage::INVALID }
                });
                DepthImage::from_metres(width, height, metres.collect())
            }
        }
    }

    /// Number of samples at the top of 16 bits: no measurements.
    pub fn n_saturated(&self) -> usize {
        match &self.samples {
            DepthSamples::Units(units) => units.iter().filter(|&&unit| unit == u16::MAX).count(),
            _ => 0,
        }
    }

    /// Number of samples over `limit`, in units, that are not saturated.
    pub fn n_beyond(&self, limit: f64) -> usize {
        match &self.samples {
            DepthSamples::Units(units) => units
                .iter()
                .filter(|&&unit| unit != u16::MAX && f64::from(unit) > limit)
                .count(),
            DepthSamples::WideUnits(values)
            | DepthSamples::Metres(values)
            | DepthSamples::Millimetres(values) => values
                .iter()
                .filter(|&&value| f64::from(value) > limit)
                .count(),
        }
    }

    /// Floats as metres or millimetres, whichever they look like.
    pub(super) fn from_floats(width: u32, height: u32, values: Vec<f32>) -> Self {
        let measured = values.iter().filter(|v| v.is_finite() && **v > 0.0);
        let (n, far) = measured.fold((0usize, 0usize), |(n, far), v| {
            (n + 1, far + usize::from(*v > MOST_METRES))
        });
        let samples = if n > 0 && far * 10 >= n * 9 {
            DepthSamples::Millimetres(values)
        } else {
            DepthSamples::Metres(values)
        };
        Self {
            width,
            height,
            samples,
        }
    }

    /// Integers as units: 16 bits where they fit. Negative ones are no measurements.
    pub(super) fn from_integers(
        width: u32,
        height: u32,
        values: impl Iterator<Item = i64> + Clone,
    ) -> Self {
        let fits = values.clone().all(|v| v <= i64::from(u16::MAX));
        let samples = if fits {
            // Negative ones become 0.
            DepthSamples::Units(values.map(|v| u16::try_from(v).unwrap_or(0)).collect())
        } else {
            DepthSamples::WideUnits(values.map(|v| v.max(0) as f32).collect())
        };
        Self {
            width,
            height,
            samples,
        }
    }
}

impl From<DepthUnits> for DepthMap {
    fn from(units: DepthUnits) -> Self {
        Self {
            width: units.width,
            height: units.height,
            samples: DepthSamples::Units(units.units),
        }
    }
}

/// Reads and decodes a depth image in any of the forms above.
pub fn read_depth(path: &Path) -> Result<DepthMap, CodecError> {
    decode_depth_map(
        &read_file(path, MAX_IMAGE_FILE_BYTES)?,
        &path.display().to_string(),
    )
}

/// Decodes a depth image in any of the forms above, told by its first bytes; `file` names it in
/// errors.
pub fn decode_depth_map(bytes: &[u8], file: &str) -> Result<DepthMap, CodecError> {
    let map = match bytes {
        [] => return Err(malformed(file, EXPECTED, "an empty file")),
        [0x89, b'P', b'N', b'G', ..] => png(bytes, file)?,
        [b'P', b'2' | b'5', ..] => netpbm::pgm(bytes, file)?,
        [b'P', b'f', ..] => netpbm::pfm(bytes, file)?,
        [0x93, b'N', b'U', b'M', b'P', b'Y', ..] => npy::decode(bytes, file)?,
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => tiff::depth(bytes, file)?,
        [0x76, 0x2F, 0x31, 0x01, ..] => exr::depth(bytes, file)?,
        [b'P', b'3' | b'6' | b'F', ..] => {
            return Err(malformed(
                file,
                EXPECTED,
                "a Netpbm image of three channels",
            ));
        }
        [0xFF, 0xD8, ..] => {
            let got = "a JPEG image (its compression destroys depth)";
            return Err(malformed(file, EXPECTED, got));
        }
        [b'P', b'K', 3, 4, ..] => {
            let got = "a zip archive (of .npz: save each array by numpy.save)";
            return Err(malformed(file, EXPECTED, got));
        }
        [b'v', b'e', b'r', b's', b'i', b'o', b'n', b' ', ..] => {
            let got = "a Git LFS pointer (the file itself was not fetched: git lfs pull)";
            return Err(malformed(file, EXPECTED, got));
        }
        _ => return Err(malformed(file, EXPECTED, "bytes of none of these")),
    };
    Ok(map)
}

fn png(bytes: &[u8], file: &str) -> Result<DepthMap, CodecError> {
    match decode(bytes, ImageFormat::Png, file, EXPECTED)? {
        DynamicImage::ImageLuma16(image) => Ok(DepthMap {
            width: image.width(),
            height: image.height(),
            samples: DepthSamples::Units(image.into_raw()),
        }),
        DynamicImage::ImageLumaA16(image) => {
            let opaque = image.pixels().any(|pixel| pixel.0[1] != 0);
            let unit = |[unit, alpha]: [u16; 2]| if opaque && alpha == 0 { 0 } else { unit };
            Ok(DepthMap {
                width: image.width(),
                height: image.height(),
                samples: DepthSamples::Units(image.pixels().map(|pixel| unit(pixel.0)).collect()),
            })
        }
        other => {
            let kind = kind_of(&other);
            let got = match other.color().channel_count() {
                1 | 2 => format!("{kind} (8 bits are a picture of depth, not depth)"),
                _ => format!("{kind} (packed or coloured depth: write it as 16-bit grey)"),
            };
            Err(malformed(file, EXPECTED, got))
        }
    }
}

/// Checks a size that a header claims, and that so many samples can be held.
pub(super) fn check_depth_size(
    width: u64,
    height: u64,
    file: &str,
) -> Result<(u32, u32), CodecError> {
    check_size(
        u32::try_from(width).unwrap_or(u32::MAX),
        u32::try_from(height).unwrap_or(u32::MAX),
        file,
        EXPECTED,
    )
}
