//! Depth maps to trace, and the rays to trace.

use std::ops::Range;

use super::super::ghost_rays::{MirrorBall, random_rays, shadow_rays};
use crate::oracle::ghost::GhostOracle;
use ghostlight::accel::Ray;
use ghostlight::camera::Intrinsics;
use ghostlight::frame::DepthImage;
use ghostlight::ghost::GhostSurface;
use ghostlight::numerics::uniform;
use ghostlight::render::GhostSettings;

/// A depth map to trace.
pub(super) struct Map {
    pub(super) name: String,
    pub(super) depth: DepthImage,
    pub(super) surface: GhostSurface,
    pub(super) oracle: GhostOracle,
    pub(super) ball: MirrorBall,
}

impl Map {
    pub(super) fn new(
        name: impl Into<String>,
        depth: &DepthImage,
        intrinsics: &Intrinsics,
    ) -> Self {
        let settings = GhostSettings::default();
        let mut surface = GhostSurface::new();
        surface.rebuild(depth, intrinsics, &settings);
        Self {
            name: name.into(),
            depth: depth.clone(),
            oracle: GhostOracle::new(depth, intrinsics, &settings),
            ball: MirrorBall::before(&surface),
            surface,
        }
    }

    /// A window of the map; its size and position depend on `number`.
    pub(super) fn window(&self, number: u32) -> Self {
        let r = |dimension| uniform(number, 11, dimension);
        let side = |of: u32, dimension| (8 + (r(dimension) * 65.0) as u32).min(of);
        let (width, height) = (side(self.depth.width, 0), side(self.depth.height, 1));
        let x0 = (r(2) * (self.depth.width - width + 1) as f32) as u32;
        let y0 = (r(3) * (self.depth.height - height + 1) as f32) as u32;
        let z_m = (y0..y0 + height)
            .flat_map(|y| (x0..x0 + width).map(move |x| (x, y)))
            .map(|(x, y)| self.depth.z_m[(y * self.depth.width + x) as usize])
            .collect();
        let k = self.surface.intrinsics();
        let intrinsics = Intrinsics {
            cx: k.cx - f64::from(x0),
            cy: k.cy - f64::from(y0),
            width,
            height,
            ..*k
        };
        Self::new(
            "",
            &DepthImage::from_metres(width, height, z_m),
            &intrinsics,
        )
    }

    /// `n`, reduced for maps larger than 640x480.
    pub(super) fn fewer(&self, n: u32) -> u32 {
        let pixels = self.depth.width * self.depth.height;
        (u64::from(n) * 640 * 480 / u64::from(pixels.max(640 * 480))) as u32
    }
}

/// Names of the ray sets. The timed rays of the ball are in scan order.
pub(super) const SETS: [&str; 3] = ["random reflections", "mirror ball", "shadow rays"];

pub(super) fn timed_rays(map: &Map, set: usize, n: u32) -> Vec<Ray> {
    match set {
        0 => random_rays(&map.surface, 0..n, 3),
        1 => {
            let all = map.ball.rays(&map.surface);
            // A band across the middle, so that rays are as coherent as the rows of a picture.
            let skip = all.len().saturating_sub(n as usize) / 2;
            all.into_iter().skip(skip).take(n as usize).collect()
        }
        _ => shadow_rays(&map.surface, 0..n, 5),
    }
}

pub(super) fn checked_rays(map: &Map, set: usize, numbers: Range<u32>) -> Vec<Ray> {
    match set {
        0 => random_rays(&map.surface, numbers, 7),
        1 => map.ball.rays_at_random(&map.surface, numbers, 8),
        _ => shadow_rays(&map.surface, numbers, 9),
    }
}
