//! Glare.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::range::{SettingsError, not_negative, within};

/// Glare: star-shaped streaks around the brightest highlights (RT2AR, section IV.F).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GlareSettings {
    /// On or off.
    pub enabled: bool,
    /// Linear luminance above which light streaks; a little above bloom's.
    #[schemars(range(min = 0.0))]
    pub threshold: f32,
    /// Passes n; each reaches four times farther, 1..=5.
    #[schemars(range(min = 1, max = 5))]
    pub passes: u32,
    /// Samples s per pass and direction, 1..=16.
    #[schemars(range(min = 1, max = 16))]
    pub samples: u32,
    /// Attenuation a, 0.85..=0.95.
    #[schemars(range(min = 0.85, max = 0.95))]
    pub attenuation: f32,
    /// Weight of the streaks in the sum, 0..=1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub intensity: f32,
}

impl Default for GlareSettings {
    fn default() -> Self {
        Self {
            enabled: false,
            threshold: 1.5,
            passes: 3,
            samples: 4,
            attenuation: 0.92,
            intensity: 0.1,
        }
    }
}

impl GlareSettings {
    /// Checks every field against the range that its documentation states.
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        not_negative("glare.threshold", self.threshold)?;
        within("glare.passes", self.passes, 1, 5)?;
        within("glare.samples", self.samples, 1, 16)?;
        within("glare.attenuation", self.attenuation, 0.85, 0.95)?;
        within("glare.intensity", self.intensity, 0.0, 1.0)
    }
}
