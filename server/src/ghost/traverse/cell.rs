//! The exact test of a segment against the two triangles of a cell, shared by all exact traversals: its result
//! depends on segment and cell alone, not on how the traversal reached the cell.
//!
//! In (u, v, w) both are linear, so `e(s) = w_ray(s) - w_surface(s)` is linear on each triangle, and the segment
//! hits the triangle where e changes sign on the part of the segment above the triangle. Positive e is the free
//! side (nearer than the surface).
//!
//! Watertight: the parameters at which the segment crosses grid lines are computed from the line alone, so
//! neighbouring cells get the same bits and no part of the segment is lost between cells. At such a parameter the
//! values of e in the two cells agree up to rounding, and a value within that rounding of zero counts as a
//! contact in both.

use super::contact::CellHit;
use super::segment::Segment;
use crate::ghost::surface::GhostSurface;

/// Distance from a cell's border, in the segment parameter, within which a contact may also belong to the
/// neighbour: four roundings of numbers up to 1, with a factor of 8 to spare.
pub(crate) const S_MARGIN: f64 = 32.0 * f64::EPSILON;

/// Rounding of e relative to the surface's w, per pixel of the image's larger side N. Positions have at most 6
/// roundings of N pixels; w is positive, so a triangle's gradients are below its largest w per pixel. Two
/// gradients give 12 N 2^-53 of w; the constant has a third to spare.
pub(crate) const E_ROUNDING_SURFACE: f64 = 8.0 * f64::EPSILON;

/// Rounding of e relative to the largest w on the segment: the four roundings of
/// `w + s dw`, with a factor of 2 to spare.
pub(crate) const E_ROUNDING_RAY: f64 = 4.0 * f64::EPSILON;

/// Parameter interval of the segment within `[line, line + 1]` on one axis.
#[inline(always)]
fn span(line: f64, x: f64, dx: f64, inv_dx: f64) -> (f64, f64) {
    let from = line - x;
    if dx == 0.0 {
        // A segment along a grid line belongs to the cells on both sides.
        return if (-1.0..=0.0).contains(&from) {
            (f64::NEG_INFINITY, f64::INFINITY)
        } else {
            (f64::INFINITY, f64::NEG_INFINITY)
        };
    }
    // Computed as `line + 1 - x`, not `from + 1`, because the neighbour computes its own line this way.
    let a = from * inv_dx;
    let b = (line + 1.0 - x) * inv_dx;
    if a <= b { (a, b) } else { (b, a) }
}

impl GhostSurface {
    /// First contact of the segment with cell (i, j). Sets `behind` if a part of the segment is behind a triangle
    /// of the cell.
    #[inline(always)]
    pub(crate) fn cell_contact(
        &self,
        segment: &Segment,
        i: usize,
        j: usize,
        behind: &mut bool,
    ) -> Option<CellHit> {
        let (upper, lower) = self.triangles(i, j);
        if !(upper | lower) {
            return None;
        }
        let (x, y) = (i as f64, j as f64);
        let (u_in, u_out) = span(x, segment.u, segment.du, segment.inv_du);
        let (v_in, v_out) = span(y, segment.v, segment.dv, segment.inv_dv);
        let s_in = u_in.max(v_in).max(0.0);
        let s_out = u_out.min(v_out).min(1.0);
        if s_in > s_out {
            return None;
        }
        let at = j * self.stride + i;
        let below = at + self.stride;
        let wa = 1.0 / f64::from(self.z[at]);
        let wb = 1.0 / f64::from(self.z[at + 1]);
        let wc = 1.0 / f64::from(self.z[below]);
        let wd = 1.0 / f64::from(self.z[below + 1]);
        let (fu, fv) = (segment.u - x, segment.v - y);
        // A segment along a grid line is shared with the neighbour over its whole length.
        let on_line = |f: f64| f == 0.0 || f == 1.0;
        let along_border = (segment.du == 0.0 && on_line(fu)) || (segment.dv == 0.0 && on_line(fv));
        // Positive on the side of the diagonal a-d where the upper right triangle is.
        let side = fu - fv;
        let side_slope = segment.du - segment.dv;
        let crossing = -side / side_slope;
        let (mut upper_in, mut upper_out) = (s_in, s_out);
        let (mut lower_in, mut lower_out) = (s_in, s_out);
        if side_slope > 0.0 {
            upper_in = upper_in.max(crossing);
            lower_out = lower_out.min(crossing);
        } else if side_slope < 0.0 {
            upper_out = upper_out.min(crossing);
            lower_in = lower_in.max(crossing);
        } else if side > 0.0 {
            lower_in = f64::INFINITY;
        } else if side < 0.0 {
            upper_in = f64::INFINITY;
        }
        let side_px = f64::from(self.side);
        let mut best: Option<(f64, bool)> = None;
        let pieces = [
            (
                upper,
                upper_in,
                upper_out,
                wb - wa,
                wd - wb,
                wa.max(wb).max(wd),
            ),
            (
                lower,
                lower_in,
                lower_out,
                wd - wc,
                wc - wa,
                wa.max(wc).max(wd),
            ),
        ];
        for (exists, from, to, w_per_u, w_per_v, w_largest) in pieces {
            if !exists || from > to {
                continue;
            }
            let tolerance =
                E_ROUNDING_SURFACE * side_px * w_largest + E_ROUNDING_RAY * segment.w_max;
            let e0 = segment.w - (wa + fu * w_per_u + fv * w_per_v);
            let slope = segment.dw - segment.du * w_per_u - segment.dv * w_per_v;
            let (e_in, e_out) = (e0 + from * slope, e0 + to * slope);
            *behind |= e_in.min(e_out) < -tolerance;
            if e_in.min(e_out) <= tolerance && e_in.max(e_out) >= -tolerance {
                let s = if slope == 0.0 {
                    from
                } else {
                    (-e0 / slope).max(from).min(to)
                };
                if best.is_none_or(|(nearest, _)| s < nearest) {
                    best = Some((s, slope <= 0.0));
                }
            }
        }
        best.map(|(s, from_front)| CellHit {
            s,
            from_front,
            interior: s - s_in > S_MARGIN && s_out - s > S_MARGIN && !along_border,
        })
    }
}
