//! A secondary ray under way: what photons and the paths of the camera have in common.

use glam::Vec3A;

use crate::accel::MASK_GHOST;
use crate::numerics::RandomKey;
use crate::render::prepare::cone::RayCone;
use crate::render::prepare::mask::MASK_ALL;
use crate::render::prepare::surface::Surface;

/// Paths that carry less than this share of light end: at radiance 1 that is a quarter of the
/// smallest 8-bit step in linear light (1 / (255 * 12.92)).
pub(crate) const MIN_THROUGHPUT: f32 = 1.0 / (4.0 * 255.0 * 12.92);

/// A secondary ray under way.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Path {
    pub(crate) origin: Vec3A,
    /// Unit length.
    pub(crate) direction: Vec3A,
    pub(crate) throughput: Vec3A,
    /// Where it starts.
    pub(crate) cone: RayCone,
    pub(crate) pixel: u16,
    /// GGX alpha of the lobe that it was drawn from, 0 of a mirror, infinite if it is to see no lamp:
    /// [`CameraLight::is_seen_by_rays`](crate::render::prepare::light::CameraLight::is_seen_by_rays) tells which it sees. The shading model shows the others.
    pub(crate) lobe: f32,
    /// Meets only what is real, and counts negative: the Ir of a modelled real mirror.
    pub(crate) real: bool,
    /// Comes from a modelled real mirror: what it brings changes the camera's pixel.
    pub(crate) of_mirror: bool,
    /// Which of its pixel's lens rays it comes from.
    pub(crate) sample: u16,
    /// What its surface draws its rays by.
    pub(crate) random: RandomKey,
}

/// A sample of a pixel, from which paths start.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PixelSample {
    /// The pixel's record in its tile.
    pub(crate) place: usize,
    /// Its share of the pixel.
    pub(crate) weight: f32,
    pub(crate) random: RandomKey,
}

/// What a path may meet: everything, or what is real only.
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
        sample: 0,
        random: sample.random,
    }
}

/// The two paths that a modelled real mirror sends: what they differ by is what virtual things
/// change in it. Both draw the same random numbers.
pub(crate) fn mirror_seeds(surface: &Surface, sample: PixelSample) -> [Path; 2] {
    [false, true].map(|real| Path {
        of_mirror: true,
        ..seed(surface, sample, real)
    })
}
