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
    /// The images asked for.
    pub aovs: Vec<(Aov, AovImage)>,
    /// Nanoseconds per stage, in the order of [`Stage::ALL`].
    pub stage_ns: [u64; Stage::ALL.len()],
    /// Nanoseconds from decoded frame to finished RGBA, the ghost surface counted in full even where
    /// it was built during decoding, and time that it was held for other frames included.
    pub total_ns: u64,
    /// Counts.
    pub stats: FrameStats,
    /// What was made with less than asked for, to keep [`RenderSettings::budget_ms`](super::RenderSettings::budget_ms).
    pub lowered: Vec<Lowered>,
}
