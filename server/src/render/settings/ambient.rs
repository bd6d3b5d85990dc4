//! Ambient light.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::range::{SettingsError, within};

/// What virtual objects do to the ambient light of real surfaces: contact shadows, and the light that
/// they send back. Lamps have shadows of their own.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AmbientSettings {
    /// On or off. Off, objects seem to float.
    pub enabled: bool,
    /// Rays at each point that gathers, for each group of objects near it, 16 to 256 in steps of 16.
    /// Few show as faint blotches.
    #[schemars(range(min = 16, max = 256))]
    pub samples: u32,
    /// Whether objects send light back: their colour on what they stand on, and the light of what
    /// glows. Off, they are black to ambient light.
    pub bounce: bool,
}

impl Default for AmbientSettings {
    fn default() -> Self {
        Self {
            enabled: true,
            samples: 32,
            bounce: true,
        }
    }
}

impl AmbientSettings {
    /// Checks every field against the range that its documentation states.
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        within("ambient.samples", self.samples, 16, 256)
    }
}
