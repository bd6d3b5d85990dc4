//! Min/max pyramid over the cells: a tile whose interval of w the segment does not overlap is
//! skipped, sixteen tiles tested at once. Leaves are the exact cell test, so the result is that
//! of the plain walk.
//!
//! Sources: maximum mipmaps for height fields (Tevs, Ihrke, Seidel 2008), quadtrees over depth
//! (Widmer et al. 2015); nodes of 4x4 children as wide trees have them (Wald, Benthin, Boulos
//! 2008).
//!
//! The tree is walked in f32 with all intervals padded outward, so rounding can only visit a
//! tile too many. Two bounds, for an image of side N pixels and u = 2^-24:
//! - a line's parameter `(x - u) / du` carries at most six roundings of numbers up to N du^-1,
//!   and the segment's own position one more: a line moved outward by 16 u N pixels bounds it;
//! - `w + s dw` carries four roundings of numbers up to the segment's largest w, once for the
//!   value and once for s: 16 u of that w bounds it. The tiles' own bounds are one rounding
//!   off, two after the division: padded by 4 u when built.

use fearless_simd::{Level, Simd, SimdBase, SimdMask, dispatch, f32x16};

use super::cell::S_MARGIN;
use super::segment::Segment;
use super::{Contact, GhostSurface};
use crate::numerics::UNIT_ROUNDOFF;

/// Sixteen tiles, four by four, row by row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    /// Smallest w of each child's triangles, rounded down; infinite where it has none.
    pub(super) low: [f32; 16],
    /// Largest w, rounded up; minus infinity where it has none.
    pub(super) high: [f32; 16],
}

impl Node {
    /// A node that nothing overlaps.
    pub(super) const EMPTY: Self = Self {
        low: [f32::INFINITY; 16],
        high: [f32::NEG_INFINITY; 16],
    };
}

/// Nodes of one size.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LevelShape {
    /// First node in the array of all levels.
    pub(super) offset: usize,
    /// Nodes per row in memory.
    pub(super) stride: usize,
    /// Rows of nodes.
    pub(super) rows: usize,
    /// Nodes per row that hold cells.
    pub(super) columns: usize,
}

/// Levels above the cells: 4^7 = 16384 cells per side, twice what an image may have.
pub(super) const MAX_LEVELS: usize = 7;

/// Stands for 1/0: large enough that a line half a pad away lies outside 0..=1, small enough
/// that its product with any coordinate stays finite.
const INV_LARGEST: f32 = 1e30;

const COLUMN: [f32; 16] = [
    0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0,
];
const ROW: [f32; 16] = [
    0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0,
];

/// The segment in f32 with its pads, laid out for the test of a node.
#[derive(Debug, Clone, Copy)]
struct Walker<S: Simd> {
    simd: S,
    u: f32,
    v: f32,
    inv_du: f32,
    inv_dv: f32,
    /// Pads of line parameters.
    pad_u: f32,
    pad_v: f32,
    /// Per child and for a tile of size 1: parameter offset of its near and far lines.
    near_u: f32x16<S>,
    far_u: f32x16<S>,
    near_v: f32x16<S>,
    far_v: f32x16<S>,
    dw: f32x16<S>,
    /// w at s = 0, padded down.
    w_low: f32x16<S>,
    /// w at s = 0, padded up; infinite while it is not known whether the segment was ever
    /// behind the sheet, so that tiles in front of it are looked into until it is.
    w_high: f32x16<S>,
    w_high_known: f32,
    /// The segment moves toward larger w.
    approaching: bool,
}

impl<S: Simd> Walker<S> {
    #[inline(always)]
    fn new(simd: S, segment: &Segment, side: f32, any: bool) -> Self {
        let inverse = |dx: f64| {
            let inv = (1.0 / dx) as f32;
            inv.clamp(-INV_LARGEST, INV_LARGEST)
        };
        let (inv_du, inv_dv) = (inverse(segment.du), inverse(segment.dv));
        let pad_px = 16.0 * UNIT_ROUNDOFF * side;
        let lines = |inv: f32, place: &[f32; 16]| {
            let place = f32x16::load_array_ref(simd, place);
            let next = place + 1.0;
            let (near, far) = if inv < 0.0 {
                (next, place)
            } else {
                (place, next)
            };
            (near * inv, far * inv)
        };
        let (near_u, far_u) = lines(inv_du, &COLUMN);
        let (near_v, far_v) = lines(inv_dv, &ROW);
        let w = segment.w as f32;
        let pad_w = 16.0 * UNIT_ROUNDOFF * segment.w_max as f32;
        let w_high_known = w + pad_w;
        Self {
            simd,
            u: segment.u as f32,
            v: segment.v as f32,
            inv_du,
            inv_dv,
            pad_u: pad_px * inv_du.abs(),
            pad_v: pad_px * inv_dv.abs(),
            near_u,
            far_u,
            near_v,
            far_v,
            dw: f32x16::splat(simd, segment.dw as f32),
            w_low: f32x16::splat(simd, w - pad_w),
            w_high: f32x16::splat(simd, if any { w_high_known } else { f32::INFINITY }),
            w_high_known,
            approaching: segment.dw > 0.0,
        }
    }

    /// From now on tiles wholly in front of the segment are skipped.
    #[inline(always)]
    fn set_behind(&mut self) {
        self.w_high = f32x16::splat(self.simd, self.w_high_known);
    }

    /// Which children the segment may touch up to parameter `s_limit`, as bits.
    #[inline(always)]
    fn test(&self, node: &Node, x: f32, y: f32, size: f32, s_limit: f32) -> u32 {
        let simd = self.simd;
        let base_u = (x - self.u) * self.inv_du;
        let base_v = (y - self.v) * self.inv_dv;
        let u_in = self.near_u * size + (base_u - self.pad_u);
        let v_in = self.near_v * size + (base_v - self.pad_v);
        let u_out = self.far_u * size + (base_u + self.pad_u);
        let v_out = self.far_v * size + (base_v + self.pad_v);
        let s_in = u_in.max(v_in).max(f32x16::splat(simd, 0.0));
        let s_out = u_out.min(v_out).min(f32x16::splat(simd, s_limit));
        let (s_low, s_high) = if self.approaching {
            (s_in, s_out)
        } else {
            (s_out, s_in)
        };
        let low = self.w_low + s_low * self.dw;
        let high = self.w_high + s_high * self.dw;
        let touched = s_in.simd_le(s_out)
            & low.simd_le(f32x16::load_array_ref(simd, &node.high))
            & high.simd_ge(f32x16::load_array_ref(simd, &node.low));
        touched.to_bitmask() as u32
    }
}

/// Puts children into ray order: bit k of the result is child `k ^ flip`. For a segment that
/// moves toward larger u and v the row-by-row order is ray order; other directions mirror it.
#[inline(always)]
fn in_ray_order(mask: u32, flip: u32) -> u32 {
    let mut m = mask;
    if flip & 3 != 0 {
        m = ((m & 0x5555) << 1) | ((m >> 1) & 0x5555);
        m = ((m & 0x3333) << 2) | ((m >> 2) & 0x3333);
    }
    if flip & 12 != 0 {
        m = ((m & 0x0f0f) << 4) | ((m >> 4) & 0x0f0f);
        m = ((m & 0x00ff) << 8) | (m >> 8);
    }
    m
}

/// What a segment needs next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Next {
    /// The test of a node.
    Node,
    /// The exact test of a cell.
    Cell,
    /// Nothing: its contact is final.
    Done,
}

/// A segment on its way down the pyramid.
#[derive(Debug, Clone, Copy)]
pub(super) struct Flight<S: Simd> {
    pub(super) segment: Segment,
    pub(super) contact: Contact,
    walker: Walker<S>,
    s_limit: f32,
    flip: u32,
    /// Any contact will do.
    any: bool,
    /// Level of the node or (0) cell that is next, one above its index in the levels.
    level: u32,
    /// Its position among the nodes of its size.
    x: u32,
    y: u32,
    /// Bit l: the open node of level l has children left.
    unfinished: u32,
    /// Children still to visit, and position, of the node open on each level.
    open: [(u32, u32, u32); MAX_LEVELS + 1],
}

impl<S: Simd> Flight<S> {
    /// At the pyramid's root.
    #[inline(always)]
    pub(super) fn start(surface: &GhostSurface, simd: S, segment: &Segment, any: bool) -> Self {
        let flip = if segment.du < 0.0 { 3 } else { 0 } | if segment.dv < 0.0 { 12 } else { 0 };
        Self {
            segment: *segment,
            contact: Contact::default(),
            walker: Walker::new(simd, segment, surface.side, any),
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

    /// Tests the children of the node that is next.
    #[inline(always)]
    pub(super) fn visit_node(&mut self, surface: &GhostSurface) -> Next {
        let shape = &surface.levels[self.level as usize - 1];
        let (x, y) = (self.x as usize, self.y as usize);
        let node = &surface.nodes[shape.offset + y * shape.stride + x];
        let child_size = (1u32 << (2 * (self.level - 1))) as f32;
        let origin = |x: u32| (x << (2 * self.level)) as f32;
        let mask = self.walker.test(
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

    /// Tests the cell that is next.
    #[inline(always)]
    pub(super) fn visit_cell(&mut self, surface: &GhostSurface) -> Next {
        let (x, y) = (self.x as usize, self.y as usize);
        let was_behind = self.contact.behind;
        if let Some(hit) = surface.cell_contact(&self.segment, x, y, &mut self.contact.behind) {
            self.contact.offer(hit, y * surface.cells_x + x);
            if self.any || hit.interior {
                return Next::Done;
            }
            // Only a cell that touches the same border can still tie or win.
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
    /// First contact along the segment (with `any`: some contact), and whether it was behind
    /// the sheet before.
    #[inline(always)]
    fn first_contact_pyramid<S: Simd>(&self, simd: S, segment: &Segment, any: bool) -> Contact {
        if self.levels.is_empty() {
            return Contact::default();
        }
        let mut flight = Flight::start(self, simd, segment, any);
        let mut next = Next::Node;
        loop {
            next = match next {
                Next::Node => flight.visit_node(self),
                Next::Cell => flight.visit_cell(self),
                Next::Done => return flight.contact,
            };
        }
    }

    /// [`Self::first_contact_pyramid`] for one segment, on the best instruction set there is.
    pub(super) fn first_contact_pyramid_single(
        &self,
        level: Level,
        segment: &Segment,
        any: bool,
    ) -> Contact {
        dispatch!(level, simd => self.first_contact_pyramid(simd, segment, any))
    }
}
