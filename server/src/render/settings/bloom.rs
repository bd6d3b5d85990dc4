//! Bloom.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::range::{SettingsError, not_negative, within};

/// Bloom: highlights of virtual objects bleed over their surroundings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BloomSettings {
    /// On or off.
    pub enabled: bool,
    /// Which form.
    pub method: BloomMethod,
    /// Linear luminance above which light bleeds, 0..; 1 is the display's white.
    #[schemars(range(min = 0.0))]
    pub threshold: f32,
    /// Width of the soft knee below the threshold, as a share of it, 0..=1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub knee: f32,
    /// Share of the light above the threshold that bleeds, 0..=1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub intensity: f32,
    /// Pyramid levels, 1..=8; each doubles the reach.
    #[schemars(range(min = 1, max = 8))]
    pub levels: u32,
}

/// Forms of bloom.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BloomMethod {
    /// RT2AR's: threshold, downscale, successive Gaussians, bilinear weighted sum.
    Gaussians,
    /// Energy-conserving pyramid with a soft knee.
    #[default]
    Pyramid,
}

impl Default for BloomSettings {
    fn default() -> Self {
        Self {
            enabled: true,
            method: BloomMethod::Pyramid,
            threshold: 1.0,
            knee: 0.5,
            intensity: 0.2,
            levels: 5,
        }
    }
}

impl BloomSettings {
    /// Checks every field against the range that its documentation states.
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        not_negative("bloom.threshold", self.threshold)?;
        within("bloom.knee", self.knee, 0.0, 1.0)?;
        within("bloom.intensity", self.intensity, 0.0, 1.0)?;
        within("bloom.levels", self.levels, 1, 8)
    }
}
