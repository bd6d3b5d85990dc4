//! RT2AR's walk for secondary rays (dos Santos et al. 2012, section IV.B, Algorithm 2), kept as the paper's
//! baseline. Approximate: it samples the surface only at some points.
//!
//! Only these errors of the listing are fixed: it steps along the longer axis, not always along x; 1/z advances
//! with the step, not by a division by `deltaY` (zero on horizontal rays); the ends are not swapped, so the first
//! contact found is the nearest; the ray is clipped before it is projected; the floor and ceil samples of the
//! text are taken if requested (the listing rounds); and both ends are sampled, without which a ray within one
//! pixel finds nothing. The listing leaves `checkIntersectionWithDepthPixel` open: here it is a change of side
//! between two successive samples of one surface.

use super::contact::{CellHit, Contact};
use super::segment::Segment;
use crate::ghost::surface::GhostSurface;

/// The surface at one step.
#[derive(Clone, Copy)]
struct Sample {
    s: f32,
    /// The ray's w minus that of the surface; positive on the free side.
    e: f32,
    /// Depth of the surface, for connectivity.
    z: f32,
}

impl GhostSurface {
    /// First change of side along the segment; `interpolate` takes the floor and the ceiling
    /// sample of each step, otherwise the nearest.
    pub(crate) fn first_contact_bresenham(&self, segment: &Segment, interpolate: bool) -> Contact {
        let mut contact = Contact::NONE;
        if self.z.is_empty() {
            return contact;
        }
        let steep = segment.dv.abs() > segment.du.abs();
        let (major, d_major, minor, d_minor) = if steep {
            (segment.v, segment.dv, segment.u, segment.du)
        } else {
            (segment.u, segment.du, segment.v, segment.dv)
        };
        // Vertex strides along the two axes, and the last vertex of each.
        let (major_stride, minor_stride, major_last, minor_last) = if steep {
            (self.stride, 1, self.cells_y, self.cells_x)
        } else {
            (1, self.stride, self.cells_x, self.cells_y)
        };
        let forward = d_major >= 0.0;
        let (first, last) = if forward {
            (major.ceil(), (major + d_major).floor())
        } else {
            (major.floor(), (major + d_major).ceil())
        };
        let n_steps = if forward { last - first } else { first - last };
        // Below one for a segment between two pixel centres; then only the ends are sampled.
        let n_inner = if n_steps >= 0.0 {
            n_steps as usize + 1
        } else {
            0
        };
        let inv = if d_major == 0.0 { 0.0 } else { 1.0 / d_major };
        let s_first = ((first - major) * inv) as f32;
        let s_step = inv.abs() as f32;
        let (w, dw) = (segment.w as f32, segment.dw as f32);
        let (minor, d_minor) = (minor as f32, d_minor as f32);
        let mut previous: Option<Sample> = None;
        for step in 0..n_inner + 2 {
            let (s, at) = if step == 0 {
                (0.0, major.round() as usize)
            } else if step == n_inner + 1 {
                (1.0, (major + d_major).round() as usize)
            } else {
                let k = step - 1;
                let at = if forward {
                    first as usize + k
                } else {
                    first as usize - k
                };
                (s_first + k as f32 * s_step, at)
            };
            let at = at.min(major_last);
            let position = (minor + s * d_minor).max(0.0);
            let sample = if interpolate {
                let low = (position as usize).min(minor_last);
                let high = (low + 1).min(minor_last);
                self.between(
                    at * major_stride + low * minor_stride,
                    at * major_stride + high * minor_stride,
                    position - low as f32,
                )
            } else {
                let nearest = ((position + 0.5) as usize).min(minor_last);
                let vertex = at * major_stride + nearest * minor_stride;
                Some((self.w[vertex], self.z[vertex])).filter(|(w, _)| !w.is_nan())
            };
            let Some((w_surface, z)) = sample else {
                previous = None;
                continue;
            };
            let e = w + s * dw - w_surface;
            contact.behind |= e < 0.0;
            if let Some(before) = previous
                && (before.e >= 0.0) != (e >= 0.0)
                && self.connection.joins(before.z, z)
            {
                let share = before.e / (before.e - e);
                contact.hit = Some(CellHit {
                    s: f64::from(before.s + share * (s - before.s)),
                    from_front: before.e >= 0.0,
                    interior: true,
                });
                return contact;
            }
            previous = Some(Sample { s, e, z });
        }
        contact
    }

    /// Inverse depth and depth between two vertices: interpolated if they are connected,
    /// otherwise the nearer of them by position.
    #[inline(always)]
    fn between(&self, low: usize, high: usize, share: f32) -> Option<(f32, f32)> {
        let (z_low, z_high) = (self.z[low], self.z[high]);
        if self.connection.joins(z_low, z_high) {
            let w = self.w[low] + share * (self.w[high] - self.w[low]);
            return Some((w, if share < 0.5 { z_low } else { z_high }));
        }
        let nearest = if share < 0.5 { low } else { high };
        Some((self.w[nearest], self.z[nearest])).filter(|(w, _)| !w.is_nan())
    }
}
