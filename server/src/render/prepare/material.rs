//! What a material does with light, known without a hit on it.

use crate::scene::{AlphaMode, Material};

/// Roughness under which a surface is traced as a perfect mirror: its GGX lobe is then narrower
/// than a pixel of a curved object's reflection.
pub(crate) const MIRROR_ROUGHNESS: f32 = 0.06;

/// Roughness from which on a dielectric's reflection of its surroundings is taken from their
/// irradiance: it is 4 % of a lobe as wide as a diffuse one, and a ray or two of it would be grain.
pub(crate) const BROAD_ROUGHNESS: f32 = 0.55;

/// Roughness from which on a metal's reflection is too wide to be told from ambient light.
const CAUSTIC_ROUGHNESS: f32 = 0.5;

/// Whether light that falls on a material directly can be seen: not on a mirror or clear glass.
pub(crate) fn needs_light(material: &Material) -> bool {
    let textured = material.metallic_roughness_texture.is_some();
    let diffuse = material.transmission < 1.0 && (material.metallic < 1.0 || textured);
    let glossy = material.roughness >= MIRROR_ROUGHNESS || textured;
    diffuse || material.clearcoat > 0.0 || (glossy && material.transmission == 0.0)
}

/// Whether light goes on through a material, refracted or between what is there of it.
pub(crate) fn lets_light_through(material: &Material) -> bool {
    material.transmission > 0.0 || matches!(material.alpha, AlphaMode::Blend { .. })
}

/// Whether light that goes on through a material changes its direction on the way.
pub(crate) fn bends_light(material: &Material) -> bool {
    material.transmission > 0.0 && !material.thin
}

/// Whether a surface can throw caustics anywhere on it.
pub(crate) fn throws_caustics(material: &Material) -> bool {
    let smooth =
        material.roughness < CAUSTIC_ROUGHNESS || material.metallic_roughness_texture.is_some();
    bends_light(material) || (material.metallic > 0.0 && smooth)
}

/// Whether a surface sends photons on.
pub(crate) fn sends_on(material: &Material, metallic: f32, roughness: f32) -> bool {
    lets_light_through(material) || (metallic > 0.0 && roughness < CAUSTIC_ROUGHNESS)
}

/// Whether rough reflections or refractions may leave a material.
pub(crate) fn scatters_roughly(material: &Material) -> bool {
    let textured = material.metallic_roughness_texture.is_some();
    textured
        || (material.roughness >= MIRROR_ROUGHNESS
            && (material.metallic > 0.0
                || material.transmission > 0.0
                || material.roughness < BROAD_ROUGHNESS))
        || (material.clearcoat > 0.0 && material.clearcoat_roughness >= MIRROR_ROUGHNESS)
}
