//! Decides which neighbouring depths belong to one surface.

use fearless_simd::{Simd, SimdBase, f32x16, mask32x16};

use super::settings::GhostSettings;
use crate::frame::{SIGMA_LEAST_M, SIGMA_NEAR_M, SIGMA_PER_M2, depth_sigma_m};

/// Condition under which two depths belong to one surface: their difference is below `edge_relative z +
/// edge_sigmas sigma(z)` at the nearer of the two, because a false connection would smear the nearer surface.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Connection {
    relative: f32,
    sigmas: f32,
}

impl Connection {
    pub(crate) fn new(settings: &GhostSettings) -> Self {
        Self {
            relative: settings.edge_relative,
            sigmas: settings.edge_sigmas,
        }
    }

    /// Whether two depths are connected; false if either is invalid.
    #[inline(always)]
    pub(crate) fn joins(&self, a: f32, b: f32) -> bool {
        let nearer = a.min(b);
        (a - b).abs() < self.relative * nearer + self.sigmas * depth_sigma_m(nearer)
    }

    /// A difference below which two depths are always connected, if neither is nearer than `nearest`.
    pub(crate) fn least_step(&self, nearest: f32) -> f32 {
        self.relative * nearest + self.sigmas * SIGMA_LEAST_M
    }

    /// [`Self::joins`] for sixteen pairs, with the same operations.
    #[inline(always)]
    pub(crate) fn joins_simd<S: Simd>(&self, a: f32x16<S>, b: f32x16<S>) -> mask32x16<S> {
        let nearer = a.min(b);
        // `depth_sigma_m` for sixteen depths.
        let d = nearer - SIGMA_NEAR_M;
        let sigma = d * d * SIGMA_PER_M2 + SIGMA_LEAST_M;
        (a - b)
            .abs()
            .simd_lt(nearer * self.relative + sigma * self.sigmas)
    }
}
