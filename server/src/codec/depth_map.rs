//! A depth image as its file stores it, before its samples are metres.

use super::{CodecError, DepthUnits, check_size};
use crate::frame::DepthImage;

/// What every form is expected to be, in errors.
pub(super) const EXPECTED: &str =
    "a depth image of one channel (16-bit PNG, PGM, TIFF, NPY, PFM or EXR)";

/// Floats above this cannot be metres, see the documentation of `depth`.
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
