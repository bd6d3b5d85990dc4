//! The sensed scene: the ghost surface, depth with its holes filled, and the camera's picture.

use glam::Vec3A;

use crate::frame::{ColorImage, RgbdFrame, depth_sigma_m};
use crate::ghost::{GhostSettings, GhostSurface, HolePolicy};
use crate::numerics::linear_from_srgb;
use crate::render::settings::RenderSettings;

use super::pinhole::Pinhole;

/// Depth per pixel with which primary rays are compared and on which shadows fall: with holes filled if the
/// settings say so, otherwise as measured.
pub(crate) fn occlusion_depth<'a>(
    frame: &'a RgbdFrame,
    settings: &RenderSettings,
    filled: &'a [f32],
) -> &'a [f32] {
    match settings.ghost.holes {
        HolePolicy::Fill if filled.len() == frame.depth.z_m.len() => filled,
        _ => &frame.depth.z_m,
    }
}

/// The sensor's data about the real scene.
#[derive(Clone, Copy)]
pub(crate) struct Sensed<'a> {
    pub(crate) color: &'a ColorImage,
    /// Depth as measured, metres per pixel, NaN in holes.
    pub(crate) measured: &'a [f32],
    /// [`occlusion_depth`], metres per pixel, NaN where unknown.
    pub(crate) depth: &'a [f32],
    pub(crate) ghost: &'a GhostSurface,
    pub(crate) settings: &'a GhostSettings,
    pub(crate) pinhole: Pinhole,
}

impl Sensed<'_> {
    /// Width and height of the picture, pixels.
    #[inline]
    pub(crate) fn size(&self) -> [u32; 2] {
        [self.color.width, self.color.height]
    }

    /// Last column and row of the picture.
    #[inline]
    pub(crate) fn last(&self) -> (u32, u32) {
        (self.color.width - 1, self.color.height - 1)
    }

    #[inline]
    fn index(&self, x: u32, y: u32) -> usize {
        y as usize * self.color.width as usize + x as usize
    }

    /// Depth of the real scene at a pixel, metres; NaN in a hole.
    #[inline]
    pub(crate) fn depth_at(&self, x: u32, y: u32) -> f32 {
        self.depth[self.index(x, y)]
    }

    /// Direction of the ray through a pixel's centre, z = 1.
    #[inline]
    pub(crate) fn direction_at(&self, x: u32, y: u32) -> Vec3A {
        self.pinhole.ray_direction(x as f32, y as f32)
    }

    /// The real surface at a pixel, camera space; NaN in a hole.
    #[inline]
    pub(crate) fn point_at(&self, x: u32, y: u32) -> Vec3A {
        self.direction_at(x, y) * self.depth_at(x, y)
    }

    /// Distance from a ray's start within which the ghost surface is ignored, metres: within the sensor's noise
    /// it is unreliable, and rays from an object that stands on a surface start on that surface.
    pub(crate) fn lift(&self, p: Vec3A) -> f32 {
        self.settings.bias_sigmas * depth_sigma_m(p.z.max(0.0))
    }

    /// Normal of the ghost surface at a pixel; towards the camera if none can be fitted.
    pub(crate) fn normal_at(&self, x: u32, y: u32) -> Vec3A {
        self.ghost
            .normal_at(x, y)
            .or_else(|| (-self.direction_at(x, y)).try_normalize())
            .unwrap_or(-Vec3A::Z)
    }

    /// Normal of the ghost surface for shading: that of the 2x2 block if the block's corner is on the same
    /// surface (a fit covers more pixels than that, and takes longer than the rays); towards the camera if none
    /// can be fitted.
    pub(crate) fn block_normal(&self, x: u32, y: u32, memo: &mut NormalMemo) -> Vec3A {
        let block = (x & !1, y & !1);
        let z = |(x, y): (u32, u32)| self.measured[self.index(x, y)];
        let step = self.settings.edge_relative * z((x, y));
        let fit = |(x, y): (u32, u32)| self.normal_at(x, y);
        // False if either is NaN.
        if (z((x, y)) - z(block)).abs() < step {
            *memo.of_block[(y >> 1 & 1) as usize][(x >> 1 & 1) as usize]
                .get_or_insert_with(|| fit(block))
        } else {
            fit((x, y))
        }
    }

    /// The camera's pixel as linear light.
    pub(crate) fn color_at(&self, x: u32, y: u32) -> Vec3A {
        let [r, g, b, _] = self.color.rgba[self.index(x, y)];
        Vec3A::new(
            linear_from_srgb(r),
            linear_from_srgb(g),
            linear_from_srgb(b),
        )
    }

    /// Bilinear interpolation of the values `at` four pixels around a position of the picture.
    pub(crate) fn interpolate(&self, u: f32, v: f32, at: impl Fn(u32, u32) -> Vec3A) -> Vec3A {
        let (right, bottom) = self.last();
        let u = u.clamp(0.0, right as f32);
        let v = v.clamp(0.0, bottom as f32);
        let (x0, y0) = (u as u32, v as u32);
        let (fx, fy) = (u - x0 as f32, v - y0 as f32);
        let (x1, y1) = ((x0 + 1).min(right), (y0 + 1).min(bottom));
        at(x0, y0)
            .lerp(at(x1, y0), fx)
            .lerp(at(x0, y1).lerp(at(x1, y1), fx), fy)
    }

    /// Whether an object at depth `z` is shown at a pixel, rather than the real scene.
    #[inline]
    pub(crate) fn shows(&self, x: u32, y: u32, z: f32) -> bool {
        let real = self.depth_at(x, y);
        if real.is_nan() {
            // With `Fill`, NaN remains only if no measurement is in reach: nothing is known to be in front, and
            // an object must not disappear together with the depth.
            self.settings.holes != HolePolicy::ShowReal
        } else {
            // Depth is known to within the sensor's noise. Within it the object is shown, so that noise does not
            // hide the object's foot on a real surface.
            z <= real + self.settings.occlusion_sigmas * depth_sigma_m(real)
        }
    }
}

/// Normals of the 2x2 blocks of one 4x4 block of pixels, computed when first needed.
#[derive(Default)]
pub(crate) struct NormalMemo {
    of_block: [[Option<Vec3A>; 2]; 2],
}
