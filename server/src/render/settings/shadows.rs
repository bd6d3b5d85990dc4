//! Soft shadows.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::range::{SettingsError, within};

/// Soft shadows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ShadowSettings {
    /// Which rays are cast.
    pub method: ShadowMethod,
    /// Rays per light in penumbra (adaptive) or everywhere (naive), 5..=256.
    #[schemars(range(min = 5, max = 256))]
    pub samples: u32,
    /// RT2AR's mean filter over penumbra pixels, radius in pixels, 0 (off) to 4. Hides the grain of
    /// few samples; with 20 it costs more sharpness than it takes noise (`ghostlight compare`).
    #[schemars(range(min = 0, max = 4))]
    pub filter_radius_px: u32,
    /// Cast no rays where one walk of a tree proves a whole block of pixels lit past everything
    /// virtual, or past everything real. Never changes a pixel; off only to see what it saves.
    pub skip_proven: bool,
}

/// Ways to cast shadow rays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShadowMethod {
    /// No shadows.
    Off,
    /// One ray to the light's centre.
    Hard,
    /// All samples at every pixel.
    Naive,
    /// RT2AR's: five first samples, the rest only in penumbra.
    #[default]
    Adaptive,
    /// As `adaptive`, and beside penumbra too: a pixel of the real surface next to one in penumbra
    /// takes half of the rest, though its own first five agree, and all where those do not. Finds
    /// more of what falls between the five; two more samples in penumbra bring more for the same time
    /// (`ghostlight compare`), but thin occluders are missed less often this way.
    AdaptiveNeighbours,
}

impl Default for ShadowSettings {
    fn default() -> Self {
        Self {
            method: ShadowMethod::Adaptive,
            // With these the error is below that of 20 from every pixel, on the bundled scenes.
            samples: 22,
            filter_radius_px: 0,
            skip_proven: true,
        }
    }
}

impl ShadowSettings {
    /// Checks every field against the range that its documentation states.
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        within("shadows.samples", self.samples, 5, 256)?;
        within("shadows.filter_radius_px", self.filter_radius_px, 0, 4)
    }
}
