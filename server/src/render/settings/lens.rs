//! Depth of field.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::range::{SettingsError, not_negative, within};

/// Depth of field: a thin lens in front of everything virtual (Kan and Kaufmann 2012, *Depth of
/// Field Rendering in Augmented Reality*, section 3.1). A point at depth z becomes a disc of
/// `2 radius_m fx |1/focus - 1/z|` pixels across. The camera's own pixels are as its own lens left
/// them: radius and focus are to be those of that lens.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LensSettings {
    /// Radius of the aperture, metres, 0 (a pinhole: everything is sharp) to 0.1; focal length over
    /// twice the f-number, 0.0125 for 50 mm at f/2. Larger than the camera's and what is added looks
    /// like a miniature; the larger, the more pixels are traced and the more grain they show.
    #[schemars(range(min = 0.0, max = 0.1))]
    pub radius_m: f32,
    /// Depth in focus, metres along the optical axis, 0.01..=1000. Wrong, and virtual things are
    /// sharp where the camera's picture is not.
    #[schemars(range(min = 0.01, max = 1000.0))]
    pub focus_m: f32,
    /// Pixel (u, v) of the camera's picture to focus on, by the depth sensed around it in each frame;
    /// `focus_m` where nothing is sensed there, or outside the picture. Focus jumps where something
    /// passes in front of that pixel.
    #[schemars(inner(range(min = 0.0)))]
    pub focus_px: Option<[f32; 2]>,
    /// Rays per pixel that something out of focus may reach, 1..=256. Few show as grain.
    #[schemars(range(min = 1, max = 256))]
    pub samples: u32,
    /// Heuristic: noise that a pixel may show, 0..=1. Where the two halves of a pixel's rays differ by
    /// more in displayed brightness, the pixel and its neighbours take twice as many, up to sixteen
    /// times; 1 leaves all with `samples`. Needed mostly where a lamp mirrored in an object becomes a
    /// small bright disc. Small is smooth and slow; large leaves specks.
    #[serde(alias = "grain")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub noise_threshold: f32,
}

impl Default for LensSettings {
    fn default() -> Self {
        Self {
            radius_m: 0.0,
            focus_m: 1.0,
            focus_px: None,
            samples: 25,
            noise_threshold: 0.1,
        }
    }
}

impl LensSettings {
    /// Checks every field against the range that its documentation states.
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        within("lens.radius_m", self.radius_m, 0.0, 0.1)?;
        within("lens.focus_m", self.focus_m, 0.01, 1000.0)?;
        for at in self.focus_px.into_iter().flatten() {
            not_negative("lens.focus_px", at)?;
        }
        within("lens.samples", self.samples, 1, 256)?;
        within("lens.noise_threshold", self.noise_threshold, 0.0, 1.0)
    }
}
