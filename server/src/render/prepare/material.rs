//! Properties of a material that are known without a hit.

use crate::scene::{AlphaMode, Material};

/// Roughness below which a surface is traced as a perfect mirror: its GGX lobe is then narrower than a pixel of a
/// curved object's reflection.
pub(crate) const MIRROR_ROUGHNESS: f32 = 0.06;

/// Roughness from which on a dielectric's reflection of the surroundings is computed from their irradiance: it is
/// 4 % of a lobe as wide as a diffuse one, and one or two rays of it would be noisy.
pub(crate) const BROAD_ROUGHNESS: f32 = 0.55;

/// Roughness from which on a metal's reflection is so wide that it looks like ambient light.
const CAUSTIC_ROUGHNESS: f32 = 0.5;

/// Whether direct light on a material is visible: not on a mirror or clear glass.
pub(crate) fn needs_light(material: &Material) -> bool {
    let textured = material.metallic_roughness_texture.is_some();
    let diffuse = material.transmission < 1.0 && (material.metallic < 1.0 || textured);
    let glossy = material.roughness >= MIRROR_ROUGHNESS || textured;
    diffuse || material.clearcoat > 0.0 || (glossy && material.transmission == 0.0)
}

/// Whether a material transmits light, by refraction or because it is blended.
pub(crate) fn lets_light_through(material: &Material) -> bool {
    material.transmission > 0.0 || matches!(material.alpha, AlphaMode::Blend { .. })
}

/// Whether transmitted light changes its direction in a material.
pub(crate) fn bends_light(material: &Material) -> bool {
    material.transmission > 0.0 && !material.thin
}

/// Whether any part of a surface can cause caustics.
pub(crate) fn throws_caustics(material: &Material) -> bool {
    let smooth =
        material.roughness < CAUSTIC_ROUGHNESS || material.metallic_roughness_texture.is_some();
    bends_light(material) || (material.metallic > 0.0 && smooth)
}

/// Whether a surface reflects or refracts photons.
pub(crate) fn sends_on(material: &Material, metallic: f32, roughness: f32) -> bool {
    lets_light_through(material) || (metallic > 0.0 && roughness < CAUSTIC_ROUGHNESS)
}

/// Whether a material can have rough reflections or refractions.
pub(crate) fn scatters_roughly(material: &Material) -> bool {
    let textured = material.metallic_roughness_texture.is_some();
    textured
        || (material.roughness >= MIRROR_ROUGHNESS
            && (material.metallic > 0.0
                || material.transmission > 0.0
                || material.roughness < BROAD_ROUGHNESS))
        || (material.clearcoat > 0.0 && material.clearcoat_roughness >= MIRROR_ROUGHNESS)
}
