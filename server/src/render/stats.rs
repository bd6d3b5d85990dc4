//! Counts of a frame.

/// Counts of a rendered frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct FrameStats {
    /// Pixels of the frame.
    pub pixels: u64,
    /// Pixels that were ray traced; the others were copied.
    pub traced_pixels: u64,
    /// Pixels that show virtual objects.
    pub virtual_pixels: u64,
    /// Pixels that show virtual objects where there is no depth, filled or measured, so that a real object in
    /// front cannot be detected. See [`HolePolicy`](super::HolePolicy).
    pub unmeasured_pixels: u64,
    /// Pixels whose light virtual objects change.
    pub relit_pixels: u64,
    /// Rays cast for ambient light.
    pub ambient_rays: u64,
    /// Shadow rays cast.
    pub shadow_rays: u64,
    /// Pairs of a shaded point and a light for which rays were cast. Points that are proven lit, or that face
    /// away from the light, do not count.
    pub shadow_points: u64,
    /// Shadow points in penumbra: the first samples disagreed here or at a neighbour, so all samples were
    /// cast.
    pub penumbra_points: u64,
    /// Shadow rays cast in penumbra.
    pub penumbra_rays: u64,
    /// Photons emitted for caustics.
    pub photons: u64,
    /// Photons stored on diffuse surfaces.
    pub photons_stored: u64,
    /// Triangles of all objects at the frame's levels of detail; see
    /// [`RenderSettings::lod_error_px`](super::RenderSettings::lod_error_px).
    pub triangles: u64,
    /// Secondary rays (reflection, refraction) cast.
    pub secondary_rays: u64,
    /// Secondary rays that ended on virtual objects or on modelled ghosts.
    pub secondary_mesh: u64,
    /// Secondary rays that ended on the ghost surface.
    pub secondary_ghost: u64,
    /// Secondary rays that left the camera's view and returned the radiance of the surroundings.
    pub secondary_environment: u64,
    /// Secondary rays that entered unknown space: behind the ghost surface, or in a hole.
    pub secondary_unknown: u64,
}

impl FrameStats {
    /// Adds the counts of a part of the frame, except pixels and photons, which are counted for the whole frame.
    pub(crate) fn add(&mut self, other: &Self) {
        self.traced_pixels += other.traced_pixels;
        self.virtual_pixels += other.virtual_pixels;
        self.unmeasured_pixels += other.unmeasured_pixels;
        self.relit_pixels += other.relit_pixels;
        self.ambient_rays += other.ambient_rays;
        self.shadow_rays += other.shadow_rays;
        self.shadow_points += other.shadow_points;
        self.penumbra_points += other.penumbra_points;
        self.penumbra_rays += other.penumbra_rays;
        self.secondary_rays += other.secondary_rays;
        self.secondary_mesh += other.secondary_mesh;
        self.secondary_ghost += other.secondary_ghost;
        self.secondary_environment += other.secondary_environment;
        self.secondary_unknown += other.secondary_unknown;
    }
}
