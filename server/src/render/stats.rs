//! Counts of a frame.

/// What was counted while a frame was made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct FrameStats {
    /// Pixels of the frame.
    pub pixels: u64,
    /// Pixels that went through ray tracing; the others were copied.
    pub traced_pixels: u64,
    /// Pixels that show something virtual.
    pub virtual_pixels: u64,
    /// Pixels that show something virtual where depth, filled or not, says nothing of what is real:
    /// whether something real is in front is unknown there. See [`HolePolicy`](super::HolePolicy).
    pub unmeasured_pixels: u64,
    /// Pixels whose light something virtual changes.
    pub relit_pixels: u64,
    /// Rays cast for ambient light.
    pub ambient_rays: u64,
    /// Shadow rays cast.
    pub shadow_rays: u64,
    /// Pairs of a shaded point and a light that rays were cast for: what is proven lit, or faces
    /// away from the light, is not among them.
    pub shadow_points: u64,
    /// Shadow points in penumbra: the first samples disagreed here or at a neighbour, so all samples were
    /// cast.
    pub penumbra_points: u64,
    /// Shadow rays cast in penumbra.
    pub penumbra_rays: u64,
    /// Photons emitted for caustics.
    pub photons: u64,
    /// Photons that came to rest where they count.
    pub photons_stored: u64,
    /// Triangles of all objects, in the levels of detail that the frame shows; see
    /// [`RenderSettings::lod_error_px`](super::RenderSettings::lod_error_px).
    pub triangles: u64,
    /// Secondary rays (reflection, refraction) cast.
    pub secondary_rays: u64,
    /// Secondary rays that ended on something virtual or on a modelled ghost.
    pub secondary_mesh: u64,
    /// Secondary rays that ended on the ghost surface.
    pub secondary_ghost: u64,
    /// Secondary rays that left what the camera sees and took the environment's radiance.
    pub secondary_environment: u64,
    /// Secondary rays that went where nothing is known: behind the ghost surface or into a hole.
    pub secondary_unknown: u64,
}

impl FrameStats {
    /// Adds the counts of a part of the frame; its pixels and photons are known as a whole.
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
