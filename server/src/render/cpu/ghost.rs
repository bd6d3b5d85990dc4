//! The ghost stage: depth as a surface, and depth with its holes filled.

use crate::camera::Intrinsics;
use crate::frame::DepthImage;
use crate::ghost::{FilledDepth, GhostSettings, GhostSurface, HolePolicy};
use crate::render::threads::Workers;

/// Builds what depends on depth alone. On two threads, if one is free.
pub(crate) fn rebuild(
    ghost: &mut GhostSurface,
    filled: &mut FilledDepth,
    depth: &DepthImage,
    intrinsics: &Intrinsics,
    settings: &GhostSettings,
    workers: Workers<'_>,
) {
    workers.join(
        || ghost.rebuild(depth, intrinsics, settings),
        || {
            if settings.holes == HolePolicy::Fill {
                filled.rebuild(depth);
            }
        },
    );
}
