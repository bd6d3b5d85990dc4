//! Visits every cell that the segment crosses, in ray order. Exact, and the plain reference for the pyramid.

use super::cell::S_MARGIN;
use super::contact::Contact;
use super::segment::Segment;
use crate::ghost::surface::GhostSurface;

/// Padding of a column's range of rows, pixels: six roundings of coordinates up to 8192 are under 1e-11. Visiting
/// additional cells costs time but never changes the result.
const SPAN_PAD_PX: f64 = 1e-9;

impl GhostSurface {
    /// First contact along the segment, and whether the segment was behind the depth surface before it.
    pub(crate) fn first_contact_dda(&self, segment: &Segment) -> Contact {
        let mut contact = Contact::NONE;
        if self.cells_x == 0 || self.cells_y == 0 {
            return contact;
        }
        let last_column = self.cells_x - 1;
        let column = |u: f64| (u.max(0.0) as usize).min(last_column);
        let (u_low, u_high) = (
            segment.u.min(segment.u + segment.du),
            segment.u.max(segment.u + segment.du),
        );
        let (first, last) = (column(u_low - SPAN_PAD_PX), column(u_high + SPAN_PAD_PX));
        for step in 0..=last - first {
            let i = if segment.du < 0.0 {
                last - step
            } else {
                first + step
            };
            // The part of the segment within this column, padded.
            let (s_in, s_out) = if segment.du == 0.0 {
                (0.0, 1.0)
            } else {
                let a = (i as f64 - SPAN_PAD_PX - segment.u) * segment.inv_du;
                let b = (i as f64 + 1.0 + SPAN_PAD_PX - segment.u) * segment.inv_du;
                (a.min(b).max(0.0), a.max(b).min(1.0))
            };
            if contact.hit.is_some_and(|hit| s_in > hit.s + S_MARGIN) {
                break;
            }
            if self.walk_column(segment, i, s_in, s_out, &mut contact) {
                break;
            }
        }
        contact
    }

    /// Tests the cells of one column; true once a contact is certain to be the first.
    fn walk_column(
        &self,
        segment: &Segment,
        i: usize,
        s_in: f64,
        s_out: f64,
        contact: &mut Contact,
    ) -> bool {
        let row = |v: f64| (v.max(0.0) as usize).min(self.cells_y - 1);
        let (va, vb) = (
            segment.v + s_in * segment.dv,
            segment.v + s_out * segment.dv,
        );
        let (first, last) = (row(va.min(vb) - SPAN_PAD_PX), row(va.max(vb) + SPAN_PAD_PX));
        for step in 0..=last - first {
            let j = if segment.dv < 0.0 {
                last - step
            } else {
                first + step
            };
            if let Some(hit) = self.cell_contact(segment, i, j, &mut contact.behind) {
                contact.offer(hit, j * self.cells_x + i);
                if hit.interior {
                    return true;
                }
            }
        }
        false
    }
}
