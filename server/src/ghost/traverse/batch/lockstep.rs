//! Sixteen segments walk the pyramid together, one lane each; a lane whose segment is done
//! takes the next one.
//!
//! Each lane goes from tile to tile in the order of its segment: down into a tile whose
//! interval of w it overlaps, past one it does not, and then up a level, since what is left of
//! the tile above may now be passed as a whole. It keeps no stack: the cell it is in, and the
//! parameter at which it came in, say everything.
//!
//! **Why no tile is lost.** Arithmetic is f32. With u = 2^-24 and an image of side N pixels, the
//! parameter of a grid line, `(line - u) / du`, is off by at most
//! - 1 u N / |du| from rounding the segment's start to f32,
//! - 1 u N / |du| from the difference (the line itself is a whole number, exact),
//! - 2 u N / |du| from the rounded 1/du and the product,
//!
//! that is 4 u N pixels of line, here [`PAD_PX`] = 5 to leave room for terms of second order and
//! for the f64 segment's own rounding (2^-53 N). So a line is crossed between its `near` and its
//! `far` parameter, a pad before and a pad after the computed one, and the tile is left no later
//! than the `far` one of the line that is first by its computed parameter. A step is taken only if
//! it is *certain*: the two axes' parameters are farther apart than their pads together, and
//! the position on the other axis, off by another 4 u N
//! from its product, sum and roundings to f32 on top of `pad |dv/du|`, is clear of every grid line.
//! Then the segment can touch no cell but those of the tiles walked through: at a crossing it is
//! farther from the next grid line than the exact test's own rounding, and between crossings it
//! is inside its tile. Where a step is not certain (rays through corners, along edges; about one
//! in a hundred) the lane gives the segment up, and it is traced by the walk that keeps all
//! children within its pads ([`crate::ghost::traverse::pyramid`]).
//!
//! **Behind the sheet.** Whether a segment was ever behind the sheet counts where it meets
//! nothing, so until that is known a tile in front of it is looked into, unless the tile is full
//! ([`Node::FULL`]): every cell in it then has both its triangles, and a segment that certainly
//! reaches it was behind one of them. The exact test says the same:
//! - The segment came in by a certain step over a line crossed before its end (the line's `far`
//!   parameter is at most 1), or it starts in the tile. So it has a part in the cell where it comes
//!   in, clear of that cell's corners by more than the exact test's rounding, and that part is
//!   above one of the cell's triangles.
//! - There its w, padded up, is less than the tile's low bound, itself moved down by 2 u of the
//!   smallest w in the tile or more when built. The exact test's tolerance is at most
//!   2^-36 of the triangle's largest w (N at most 8192) and 2^-50 of the segment's, and a full
//!   tile's cells span 8 octaves at most: 2^-28, less than 2 u = 2^-23. The segment's own share
//!   is far below its pad, 16 u of its largest w, of which rounding takes up to 12.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, i32x16, mask32x16, u8x64, u32x16};

use super::cells::Candidates;
use super::queue::{Ids, PAD_PX, PLACES, Waiting};
use super::segments::LANES;
use crate::ghost::node::Node;
use crate::ghost::surface::GhostSurface;

/// Tile sizes that the walk uses: 1, 4, 16, 64 cells.
const WALK_LEVELS: usize = 4;

/// Sixteen segments under way.
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
    /// Half a pixel less the rounding of v where a line of u is crossed, and the reverse.
    clear_v: f32x16<S>,
    clear_u: f32x16<S>,
    id: u32x16<S>,
    x: i32x16<S>,
    y: i32x16<S>,
    s_in: f32x16<S>,
    /// Where it is done, at most 1.
    s_end: f32x16<S>,
    /// Level of the tile as the bytes of a table's entry: four times the level and 0 to 3.
    level: u32x16<S>,
    /// The tile: sixteen times its node, and its place in it.
    at: [u32; LANES],
    /// Under way, not waiting for the exact test.
    pub(crate) active: u32,
    /// At a cell, waiting for it.
    pub(crate) at_cell: u32,
    /// The cell where it is was tested.
    passed: u32,
    /// The segment certainly reaches the tile.
    entered: u32,
    /// It was behind the sheet, or nobody asks.
    behind: u32,
    /// Given up.
    lost: u32,
}

/// What stays the same for all steps.
pub(crate) struct Terrain<'a, S: Simd> {
    pub(crate) simd: S,
    pub(crate) surface: &'a GhostSurface,
    /// Of all nodes, one after the other.
    tiles: &'a [u32],
    /// Per level: shift to its tiles, cells of a tile's side less one, offset and stride of its
    /// nodes.
    shift: u32x16<S>,
    within: u32x16<S>,
    offset: u32x16<S>,
    stride: u32x16<S>,
    top: u32,
    /// Last cell of a row and of a column.
    last_x: u32x16<S>,
    last_y: u32x16<S>,
    pub(crate) any: bool,
}

const LEVEL_ZERO: u32 = 0x0302_0100;
const LEVEL_STEP: u32 = 0x0404_0404;

impl<'a, S: Simd> Terrain<'a, S> {
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

/// A table's entries by level.
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

    /// Notes what became of segments that are done.
    #[inline(always)]
    pub(crate) fn retire(
        &mut self,
        terrain: &Terrain<'_, S>,
        uncertain: &mut Ids,
        behind: &mut Ids,
    ) {
        let done = !(self.active | self.at_cell);
        uncertain.append(terrain.simd, self.id, self.lost);
        self.lost = 0;
        if !terrain.any {
            behind.append(terrain.simd, self.id, self.behind & done);
        }
        self.behind &= !done;
    }

    /// Puts waiting segments, from `next` on, into lanes that are free.
    #[inline(always)]
    pub(crate) fn refill(&mut self, terrain: &Terrain<'_, S>, waiting: &Waiting, next: &mut usize) {
        let simd = terrain.simd;
        let surface = terrain.surface;
        let mut free = !(self.active | self.at_cell) & 0xffff;
        let left = waiting.n - *next;
        while free.count_ones() as usize > left {
            free &= free - 1;
        }
        let from = *next;
        *next += free.count_ones() as usize;
        let lanes = mask32x16::from_bitmask(simd, u64::from(free));
        let take = |field: &[f32; PLACES], old: f32x16<S>| {
            f32x16::from_slice(simd, &field[from..from + LANES]).expand_merge(lanes, old)
        };
        self.u = take(&waiting.u, self.u);
        self.v = take(&waiting.v, self.v);
        self.du = take(&waiting.du, self.du);
        self.dv = take(&waiting.dv, self.dv);
        self.inv_du = take(&waiting.inv_du, self.inv_du);
        self.inv_dv = take(&waiting.inv_dv, self.inv_dv);
        self.dw = take(&waiting.dw, self.dw);
        self.s_end = take(&waiting.s_end, self.s_end);
        let zero = f32x16::splat(simd, 0.0);
        let w = take(&waiting.w, zero);
        let pad_w = take(&waiting.pad_w, zero);
        self.w_low = lanes.select(w - pad_w, self.w_low);
        self.w_high = lanes.select(w + pad_w, self.w_high);
        let pad_px = PAD_PX * surface.side;
        self.pad_u = self.inv_du.abs() * pad_px;
        self.pad_v = self.inv_dv.abs() * pad_px;
        let half = f32x16::splat(simd, 0.5 - pad_px);
        self.clear_v = half - self.pad_u * self.dv.abs();
        self.clear_u = half - self.pad_v * self.du.abs();
        self.id =
            u32x16::from_slice(simd, &waiting.id[from..from + LANES]).expand_merge(lanes, self.id);
        let cell = |x: f32x16<S>, n: usize| {
            x.to_int::<i32x16<S>>()
                .min(i32x16::splat(simd, n as i32 - 1))
        };
        self.x = lanes.select(cell(self.u, surface.cells_x), self.x);
        self.y = lanes.select(cell(self.v, surface.cells_y), self.y);
        self.s_in = lanes.select(zero, self.s_in);
        self.level = lanes.select(u32x16::splat(simd, terrain.top), self.level);
        self.active |= free;
        self.passed &= !free;
        self.entered |= free;
        self.behind = if terrain.any {
            self.behind | free
        } else {
            self.behind & !free
        };
        self.locate(terrain);
    }

    /// One step of every lane under way.
    #[inline(always)]
    pub(crate) fn step(&mut self, terrain: &Terrain<'_, S>) {
        let simd = terrain.simd;
        let within = lookup(terrain.within, self.level).bitcast::<i32x16<S>>();
        // The cells beyond the tile's far sides, and the lines before them: where a coordinate
        // falls, its complement rises.
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
        // Spelled out, so that the tiles go from memory into the vector without a detour.
        let (at, tiles) = (&self.at, terrain.tiles);
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
        // Past the tile.
        let position = cross_u.select(self.v, self.u) + along * cross_u.select(self.dv, self.du);
        let floor = position.floor();
        let clear = (position - floor - 0.5)
            .abs()
            .simd_lt(cross_u.select(self.clear_v, self.clear_u));
        let side = floor.to_int::<i32x16<S>>();
        let beyond_cell = cross_u.select(beyond_x, beyond_y).bitcast::<u32x16<S>>();
        let outside = beyond_cell.simd_gt(cross_u.select(terrain.last_x, terrain.last_y));
        let ends = passes & bits(certain & (near.simd_gt(self.s_end) | outside));
        let moves = passes & !ends & bits(certain & clear);
        let lost = passes & !ends & !moves;
        // In the image by the bounds above: the limits only keep wrong ones from reading beyond it.
        let limit = |to: i32x16<S>, last| to.bitcast::<u32x16<S>>().min(last).bitcast();
        let to_x: i32x16<S> = limit(cross_u.select(beyond_x, side), terrain.last_x);
        let to_y: i32x16<S> = limit(cross_u.select(side, beyond_y), terrain.last_y);
        // Still below the same tile of the level above: that one is known to overlap.
        let differ = ((to_x ^ self.x) | (to_y ^ self.y)) >> 2;
        let rises = moves & bits(differ.simd_gt(within));
        let moving = lanes(simd, moves);
        self.s_in = moving.select(near.max(f32x16::splat(simd, 0.0)), self.s_in);
        self.x = moving.select(to_x, self.x);
        self.y = moving.select(to_y, self.y);
        let reaches = overlaps & bits(self.level.simd_eq(u32x16::splat(simd, LEVEL_ZERO)));
        let descends = lanes(simd, overlaps & !reaches);
        let up = (self.level + LEVEL_STEP).min(u32x16::splat(simd, terrain.top));
        self.level = lanes(simd, rises).select(up, self.level);
        self.level = descends.select(self.level - LEVEL_STEP, self.level);
        self.passed &= !moves;
        self.entered &= !moves | bits(far.simd_le(self.s_end));
        self.at_cell |= reaches;
        self.active &= !(reaches | lost | ends);
        self.locate(terrain);
        self.lost |= lost;
    }

    /// Where each lane's tile is: known a turn ahead, so that its load need not wait for it.
    #[inline(always)]
    fn locate(&mut self, terrain: &Terrain<'_, S>) {
        let level = self.level;
        let shift = lookup(terrain.shift, level);
        let x = self.x.bitcast::<u32x16<S>>() >> shift;
        let y = self.y.bitcast::<u32x16<S>>() >> shift;
        let node =
            lookup(terrain.offset, level) + (y >> 2) * lookup(terrain.stride, level) + (x >> 2);
        self.at = ((node << 4) | ((y & 3) << 2) | (x & 3)).to_array();
    }

    /// Appends the cells that lanes wait for.
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

    /// Lets lanes that waited go on if their cells held nothing. `answers` has a bit for each,
    /// in the order of [`Self::candidates`].
    #[inline(always)]
    pub(crate) fn resume(&mut self, simd: S, answers: Answers) -> Answers {
        let waited = mask32x16::from_bitmask(simd, u64::from(self.at_cell));
        let goes_on = spread(simd, answers.goes_on, waited);
        let behind = spread(simd, answers.behind, waited);
        self.behind |= behind;
        let n = self.at_cell.count_ones();
        self.at_cell = 0;
        self.active |= goes_on;
        self.passed |= goes_on;
        Answers {
            goes_on: (u64::from(answers.goes_on) >> n) as u32,
            behind: (u64::from(answers.behind) >> n) as u32,
        }
    }
}

/// The lowest bits, one for each lane of a mask.
#[inline(always)]
fn spread<S: Simd>(simd: S, bits: u32, lanes: mask32x16<S>) -> u32 {
    let set = mask32x16::from_bitmask(simd, u64::from(bits & 0xffff));
    let one = set.select(i32x16::splat(simd, 1), i32x16::splat(simd, 0));
    one.expand(lanes).simd_eq(1).to_bitmask() as u32
}

/// Per tested cell, as bits: its segment goes on, and was behind the sheet.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Answers {
    pub(crate) goes_on: u32,
    pub(crate) behind: u32,
}
