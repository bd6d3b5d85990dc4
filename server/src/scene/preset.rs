//! Materials by name, and overrides of a scene document.

use glam::Vec3;

use super::Material;
use super::document::{MaterialSpec, Preset};
use super::triple::Triple;

impl Preset {
    /// All presets, in display order.
    pub const ALL: [Self; 8] = [
        Self::Matte,
        Self::Plastic,
        Self::BrushedMetal,
        Self::Mirror,
        Self::Glass,
        Self::Gold,
        Self::Copper,
        Self::Chrome,
    ];

    /// Name in documents and for `--material`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Matte => "matte",
            Self::Plastic => "plastic",
            Self::BrushedMetal => "brushed_metal",
            Self::Mirror => "mirror",
            Self::Glass => "glass",
            Self::Gold => "gold",
            Self::Copper => "copper",
            Self::Chrome => "chrome",
        }
    }

    /// Description for people.
    pub fn about(self) -> &'static str {
        match self {
            Self::Matte => "mid-grey, diffuse",
            Self::Plastic => "mid-grey under a clear, fairly smooth coat",
            Self::BrushedMetal => "grey metal with a blurred reflection",
            Self::Mirror => "a perfect mirror",
            Self::Glass => "clear window glass, refracting as a solid",
            Self::Gold => "polished gold",
            Self::Copper => "polished copper",
            Self::Chrome => "polished chrome",
        }
    }

    /// The material.
    pub fn material(self) -> Material {
        // Reflectances of metals at normal incidence, linear Rec.709 (Lagarde 2011, "Feeding a
        // physically based shading model").
        let metal = |name: &str, r, g, b, roughness| Material {
            name: name.to_owned(),
            base_color: Vec3::new(r, g, b),
            metallic: 1.0,
            roughness,
            ..Material::default()
        };
        let dielectric = |name: &str, base: f32, roughness| Material {
            name: name.to_owned(),
            base_color: Vec3::splat(base),
            roughness,
            ..Material::default()
        };
        match self {
            Self::Matte => dielectric("matte", 0.5, 1.0),
            Self::Plastic => dielectric("plastic", 0.5, 0.2),
            Self::BrushedMetal => metal("brushed_metal", 0.77, 0.77, 0.78, 0.35),
            Self::Mirror => metal("mirror", 0.97, 0.97, 0.97, 0.0),
            Self::Glass => Material {
                transmission: 1.0,
                ior: 1.5,
                ..dielectric("glass", 1.0, 0.0)
            },
            Self::Gold => metal("gold", 1.0, 0.766, 0.336, 0.1),
            Self::Copper => metal("copper", 0.955, 0.638, 0.538, 0.1),
            Self::Chrome => metal("chrome", 0.549, 0.556, 0.554, 0.05),
        }
    }
}

impl MaterialSpec {
    /// The material of a part: the file's own, with the document's overrides.
    pub(super) fn apply(&self, own: &Material) -> Material {
        let mut material = match self.preset {
            // A preset replaces the file's material completely, vertex colours included.
            Some(preset) => Material {
                vertex_colors: false,
                ..preset.material()
            },
            None => own.clone(),
        };
        let rgb = |slot: &mut Vec3, value: Option<Triple>| {
            if let Some(Triple(rgb)) = value {
                *slot = Vec3::from(rgb.map(|c| c as f32));
            }
        };
        let number = |slot: &mut f32, value: Option<f64>| {
            if let Some(x) = value {
                *slot = x as f32;
            }
        };
        rgb(&mut material.base_color, self.base_color);
        number(&mut material.metallic, self.metallic);
        number(&mut material.roughness, self.roughness);
        number(&mut material.transmission, self.transmission);
        number(&mut material.ior, self.ior);
        rgb(&mut material.emissive, self.emissive);
        rgb(&mut material.attenuation_color, self.attenuation_color);
        number(
            &mut material.attenuation_distance_m,
            self.attenuation_distance_m,
        );
        material.thin = self.thin.unwrap_or(material.thin);
        material
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overrides_change_only_what_they_name() {
        let spec = MaterialSpec {
            preset: Some(Preset::Glass),
            ior: Some(1.33),
            base_color: Some(Triple([0.9, 1.0, 0.9])),
            ..MaterialSpec::default()
        };
        let material = spec.apply(&Material::default());
        assert_eq!(
            (material.ior, material.transmission, material.roughness),
            (1.33, 1.0, 0.0)
        );
        assert_eq!(material.base_color, Vec3::new(0.9, 1.0, 0.9));
        let own = Material {
            metallic: 1.0,
            ..Material::default()
        };
        let spec = MaterialSpec {
            roughness: Some(0.25),
            ..MaterialSpec::default()
        };
        let material = spec.apply(&own);
        assert_eq!((material.metallic, material.roughness), (1.0, 0.25));
    }
}
