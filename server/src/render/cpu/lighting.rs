//! What lights surfaces beside the lamps.

use crate::render::prepare::camera_levels::CameraLevels;
use crate::render::prepare::environment::Surroundings;

use super::photons::PhotonMap;

/// Environment and photons of a frame.
#[derive(Clone, Copy)]
pub(crate) struct Lighting<'a> {
    pub(crate) surroundings: Surroundings<'a>,
    /// `None` if nothing reflects or refracts roughly.
    pub(crate) camera_levels: Option<&'a CameraLevels>,
    /// `None` without caustics.
    pub(crate) photons: Option<&'a PhotonMap>,
}
