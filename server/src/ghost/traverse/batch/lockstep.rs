//! Traverses the pyramid with sixteen segments at once, one per lane; a lane whose segment is done takes the next
//! one.
//!
//! Each lane visits tiles in the order of its segment. It descends into a tile whose interval of w the segment
//! overlaps. It skips other tiles and then goes up a level, because the rest of the parent tile may now be
//! skipped as a whole. No stack is needed: the current cell, and the parameter at which the segment entered it,
//! are the whole state.
//!
//! **Why no tile is lost.** Arithmetic is f32. With u = 2^-24 and an image of side N pixels, the parameter of a
//! grid line, `(line - u) / du`, has an error of at most
//! - 1 u N / |du| from rounding the segment's start to f32,
//! - 1 u N / |du| from the difference (the line itself is a whole number, exact),
//! - 2 u N / |du| from the rounded 1/du and the product,
//!
//! which is equivalent to moving the line by 4 u N pixels. [`PAD_PX`] = 5 also covers terms of second order and
//! the f64 segment's own rounding (2^-53 N). So a line is crossed between its `near` and its `far` parameter,
//! which are one pad before and one pad after the computed parameter. The tile is left no later than at the `far`
//! parameter of the line whose computed parameter is smaller. A step is taken only if it is *certain*: the
//! parameters of the two axes differ by more than the sum of their pads, and the position on the other axis is
//! clear of every grid line. The error of this position is `pad |dv/du|` plus 4 u N from its product, sum and
//! roundings to f32. Then the segment can touch no cells outside the visited tiles: at a crossing it is farther
//! from the next grid line than the exact test's own rounding, and between crossings it is inside its tile. If a
//! step is not certain (rays through corners, along edges; about one in a hundred), the lane gives up the
//! segment, which is then traced by the traversal that keeps all children within its pads
//! ([`crate::ghost::traverse::pyramid`]).
//!
//! **Behind the depth surface.** If a segment has no contact, its outcome depends on whether it was ever behind
//! the surface. Until that is known, the lane also descends into tiles that are nearer than the segment, unless
//! the tile is full ([`Node::FULL`]): every cell in it then has both its triangles, and a segment that certainly
//! reaches the tile was behind one of them. The exact test gives the same result:
//! - The segment entered by a certain step over a line that it crosses before its end (the line's `far` parameter
//!   is at most 1), or it starts in the tile. So a part of it is in the cell where it enters, away from the
//!   cell's corners by more than the exact test's rounding, and above one of the cell's triangles.
//! - There its w, padded up, is less than the tile's low bound, which was moved down by at least 2 u of the
//!   smallest w in the tile when the pyramid was built. The exact test's tolerance is at most 2^-36 of the
//!   triangle's largest w (N is at most 8192) and 2^-50 of the segment's. The cells of a full tile span at most 8
//!   octaves, so the first part is at most 2^-28 of the smallest w, less than 2 u = 2^-23. The segment's part is
//!   far below its pad of 16 u of its largest w, of which rounding takes up to 12.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, i32x16, mask32x16, u8x64, u32x16};

use super::cells::Candidates;
use super::queue::{Ids, PAD_PX, PLACES, SegmentQueue};
use super::segments::LANES;
use crate::ghost::node::Node;
use crate::ghost::surface::GhostSurface;

/// Tile sizes that the traversal uses: 1, 4, 16, 64 cells.
const WALK_LEVELS: usize = 4;

/// Sixteen segments in progress.
pub(crate) struct Lanes<S: Simd> {
    u: f32x16<S>,
    v: f32x16<S>,
    du: f32x16<S>,
    dv: f32x16<S>,
    inv_du: f32x16<S>,
    inv_dv: f32x16<S>,
    dw: f32x16<S>,
    w_low: f32x16<S>,
    w_high: f32x16<S>,
    pad_u: f32x16<S>,
    pad_v: f32x16<S>,
    /// Half a pixel minus the rounding of v at the crossing of a line of u; likewise for u.
    clear_v: f32x16<S>,
    clear_u: f32x16<S>,
    id: u32x16<S>,
    x: i32x16<S>,
    y: i32x16<S>,
    s_in: f32x16<S>,
    /// Parameter at which the segment is done, at most 1.
    s_end: f32x16<S>,
    /// Level of the tile as byte indices into a table: four times the level plus 0 to 3.
    level: u32x16<S>,
    /// The tile: sixteen times its node's index, plus its index in the node.
    at: [u32; LANES],
    /// Lanes whose segment is being stepped.
    pub(crate) active: u32,
    /// Lanes whose segment is at a cell and waits for the exact test.
    pub(crate) at_cell: u32,
    /// Lanes whose current cell has been tested.
    passed: u32,
    /// Lanes whose segment certainly reaches the current tile.
    entered: u32,
    /// Lanes whose segment was behind the depth surface, or whose query is any-hit.
    behind: u32,
    /// Lanes whose segment is left to the traversal of single segments.
    lost: u32,
}

/// Constants of a traversal: the surface and its pyramid, for all lanes.
pub(crate) struct WalkConstants<'a, S: Simd> {
    pub(crate) simd: S,
    pub(crate) surface: &'a GhostSurface,
    /// Tiles of all nodes, one node after the other.
    tiles: &'a [u32],
    /// For each level: shift from cells to its tiles, cells per side of a tile minus one, offset and stride of
    /// its nodes.
    shift: u32x16<S>,
    within: u32x16<S>,
    offset: u32x16<S>,
    stride: u32x16<S>,
    top: u32,
    /// Last cell of a row, and of a column.
    last_x: u32x16<S>,
    last_y: u32x16<S>,
    pub(crate) any: bool,
}

const LEVEL_ZERO: u32 = 0x0302_0100;
const LEVEL_STEP: u32 = 0x0404_0404;

impl<'a, S: Simd> WalkConstants<'a, S> {
    #[inline(always)]
    pub(crate) fn new(simd: S, surface: &'a GhostSurface, any: bool) -> Self {
        let mut tables = [[0u32; WALK_LEVELS]; 4];
        for (level, shape) in surface.levels.iter().take(WALK_LEVELS).enumerate() {
            tables[0][level] = 2 * level as u32;
            tables[1][level] = shape.offset as u32;
            tables[2][level] = shape.stride as u32;
            tables[3][level] = (1 << (2 * level)) - 1;
        }
        let [shift, offset, stride, within] =
            tables.map(|table| u32x16::from_fn(simd, |lane| table[lane % WALK_LEVELS]));
        let last = |cells: usize| u32x16::splat(simd, cells.saturating_sub(1) as u32);
        let top = surface.levels.len().clamp(1, WALK_LEVELS) as u32 - 1;
        Self {
            simd,
            surface,
            tiles: bytemuck::cast_slice(&surface.nodes),
            shift,
            within,
            offset,
            stride,
            top: LEVEL_ZERO + LEVEL_STEP * top,
            last_x: last(surface.cells_x),
            last_y: last(surface.cells_y),
            any,
        }
    }
}

/// Looks up the entries of a table by level.
#[inline(always)]
fn lookup<S: Simd>(table: u32x16<S>, level: u32x16<S>) -> u32x16<S> {
    table.swizzle_dyn_within_blocks(level.bitcast::<u8x64<S>>())
}

#[inline(always)]
fn bits<S: Simd>(lanes: mask32x16<S>) -> u32 {
    lanes.to_bitmask() as u32
}

#[inline(always)]
fn lanes<S: Simd>(simd: S, bits: u32) -> mask32x16<S> {
    mask32x16::from_bitmask(simd, u64::from(bits))
}

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    pub(crate) fn new(simd: S) -> Self {
        let zero = f32x16::splat(simd, 0.0);
        let none = i32x16::splat(simd, 0);
        Self {
            u: zero,
            v: zero,
            du: zero,
            dv: zero,
            inv_du: zero,
            inv_dv: zero,
            dw: zero,
            w_low: zero,
            w_high: zero,
            pad_u: zero,
            pad_v: zero,
            clear_v: zero,
            clear_u: zero,
            id: u32x16::splat(simd, 0),
            x: none,
            y: none,
            s_in: zero,
            s_end: zero,
            level: u32x16::splat(simd, LEVEL_ZERO),
            at: [0; LANES],
            active: 0,
            at_cell: 0,
            passed: 0,
            entered: 0,
            behind: 0,
            lost: 0,
        }
    }

    /// Records the segments of lanes that are done.
    #[inline(always)]
    pub(crate) fn retire(
        &mut self,
        constants: &WalkConstants<'_, S>,
        uncertain: &mut Ids,
        behind: &mut Ids,
    ) {
        let done = !(self.active | self.at_cell);
        uncertain.append(constants.simd, self.id, self.lost);
        self.lost = 0;
        if !constants.any {
            behind.append(constants.simd, self.id, self.behind & done);
        }
        self.behind &= !done;
    }

    /// Puts queued segments, from `next` on, into free lanes.
    #[inline(always)]
    pub(crate) fn refill(
        &mut self,
        constants: &WalkConstants<'_, S>,
        queue: &SegmentQueue,
        next: &mut usize,
    ) {
        let simd = constants.simd;
        let surface = constants.surface;
        let mut free = !(self.active | self.at_cell) & 0xffff;
        let left = queue.n - *next;
        while free.count_ones() as usize > left {
            free &= free - 1;
        }
        let from = *next;
        *next += free.count_ones() as usize;
        let lanes = mask32x16::from_bitmask(simd, u64::from(free));
        let take = |field: &[f32; PLACES], old: f32x16<S>| {
            f32x16::from_slice(simd, &field[from..from + LANES]).expand_merge(lanes, old)
        };
        self.u = take(&queue.u, self.u);
        self.v = take(&queue.v, self.v);
        self.du = take(&queue.du, self.du);
        self.dv = take(&queue.dv, self.dv);
        self.inv_du = take(&queue.inv_du, self.inv_du);
        self.inv_dv = take(&queue.inv_dv, self.inv_dv);
        self.dw = take(&queue.dw, self.dw);
        self.s_end = take(&queue.s_end, self.s_end);
        let zero = f32x16::splat(simd, 0.0);
        let w = take(&queue.w, zero);
        let pad_w = take(&queue.pad_w, zero);
        self.w_low = lanes.select(w - pad_w, self.w_low);
        self.w_high = lanes.select(w + pad_w, self.w_high);
        let pad_px = PAD_PX * surface.side;
        self.pad_u = self.inv_du.abs() * pad_px;
        self.pad_v = self.inv_dv.abs() * pad_px;
        let half = f32x16::splat(simd, 0.5 - pad_px);
        self.clear_v = half - self.pad_u * self.dv.abs();
        self.clear_u = half - self.pad_v * self.du.abs();
        self.id =
            u32x16::from_slice(simd, &queue.id[from..from + LANES]).expand_merge(lanes, self.id);
        let cell = |x: f32x16<S>, n: usize| {
            x.to_int::<i32x16<S>>()
                .min(i32x16::splat(simd, n as i32 - 1))
        };
        self.x = lanes.select(cell(self.u, surface.cells_x), self.x);
        self.y = lanes.select(cell(self.v, surface.cells_y), self.y);
        self.s_in = lanes.select(zero, self.s_in);
        self.level = lanes.select(u32x16::splat(simd, constants.top), self.level);
        self.active |= free;
        self.passed &= !free;
        self.entered |= free;
        self.behind = if constants.any {
            self.behind | free
        } else {
            self.behind & !free
        };
        self.locate(constants);
    }

    /// One step of every active lane.
    #[inline(always)]
    pub(crate) fn step(&mut self, constants: &WalkConstants<'_, S>) {
        let simd = constants.simd;
        let within = lookup(constants.within, self.level).bitcast::<i32x16<S>>();
        // The cells beyond the tile's far sides, and the lines before these cells. If a coordinate decreases
        // along the segment, its complement increases.
        let fall_x = self.inv_du.bitcast::<i32x16<S>>() >> 31;
        let fall_y = self.inv_dv.bitcast::<i32x16<S>>() >> 31;
        let beyond_x = (((self.x ^ fall_x) | within) + 1) ^ fall_x;
        let beyond_y = (((self.y ^ fall_y) | within) + 1) ^ fall_y;
        let line_x = (beyond_x - fall_x).to_float::<f32x16<S>>();
        let line_y = (beyond_y - fall_y).to_float::<f32x16<S>>();
        let s_u = (line_x - self.u) * self.inv_du;
        let s_v = (line_y - self.v) * self.inv_dv;
        let lead = s_v - s_u;
        let cross_u = lead.simd_gt(f32x16::splat(simd, 0.0));
        let certain = lead.abs().simd_gt(self.pad_u + self.pad_v);
        let along = s_u.min(s_v);
        let pad = cross_u.select(self.pad_u, self.pad_v);
        let (near, far) = (along - pad, along + pad);
        let s_out = far.min(self.s_end);
        // Written out, so that the tiles are loaded from memory directly into the vector.
        let (at, tiles) = (&self.at, constants.tiles);
        let tile = |lane: usize| tiles[at[lane] as usize];
        #[rustfmt::skip]
        let tiles = [
            tile(0), tile(1), tile(2), tile(3), tile(4), tile(5), tile(6), tile(7),
            tile(8), tile(9), tile(10), tile(11), tile(12), tile(13), tile(14), tile(15),
        ];
        let tile = u32x16::load_array(simd, tiles);
        let (tile_low, tile_high) = Node::bounds(tile);
        let (w_in, w_out) = (self.s_in * self.dw, s_out * self.dw);
        let low = self.w_low + w_in.min(w_out);
        let high = self.w_high + w_in.max(w_out);
        let open = self.active & !self.passed;
        let beyond = bits(high.simd_lt(tile_low));
        let full = bits((tile & Node::FULL).simd_ne(u32x16::splat(simd, 0)));
        self.behind |= open & self.entered & beyond & full;
        let overlaps = open
            & !(beyond & self.behind)
            & bits(low.simd_le(tile_high) & tile_low.simd_le(tile_high));
        let passes = self.active & !overlaps;
        // Skips the tile.
        let position = cross_u.select(self.v, self.u) + along * cross_u.select(self.dv, self.du);
        let floor = position.floor();
        let clear = (position - floor - 0.5)
            .abs()
            .simd_lt(cross_u.select(self.clear_v, self.clear_u));
        let side = floor.to_int::<i32x16<S>>();
        let beyond_cell = cross_u.select(beyond_x, beyond_y).bitcast::<u32x16<S>>();
        let outside = beyond_cell.simd_gt(cross_u.select(constants.last_x, constants.last_y));
        let ends = passes & bits(certain & (near.simd_gt(self.s_end) | outside));
        let moves = passes & !ends & bits(certain & clear);
        let lost = passes & !ends & !moves;
        // Inside the image by the bounds above; the limits only prevent reads out of bounds if these were wrong.
        let limit = |to: i32x16<S>, last| to.bitcast::<u32x16<S>>().min(last).bitcast();
        let to_x: i32x16<S> = limit(cross_u.select(beyond_x, side), constants.last_x);
        let to_y: i32x16<S> = limit(cross_u.select(side, beyond_y), constants.last_y);
        // Still below the same tile of the level above, which is known to overlap.
        let differ = ((to_x ^ self.x) | (to_y ^ self.y)) >> 2;
        let rises = moves & bits(differ.simd_gt(within));
        let moving = lanes(simd, moves);
        self.s_in = moving.select(near.max(f32x16::splat(simd, 0.0)), self.s_in);
        self.x = moving.select(to_x, self.x);
        self.y = moving.select(to_y, self.y);
        let reaches = overlaps & bits(self.level.simd_eq(u32x16::splat(simd, LEVEL_ZERO)));
        let descends = lanes(simd, overlaps & !reaches);
        let up = (self.level + LEVEL_STEP).min(u32x16::splat(simd, constants.top));
        self.level = lanes(simd, rises).select(up, self.level);
        self.level = descends.select(self.level - LEVEL_STEP, self.level);
        self.passed &= !moves;
        self.entered &= !moves | bits(far.simd_le(self.s_end));
        self.at_cell |= reaches;
        self.active &= !(reaches | lost | ends);
        self.locate(constants);
        self.lost |= lost;
    }

    /// Computes the memory position of each lane's tile one step ahead, so that its load does not wait for it.
    #[inline(always)]
    fn locate(&mut self, constants: &WalkConstants<'_, S>) {
        let level = self.level;
        let shift = lookup(constants.shift, level);
        let x = self.x.bitcast::<u32x16<S>>() >> shift;
        let y = self.y.bitcast::<u32x16<S>>() >> shift;
        let node =
            lookup(constants.offset, level) + (y >> 2) * lookup(constants.stride, level) + (x >> 2);
        self.at = ((node << 4) | ((y & 3) << 2) | (x & 3)).to_array();
    }

    /// Appends the cells for which lanes wait.
    #[inline(always)]
    pub(crate) fn candidates(&self, simd: S, list: &mut Candidates) {
        let waiting = mask32x16::from_bitmask(simd, u64::from(self.at_cell));
        let at = list.n..list.n + LANES;
        let (x, y) = (self.x.bitcast::<u32x16<S>>(), self.y.bitcast::<u32x16<S>>());
        self.id
            .compress(waiting)
            .store_slice(&mut list.id[at.clone()]);
        x.compress(waiting).store_slice(&mut list.x[at.clone()]);
        y.compress(waiting).store_slice(&mut list.y[at]);
        list.n += self.at_cell.count_ones() as usize;
    }

    /// Resumes waiting lanes whose cells have no contact. `results` has a bit for each cell, in the order of
    /// [`Self::candidates`].
    #[inline(always)]
    pub(crate) fn resume(&mut self, simd: S, results: CellResults) -> CellResults {
        let waited = mask32x16::from_bitmask(simd, u64::from(self.at_cell));
        let goes_on = spread(simd, results.goes_on, waited);
        let behind = spread(simd, results.behind, waited);
        self.behind |= behind;
        let n = self.at_cell.count_ones();
        self.at_cell = 0;
        self.active |= goes_on;
        self.passed |= goes_on;
        CellResults {
            goes_on: (u64::from(results.goes_on) >> n) as u32,
            behind: (u64::from(results.behind) >> n) as u32,
        }
    }
}

/// Spreads the lowest bits to the lanes of a mask, one bit for each lane.
#[inline(always)]
fn spread<S: Simd>(simd: S, bits: u32, lanes: mask32x16<S>) -> u32 {
    let set = mask32x16::from_bitmask(simd, u64::from(bits & 0xffff));
    let one = set.select(i32x16::splat(simd, 1), i32x16::splat(simd, 0));
    one.expand(lanes).simd_eq(1).to_bitmask() as u32
}

/// Results of the exact tests, one bit for each tested cell.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CellResults {
    /// The cell has no contact: its segment continues.
    pub(crate) goes_on: u32,
    /// The segment is behind a triangle of the cell.
    pub(crate) behind: u32,
}
