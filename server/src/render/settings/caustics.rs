//! Caustics.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::range::{SettingsError, within};

/// Caustics: light that mirrors and glass throw on diffuse surfaces, by photon mapping (Kan and
/// Kaufmann 2012, section 3.2). Off costs nothing and changes nothing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CausticSettings {
    /// On or off. On, what lets light through casts a full shadow, for its light arrives as photons.
    /// Not given or null: on where a lamp shines on solid glass, whose shadow is wrong without; the
    /// kernel then widens with the size of what throws them, so that few photons do not sparkle.
    pub enabled: Option<bool>,
    /// Photons per frame, 1000 to 4000000. Grain falls with their square root, time grows with them;
    /// each takes 64 bytes.
    #[schemars(range(min = 1000, max = 4_000_000))]
    pub photons: u32,
    /// Radius of the kernel that photons are blurred with, metres, 0.0005 to 0.1; in the picture
    /// never under one pixel. Too small shows grain, too large blurs and darkens fine lines
    /// and edges.
    #[schemars(range(min = 0.0005, max = 0.1))]
    pub radius_m: f32,
}

impl Default for CausticSettings {
    fn default() -> Self {
        Self {
            enabled: None,
            photons: 30_000,
            radius_m: 0.003,
        }
    }
}

impl CausticSettings {
    /// Whether photons are cast in a scene with or without solid glass under a lamp.
    pub fn wanted(&self, lit_glass: bool) -> bool {
        self.enabled.unwrap_or(lit_glass)
    }
}

impl CausticSettings {
    /// Checks every field against the range that its documentation states.
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        within("caustics.photons", self.photons, 1000, 4_000_000)?;
        within("caustics.radius_m", self.radius_m, 0.0005, 0.1)
    }
}
