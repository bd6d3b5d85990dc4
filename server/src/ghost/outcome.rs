//! How rays end.

/// Where a ray met the ghost surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GhostHit {
    /// Parameter of the ray, in units of its direction.
    pub t: f32,
    /// Pixel position of the contact (pixel centres are integers).
    pub u: f32,
    /// Pixel position of the contact.
    pub v: f32,
    /// The ray came from the free side, the camera's. From behind, the camera's picture shows
    /// the other side of what was met.
    pub from_front: bool,
}

/// How a ray ended; see the documentation of [`super`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GhostOutcome {
    /// On the surface.
    Hit(GhostHit),
    /// Out of what the camera sees, through free space only.
    Environment,
    /// Where the camera knows nothing.
    Unknown,
}
