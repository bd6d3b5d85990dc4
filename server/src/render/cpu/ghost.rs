//! The ghost stage: depth as a surface, and depth with its holes filled.

use glam::DVec3;

use crate::camera::Intrinsics;
use crate::frame::DepthImage;
use crate::ghost::{FilledDepth, GhostSurface};
use crate::render::settings::{GhostSettings, HolePolicy};

/// Builds what depends on depth alone. On a render thread others help.
pub(crate) fn rebuild(
    ghost: &mut GhostSurface,
    filled: &mut FilledDepth,
    depth: &DepthImage,
    intrinsics: &Intrinsics,
    settings: &GhostSettings,
) {
    rayon::join(
        || ghost.rebuild(depth, intrinsics, settings),
        || {
            if settings.holes == HolePolicy::Fill {
                filled.rebuild(depth);
            }
        },
    );
}

/// The camera-space point and normal that a caller may stand objects on.
impl crate::scene::Surface for GhostSurface {
    fn plane_at(&self, u: f32, v: f32, radius_px: f32) -> Option<(DVec3, DVec3)> {
        GhostSurface::plane_at(self, u, v, radius_px.ceil().max(1.0) as u32)
            .map(|(p, n)| (p.as_dvec3(), n.as_dvec3()))
    }
}
