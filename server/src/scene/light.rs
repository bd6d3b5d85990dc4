//! Lights and environment.

use std::sync::Arc;

use glam::{DQuat, DVec3, Vec3};

/// A light source, in world space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Light {
    /// A sphere with uniform emission: soft shadows.
    Sphere {
        /// Centre, metres.
        position: DVec3,
        /// Radius, metres; 0 is a point light with hard shadows.
        radius_m: f64,
        /// Radiant intensity per channel: irradiance at distance d is `intensity cos / d^2`.
        intensity: Vec3,
    },
    /// Parallel light from far away.
    Directional {
        /// Unit direction in which the light travels.
        direction: DVec3,
        /// Half the angle of the light source as seen from the scene, radians; 0 gives hard shadows.
        angular_radius_rad: f64,
        /// Irradiance per channel on a surface that faces it.
        irradiance: Vec3,
    },
}

/// Radiance from outside the sensed scene: an equirectangular map.
#[derive(Debug, Clone)]
pub struct Environment {
    /// Pixels per row; a row spans 360 degrees.
    pub width: u32,
    /// Rows, from straight up to straight down.
    pub height: u32,
    /// Linear radiance, already multiplied by `intensity`.
    pub radiance: Arc<Vec<Vec3>>,
    /// World from map axes (y up, the middle column looks along -z).
    pub world_from_map: DQuat,
}
