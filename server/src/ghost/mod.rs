//! The sensed depth map as a surface that rays can hit.
//!
//! Input: depth (metres, camera axes), intrinsics. Output: the nearest contact of rays given in
//! camera space (origin and direction in metres).
//!
//! **Space.** All computations are done in (u, v, w) with w = 1/z. The perspective map keeps straight lines
//! straight and planes plane, so a ray is a straight segment, the depth map is a height field w(u, v), and the
//! surface is exactly the triangle mesh of the depth map.
//!
//! **Surface.** Vertices are pixel centres. Each cell of 2x2 pixels with corners a = (x, y), b = (x+1, y), c =
//! (x, y+1), d = (x+1, y+1) holds two triangles along the diagonal a-d: the upper right one a b d and the lower
//! left one a d c. A triangle exists if its three depths are valid and pairwise connected: their difference is
//! below `edge_relative z + edge_sigmas sigma(z)` with z the nearer of the two and sigma the sensor's noise.
//! Triangles are closed: their borders belong to them, and both sides can be hit.
//!
//! **Rays** are clipped in camera space to z >= [`DepthImage::MIN_M`] and to the image's vertices, then
//! projected. Arithmetic that decides an outcome is f64.
//!
//! **Outcome**, the same for all exact traversals:
//! - [`GhostOutcome::Hit`]: the nearest contact with `t_min <= t <= t_max`, from either side. A ray that starts
//!   on the surface hits it at its start: callers give secondary rays a `t_min` beyond the sensor's noise.
//! - [`GhostOutcome::Environment`]: the ray has no contact and is in front of the surface wherever there is one
//!   on its way. It leaves through the image's border or the camera's plane, or ends (`t_max`) in front of the
//!   surface. Also every ray that is outside of the image from start to end.
//! - [`GhostOutcome::Unknown`]: the ray has no contact and is behind the surface somewhere (it passed a depth
//!   discontinuity or a hole), or it ends, at `t_max` or at infinity, inside the image where there is no surface.
//!   Also every invalid ray: a NaN, an infinite origin or direction, a direction of zero, an infinite `t_min`, or
//!   `t_min > t_max`.
//!
//! Known limit: a hit's `t` saturates at the largest f32.

mod build;
mod connection;
mod fill;
mod node;
mod outcome;
mod plane;
mod sample_rays;
mod settings;
mod surface;
#[cfg(test)]
mod tests;
mod traverse;

pub(crate) use connection::Connection;
pub use fill::{FILL_REACH_PX, FilledDepth};
pub use outcome::{GhostHit, GhostOutcome};
pub use plane::DepthPlanes;
pub use sample_rays::mixed_rays;
pub use settings::{GhostSettings, HolePolicy, Traversal};
pub use surface::GhostSurface;
pub use traverse::BeamEnd;
