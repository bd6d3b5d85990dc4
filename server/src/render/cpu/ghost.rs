//! The ghost stage: builds the ghost surface, and fills the holes of the depth map.

use crate::camera::Intrinsics;
use crate::frame::DepthImage;
use crate::ghost::{FilledDepth, GhostSettings, GhostSurface, HolePolicy};
use crate::render::threads::Workers;

/// Builds everything that depends on depth alone, on two threads if one is free.
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
