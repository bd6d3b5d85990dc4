//! Outcomes of rays.

/// Where a ray met the ghost surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GhostHit {
    /// Parameter of the ray, in units of its direction.
    pub t: f32,
    /// Pixel position of the contact (pixel centres are integers).
    pub u: f32,
    /// Pixel position of the contact.
    pub v: f32,
    /// Whether the ray came from the free side, which is the camera's. If it came from behind, the camera's
    /// picture shows the other side of the surface.
    pub from_front: bool,
}

/// How a ray ended; see the documentation of [`super`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GhostOutcome {
    /// The ray hits the surface.
    Hit(GhostHit),
    /// The ray leaves the camera's view, through free space only.
    Environment,
    /// The ray enters space that the camera does not see.
    Unknown,
}
