//! Rays against the surface. They are clipped to the volume that the image sees (`segment`), then walked cell by
//! cell (`dda`), through the pyramid one at a time (`pyramid`) or sixteen at once (`batch`), or with RT2AR's
//! algorithm (`bresenham`). `cell` is the exact test of one cell, `beam` excludes whole bundles of rays, and
//! `trace` is the interface for the rest of the program.

pub(super) mod batch;
mod beam;
mod bresenham;
mod cell;
mod contact;
mod dda;
mod pyramid;
pub(super) mod segment;
mod trace;

pub use beam::BeamEnd;
