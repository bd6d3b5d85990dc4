//! Surface materials, in glTF terms.

use std::sync::Arc;

use glam::Vec3;

use super::Texture;

/// Interpretation of alpha (glTF 2.0, 3.9.4).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum AlphaMode {
    /// Alpha is ignored.
    #[default]
    Opaque,
    /// Texels with alpha below the cutoff are removed.
    Mask {
        /// Cutoff, 0..=1.
        cutoff: f32,
    },
    /// Alpha is the coverage of the surface: the rest shows the background.
    Blend {
        /// Multiplies the alpha of texture and vertex colours, 0..=1.
        opacity: f32,
    },
}

/// A surface in glTF's metallic-roughness model with transmission, ior and volume.
#[derive(Debug, Clone)]
pub struct Material {
    /// Name, for messages.
    pub name: String,
    /// Diffuse albedo of a dielectric, F0 of a metal; linear.
    pub base_color: Vec3,
    /// Multiplies `base_color`; its alpha is used for [`Material::alpha`].
    pub base_color_texture: Option<Arc<Texture>>,
    /// Whether a mesh's vertex colours multiply `base_color` too; their alpha is used for [`Material::alpha`].
    pub vertex_colors: bool,
    /// Alpha mode.
    pub alpha: AlphaMode,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 (mirror) to 1; GGX alpha is its square.
    pub roughness: f32,
    /// Multiplies metallic (blue) and roughness (green).
    pub metallic_roughness_texture: Option<Arc<Texture>>,
    /// Emitted radiance, linear.
    pub emissive: Vec3,
    /// Multiplies `emissive`.
    pub emissive_texture: Option<Arc<Texture>>,
    /// Red: share of ambient light that arrives, for occlusion by details finer than the mesh.
    pub occlusion_texture: Option<Arc<Texture>>,
    /// Strength of `occlusion_texture`, 0..=1.
    pub occlusion_strength: f32,
    /// Tangent-space normals (needs texture coordinates).
    pub normal_texture: Option<Arc<Texture>>,
    /// Scales the normal map's x and y.
    pub normal_scale: f32,
    /// Share of the light entering the surface that is refracted instead of diffused, 0..=1.
    pub transmission: f32,
    /// Strength of a clear coat of index 1.5 over everything else, 0..=1.
    pub clearcoat: f32,
    /// Perceptual roughness of the clear coat, 0..=1.
    pub clearcoat_roughness: f32,
    /// Index of refraction relative to air, >= 1.
    pub ior: f32,
    /// Planar refraction (RT2AR, section IV.D): a thin sheet, behind which the ray is in its old medium. Otherwise
    /// the volume is modelled: the ray's current medium is tracked.
    pub thin: bool,
    /// Colour of white light after `attenuation_distance_m` inside (Beer-Lambert).
    pub attenuation_color: Vec3,
    /// Distance in metres; infinite for a clear medium.
    pub attenuation_distance_m: f32,
}

impl Default for Material {
    /// A mid-grey matte material.
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: Vec3::splat(0.5),
            base_color_texture: None,
            vertex_colors: true,
            alpha: AlphaMode::Opaque,
            metallic: 0.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            emissive: Vec3::ZERO,
            emissive_texture: None,
            occlusion_texture: None,
            occlusion_strength: 1.0,
            normal_texture: None,
            normal_scale: 1.0,
            transmission: 0.0,
            clearcoat: 0.0,
            clearcoat_roughness: 0.0,
            ior: 1.5,
            thin: false,
            attenuation_color: Vec3::ONE,
            attenuation_distance_m: f32::INFINITY,
        }
    }
}
