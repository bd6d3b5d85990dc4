//! The scene's environment map ready for shading, and the lights taken from it.

use glam::Mat3A;

use crate::scene::{Environment, EnvironmentLights, Harmonics, Light, Scene};

use super::environment::{CoarseMap, Surroundings};
use super::map_levels::MapLevels;

/// An environment map ready for shading: what its lights do not carry.
pub(crate) struct MapLight {
    pub(crate) map: Environment,
    pub(crate) ambient: Harmonics,
    /// The same light, coarse.
    pub(crate) coarse: CoarseMap,
    /// What wider and wider lookups see of it.
    pub(crate) levels: MapLevels,
    /// Luminance above which its radiance is that of lights taken from it.
    pub(crate) threshold: f32,
}

impl MapLight {
    /// As a frame sees it.
    pub(crate) fn surroundings(&self, world_from_camera: Mat3A) -> Surroundings<'_> {
        Surroundings::Map {
            map: &self.map,
            world_from_camera,
            ambient: &self.ambient,
            coarse: &self.coarse,
            levels: &self.levels,
            threshold: self.threshold,
        }
    }
}

/// The scene's lights; a scene with a map and no lights has its brightest parts as lights, and the
/// map's diffuse light is what they leave.
pub(crate) fn lights_and_map(scene: &Scene) -> (Vec<Light>, Option<MapLight>) {
    let Some(map) = &scene.environment else {
        return (scene.lights.clone(), None);
    };
    if !scene.lights.is_empty() {
        return (
            scene.lights.clone(),
            Some(MapLight {
                map: map.clone(),
                ambient: map.harmonics(),
                coarse: CoarseMap::new(&map.coarse(f64::INFINITY)),
                levels: MapLevels::new(map, f32::INFINITY),
                threshold: f32::INFINITY,
            }),
        );
    }
    let EnvironmentLights {
        lights,
        ambient,
        threshold,
    } = map.to_lights(Environment::DEFAULT_LIGHTS);
    (
        lights,
        Some(MapLight {
            map: map.clone(),
            ambient,
            coarse: CoarseMap::new(&map.coarse(threshold)),
            levels: MapLevels::new(map, threshold as f32),
            threshold: threshold as f32,
        }),
    )
}
