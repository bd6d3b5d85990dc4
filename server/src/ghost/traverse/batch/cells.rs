//! The exact test of [`GhostSurface::cell_contact`] for eight segments at once, each with its own cell. The
//! operations and their order are the same, so every lane gets the same bits; branches are replaced by
//! selections.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f64x8, mask64x8};

use super::segments::{CELLS, GROUP, Group, LANES, SETS};
use crate::ghost::surface::GhostSurface;
use crate::ghost::traverse::cell::{E_ROUNDING_RAY, E_ROUNDING_SURFACE, S_MARGIN};

/// Cells to test: for each, the segment's index in the group, and the cell's position. Entries beyond the last
/// hold arbitrary cells; they are tested, and the results ignored.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Candidates {
    pub(crate) id: [u32; SETS * LANES],
    pub(crate) x: [u32; SETS * LANES],
    pub(crate) y: [u32; SETS * LANES],
    pub(crate) n: usize,
}

impl Candidates {
    pub(crate) const NONE: Self = Self {
        id: [0; SETS * LANES],
        x: [0; SETS * LANES],
        y: [0; SETS * LANES],
        n: 0,
    };
}

/// Results for eight cells, as bits by candidate; see [`crate::ghost::traverse::contact::CellHit`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct CellHits {
    pub(crate) hit: u32,
    pub(crate) from_front: u32,
    pub(crate) interior: u32,
    pub(crate) behind: u32,
    /// Cells left to the test of a single segment: the segment's extent is not zero, but has no finite inverse.
    pub(crate) unsettled: u32,
    pub(crate) s: [f64; CELLS],
}

/// Parameter interval within `[line, line + 1]` on one axis.
#[inline(always)]
fn span<S: Simd>(
    simd: S,
    line: f64x8<S>,
    x: f64x8<S>,
    dx: f64x8<S>,
    inv_dx: f64x8<S>,
) -> (f64x8<S>, f64x8<S>) {
    let splat = |x: f64| f64x8::splat(simd, x);
    let (zero, infinity) = (splat(0.0), splat(f64::INFINITY));
    let from = line - x;
    let a = from * inv_dx;
    let b = (line + 1.0 - x) * inv_dx;
    let rises = a.simd_le(b);
    let still = dx.simd_eq(zero);
    let within = from.simd_ge(splat(-1.0)) & from.simd_le(zero);
    let reach = within.select(infinity, -infinity);
    (
        still.select(-reach, rises.select(a, b)),
        still.select(reach, rises.select(b, a)),
    )
}

/// Whether a coordinate within the cell is on one of its borders.
#[inline(always)]
fn on_line<S: Simd>(simd: S, f: f64x8<S>) -> mask64x8<S> {
    f.simd_eq(f64x8::splat(simd, 0.0)) | f.simd_eq(f64x8::splat(simd, 1.0))
}

/// Whether an extent is not zero, but has no finite inverse.
#[inline(always)]
fn endless<S: Simd>(simd: S, d: f64x8<S>, inverse: f64x8<S>) -> mask64x8<S> {
    let infinity = f64x8::splat(simd, f64::INFINITY);
    !d.simd_eq(f64x8::splat(simd, 0.0)) & !inverse.abs().simd_lt(infinity)
}

/// The contact of a segment with one triangle.
struct Piece<S: Simd> {
    hit: mask64x8<S>,
    s: f64x8<S>,
    from_front: mask64x8<S>,
    behind: mask64x8<S>,
}

/// Tests the part of a segment above a triangle. A function and not a closure, because code that is not inlined
/// is compiled without the instruction set.
#[inline(always)]
fn piece<S: Simd>(
    simd: S,
    exists: mask64x8<S>,
    [from, to]: [f64x8<S>; 2],
    [fu, fv, w, du, dv, dw]: [f64x8<S>; 6],
    [wa, w_per_u, w_per_v]: [f64x8<S>; 3],
    tolerance: f64x8<S>,
) -> Piece<S> {
    let zero = f64x8::splat(simd, 0.0);
    let there = exists & from.simd_le(to);
    let e0 = w - (wa + fu * w_per_u + fv * w_per_v);
    let slope = dw - du * w_per_u - dv * w_per_v;
    let (e_in, e_out) = (e0 + from * slope, e0 + to * slope);
    let (least, largest) = (e_in.min(e_out), e_in.max(e_out));
    let root = (-e0 / slope).max(from).min(to);
    Piece {
        hit: there & least.simd_le(tolerance) & largest.simd_ge(-tolerance),
        s: slope.simd_eq(zero).select(from, root),
        from_front: slope.simd_le(zero),
        behind: there & least.simd_lt(-tolerance),
    }
}

impl GhostSurface {
    /// First contacts of eight segments from a candidate on, each with its own cell.
    #[inline(always)]
    pub(crate) fn cell_contacts<S: Simd>(
        &self,
        simd: S,
        group: &Group,
        candidates: &Candidates,
        first: usize,
    ) -> CellHits {
        let splat = |x: f64| f64x8::splat(simd, x);
        let (zero, one, infinity) = (splat(0.0), splat(1.0), splat(f64::INFINITY));
        let mut fields = [[0.0f64; CELLS]; 9];
        let mut place = [[0.0f64; CELLS]; 2];
        let mut depth = [[1.0f64; CELLS]; 4];
        let mut triangles = [0u64; 2];
        for lane in 0..CELLS {
            let k = (first + lane) % (SETS * LANES);
            let id = candidates.id[k] as usize % GROUP;
            let (x, y) = (candidates.x[k] as usize, candidates.y[k] as usize);
            fields[0][lane] = group.u[id];
            fields[1][lane] = group.v[id];
            fields[2][lane] = group.w[id];
            fields[3][lane] = group.du[id];
            fields[4][lane] = group.dv[id];
            fields[5][lane] = group.dw[id];
            fields[6][lane] = group.inv_du[id];
            fields[7][lane] = group.inv_dv[id];
            fields[8][lane] = group.w_max[id];
            place[0][lane] = x as f64;
            place[1][lane] = y as f64;
            let above = y * self.stride + x;
            let below = above + self.stride;
            depth[0][lane] = f64::from(self.z[above]);
            depth[1][lane] = f64::from(self.z[above + 1]);
            depth[2][lane] = f64::from(self.z[below]);
            depth[3][lane] = f64::from(self.z[below + 1]);
            let (upper, lower) = self.triangles(x, y);
            triangles[0] |= u64::from(upper) << lane;
            triangles[1] |= u64::from(lower) << lane;
        }
        let load = |values: &[f64; CELLS]| f64x8::load_array_ref(simd, values);
        let (u, v, w) = (load(&fields[0]), load(&fields[1]), load(&fields[2]));
        let (du, dv, dw) = (load(&fields[3]), load(&fields[4]), load(&fields[5]));
        let (inv_du, inv_dv) = (load(&fields[6]), load(&fields[7]));
        let (x, y) = (load(&place[0]), load(&place[1]));
        let (u_in, u_out) = span(simd, x, u, du, inv_du);
        let (v_in, v_out) = span(simd, y, v, dv, inv_dv);
        let s_in = u_in.max(v_in).max(zero);
        let s_out = u_out.min(v_out).min(one);
        let (wa, wb) = (one / load(&depth[0]), one / load(&depth[1]));
        let (wc, wd) = (one / load(&depth[2]), one / load(&depth[3]));
        let (fu, fv) = (u - x, v - y);
        let side = fu - fv;
        let side_slope = du - dv;
        let crossing = -side / side_slope;
        let (rises, falls) = (side_slope.simd_gt(zero), side_slope.simd_lt(zero));
        let level = side_slope.simd_eq(zero);
        let (later, earlier) = (s_in.max(crossing), s_out.min(crossing));
        let never = |on_other_side: mask64x8<S>, from: f64x8<S>| {
            (level & on_other_side).select(infinity, from)
        };
        let upper_in = never(side.simd_lt(zero), rises.select(later, s_in));
        let upper_out = falls.select(earlier, s_out);
        let lower_in = never(side.simd_gt(zero), falls.select(later, s_in));
        let lower_out = rises.select(earlier, s_out);
        let crosses = s_in.simd_le(s_out);
        let ray_tolerance = load(&fields[8]) * E_ROUNDING_RAY;
        let surface_rounding = E_ROUNDING_SURFACE * f64::from(self.side);
        let exists = |bits: u64| crosses & mask64x8::from_bitmask(simd, bits);
        let ray = [fu, fv, w, du, dv, dw];
        let tolerance = |w_largest: f64x8<S>| w_largest * surface_rounding + ray_tolerance;
        let upper = piece(
            simd,
            exists(triangles[0]),
            [upper_in, upper_out],
            ray,
            [wa, wb - wa, wd - wb],
            tolerance(wa.max(wb).max(wd)),
        );
        let lower = piece(
            simd,
            exists(triangles[1]),
            [lower_in, lower_out],
            ray,
            [wa, wd - wc, wc - wa],
            tolerance(wa.max(wc).max(wd)),
        );
        let takes_lower = lower.hit & (!upper.hit | lower.s.simd_lt(upper.s));
        let s = takes_lower.select(lower.s, upper.s);
        let margin = splat(S_MARGIN);
        let along_border =
            (du.simd_eq(zero) & on_line(simd, fu)) | (dv.simd_eq(zero) & on_line(simd, fv));
        let interior = (s - s_in).simd_gt(margin) & (s_out - s).simd_gt(margin) & !along_border;
        let bits = |mask: mask64x8<S>| mask.to_bitmask() as u32;
        let takes_lower_bits = bits(takes_lower);
        CellHits {
            hit: bits(upper.hit | lower.hit),
            from_front: (bits(lower.from_front) & takes_lower_bits)
                | (bits(upper.from_front) & !takes_lower_bits),
            interior: bits(interior),
            behind: bits(upper.behind | lower.behind),
            unsettled: bits(endless(simd, du, inv_du) | endless(simd, dv, inv_dv)),
            s: s.to_array(),
        }
    }
}
