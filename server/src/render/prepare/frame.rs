//! A frame that is ready to be rendered.

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

/// The frame number used in every random number: the same for all frames, so that noise is static while the
/// camera is. Any value is equally good.
const PATTERN: u32 = 1;

/// The input of every stage: complete before the first stage runs, and never changed.
pub(crate) struct PreparedFrame<'a> {
    pub(crate) settings: &'a RenderSettings,
    /// The frame's checkpoint, called between pieces of work.
    pub(crate) pulse: &'a Pulse<'a>,
    pub(crate) sensed: Sensed<'a>,
    pub(crate) scene: SceneQuery<'a>,
    /// Rotation from camera axes to world axes.
    pub(crate) world_from_camera: Mat3A,
    pub(crate) lights: &'a [CameraLight],
    pub(crate) light_samples: &'a LightSamples,
    pub(crate) ambient_samples: &'a AmbientSamples,
    pub(crate) occluders: &'a Occluders,
    pub(crate) material_needs_light: &'a [bool],
    pub(crate) transmissive: Transmissive,
    /// Some objects model real objects.
    pub(crate) has_ghost_objects: bool,
    /// `None` for a pinhole.
    pub(crate) lens: Option<&'a Lens>,
}

impl PreparedFrame<'_> {
    /// Calls the checkpoint; false if the frame is cancelled. Values written after that are never read, so loops
    /// just end.
    #[inline]
    pub(crate) fn go_on(&self) -> bool {
        self.pulse.go_on()
    }

    /// The random numbers for a sample of a pixel.
    pub(crate) fn random(&self, x: u32, y: u32, sample: u32) -> RandomKey {
        RandomKey::new(y * self.sensed.color.width + x, PATTERN, sample)
    }

    /// The surface that a pixel's primary ray hit.
    pub(crate) fn primary_surface(&self, hit: &Hit, x: u32, y: u32) -> Surface {
        let cone = self.sensed.pinhole.pixel_cone(hit.t);
        self.scene
            .surface(hit, self.sensed.direction_at(x, y), cone)
    }
}
