//! Traversal of the min/max pyramid over the cells: a tile whose interval of w the segment does not overlap is
//! skipped, and sixteen tiles are tested at once. Cells are tested with the exact test, so the result is that of
//! the plain walk.
//!
//! Sources: maximum mipmaps for height fields (Tevs, Ihrke, Seidel 2008), quadtrees over depth (Widmer et al.
//! 2015); nodes of 4x4 children as in wide BVHs (Wald, Benthin, Boulos 2008).
//!
//! The traversal uses f32 with all intervals padded outward, so rounding can only add visits of tiles. Two
//! bounds, for an image of side N pixels and u = 2^-24:
//! - a line's parameter `(x - u) / du` has at most six roundings of numbers up to N du^-1, and the segment's own
//!   position one more: moving the line outward by 16 u N pixels covers them;
//! - `w + s dw` has four roundings of numbers up to the segment's largest w, once for the value and once for s:
//!   16 u of that w covers them. The tiles' own bounds have one rounding, two after the division: they are padded
//!   by 4 u when built.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16, u32x16};

use super::cell::S_MARGIN;
use super::contact::Contact;
use super::segment::Segment;
use crate::ghost::node::{MAX_LEVELS, Node};
use crate::ghost::surface::GhostSurface;
use crate::numerics::UNIT_ROUNDOFF;

/// Used in place of 1/0: large enough that a line half a pad away is outside 0..=1, small enough that its product
/// with any coordinate stays finite.
pub(crate) const INV_LARGEST: f32 = 1e30;

/// For each child, the near and the far line of its column; index by whether u decreases along the segment.
const COLUMN_LINES: [[[f32; 16]; 2]; 2] = {
    let (mut lines, mut child) = ([[[0.0; 16]; 2]; 2], 0);
    while child < 16 {
        let column = (child % 4) as f32;
        lines[0][0][child] = column;
        lines[0][1][child] = column + 1.0;
        lines[1][0][child] = column + 1.0;
        lines[1][1][child] = column;
        child += 1;
    }
    lines
};

/// The same for rows and v.
const ROW_LINES: [[[f32; 16]; 2]; 2] = {
    let (mut lines, mut child) = ([[[0.0; 16]; 2]; 2], 0);
    while child < 16 {
        let row = (child / 4) as f32;
        lines[0][0][child] = row;
        lines[0][1][child] = row + 1.0;
        lines[1][0][child] = row + 1.0;
        lines[1][1][child] = row;
        child += 1;
    }
    lines
};

static LINES: [[[[f32; 16]; 2]; 2]; 2] = [COLUMN_LINES, ROW_LINES];

/// The segment in f32 with its pads, in the form needed for the test of a node.
#[derive(Debug, Clone, Copy)]
struct Walker {
    u: f32,
    v: f32,
    inv_du: f32,
    inv_dv: f32,
    /// Pads of line parameters.
    pad_u: f32,
    pad_v: f32,
    dw: f32,
    /// w at s = 0, padded down.
    w_low: f32,
    /// w at s = 0, padded up; infinite while it is not known whether the segment was ever behind the depth
    /// surface, so that tiles nearer than the segment are visited until it is known.
    w_high: f32,
    w_high_known: f32,
    /// Whether u and v decrease along the segment: bits 0 and 1.
    falling: u32,
}

impl Walker {
    #[inline(always)]
    fn new(segment: &Segment, side: f32, any: bool) -> Self {
        // No NaN can arise, because du is finite.
        let inverse = |inv: f64| (inv as f32).clamp(-INV_LARGEST, INV_LARGEST);
        let (inv_du, inv_dv) = (inverse(segment.inv_du), inverse(segment.inv_dv));
        let pad_px = 16.0 * UNIT_ROUNDOFF * side;
        let w = segment.w as f32;
        let pad_w = 16.0 * UNIT_ROUNDOFF * segment.w_max as f32;
        let w_high_known = w + pad_w;
        Self {
            u: segment.u as f32,
            v: segment.v as f32,
            inv_du,
            inv_dv,
            pad_u: pad_px * inv_du.abs(),
            pad_v: pad_px * inv_dv.abs(),
            dw: segment.dw as f32,
            w_low: w - pad_w,
            w_high: if any { w_high_known } else { f32::INFINITY },
            w_high_known,
            falling: u32::from(inv_du < 0.0) | u32::from(inv_dv < 0.0) << 1,
        }
    }

    /// From now on, tiles entirely nearer than the segment are skipped.
    #[inline(always)]
    fn set_behind(&mut self) {
        self.w_high = self.w_high_known;
    }

    /// The children that the segment may touch up to parameter `s_limit`, as bits. Branch-free, because a branch
    /// could not be predicted.
    #[inline(always)]
    fn test<S: Simd>(&self, simd: S, node: &Node, x: f32, y: f32, size: f32, s_limit: f32) -> u32 {
        let load = |lines| f32x16::load_array_ref(simd, lines);
        let splat = |x| f32x16::splat(simd, x);
        let [near_u, far_u] = &LINES[0][(self.falling & 1) as usize];
        let [near_v, far_v] = &LINES[1][(self.falling >> 1 & 1) as usize];
        let base_u = (x - self.u) * self.inv_du;
        let base_v = (y - self.v) * self.inv_dv;
        // The size is a power of two, so the order of multiplications does not change the result.
        let (per_u, per_v) = (splat(self.inv_du * size), splat(self.inv_dv * size));
        let u_in = load(near_u) * per_u + splat(base_u - self.pad_u);
        let v_in = load(near_v) * per_v + splat(base_v - self.pad_v);
        let u_out = load(far_u) * per_u + splat(base_u + self.pad_u);
        let v_out = load(far_v) * per_v + splat(base_v + self.pad_v);
        let s_in = u_in.max(v_in).max(splat(0.0));
        let s_out = u_out.min(v_out).min(splat(s_limit));
        let dw = splat(self.dw);
        let (w_in, w_out) = (s_in * dw, s_out * dw);
        let low = splat(self.w_low) + w_in.min(w_out);
        let high = splat(self.w_high) + w_in.max(w_out);
        let tiles = u32x16::load_array_ref(simd, &node.0);
        let (tile_low, tile_high) = Node::bounds(tiles);
        let touched = s_in.simd_le(s_out)
            & low.simd_le(tile_high)
            & high.simd_ge(tile_low)
            & tile_low.simd_le(tile_high);
        touched.to_bitmask() as u32
    }
}

/// Puts children into ray order: bit k of the result is child `k ^ flip`. For a segment towards larger u and v
/// the row-by-row order is ray order; other directions mirror it. Branch-free, because a ray's direction cannot
/// be predicted.
#[inline(always)]
fn in_ray_order(mask: u32, flip: u32) -> u32 {
    let pick = |bit: u32, plain: u32, mirrored: u32| {
        let all = (flip >> bit & 1).wrapping_neg();
        plain ^ ((plain ^ mirrored) & all)
    };
    let pairs = ((mask & 0x5555) << 1) | ((mask >> 1) & 0x5555);
    let columns = ((pairs & 0x3333) << 2) | ((pairs >> 2) & 0x3333);
    let m = pick(0, mask, columns);
    let rows = ((m & 0x0f0f) << 4) | ((m >> 4) & 0x0f0f);
    let rows = ((rows & 0x00ff) << 8) | (rows >> 8);
    pick(2, m, rows)
}

/// The next step of a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Next {
    /// The test of a node.
    Node,
    /// The exact test of a cell.
    Cell,
    /// None: the contact is final.
    Done,
}

/// State of one segment's traversal of the pyramid.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TraversalState {
    pub(crate) segment: Segment,
    pub(crate) contact: Contact,
    walker: Walker,
    s_limit: f32,
    flip: u32,
    /// Whether the query is any-hit.
    any: bool,
    /// Level of the next node or (0) cell, one above its index in the levels.
    level: u32,
    /// Its position among the nodes of its size.
    x: u32,
    y: u32,
    /// Bit l: the open node of level l has children left to visit.
    unfinished: u32,
    /// For each level, the open node's children still to visit, and its position.
    open: [(u32, u32, u32); MAX_LEVELS + 1],
}

impl TraversalState {
    /// A traversal that begins at the pyramid's root.
    #[inline(always)]
    pub(crate) fn start(surface: &GhostSurface, segment: &Segment, any: bool) -> Self {
        let flip = if segment.du < 0.0 { 3 } else { 0 } | if segment.dv < 0.0 { 12 } else { 0 };
        Self {
            segment: *segment,
            contact: Contact::NONE,
            walker: Walker::new(segment, surface.side, any),
            s_limit: 1.0,
            flip,
            any,
            level: surface.levels.len() as u32,
            x: 0,
            y: 0,
            unfinished: 0,
            open: [(0, 0, 0); MAX_LEVELS + 1],
        }
    }

    /// Tests the children of the next node.
    #[inline(always)]
    pub(crate) fn visit_node<S: Simd>(&mut self, simd: S, surface: &GhostSurface) -> Next {
        let shape = &surface.levels[self.level as usize - 1];
        let (x, y) = (self.x as usize, self.y as usize);
        let node = &surface.nodes[shape.offset + y * shape.stride + x];
        let child_size = (1u32 << (2 * (self.level - 1))) as f32;
        let origin = |x: u32| (x << (2 * self.level)) as f32;
        let mask = self.walker.test(
            simd,
            node,
            origin(self.x),
            origin(self.y),
            child_size,
            self.s_limit,
        );
        let mask = in_ray_order(mask, self.flip);
        self.open[self.level as usize & MAX_LEVELS] = (mask, self.x, self.y);
        self.unfinished |= u32::from(mask != 0) << self.level;
        self.advance()
    }

    /// Tests the next cell.
    #[inline(always)]
    pub(crate) fn visit_cell(&mut self, surface: &GhostSurface) -> Next {
        let (x, y) = (self.x as usize, self.y as usize);
        let was_behind = self.contact.behind;
        if let Some(hit) = surface.cell_contact(&self.segment, x, y, &mut self.contact.behind) {
            self.contact.offer(hit, y * surface.cells_x + x);
            if self.any || hit.interior {
                return Next::Done;
            }
            // Only a cell that touches the same border can still have an equal or earlier contact.
            let best = self.contact.hit.map_or(1.0, |best| best.s);
            self.s_limit = ((best + S_MARGIN) as f32).next_up().min(1.0);
        }
        if self.contact.behind && !was_behind {
            self.walker.set_behind();
        }
        self.advance()
    }

    /// Moves to the next child in ray order of the lowest node that has one.
    #[inline(always)]
    fn advance(&mut self) -> Next {
        if self.unfinished == 0 {
            return Next::Done;
        }
        let level = self.unfinished.trailing_zeros();
        let slot = &mut self.open[level as usize & MAX_LEVELS];
        let (mask, parent_x, parent_y) = *slot;
        slot.0 = mask & (mask - 1);
        self.unfinished &= !(u32::from(slot.0 == 0) << level);
        let child = mask.trailing_zeros() ^ self.flip;
        self.x = parent_x * 4 + (child & 3);
        self.y = parent_y * 4 + (child >> 2);
        self.level = level - 1;
        if self.level == 0 {
            Next::Cell
        } else {
            Next::Node
        }
    }
}

impl GhostSurface {
    /// First contact along the segment (with `any`: some contact), and whether the segment was behind the depth
    /// surface before it.
    #[inline(always)]
    fn first_contact_pyramid<S: Simd>(&self, simd: S, segment: &Segment, any: bool) -> Contact {
        if self.levels.is_empty() {
            return Contact::NONE;
        }
        let mut state = TraversalState::start(self, segment, any);
        let mut next = Next::Node;
        loop {
            next = match next {
                Next::Node => state.visit_node(simd, self),
                Next::Cell => state.visit_cell(self),
                Next::Done => return state.contact,
            };
        }
    }

    /// [`Self::first_contact_pyramid`] for one segment, on the best instruction set.
    #[inline(never)]
    pub(crate) fn first_contact_pyramid_single(
        &self,
        level: Level,
        segment: &Segment,
        any: bool,
    ) -> Contact {
        dispatch!(level, simd => self.first_contact_pyramid(simd, segment, any))
    }
}
