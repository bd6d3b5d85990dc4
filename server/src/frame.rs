//! RGB-D frames, and the conventions of the whole project.
//!
//! - Metres, seconds (i64 nanoseconds for time stamps), radians.
//! - Camera axes x right, y down, z forward; `world_from_camera` poses in f64. All ray tracing is relative to the
//!   current camera in f32, so a world origin 100 km away costs no precision.
//! - Pixel centres at integer coordinates; depth is z, not range.
//! - Invalid depth is [`DepthImage::INVALID`] (a NaN, so that results computed from it are not mistaken for
//!   measurements), tested by [`is_valid_depth`]; never 0.0.
//! - Colour is 8-bit sRGB RGBA in and out, linear Rec.709 f32 inside.
//! - A frame's depth is registered: pixel (u, v) of depth and of colour have the same ray.

use crate::camera::{Intrinsics, Pose};

/// An 8-bit sRGB image, RGBA, rows from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColorImage {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` pixels.
    pub rgba: Vec<[u8; 4]>,
}

impl ColorImage {
    /// An image of one colour.
    pub fn filled(width: u32, height: u32, rgba: [u8; 4]) -> Self {
        Self {
            width,
            height,
            rgba: vec![rgba; width as usize * height as usize],
        }
    }

    /// The pixels as bytes, 4 per pixel.
    pub fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.rgba)
    }
}

/// A depth map: z in metres per pixel, rows from the top.
#[derive(Debug, Clone)]
pub struct DepthImage {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` depths; either valid ([`is_valid_depth`]) or [`DepthImage::INVALID`].
    pub z_m: Vec<f32>,
}

/// Whether a depth sample is a measurement.
#[inline]
pub fn is_valid_depth(z_m: f32) -> bool {
    // False for NaN. The range keeps 1/z finite and normal.
    (DepthImage::MIN_M..=DepthImage::MAX_M).contains(&z_m)
}

impl DepthImage {
    /// The value of a pixel without a valid depth.
    pub const INVALID: f32 = f32::NAN;
    /// Nearest valid depth, metres.
    pub const MIN_M: f32 = 1e-3;
    /// Farthest valid depth, metres.
    pub const MAX_M: f32 = 1e4;

    /// From metres; values that are not valid become [`DepthImage::INVALID`].
    ///
    /// # Panics
    /// If `z_m` does not hold `width * height` samples.
    pub fn from_metres(width: u32, height: u32, mut z_m: Vec<f32>) -> Self {
        assert_eq!(
            z_m.len(),
            width as usize * height as usize,
            "depth samples of {width}x{height}"
        );
        for z in &mut z_m {
            if !is_valid_depth(*z) {
                *z = Self::INVALID;
            }
        }
        Self { width, height, z_m }
    }

    /// From sensor units; 0 and 65535 are invalid. `max_m` is the sensor's range.
    pub fn from_units(
        width: u32,
        height: u32,
        units: &[u16],
        units_per_metre: f64,
        max_m: f32,
    ) -> Self {
        let z_m = units
            .iter()
            .map(|&unit| match unit {
                0 | u16::MAX => Self::INVALID,
                unit => {
                    let z = (f64::from(unit) / units_per_metre) as f32;
                    if z <= max_m { z } else { Self::INVALID }
                }
            })
            .collect();
        Self::from_metres(width, height, z_m)
    }

    /// Share of pixels without a valid depth, 0..=1.
    pub fn invalid_share(&self) -> f64 {
        let n = self.z_m.iter().filter(|z| !is_valid_depth(**z)).count();
        n as f64 / self.z_m.len().max(1) as f64
    }
}

/// Smallest standard deviation of a Kinect-class sensor's depth noise, metres.
pub(crate) const SIGMA_LEAST_M: f32 = 0.0012;
/// Growth of the standard deviation, metres per square metre.
pub(crate) const SIGMA_PER_M2: f32 = 0.0019;
/// Depth from which on the standard deviation grows, metres.
pub(crate) const SIGMA_NEAR_M: f32 = 0.4;

/// Standard deviation of a Kinect-class sensor's depth noise at depth `z_m`, metres:
/// 1.2 mm + 1.9 mm/m^2 (z - 0.4 m)^2 (Nguyen, Izadi, Lovell 2012, axial noise at small tilt).
#[inline]
pub fn depth_sigma_m(z_m: f32) -> f32 {
    let d = z_m - SIGMA_NEAR_M;
    SIGMA_LEAST_M + SIGMA_PER_M2 * (d * d)
}

/// A decoded, registered RGB-D frame.
#[derive(Debug, Clone)]
pub struct RgbdFrame {
    /// Index among the kept frames, from 0.
    pub index: u64,
    /// Capture time, nanoseconds; only differences are meaningful.
    pub time_ns: i64,
    /// The camera's picture.
    pub color: ColorImage,
    /// Depth registered to the colour camera, same size as `color`.
    pub depth: DepthImage,
    /// Intrinsics of the colour camera.
    pub intrinsics: Intrinsics,
    /// World from camera.
    pub pose: Pose,
}

/// A frame without its picture, which is sufficient to begin rendering. Fields as in [`RgbdFrame`].
#[derive(Debug, Clone)]
pub struct FrameGeometry {
    /// Index among the kept frames, from 0.
    pub index: u64,
    /// Capture time, nanoseconds.
    pub time_ns: i64,
    /// Depth registered to the colour camera.
    pub depth: DepthImage,
    /// Intrinsics of the colour camera.
    pub intrinsics: Intrinsics,
    /// World from camera.
    pub pose: Pose,
}

impl FrameGeometry {
    /// The complete frame; the picture must have the depth's size.
    pub fn with_color(self, color: ColorImage) -> RgbdFrame {
        RgbdFrame {
            index: self.index,
            time_ns: self.time_ns,
            color,
            depth: self.depth,
            intrinsics: self.intrinsics,
            pose: self.pose,
        }
    }
}

/// Any error of a frame source or renderer.
pub type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// A sequence of frames that can be read in any order: a recording, or frames in memory.
pub trait FrameSource: Send {
    /// Number of frames.
    fn n_frames(&self) -> usize;
    /// Capture time of frame `index`, nanoseconds, ascending; `None` from [`Self::n_frames`] on.
    fn time_ns(&self, index: usize) -> Option<i64>;
    /// Frame `index`, from 0.
    fn frame(&mut self, index: usize) -> Result<RgbdFrame, BoxError>;
    /// Whether an error of [`FrameSource::frame`] concerns only that frame, so that the others can still be read.
    fn leaves_out(&self, _error: &BoxError) -> bool {
        false
    }
}

/// Frames that are already in memory.
impl FrameSource for Vec<RgbdFrame> {
    fn n_frames(&self) -> usize {
        self.len()
    }

    fn time_ns(&self, index: usize) -> Option<i64> {
        self.get(index).map(|frame| frame.time_ns)
    }

    fn frame(&mut self, index: usize) -> Result<RgbdFrame, BoxError> {
        match self.get(index) {
            Some(frame) => Ok(frame.clone()),
            None => Err(format!("frame {index}: there are {}", self.len()).into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anything_that_is_no_measurement_is_invalid() {
        let z = vec![
            0.0,
            -1.0,
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            1e-30,
            2e4,
            1.5,
        ];
        let depth = DepthImage::from_metres(8, 1, z);
        assert_eq!(depth.z_m.iter().filter(|z| z.is_nan()).count(), 7);
        assert_eq!(depth.z_m[7], 1.5);
        let depth = DepthImage::from_units(4, 1, &[0, 65535, 5000, 60000], 5000.0, 10.0);
        assert!(depth.z_m[0].is_nan() && depth.z_m[1].is_nan() && depth.z_m[3].is_nan());
        assert_eq!(depth.z_m[2], 1.0);
        assert!((depth.invalid_share() - 0.75).abs() < 1e-12);
    }
}
