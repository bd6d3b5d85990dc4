//! Everything a user can choose about a picture, one struct a file.

mod ambient;
mod bloom;
mod caustics;
mod glare;
mod lens;
mod range;
mod shadows;

pub use ambient::AmbientSettings;
pub use bloom::{BloomMethod, BloomSettings};
pub use caustics::CausticSettings;
pub use glare::GlareSettings;
pub use lens::LensSettings;
pub use range::SettingsError;
pub use shadows::{ShadowMethod, ShadowSettings};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ghost::GhostSettings;
use crate::json::SchemaLink;
use range::within;

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
    /// Heuristic: how far neighbouring pixels share the rays of their rough reflections, as a share of the
    /// width of the lobe, 0 (not at all) to 1. Pixels whose lobes look the same way within that send fewer
    /// rays, of which each takes the mean. Too large: rough reflections are more blurred than their
    /// roughness says.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub glossy_sharing: f32,
    /// Rays per pixel on edges of virtual objects, 1 (off) to 64.
    #[schemars(range(min = 1, max = 64))]
    pub edge_samples: u32,
    /// Difference in displayed brightness to a neighbour from which a virtual pixel gets
    /// `edge_samples` rays as well, 0..=1; 1 leaves them to outlines.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub edge_contrast: f32,
    /// Heuristic: error of a simplified mesh in pixels, 0 (meshes are shown as they are) to 16. Meshes of
    /// more than 32 thousand triangles have coarser levels of detail, each with a measured error, and a
    /// frame shows the coarsest whose error is below this where the object is nearest. A concave mirror or
    /// a lens may magnify it. Too large: outlines show corners, reflections ripple.
    #[serde(alias = "detail_px")]
    #[schemars(range(min = 0.0, max = 16.0))]
    pub lod_error_px: f32,
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
            glossy_sharing: 0.25,
            edge_samples: 4,
            edge_contrast: 0.1,
            lod_error_px: 0.5,
            lens: LensSettings::default(),
            bloom: BloomSettings::default(),
            glare: GlareSettings::default(),
            budget_ms: None,
        }
    }
}

impl RenderSettings {
    /// Milliseconds that a frame may take; none: as long as it needs.
    pub(super) fn limit_ms(&self) -> Option<f32> {
        self.budget_ms.filter(|&ms| ms > 0.0)
    }

    /// Checks every field against the range that its documentation states.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let ghost = &self.ghost;
        within("ghost.edge_relative", ghost.edge_relative, 0.001, 1.0)?;
        within("ghost.edge_sigmas", ghost.edge_sigmas, 0.0, 20.0)?;
        within("ghost.occlusion_sigmas", ghost.occlusion_sigmas, 0.0, 20.0)?;
        within("ghost.bias_sigmas", ghost.bias_sigmas, 0.0, 20.0)?;
        self.shadows.validate()?;
        self.ambient.validate()?;
        self.caustics.validate()?;
        within("max_bounces", self.max_bounces, 0, 8)?;
        within("glossy_samples", self.glossy_samples, 1, 64)?;
        within("glossy_sharing", self.glossy_sharing, 0.0, 1.0)?;
        within("edge_samples", self.edge_samples, 1, 64)?;
        within("edge_contrast", self.edge_contrast, 0.0, 1.0)?;
        within("lod_error_px", self.lod_error_px, 0.0, 16.0)?;
        self.lens.validate()?;
        within("budget_ms", self.budget_ms.unwrap_or(0.0), 0.0, 10_000.0)?;
        self.bloom.validate()?;
        self.glare.validate()
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
