//! Light sources other than lamps.

use crate::render::prepare::camera_levels::CameraLevels;
use crate::render::prepare::environment::Surroundings;

use super::photons::PhotonMap;

/// Surroundings and photons of a frame.
#[derive(Clone, Copy)]
pub(crate) struct Lighting<'a> {
    pub(crate) surroundings: Surroundings<'a>,
    /// `None` without rough reflections or refractions.
    pub(crate) camera_levels: Option<&'a CameraLevels>,
    /// `None` without caustics.
    pub(crate) photons: Option<&'a PhotonMap>,
}
