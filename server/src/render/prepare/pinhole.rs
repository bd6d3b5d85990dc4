//! The pinhole camera, in the precision of rays.

use glam::Vec3A;

use crate::camera::Intrinsics;

use super::cone::RayCone;

/// Nearest depth at which primary rays see a mesh, metres.
pub(crate) const NEAR_M: f32 = 1e-3;

/// Pinhole projection: pixel centres at integers, camera space with x right, y down and z forward.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Pinhole {
    /// Focal lengths, pixels.
    pub(crate) fx: f32,
    pub(crate) fy: f32,
    /// Principal point, pixels.
    pub(crate) cx: f32,
    pub(crate) cy: f32,
}

impl Pinhole {
    pub(crate) fn new(intrinsics: &Intrinsics) -> Self {
        Self {
            fx: intrinsics.fx as f32,
            fy: intrinsics.fy as f32,
            cx: intrinsics.cx as f32,
            cy: intrinsics.cy as f32,
        }
    }

    /// Direction of the ray through a position of the picture, with z = 1, so that its parameter is depth.
    #[inline]
    pub(crate) fn ray_direction(&self, u: f32, v: f32) -> Vec3A {
        Vec3A::new((u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0)
    }

    /// Projection of a point in front of the camera, pixels.
    #[inline]
    pub(crate) fn project(&self, p: Vec3A) -> (f32, f32) {
        (self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy)
    }

    /// Width and spread of a pixel's cone at a depth. The same cone is used for lens rays.
    pub(crate) fn pixel_cone(&self, depth: f32) -> RayCone {
        let spread = 1.0 / self.fx.abs();
        RayCone {
            width: spread * depth,
            spread,
        }
    }
}
