//! The scene's environment map prepared for shading, and the lights extracted from it.

use glam::Mat3A;

use crate::scene::{Environment, EnvironmentLights, Harmonics, Light, Scene};

use super::environment::{CoarseMap, Surroundings};
use super::map_levels::MapLevels;

/// An environment map prepared for shading: without the light of its lamps.
pub(crate) struct MapLight {
    pub(crate) map: Environment,
    pub(crate) ambient: Harmonics,
    /// The same light, at a coarse resolution.
    pub(crate) coarse: CoarseMap,
    /// Its levels for filtered look-ups.
    pub(crate) levels: MapLevels,
    /// Luminance above which its radiance belongs to lamps extracted from it.
    pub(crate) threshold: f32,
}

impl MapLight {
    /// The map as the surroundings of a frame.
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

/// The lights of a scene. For a scene with a map and no lights, the brightest parts of the map become lights, and
/// its diffuse light is the remainder.
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
