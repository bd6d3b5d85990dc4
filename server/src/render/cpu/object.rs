//! What of a scene the renderer wants to know at a glance, found once.

use glam::Vec3A;

use crate::scene::{Environment, EnvironmentLights, Harmonics, Light, Material, Scene};

use super::bsdf;
use super::scatter::MIRROR_ROUGHNESS;

/// An environment map ready for shading: what its lights do not carry.
pub(super) struct MapLight {
    pub(super) map: Environment,
    pub(super) ambient: Harmonics,
}

/// Whether light that falls on a material directly can be seen: not on a mirror or clear glass.
pub(super) fn needs_light(material: &Material) -> bool {
    let textured = material.metallic_roughness_texture.is_some();
    let diffuse = material.transmission < 1.0 && (material.metallic < 1.0 || textured);
    let glossy = material.roughness >= MIRROR_ROUGHNESS || textured;
    diffuse || (glossy && material.transmission == 0.0)
}

/// Two crossings of a clear boundary at normal incidence, and the material's own colour.
pub(super) fn shadow_tint(material: &Material) -> Vec3A {
    let enters = 1.0 - bsdf::f0_of_ior(material.ior);
    Vec3A::from(material.base_color) * (material.transmission * enters * enters)
}

/// The scene's lights; a scene with a map and no lights has its brightest parts as lights, and the
/// map's diffuse light is what they leave.
pub(super) fn lights_and_map(scene: &Scene) -> (Vec<Light>, Option<MapLight>) {
    let Some(map) = &scene.environment else {
        return (scene.lights.clone(), None);
    };
    if !scene.lights.is_empty() {
        return (
            scene.lights.clone(),
            Some(MapLight {
                map: map.clone(),
                ambient: map.harmonics(),
            }),
        );
    }
    let EnvironmentLights { lights, ambient } = map.to_lights(Environment::DEFAULT_LIGHTS);
    (
        lights,
        Some(MapLight {
            map: map.clone(),
            ambient,
        }),
    )
}
