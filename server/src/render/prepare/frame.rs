//! A frame ready to be rendered.

use glam::Mat3A;

use crate::accel::Hit;
use crate::numerics::RandomKey;
use crate::render::checkpoint::Pulse;
use crate::render::settings::RenderSettings;

use super::ambient_samples::AmbientSamples;
use super::lens::Lens;
use super::light::CameraLight;
use super::light_samples::LightSamples;
use super::object::Transmissive;
use super::occluder::Occluders;
use super::scene::SceneQuery;
use super::sensed::Sensed;
use super::surface::Surface;

/// The frame number in every random number: one for all frames, so that noise rests while the camera does. Of
/// equally good patterns one is taken.
const PATTERN: u32 = 1;

/// What every stage reads: complete before the first one runs, and never written to.
pub(crate) struct PreparedFrame<'a> {
    pub(crate) settings: &'a RenderSettings,
    /// Asked between pieces of work whether the frame goes on.
    pub(crate) pulse: &'a Pulse<'a>,
    pub(crate) sensed: Sensed<'a>,
    pub(crate) scene: SceneQuery<'a>,
    /// Axes of the world from those of the camera.
    pub(crate) world_from_camera: Mat3A,
    pub(crate) lights: &'a [CameraLight],
    pub(crate) light_samples: &'a LightSamples,
    pub(crate) ambient_samples: &'a AmbientSamples,
    pub(crate) occluders: &'a Occluders,
    pub(crate) material_needs_light: &'a [bool],
    pub(crate) transmissive: Transmissive,
    /// Some objects model real things.
    pub(crate) has_ghost_objects: bool,
    /// `None` for a pinhole.
    pub(crate) lens: Option<&'a Lens>,
}

impl PreparedFrame<'_> {
    /// Passes the checkpoint; false if the frame is given up. What is written after that is never read,
    /// so loops just end.
    #[inline]
    pub(crate) fn go_on(&self) -> bool {
        self.pulse.go_on()
    }

    /// The random numbers of a sample of a pixel.
    pub(crate) fn random(&self, x: u32, y: u32, sample: u32) -> RandomKey {
        RandomKey::new(y * self.sensed.color.width + x, PATTERN, sample)
    }

    /// The surface that a pixel's primary ray met.
    pub(crate) fn primary_surface(&self, hit: &Hit, x: u32, y: u32) -> Surface {
        let cone = self.sensed.pinhole.pixel_cone(hit.t);
        self.scene
            .surface(hit, self.sensed.direction_at(x, y), cone)
    }
}
