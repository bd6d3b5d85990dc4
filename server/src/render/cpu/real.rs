//! What of a frame is real: its depth as a surface, and with holes filled.

use crate::camera::Intrinsics;
use crate::frame::{DepthImage, RgbdFrame};
use crate::ghost::{FilledDepth, GhostSurface};
use crate::render::{GhostSettings, HolePolicy, RenderSettings};

/// Depth per pixel that primary rays compare with and that shadows fall on.
pub(super) fn occlusion_depth<'a>(
    frame: &'a RgbdFrame,
    settings: &RenderSettings,
    filled: &'a [f32],
) -> &'a [f32] {
    match settings.ghost.holes {
        HolePolicy::Fill if filled.len() == frame.depth.z_m.len() => filled,
        _ => &frame.depth.z_m,
    }
}

/// Builds what depends on depth alone. On a render thread others help.
pub(super) fn rebuild(
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
