//! Pinhole intrinsics and rigid poses.
//!
//! Pixel centres lie at integer coordinates (as OpenCV and RGB-D data sets calibrate):
//! `u = fx x / z + cx`, and an image spans [-0.5, width - 0.5]. Axes: x right, y down,
//! z forward. Poses are `world_from_camera`, in f64 metres.

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3A};

/// Why a camera is invalid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// An invalid focal length or principal point.
    #[error("intrinsics {field}: expected {expected}, got {got:?}")]
    Intrinsics {
        /// The invalid number.
        field: &'static str,
        /// The expected value.
        expected: &'static str,
        /// The actual value.
        got: f64,
    },
    /// An image without pixels, or one that is too large to address.
    #[error("image size: expected 1x1 to {max}x{max}, got {width}x{height}", max = Intrinsics::MAX_SIDE)]
    Size {
        /// Width given, pixels.
        width: u32,
        /// Height given, pixels.
        height: u32,
    },
    /// A pose with a number that is NaN or infinite.
    #[error("pose {field}: expected a finite number, got {got}")]
    NotFinite {
        /// The part of the pose.
        field: &'static str,
        /// The invalid number.
        got: f64,
    },
    /// A pose too far from the origin for the precision of f64.
    #[error("pose translation: expected at most {bound:e} m from the origin, got {got:e} m")]
    TooFar {
        /// The invalid coordinate, metres.
        got: f64,
        /// The limit, metres.
        bound: f64,
    },
    /// A matrix or quaternion too far from a rotation to be corrected.
    #[error(
        "pose rotation: expected a rotation (|R Rt - I| under {bound}, det +1), got deviation {deviation:.3e}, det {det:.4}"
    )]
    NotRotation {
        /// Largest entry of `|R Rt - I|`.
        deviation: f64,
        /// Determinant.
        det: f64,
        /// The limit.
        bound: f64,
    },
}

/// Pinhole intrinsics of one image, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Intrinsics {
    /// Focal length along u, pixels, > 0.
    pub fx: f64,
    /// Focal length along v, pixels, > 0.
    pub fy: f64,
    /// Principal point u, pixels (pixel centres are integers).
    pub cx: f64,
    /// Principal point v, pixels.
    pub cy: f64,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
}

impl Intrinsics {
    /// Largest image side, pixels. Keeps pixel coordinates exact in f32 with eleven bits to spare, and bounds memory.
    pub const MAX_SIDE: u32 = 8192;
    /// Shortest focal length, pixels. Keeps a ray's direction (z = 1) under [`Self::MAX_CENTRE_PX`] / 1e-3 = 1e9,
    /// whose square fits into f32.
    pub const MIN_FOCAL_PX: f64 = 1e-3;
    /// Longest focal length, pixels: ten thousand times that of a telescope, and far inside the range of f32.
    pub const MAX_FOCAL_PX: f64 = 1e9;
    /// Farthest principal point, pixels: a small part of the largest possible picture. In f32 it still has a
    /// resolution of a sixteenth of a pixel.
    pub const MAX_CENTRE_PX: f64 = 1e6;

    /// Checked intrinsics, from which every ray can be computed in f32.
    pub fn new(
        fx: f64,
        fy: f64,
        cx: f64,
        cy: f64,
        width: u32,
        height: u32,
    ) -> Result<Self, CameraError> {
        for (field, got) in [("fx", fx), ("fy", fy)] {
            // False for NaN.
            if !(Self::MIN_FOCAL_PX..=Self::MAX_FOCAL_PX).contains(&got) {
                return Err(CameraError::Intrinsics {
                    field,
                    expected: "0.001 to 1e9 pixels",
                    got,
                });
            }
        }
        for (field, got) in [("cx", cx), ("cy", cy)] {
            if !(-Self::MAX_CENTRE_PX..=Self::MAX_CENTRE_PX).contains(&got) {
                return Err(CameraError::Intrinsics {
                    field,
                    expected: "-1e6 to 1e6 pixels",
                    got,
                });
            }
        }
        if width == 0 || height == 0 || width > Self::MAX_SIDE || height > Self::MAX_SIDE {
            return Err(CameraError::Size { width, height });
        }
        Ok(Self {
            fx,
            fy,
            cx,
            cy,
            width,
            height,
        })
    }

    /// The same camera sampled at another resolution. Edges are mapped to edges: with pixel centres at integers,
    /// `cx' = (cx + 0.5) s - 0.5`.
    pub fn scaled_to(&self, width: u32, height: u32) -> Result<Self, CameraError> {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        Self::new(
            self.fx * sx,
            self.fy * sy,
            (self.cx + 0.5) * sx - 0.5,
            (self.cy + 0.5) * sy - 0.5,
            width,
            height,
        )
    }

    /// Number of pixels.
    pub fn n_pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Pixel coordinates of a point in front of the camera (camera axes, metres).
    #[inline]
    pub fn project(&self, p: DVec3) -> (f64, f64) {
        (self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy)
    }

    /// The point at pixel (u, v) and depth z (camera axes, metres).
    #[inline]
    pub fn unproject(&self, u: f64, v: f64, z: f64) -> DVec3 {
        DVec3::new((u - self.cx) / self.fx * z, (v - self.cy) / self.fy * z, z)
    }

    /// Direction of the ray through pixel (u, v), scaled to z = 1, so that the ray parameter is depth.
    #[inline]
    pub fn ray_direction(&self, u: f32, v: f32) -> Vec3A {
        Vec3A::new(
            (u - self.cx as f32) / self.fx as f32,
            (v - self.cy as f32) / self.fy as f32,
            1.0,
        )
    }
}

/// A rigid motion; as a camera pose, `world_from_camera`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Unit quaternion (x, y, z, w).
    pub rotation: DQuat,
    /// In metres.
    pub translation: DVec3,
}

impl Pose {
    /// The identity.
    pub const IDENTITY: Self = Self {
        rotation: DQuat::IDENTITY,
        translation: DVec3::ZERO,
    };

    /// Largest `|R Rt - I|` of a matrix that is re-orthonormalised; a larger deviation is an error. 7-Scenes' own
    /// poses reach 4e-4; a hundredth is a scale or shear error that rounding does not explain.
    pub const MAX_DEVIATION: f64 = 1e-2;

    /// Farthest pose from the origin, metres: f64 has a resolution of a tenth of a micrometre there. Map coordinates
    /// reach 1e7.
    pub const MAX_DISTANCE_M: f64 = 1e9;

    /// From a 3x3 rotation (row-major) and a translation; the rotation is re-orthonormalised.
    pub fn from_rows(rows: [[f64; 3]; 3], translation: [f64; 3]) -> Result<Self, CameraError> {
        for got in rows.iter().flatten().copied() {
            if !got.is_finite() {
                return Err(CameraError::NotFinite {
                    field: "rotation",
                    got,
                });
            }
        }
        let translation = finite_translation(translation)?;
        let m = DMat3::from_cols_array_2d(&rows).transpose();
        let residual = m * m.transpose() - DMat3::IDENTITY;
        let deviation = residual
            .to_cols_array()
            .iter()
            .fold(0.0f64, |a, b| a.max(b.abs()));
        let det = m.determinant();
        if deviation > Self::MAX_DEVIATION || det <= 0.0 {
            return Err(CameraError::NotRotation {
                deviation,
                det,
                bound: Self::MAX_DEVIATION,
            });
        }
        // Newton's iteration for the nearest rotation (polar factor); it converges quadratically, so three steps
        // reduce a deviation of 1e-2 below f64 rounding.
        let mut r = m;
        for _ in 0..3 {
            r = (r + r.transpose().inverse()) * 0.5;
        }
        Ok(Self {
            rotation: DQuat::from_mat3(&r).normalize(),
            translation,
        })
    }

    /// From a quaternion (x, y, z, w), normalised here, and a translation.
    pub fn from_quaternion(xyzw: [f64; 4], translation: [f64; 3]) -> Result<Self, CameraError> {
        for got in xyzw {
            if !got.is_finite() {
                return Err(CameraError::NotFinite {
                    field: "quaternion",
                    got,
                });
            }
        }
        let q = DQuat::from_array(xyzw);
        let deviation = (q.length_squared() - 1.0).abs();
        // A quaternion of length 1 + e gives a matrix with an error of about 2 e.
        if deviation > Self::MAX_DEVIATION {
            return Err(CameraError::NotRotation {
                deviation,
                det: q.length_squared(),
                bound: Self::MAX_DEVIATION,
            });
        }
        Ok(Self {
            rotation: q.normalize(),
            translation: finite_translation(translation)?,
        })
    }

    /// The inverse motion.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// The composition: first `other`, then `self`: `a_from_c = a_from_b.then(b_from_c)`.
    pub fn then(&self, other: &Self) -> Self {
        Self {
            rotation: (self.rotation * other.rotation).normalize(),
            translation: self.rotation * other.translation + self.translation,
        }
    }

    /// Transforms a point.
    #[inline]
    pub fn transform_point(&self, p: DVec3) -> DVec3 {
        self.rotation * p + self.translation
    }

    /// Interpolates between two poses: translation linearly, rotation spherically along the shorter arc; t in 0..=1.
    pub fn interpolate(&self, other: &Self, t: f64) -> Self {
        Self {
            rotation: self.rotation.slerp(other.rotation, t).normalize(),
            translation: self.translation.lerp(other.translation, t),
        }
    }

    /// As an affine map.
    pub fn to_affine(&self) -> DAffine3 {
        DAffine3::from_rotation_translation(self.rotation, self.translation)
    }
}

fn finite_translation(t: [f64; 3]) -> Result<DVec3, CameraError> {
    for got in t {
        if !got.is_finite() {
            return Err(CameraError::NotFinite {
                field: "translation",
                got,
            });
        }
        let bound = Pose::MAX_DISTANCE_M;
        if got.abs() > bound {
            return Err(CameraError::TooFar { got, bound });
        }
    }
    Ok(DVec3::from_array(t))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn bad_intrinsics_name_their_field() {
        for (fx, fy, cx) in [
            (0.0, 1.0, 0.0),
            (1.0, -2.0, 0.0),
            (1.0, f64::NAN, 0.0),
            (1.0, 1.0, f64::INFINITY),
        ] {
            assert!(Intrinsics::new(fx, fy, cx, 0.0, 4, 4).is_err());
        }
        let error = Intrinsics::new(1.0, -2.0, 0.0, 0.0, 4, 4)
            .unwrap_err()
            .to_string();
        assert_eq!(
            error,
            "intrinsics fy: expected 0.001 to 1e9 pixels, got -2.0"
        );
        assert!(Intrinsics::new(1.0, 1.0, 0.0, 0.0, 0, 4).is_err());
        assert!(Intrinsics::new(1.0, 1.0, 0.0, 0.0, 4, 100_000).is_err());
    }

    #[test]
    fn a_slightly_sheared_matrix_becomes_a_rotation_and_a_mirror_is_refused() {
        let near = [[1.0, 3e-4, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.9996]];
        let pose = Pose::from_rows(near, [0.0; 3]).unwrap();
        assert!((pose.rotation.length() - 1.0).abs() < 1e-15);
        assert!(
            Pose::from_rows(
                [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]],
                [0.0; 3]
            )
            .is_err()
        );
        assert!(
            Pose::from_rows(
                [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]],
                [0.0; 3]
            )
            .is_err()
        );
        assert!(Pose::from_rows([[f64::NAN; 3]; 3], [0.0; 3]).is_err());
        assert!(Pose::from_quaternion([0.0; 4], [0.0; 3]).is_err());
        assert!(Pose::from_quaternion([0.0, 0.0, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0]).is_err());
    }

    #[test]
    fn a_pose_that_a_double_cannot_place_is_refused() {
        let at = |x: f64| Pose::from_quaternion([0.0, 0.0, 0.0, 1.0], [0.0, x, 0.0]);
        assert!(at(-1e9).is_ok());
        assert_eq!(
            at(-1e30).unwrap_err().to_string(),
            "pose translation: expected at most 1e9 m from the origin, got -1e30 m"
        );
        let rows = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert!(Pose::from_rows(rows, [1.1e9, 0.0, 0.0]).is_err());
    }

    proptest! {
        #[test]
        fn project_undoes_unproject(u in -0.5..639.5f64, v in -0.5..479.5f64, z in 1e-3..1e4f64) {
            let k = Intrinsics::new(525.0, 520.0, 319.5, 239.5, 640, 480).unwrap();
            let (u2, v2) = k.project(k.unproject(u, v, z));
            prop_assert!((u - u2).abs() < 1e-10 && (v - v2).abs() < 1e-10);
        }

        #[test]
        fn scaling_keeps_viewing_rays(u in 0.0..639.0f64) {
            let k = Intrinsics::new(525.0, 525.0, 319.5, 239.5, 640, 480).unwrap();
            let half = k.scaled_to(320, 240).unwrap();
            let p = k.unproject(u, 7.0, 2.0);
            let (u2, _) = half.project(p);
            // Edges are mapped to edges: (u + 0.5) / 2 - 0.5.
            prop_assert!((u2 - ((u + 0.5) / 2.0 - 0.5)).abs() < 1e-10);
        }

        #[test]
        fn a_pose_and_its_inverse_cancel(x in -1e3..1e3f64, y in -3.0..3.0f64, a in -3.0..3.0f64) {
            let pose = Pose { rotation: DQuat::from_euler(glam::EulerRot::XYZ, a, y, 0.3), translation: DVec3::new(x, y, a) };
            let same = pose.then(&pose.inverse());
            prop_assert!(same.translation.length() < 1e-12 * (1.0 + x.abs()));
            prop_assert!(same.rotation.angle_between(DQuat::IDENTITY) < 1e-7);
        }
    }
}
