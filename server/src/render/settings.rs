//! Everything a user can choose about a picture.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ghost::GhostSettings;
use crate::json::SchemaLink;

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
    /// Heuristic: the difference in displayed brightness between two halves of a pixel's rays from
    /// which it and its neighbours take twice as many, up to sixteen times, 0..=1; 1 leaves all with
    /// `samples`. What needs them is mostly the small bright disc that a lamp mirrored in an object
    /// becomes. Small is smooth and slow; large leaves specks.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub grain: f32,
}

impl Default for LensSettings {
    fn default() -> Self {
        Self {
            radius_m: 0.0,
            focus_m: 1.0,
            focus_px: None,
            samples: 25,
            grain: 0.1,
        }
    }
}

/// Everything a user can choose about a picture; every field optional in JSON.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "Ghostlight render settings")]
pub struct RenderSettings {
    /// Where these settings' JSON Schema lies, for editors; ignored.
    #[serde(rename = "$schema", skip_serializing)]
    pub schema: SchemaLink,
    /// Ghost surface.
    pub ghost: GhostSettings,
    /// Soft shadows.
    pub shadows: ShadowSettings,
    /// Ambient light.
    pub ambient: AmbientSettings,
    /// Caustics.
    pub caustics: CausticSettings,
    /// Reflections and refractions followed in a row, 0..=8.
    #[schemars(range(min = 0, max = 8))]
    pub max_bounces: u32,
    /// Rays that estimate a rough reflection at its first bounce, 1..=64.
    #[schemars(range(min = 1, max = 64))]
    pub glossy_samples: u32,
    /// Rays per pixel on edges of virtual objects, 1 (off) to 64.
    #[schemars(range(min = 1, max = 64))]
    pub edge_samples: u32,
    /// Difference in displayed brightness to a neighbour from which a virtual pixel gets
    /// `edge_samples` rays as well, 0..=1; 1 leaves them to outlines.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub edge_contrast: f32,
    /// Heuristic: how far a large mesh may be off, pixels, 0 (never: as it is) to 16. Meshes of more
    /// than 32 thousand triangles have coarser versions, each with an estimate of its error, and a
    /// frame shows the coarsest that is within this where the object is nearest. What is seen in
    /// a concave mirror or a lens may be larger than that. Too large and outlines show corners and
    /// mirrors ripples.
    #[schemars(range(min = 0.0, max = 16.0))]
    pub detail_px: f32,
    /// Depth of field.
    pub lens: LensSettings,
    /// Bloom.
    pub bloom: BloomSettings,
    /// Glare.
    pub glare: GlareSettings,
    /// Milliseconds that a frame may take (`total_ms`), 0 (as long as it needs) to 10000. Over it,
    /// samples, bounces and the detail of large meshes are lowered step by step and each frame says
    /// which; pictures then depend on how fast the machine is. Too small and every frame is made with
    /// the least. Not given or null: where frames come at a rate, as in `serve` and `demo`, what keeps
    /// it (0.85 of the time between two frames); else as long as it needs.
    #[schemars(range(min = 0.0, max = 10_000.0))]
    pub budget_ms: Option<f32>,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            schema: SchemaLink,
            ghost: GhostSettings::default(),
            shadows: ShadowSettings::default(),
            ambient: AmbientSettings::default(),
            caustics: CausticSettings::default(),
            max_bounces: 5,
            glossy_samples: 8,
            edge_samples: 4,
            edge_contrast: 0.1,
            detail_px: 0.5,
            lens: LensSettings::default(),
            bloom: BloomSettings::default(),
            glare: GlareSettings::default(),
            budget_ms: None,
        }
    }
}

/// A setting outside its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: expected {expected}, got {got}")]
pub struct SettingsError {
    /// Which one, as in the JSON: `bloom.levels`.
    pub field: &'static str,
    /// Its range.
    pub expected: String,
    /// What it is.
    pub got: String,
}

impl RenderSettings {
    /// Milliseconds that a frame may take; none: as long as it needs.
    pub(super) fn limit_ms(&self) -> Option<f32> {
        self.budget_ms.filter(|&ms| ms > 0.0)
    }

    /// Checks every field against the range that its documentation states.
    pub fn validate(&self) -> Result<(), SettingsError> {
        fn within<T: PartialOrd + std::fmt::Display + Copy>(
            field: &'static str,
            got: T,
            least: T,
            most: T,
        ) -> Result<(), SettingsError> {
            // False for NaN.
            if (least..=most).contains(&got) {
                return Ok(());
            }
            Err(SettingsError {
                field,
                expected: format!("{least} to {most}"),
                got: got.to_string(),
            })
        }
        let not_negative = |field, got: f32| {
            if got.is_finite() && got >= 0.0 {
                return Ok(());
            }
            Err(SettingsError {
                field,
                expected: "a finite number, 0 or more".to_owned(),
                got: got.to_string(),
            })
        };
        within("ghost.edge_relative", self.ghost.edge_relative, 0.001, 1.0)?;
        within("ghost.edge_sigmas", self.ghost.edge_sigmas, 0.0, 20.0)?;
        within(
            "ghost.occlusion_sigmas",
            self.ghost.occlusion_sigmas,
            0.0,
            20.0,
        )?;
        within("ghost.bias_sigmas", self.ghost.bias_sigmas, 0.0, 20.0)?;
        within("shadows.samples", self.shadows.samples, 5, 256)?;
        within(
            "shadows.filter_radius_px",
            self.shadows.filter_radius_px,
            0,
            4,
        )?;
        within("ambient.samples", self.ambient.samples, 16, 256)?;
        within("caustics.photons", self.caustics.photons, 1000, 4_000_000)?;
        within("caustics.radius_m", self.caustics.radius_m, 0.0005, 0.1)?;
        within("max_bounces", self.max_bounces, 0, 8)?;
        within("glossy_samples", self.glossy_samples, 1, 64)?;
        within("edge_samples", self.edge_samples, 1, 64)?;
        within("edge_contrast", self.edge_contrast, 0.0, 1.0)?;
        within("detail_px", self.detail_px, 0.0, 16.0)?;
        within("lens.radius_m", self.lens.radius_m, 0.0, 0.1)?;
        within("lens.focus_m", self.lens.focus_m, 0.01, 1000.0)?;
        for at in self.lens.focus_px.into_iter().flatten() {
            not_negative("lens.focus_px", at)?;
        }
        within("lens.samples", self.lens.samples, 1, 256)?;
        within("lens.grain", self.lens.grain, 0.0, 1.0)?;
        within("budget_ms", self.budget_ms.unwrap_or(0.0), 0.0, 10_000.0)?;
        not_negative("bloom.threshold", self.bloom.threshold)?;
        within("bloom.knee", self.bloom.knee, 0.0, 1.0)?;
        within("bloom.intensity", self.bloom.intensity, 0.0, 1.0)?;
        within("bloom.levels", self.bloom.levels, 1, 8)?;
        not_negative("glare.threshold", self.glare.threshold)?;
        within("glare.passes", self.glare.passes, 1, 5)?;
        within("glare.samples", self.glare.samples, 1, 16)?;
        within("glare.attenuation", self.glare.attenuation, 0.85, 0.95)?;
        within("glare.intensity", self.glare.intensity, 0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_in_range_and_a_setting_that_is_not_is_named() {
        let defaults = RenderSettings::default();
        assert_eq!(defaults.validate(), Ok(()));
        let mut s = defaults;
        s.max_bounces = 9;
        let error = s.validate().unwrap_err().to_string();
        assert_eq!(error, "max_bounces: expected 0 to 8, got 9");
        let mut s = defaults;
        s.bloom.threshold = f32::INFINITY;
        let error = s.validate().unwrap_err().to_string();
        assert_eq!(
            error,
            "bloom.threshold: expected a finite number, 0 or more, got inf"
        );
        for number in [f32::NAN, -0.1, 1.5] {
            let mut s = defaults;
            s.glare.intensity = number;
            assert_eq!(s.validate().unwrap_err().field, "glare.intensity");
        }
        for budget_ms in [f32::NAN, -1.0, 10_001.0] {
            let mut s = defaults;
            s.budget_ms = Some(budget_ms);
            assert_eq!(s.validate().unwrap_err().field, "budget_ms");
        }
        for photons in [999, 4_000_001] {
            let mut s = defaults;
            s.caustics.photons = photons;
            assert_eq!(s.validate().unwrap_err().field, "caustics.photons");
        }
        for radius_m in [f32::NAN, 0.0, 0.2] {
            let mut s = defaults;
            s.caustics.radius_m = radius_m;
            assert_eq!(s.validate().unwrap_err().field, "caustics.radius_m");
        }
    }
}
