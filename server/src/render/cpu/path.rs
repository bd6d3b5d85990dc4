//! State of a secondary ray, shared by photons and camera paths.

use glam::Vec3A;

use crate::accel::MASK_GHOST;
use crate::numerics::RandomKey;
use crate::render::prepare::cone::RayCone;
use crate::render::prepare::mask::MASK_ALL;
use crate::render::prepare::surface::Surface;

/// Paths with a throughput below this end: at radiance 1 it is a quarter of the smallest 8-bit step in linear
/// light (1 / (255 * 12.92)).
pub(crate) const MIN_THROUGHPUT: f32 = 1.0 / (4.0 * 255.0 * 12.92);

/// A path that is being traced.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Path {
    pub(crate) origin: Vec3A,
    /// Unit length.
    pub(crate) direction: Vec3A,
    pub(crate) throughput: Vec3A,
    /// Cone of the ray, at its origin.
    pub(crate) cone: RayCone,
    pub(crate) pixel: u16,
    /// GGX alpha of the lobe from which the ray was drawn, 0 for a mirror, infinite if the ray must not see
    /// lamps. [`CameraLight::is_seen_by_rays`](crate::render::prepare::light::CameraLight::is_seen_by_rays) says
    /// which lamps the ray sees; the highlights of the others come from the shading model.
    pub(crate) lobe: f32,
    /// The ray intersects real objects only, and its radiance counts negative: the Ir of a modelled real mirror.
    pub(crate) real: bool,
    /// The path starts at a modelled real mirror: its radiance changes the camera's pixel.
    pub(crate) of_mirror: bool,
    /// Belongs to a rough reflection that its pixel shares with its neighbours.
    pub(crate) shared: bool,
    /// Index of the lens ray of the pixel.
    pub(crate) sample: u16,
    /// Random numbers for scattering at its surface.
    pub(crate) random: RandomKey,
}

/// A sample of a pixel, at which paths start.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PixelSample {
    /// Index of the pixel's record in its tile.
    pub(crate) place: usize,
    /// The sample's share of the pixel.
    pub(crate) weight: f32,
    pub(crate) random: RandomKey,
}

/// Objects that a path can hit: all, or real ones only.
pub(crate) fn mask_of_path(real: bool) -> u8 {
    if real { MASK_GHOST } else { MASK_ALL }
}

/// The path state at a primary hit, before it scatters.
pub(crate) fn seed(surface: &Surface, sample: PixelSample, real: bool) -> Path {
    Path {
        origin: surface.position,
        direction: surface.incoming,
        throughput: Vec3A::splat(sample.weight),
        cone: surface.cone,
        pixel: sample.place as u16,
        lobe: 0.0,
        real,
        of_mirror: false,
        shared: false,
        sample: 0,
        random: sample.random,
    }
}

/// The two paths that start at a modelled real mirror. Their difference is the change that virtual objects cause
/// in the mirror. Both use the same random numbers.
pub(crate) fn mirror_seeds(surface: &Surface, sample: PixelSample) -> [Path; 2] {
    [false, true].map(|real| Path {
        of_mirror: true,
        ..seed(surface, sample, real)
    })
}
