//! A depth image as stored in its file, before its samples are converted to metres.

use super::{CodecError, DepthUnits, check_size};
use crate::frame::DepthImage;

/// The expected formats, for errors.
pub(super) const EXPECTED: &str =
    "a depth image of one channel (16-bit PNG, PGM, TIFF, NPY, PFM or EXR)";

/// Floats above this are not metres, see the documentation of `depth`.
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
    /// Sensor units; 0 and 65535 are invalid.
    Units(Vec<u16>),
    /// Sensor units beyond 16 bits; 0 is invalid.
    WideUnits(Vec<f32>),
    /// Metres.
    Metres(Vec<f32>),
    /// Millimetres, as floats.
    Millimetres(Vec<f32>),
}

impl DepthMap {
    /// Depth units per metre of these samples; `layout` is the value for integers.
    pub fn units_per_metre(&self, layout: f64) -> f64 {
        match self.samples {
            DepthSamples::Units(_) | DepthSamples::WideUnits(_) => layout,
            DepthSamples::Metres(_) => 1.0,
            DepthSamples::Millimetres(_) => 1000.0,
        }
    }

    /// Converts to metres; depth beyond `max_m` is invalid.
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

    /// Number of samples with the largest 16-bit value, which are invalid.
    pub fn n_saturated(&self) -> usize {
        match &self.samples {
            DepthSamples::Units(units) => units.iter().filter(|&&unit| unit == u16::MAX).count(),
            _ => 0,
        }
    }

    /// Number of samples over `limit` units that are not saturated.
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

    /// From floats, which are recognised as metres or millimetres by their values.
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

    /// From integers in depth units: 16 bits if they fit. Negative values are invalid.
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

/// Checks the size in a header, and that an image with so many samples can be held in memory.
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
