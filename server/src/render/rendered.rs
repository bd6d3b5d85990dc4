//! The result of a frame.

use crate::frame::ColorImage;

use super::aov::{Aov, AovImage};
use super::budget::Lowered;
use super::stage::Stage;
use super::stats::FrameStats;

/// A finished frame.
#[derive(Debug, Clone)]
pub struct Rendered {
    /// The composite.
    pub color: ColorImage,
    /// The requested AOVs.
    pub aovs: Vec<(Aov, AovImage)>,
    /// Nanoseconds per stage, in the order of [`Stage::ALL`].
    pub stage_ns: [u64; Stage::ALL.len()],
    /// Nanoseconds from decoded frame to finished RGBA. Includes the whole ghost stage even if it ran during
    /// decoding, and the time for which the frame was held for other frames.
    pub total_ns: u64,
    /// Counts of the frame.
    pub stats: FrameStats,
    /// Settings reduced to keep [`RenderSettings::budget_ms`](super::RenderSettings::budget_ms).
    pub lowered: Vec<Lowered>,
}
