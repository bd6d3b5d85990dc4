//! Rays through the surface: clipped to what the image sees (`segment`), walked cell by cell (`dda`),
//! through the pyramid one at a time (`pyramid`) or sixteen at once (`batch`), or as RT2AR does
//! (`bresenham`); `cell` is the exact test of one cell, `beam` rules out whole bundles of rays, and
//! `trace` is what the rest of the program calls.

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
