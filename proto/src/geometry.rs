//! Cameras and poses of the message headers, checked.

use serde::{Deserialize, Serialize};

use crate::bytes::{Header, Writer};
use crate::{Code, WireError};

/// A rigid motion: unit quaternion and translation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Translation, metres.
    pub translation: [f64; 3],
    /// Quaternion x, y, z, w.
    pub quaternion: [f64; 4],
}

impl Pose {
    /// The identity.
    pub const IDENTITY: Self = Self {
        translation: [0.0; 3],
        quaternion: [0.0, 0.0, 0.0, 1.0],
    };

    /// Largest deviation of a quaternion's squared length from 1.
    pub const MAX_DEVIATION: f64 = 1e-2;

    /// Farthest pose from the origin, metres: f64 has a resolution of a tenth of a micrometre there.
    pub const MAX_DISTANCE_M: f64 = 1e9;

    pub(crate) fn read(header: &Header, offset: usize) -> Self {
        Self {
            translation: header.f64s(offset),
            quaternion: header.f64s(offset + 24),
        }
    }

    pub(crate) fn write(&self, out: &mut Writer) {
        out.f64s(&self.translation);
        out.f64s(&self.quaternion);
    }

    /// Checks that the pose is finite, near enough to the origin, and a rotation.
    pub(crate) fn check(&self, what: &str) -> Result<(), WireError> {
        for (part, values) in [
            ("translation", &self.translation[..]),
            ("quaternion", &self.quaternion[..]),
        ] {
            if let Some(got) = values.iter().find(|x| !x.is_finite()) {
                return Err(WireError::new(
                    Code::Pose,
                    format_args!("{what} {part}"),
                    "finite numbers",
                    got,
                ));
            }
        }
        let far = |x: &&f64| x.abs() > Self::MAX_DISTANCE_M;
        if let Some(got) = self.translation.iter().find(far) {
            return Err(WireError::new(
                Code::Pose,
                format_args!("{what} translation"),
                "at most 1e9 m from the origin",
                format_args!("{got:e} m"),
            ));
        }
        let squared: f64 = self.quaternion.iter().map(|x| x * x).sum();
        // Also false for infinity, the square of very large components.
        if (squared - 1.0).abs() <= Self::MAX_DEVIATION {
            return Ok(());
        }
        Err(WireError::new(
            Code::Pose,
            format_args!("{what} quaternion"),
            "a unit quaternion (squared length within 0.01 of 1)",
            format_args!("squared length {squared}"),
        ))
    }
}

/// A pinhole camera, pixels; pixel centres are at integer coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Focal length along u, pixels.
    pub fx: f64,
    /// Focal length along v, pixels.
    pub fy: f64,
    /// Principal point u.
    pub cx: f64,
    /// Principal point v.
    pub cy: f64,
}

impl Intrinsics {
    pub(crate) fn read(header: &Header, offset: usize) -> Self {
        let [fx, fy, cx, cy] = header.f64s(offset + 8);
        Self {
            width: header.u32(offset),
            height: header.u32(offset + 4),
            fx,
            fy,
            cx,
            cy,
        }
    }

    pub(crate) fn write(&self, out: &mut Writer) {
        out.u32(self.width);
        out.u32(self.height);
        out.f64s(&[self.fx, self.fy, self.cx, self.cy]);
    }

    /// Number of pixels.
    pub fn n_pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    pub(crate) fn check(&self, what: &str, max_side: u32) -> Result<(), WireError> {
        let sides = 1..=max_side;
        if !sides.contains(&self.width) || !sides.contains(&self.height) {
            return Err(WireError::new(
                Code::Size,
                format_args!("{what} size"),
                format_args!("1x1 to {max_side}x{max_side}"),
                format_args!("{}x{}", self.width, self.height),
            ));
        }
        for (field, got) in [("fx", self.fx), ("fy", self.fy)] {
            if !(got.is_finite() && got > 0.0) {
                return Err(WireError::new(
                    Code::Intrinsics,
                    format_args!("{what} {field}"),
                    "a finite number above 0",
                    got,
                ));
            }
        }
        for (field, got) in [("cx", self.cx), ("cy", self.cy)] {
            if !got.is_finite() {
                return Err(WireError::new(
                    Code::Intrinsics,
                    format_args!("{what} {field}"),
                    "a finite number",
                    got,
                ));
            }
        }
        Ok(())
    }
}
