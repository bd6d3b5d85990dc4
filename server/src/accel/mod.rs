//! (see README)

use glam::Vec3A;

/// A ray in camera space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where it starts, metres.
    pub origin: Vec3A,
    /// Where it goes; need not be of unit length.
    pub direction: Vec3A,
    /// Hits count from here, in units of the direction.
    pub t_min: f32,
    /// Hits count up to here; may be infinite.
    pub t_max: f32,
}
